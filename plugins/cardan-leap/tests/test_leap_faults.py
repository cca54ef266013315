"""Unplugging, silence, lost links, invalid data: neutral within 100 ms, and live only after a
neutral state."""

from __future__ import annotations

import pytest

from cardan.sim_peers.base import parse_script
from cardan.sim_peers.scripted import play
from cardan.types import DeviceLink, DeviceState, Quaternion, Vector3
from cardan_leap.driver import LeapCore, LeapOptions
from cardan_leap.driver.core import STALE_AFTER_S
from cardan_leap.peer import SCRIPT_VERBS, SCRIPTS, ScriptedHands, SimulatedLeapService
from cardan_leap.protocol import DeviceEvent, decode_service
from leap_frames import PERIOD_S, PLUGGED, engaged, hand

pytestmark = pytest.mark.matrix

CLUTCHES = ("still", "open", "grab", "pinch")
HELD = {"still": {}, "open": {}, "grab": {"grab_strength": 1.0}, "pinch": {"pinch_strength": 1.0}}
NEUTRAL = {
    "still": None,
    "open": {"grab_strength": 1.0},
    "grab": {},
    "pinch": {},
}


def assert_neutral(state: DeviceState) -> None:
    assert state.link is not DeviceLink.LIVE
    assert state.reason
    assert state.pose is None
    assert state.buttons == frozenset()
    assert state.axes == (0.0,) * 6


def assert_re_arms_only_after_neutral(bench, clutch) -> None:
    """Check that an unchanged hand engages nothing, and that after neutral the clutch works
    again."""
    for _ in range(100):
        assert "clutch" not in bench.frame(hand(**HELD[clutch])).buttons
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    rest = NEUTRAL[clutch]
    bench.frame(*[] if rest is None else [hand(**rest)])
    assert bench.state.link is DeviceLink.LIVE
    bench.frames(0.7, hand(**HELD[clutch]))
    assert "clutch" in bench.state.buttons


@pytest.mark.parametrize("clutch", CLUTCHES)
class TestLinkFaults:
    def test_silence(self, clutch):
        bench = engaged(clutch)
        assert "clutch" in bench.wait(STALE_AFTER_S - 0.001).buttons
        assert_neutral(bench.wait(0.002))
        assert bench.state.link is DeviceLink.STALE
        assert set(bench.edges()) >= {"-hand", "-clutch"}
        assert_re_arms_only_after_neutral(bench, clutch)
        assert bench.core.metrics(bench.now_s)["silences"] == 1

    def test_garbage(self, clutch):
        bench = engaged(clutch)
        assert_neutral(bench.garbage(0.1))
        assert_re_arms_only_after_neutral(bench, clutch)

    def test_frames_that_do_not_get_newer(self, clutch):
        bench = engaged(clutch)
        for _ in range(12):
            bench.frame(hand(**HELD[clutch]), frame_id=7)
        assert_neutral(bench.state)
        assert_re_arms_only_after_neutral(bench, clutch)

    def test_a_count_that_begins_anew(self, clutch):
        bench = engaged(clutch)
        bench.frame_id = 0
        for _ in range(11):
            bench.frame(hand(**HELD[clutch]))
        assert_neutral(bench.state)
        assert_re_arms_only_after_neutral(bench, clutch)

    def test_the_connection_is_lost(self, clutch):
        bench = engaged(clutch)
        bench.core.on_lost("gone", bench.now_s)
        assert_neutral(bench.state)
        assert (bench.state.link, bench.state.reason) == (DeviceLink.LOST, "gone")
        bench.frame(hand(**HELD[clutch]))
        assert bench.state.link is DeviceLink.LOST
        bench.core.on_opened(bench.now_s)
        bench.tell(PLUGGED)
        bench.frame_id = 0
        assert_re_arms_only_after_neutral(bench, clutch)

    @pytest.mark.parametrize(
        ("attached", "link", "words"),
        [(True, DeviceLink.STALE, "sends no frames"), (False, DeviceLink.LOST, "unplugged")],
    )
    def test_the_tracker(self, clutch, attached, link, words):
        bench = engaged(clutch)
        bench.tell(DeviceEvent("LP1", "peripheral", attached, streaming=False))
        assert_neutral(bench.state)
        assert bench.state.link is link
        assert words in bench.state.reason
        # Some services continue with empty frames.
        assert bench.frames(0.3).link is link
        bench.tell(PLUGGED)
        assert_neutral(bench.state)
        assert_re_arms_only_after_neutral(bench, clutch)

    def test_another_tracker_keeps_it_alive(self, clutch):
        bench = engaged(clutch)
        bench.tell(DeviceEvent("LP2", "laptop", attached=False, streaming=False))
        assert "clutch" in bench.frame(hand(**HELD[clutch])).buttons


@pytest.mark.parametrize("clutch", CLUTCHES)
@pytest.mark.parametrize(
    ("bad", "unreadable"),
    [
        ({"confidence": 0.1}, 0),
        ({"position": Vector3(0.0, 0.0, 3.0)}, 0),
        ({"position": Vector3(0.9, 0.0, 0.2)}, 0),
        ({"orientation": Quaternion(0.0, 1.0, 0.0, 0.0)}, 0),
        (None, 1),
    ],
)
def test_a_hand_that_is_not_measured_is_lost(clutch, bad, unreadable):
    bench = engaged(clutch)
    for _ in range(30):
        hands = [] if bad is None else [hand(**{**HELD[clutch], **bad})]
        state = bench.frame(*hands, unreadable=unreadable)
        if "clutch" not in state.buttons:
            break
    assert state.link is DeviceLink.LIVE
    assert "clutch" not in state.buttons
    assert bench.core.metrics(bench.now_s)["hands_lost"] == 1
    # The same without any frame after the last measurement.
    again = engaged(clutch)
    again.frame(unreadable=1)
    again.frame(unreadable=1)
    again.wait(STALE_AFTER_S - 0.005)
    assert "clutch" not in again.state.buttons


def test_a_burst_of_old_frames_neither_engages_nor_re_arms():
    bench = engaged("still")
    bench.wait(0.5)
    assert_neutral(bench.state)
    for _ in range(55):  # All queued frames arrive at one moment, the last without a hand.
        bench.frame(hand())
        bench.now_s -= PERIOD_S
    bench.frame()
    assert_neutral(bench.state)
    bench.frames(0.3, hand())
    assert "clutch" not in bench.state.buttons
    assert bench.frame().link is DeviceLink.LIVE
    for _ in range(55):
        bench.frame(hand(2))
        bench.now_s -= PERIOD_S
    assert bench.state.buttons == {"hand"}


def drive(script: str, seconds: float, faults=None, clutch="still"):
    """States of a core every 5 ms, connected to a simulated service, in virtual time."""
    service = SimulatedLeapService(faults=faults)
    hands = ScriptedHands(parse_script(SCRIPTS[script], SCRIPT_VERBS))
    core = LeapCore(LeapOptions(clutch=clutch))

    def reconnect(now_s: float) -> None:
        core.on_opened(now_s)
        service.connect(1, 6)
        service.receive(1, '{"background":true}', now_s)

    reconnect(0.0)
    restarts = 0
    for tick in range(int(seconds * 200)):
        now_s = tick * 0.005
        for _, _, text in play(service, hands, now_s):
            core.on_message(decode_service(text), now_s)
        if service.restarts > restarts:
            restarts = service.restarts
            core.on_lost("gone", now_s)
        if service.plugged and not service.clients:
            reconnect(now_s)
        yield now_s, core, core.state(now_s)


FAULTS = {
    "unplug": 3.5,
    "pause": 3.5,
    "stall": 0.3,
    "burst": 0.5,
    "drop": 0.3,
    "restart": 3.5,
    "malformed": 2.0,
    "unknown": 2.0,
    "no-palm": 2.0,
    "absurd": 3.0,
    "repeat": 1.0,
    "count-anew": 3.5,
    "new-ids": 0.9,
    "confidence": 0.1,
    "no-device": 1.0,
    "mute": 1.0,
}


@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_no_fault_makes_a_pose_jump_or_go_on(fault):
    """While the clutch is held the pose moves no faster than a hand, and is always fresh."""
    last = None
    held_s = 0.0
    for _, _, state in drive("demo", 9.0, {fault: FAULTS[fault]}):
        if "clutch" in state.buttons:
            assert state.pose is not None
            held_s += 0.005
            if last is not None:
                gap = max(abs(a - b) for a, b in zip(state.pose.position, last, strict=True))
                assert gap <= 0.04
            last = state.pose.position
        else:
            last = None
        if state.link is not DeviceLink.LIVE:
            assert_neutral(state)
    if fault in ("confidence", "no-device", "mute", "burst"):
        assert held_s == 0.0
    elif fault not in ("new-ids",):
        assert held_s > 1.0


def test_the_script_of_troubles_holds_and_lets_go():
    """Every fault releases the clutch; each new entry of the hand engages it again."""
    presses = []
    links = set()
    for _, core, state in drive("trouble", 31.0):
        presses += [
            (round(event.stamp_s, 1), event.pressed)
            for event in core.events()
            if event.button == "clutch"
        ]
        links.add(state.link)
    assert [pressed for _, pressed in presses] == [True, False] * (len(presses) // 2)
    assert len(presses) >= 8
    assert links == {
        DeviceLink.LIVE,
        DeviceLink.STALE,
        DeviceLink.LOST,
        DeviceLink.NEEDS_NEUTRAL,
    }
