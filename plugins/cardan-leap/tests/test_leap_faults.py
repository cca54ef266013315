"""Unplug, silence, lost links, garbage: neutral within 100 ms, and live only after neutral."""

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


def assert_re_arms_only_after_neutral(rig, clutch) -> None:
    """With the hand as it was nothing happens; after neutral the clutch works anew."""
    for _ in range(100):
        assert "clutch" not in rig.frame(hand(**HELD[clutch])).buttons
    assert rig.state.link is DeviceLink.NEEDS_NEUTRAL
    rest = NEUTRAL[clutch]
    rig.frame(*[] if rest is None else [hand(**rest)])
    assert rig.state.link is DeviceLink.LIVE
    rig.frames(0.7, hand(**HELD[clutch]))
    assert "clutch" in rig.state.buttons


@pytest.mark.parametrize("clutch", CLUTCHES)
class TestLinkFaults:
    def test_silence(self, clutch):
        rig = engaged(clutch)
        assert "clutch" in rig.wait(STALE_AFTER_S - 0.001).buttons
        assert_neutral(rig.wait(0.002))
        assert rig.state.link is DeviceLink.STALE
        assert set(rig.edges()) >= {"-hand", "-clutch"}
        assert_re_arms_only_after_neutral(rig, clutch)
        assert rig.core.metrics(rig.now_s)["silences"] == 1

    def test_garbage(self, clutch):
        rig = engaged(clutch)
        assert_neutral(rig.garbage(0.1))
        assert_re_arms_only_after_neutral(rig, clutch)

    def test_frames_that_do_not_get_newer(self, clutch):
        rig = engaged(clutch)
        for _ in range(12):
            rig.frame(hand(**HELD[clutch]), frame_id=7)
        assert_neutral(rig.state)
        assert_re_arms_only_after_neutral(rig, clutch)

    def test_a_count_that_begins_anew(self, clutch):
        rig = engaged(clutch)
        rig.frame_id = 0
        for _ in range(11):
            rig.frame(hand(**HELD[clutch]))
        assert_neutral(rig.state)
        assert_re_arms_only_after_neutral(rig, clutch)

    def test_the_connection_is_lost(self, clutch):
        rig = engaged(clutch)
        rig.core.on_lost("gone", rig.now_s)
        assert_neutral(rig.state)
        assert (rig.state.link, rig.state.reason) == (DeviceLink.LOST, "gone")
        rig.frame(hand(**HELD[clutch]))
        assert rig.state.link is DeviceLink.LOST
        rig.core.on_opened(rig.now_s)
        rig.tell(PLUGGED)
        rig.frame_id = 0
        assert_re_arms_only_after_neutral(rig, clutch)

    @pytest.mark.parametrize(
        ("attached", "link", "words"),
        [(True, DeviceLink.STALE, "does not deliver"), (False, DeviceLink.LOST, "unplugged")],
    )
    def test_the_tracker(self, clutch, attached, link, words):
        rig = engaged(clutch)
        rig.tell(DeviceEvent("LP1", "peripheral", attached, streaming=False))
        assert_neutral(rig.state)
        assert rig.state.link is link
        assert words in rig.state.reason
        # Some services go on with empty frames.
        assert rig.frames(0.3).link is link
        rig.tell(PLUGGED)
        assert_neutral(rig.state)
        assert_re_arms_only_after_neutral(rig, clutch)

    def test_another_tracker_keeps_it_alive(self, clutch):
        rig = engaged(clutch)
        rig.tell(DeviceEvent("LP2", "laptop", attached=False, streaming=False))
        assert "clutch" in rig.frame(hand(**HELD[clutch])).buttons


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
    rig = engaged(clutch)
    for _ in range(30):
        hands = [] if bad is None else [hand(**{**HELD[clutch], **bad})]
        state = rig.frame(*hands, unreadable=unreadable)
        if "clutch" not in state.buttons:
            break
    assert state.link is DeviceLink.LIVE
    assert "clutch" not in state.buttons
    assert rig.core.metrics(rig.now_s)["hands_lost"] == 1
    # No frame at all after the last measurement: the same.
    again = engaged(clutch)
    again.frame(unreadable=1)
    again.frame(unreadable=1)
    again.wait(STALE_AFTER_S - 0.005)
    assert "clutch" not in again.state.buttons


def test_a_burst_of_old_frames_neither_engages_nor_re_arms():
    rig = engaged("still")
    rig.wait(0.5)
    assert_neutral(rig.state)
    for _ in range(55):  # all that queued up, at one moment, the last without a hand
        rig.frame(hand())
        rig.now_s -= PERIOD_S
    rig.frame()
    assert_neutral(rig.state)
    rig.frames(0.3, hand())
    assert "clutch" not in rig.state.buttons
    assert rig.frame().link is DeviceLink.LIVE
    for _ in range(55):
        rig.frame(hand(2))
        rig.now_s -= PERIOD_S
    assert rig.state.buttons == {"hand"}


def drive(script: str, seconds: float, faults=None, clutch="still"):
    """States of a core every 5 ms behind a simulated service, in virtual time."""
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
    """While the clutch is held the pose moves no faster than a hand, and is never old."""
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
    """Every trouble releases the clutch; each new entry of the hand engages it again."""
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
