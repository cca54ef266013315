"""Scripts for the hands above the simulated tracker."""

from __future__ import annotations

import pytest

from cardan.errors import ScriptError
from cardan.sim_peers.base import parse_script
from cardan.sim_peers.scripted import play
from cardan_leap.peer import SCRIPT_VERBS, SCRIPTS, ScriptedHands, SimulatedLeapService
from cardan_leap.protocol import TrackingFrame, decode_service

pytestmark = pytest.mark.matrix


def frames(text, until_s, step_s=None):
    """Frames of a script, with the times at which they were sent."""
    service = SimulatedLeapService(jitter=0.0)
    service.connect(1, 6)
    service.receive(1, '{"background":true}', 0.0)
    hands = ScriptedHands(parse_script(text, SCRIPT_VERBS))
    sent = play(service, hands, until_s)
    reported = [(time_s, decode_service(message)) for time_s, _, message in sent]
    return [
        (time_s, frame) for time_s, frame in reported if isinstance(frame, TrackingFrame)
    ], service


def at(reported, time_s):
    """Return the only hand of the first frame at or after `time_s`."""
    frame = next(frame for sent_s, frame in reported if sent_s >= time_s)
    (hand,) = frame.hands
    return hand


def test_enter_move_and_leave():
    reported, _ = frames(
        "0.1 enter left 10 150 20\n1 move left 110 150 20 over 1\n3 leave left", 4.0
    )
    assert reported[0][1].hands == ()
    assert at(reported, 0.5).palm_position_mm == (10.0, 150.0, 20.0)
    assert at(reported, 0.5).type == "left"
    assert at(reported, 1.5).palm_position_mm.x == pytest.approx(60.0, abs=1.5)
    assert at(reported, 1.1).palm_position_mm.x < 15.0  # It starts smoothly.
    assert at(reported, 2.5).palm_position_mm == (110.0, 150.0, 20.0)
    assert reported[-1][1].hands == ()


def test_tilt_swing_grab_pinch_and_confidence():
    text = """
        0 enter right
        0 tilt right 30 0 0
        1 swing right 0 0 -40 0 0 20 over 1
        3 grab right 1 over 0.5
        4 pinch right 0.5
        5 confidence right 0.2
    """
    reported, _ = frames(text, 6.0)
    assert at(reported, 0.5).direction == pytest.approx((0.0, 0.5, -0.866025))
    assert at(reported, 1.25).palm_position_mm.z == pytest.approx(-40.0, abs=0.2)
    assert at(reported, 2.5).palm_position_mm == (0.0, 200.0, 0.0)
    assert 0.0 < (at(reported, 3.25).grab_strength or 0.0) < 1.0
    assert at(reported, 3.6).grab_strength == 1.0
    assert at(reported, 4.1).pinch_strength == 0.5
    assert at(reported, 5.1).confidence == 0.2


def test_what_happens_to_the_service():
    text = """
        0 enter right
        1 new-id right
        2 stall
        2.5 resume
        3 malformed 2
        4 pause
        4.5 unpause
        5 unplug
        5.5 replug
        6 restart 0.5
    """
    reported, service = frames(text, 7.0)
    assert at(reported, 0.5).id == 1
    assert at(reported, 1.5).id == 2
    for start_s, end_s in ((2.0, 2.5), (4.0, 4.5), (5.0, 5.5), (6.0, 7.0)):
        assert not [time_s for time_s, _ in reported if start_s + 0.02 < time_s < end_s]
    assert sum(2.999 <= time_s < 3.05 for time_s, _ in reported) == 6 - 2
    assert service.restarts == 1


def test_a_hand_that_comes_back_begins_at_rest():
    reported, _ = frames("0 enter right\n0 grab right 1\n1 leave right\n2 enter right", 3.0)
    assert at(reported, 2.5).grab_strength == 0.0
    assert at(reported, 2.5).id == 2


def test_loop():
    reported, _ = frames("0.5 enter right\n1 leave right\n1.5 loop", 6.0)
    assert len({frame.hands[0].id for _, frame in reported if frame.hands}) == 4


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_built_in_scripts_begin_without_a_hand(name):
    reported, _ = frames(SCRIPTS[name], 5.0)
    assert reported[0][1].hands == ()


def test_the_demo_returns_to_where_it_began():
    """The robot's total motion, over both engagements of the clutch, is zero."""
    reported, _ = frames(SCRIPTS["demo"], 24.0)
    by_hand: dict[int, list] = {}
    for _, frame in reported:
        for hand in frame.hands:
            by_hand.setdefault(hand.id, []).append(hand.palm_position_mm)
    assert len(by_hand) == 2
    total = [0.0, 0.0, 0.0]
    for positions in by_hand.values():
        for axis in range(3):
            total[axis] += positions[-1][axis] - positions[0][axis]
    assert total == pytest.approx([0.0, 0.0, 0.0], abs=0.1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 enter", "must be left or right"),
        ("0 enter both", "must be left or right"),
        ("0 enter right 1 2", "Z is missing"),
        ("0 move right 1 2 x", "Z is 'x', must be a number from -2000 to 2000"),
        ("0 tilt right 0 200 0", "YAW is '200'"),
        ("0 grab right 2", "must be a number from 0 to 1"),
        ("0 swing right 1 2 3", "'over' is missing"),
        ("0 swing right 1 2 3 over 0", "SECONDS is '0'"),
        ("0 grab right 1 over", "SECONDS is missing"),
        ("0 leave right now", "'now' is too much"),
        ("0 restart -1", "must be a number from 0"),
        ("0 loop", "must be the last step"),
        ("1 loop\n2 unplug", "must be the last step"),
        ("0 wave right", "comes one of"),
    ],
)
def test_nonsense_is_named(text, words):
    with pytest.raises(ScriptError, match=words):
        ScriptedHands(parse_script(text, SCRIPT_VERBS))
