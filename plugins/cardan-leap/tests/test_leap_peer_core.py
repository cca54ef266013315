"""The simulated tracking service in virtual time."""

from __future__ import annotations

import json
from itertools import pairwise

import pytest

from cardan.errors import ScriptError
from cardan_leap.peer import FAULTS, SimulatedLeapService
from cardan_leap.protocol import DeviceEvent, Malformed, TrackingFrame, Version, decode_service

BACKGROUND = '{"background":true}'
FOCUSED = '{"focused":true}'


def run(service, until_s):
    """Advance, and return the decoded messages by client."""
    service.advance(until_s)
    reported: dict[int, list] = {number: [] for number in service.clients}
    for number, text in service.outgoing():
        reported.setdefault(number, []).append(decode_service(text))
    return reported


def frames_of(messages):
    return [message for message in messages if isinstance(message, TrackingFrame)]


def listening(**options):
    """A service whose client 1 receives frames and has read its version."""
    service = SimulatedLeapService(**options)
    assert service.connect(1, 6) is None
    service.receive(1, BACKGROUND, 0.0)
    service.outgoing()
    return service


class TestHandshake:
    def test_version_then_device_then_frames(self):
        service = SimulatedLeapService()
        service.connect(1, 6)
        service.receive(1, BACKGROUND, 0.0)
        messages = run(service, 0.1)[1]
        assert messages[0] == Version(6, "2.3.1+33747")
        assert messages[1] == DeviceEvent("LP00000000001", "peripheral", True, True)
        assert all(isinstance(message, TrackingFrame) for message in messages[2:])
        assert len(messages) > 5

    def test_older_versions_get_no_device_event_first(self):
        service = SimulatedLeapService()
        service.connect(1, 4)
        assert run(service, 0.0)[1] == [Version(4, "2.3.1+33747")]

    def test_unsupported_versions_are_closed(self):
        assert SimulatedLeapService().connect(1, 7) == 1001
        service = SimulatedLeapService(faults={"highest-version": 4.0})
        assert service.connect(1, 5) == 1001
        assert service.clients == ()
        assert service.connect(2, 4) is None

    def test_mute(self):
        service = listening(faults={"mute": 1.0})
        assert run(service, 1.0) == {1: []}


class TestFocus:
    def test_nobody_gets_frames_without_asking(self):
        service = SimulatedLeapService()
        service.connect(1, 6)
        assert frames_of(run(service, 0.1)[1]) == []

    def test_focus_is_taken_from_others_and_dropped(self):
        service = SimulatedLeapService()
        for number in (1, 2):
            service.connect(number, 6)
            service.receive(number, FOCUSED, 0.0)
        reported = run(service, 0.1)
        assert frames_of(reported[1]) == []
        assert frames_of(reported[2])
        service.receive(1, '{"focused":false}', 0.1)
        assert service.focused == 2
        service.receive(2, '{"focused":false}', 0.1)
        assert frames_of(run(service, 0.2)[2]) == []

    def test_background_clients_get_frames_whichever_program_has_the_focus(self):
        service = listening()
        service.connect(2, 6)
        service.receive(2, FOCUSED, 0.0)
        reported = run(service, 0.1)
        assert frames_of(reported[1])
        assert frames_of(reported[2])
        service.disconnect(2)
        assert service.focused is None
        assert frames_of(run(service, 0.2)[1])

    def test_heartbeats_of_versions_2_and_3(self):
        service = SimulatedLeapService()
        service.connect(1, 3)
        service.receive(1, BACKGROUND, 0.0)
        assert frames_of(run(service, 0.1)[1]) == []
        service.receive(1, '{"heartbeat":true}', 0.1)
        assert frames_of(run(service, 0.2)[1])
        run(service, 0.35)
        assert frames_of(run(service, 0.5)[1]) == []

    def test_version_1_gets_frames_at_once(self):
        service = SimulatedLeapService()
        service.connect(1, 1)
        assert frames_of(run(service, 0.1)[1])

    def test_nonsense_and_unknown_keys_are_logged_and_change_nothing(self):
        service = listening()
        for text in (b"\xff", "{", '{"x":1}', '{"background":"no"}', "[]"):
            service.receive(1, text, 0.0)
        service.receive(9, FOCUSED, 0.0)
        assert len(service.requests) == 7
        assert frames_of(run(service, 0.1)[1])


class TestFrames:
    def test_rate_jitter_ids_and_timestamps(self):
        service = listening(rate_hz=100.0, jitter=0.5)
        frames = frames_of(run(service, 10.0)[1])
        assert 1000 <= len(frames) <= 1001
        assert [frame.id for frame in frames] == list(range(1, len(frames) + 1))
        gaps = [b.timestamp_us - a.timestamp_us for a, b in pairwise(frames)]
        assert 5000 <= min(gaps) < 7000 < 13000 < max(gaps) <= 15001
        assert frames[0].current_frame_rate_hz == 0.0
        assert frames[-1].current_frame_rate_hz == pytest.approx(100.0, rel=0.2)

    def test_a_late_service_leaves_frames_out(self):
        service = listening()
        run(service, 1.0)
        service.skip_to(2.0)
        frames = frames_of(run(service, 2.01)[1])
        assert 1 <= len(frames) <= 2
        assert frames[0].id > 215

    def test_hands_get_new_ids_and_come_in_no_order(self):
        service = listening()
        service.enter("right")
        service.enter("left")
        frames = frames_of(run(service, 0.1)[1])
        orders = {tuple(hand.id for hand in frame.hands) for frame in frames}
        assert orders == {(1, 2), (2, 1)}
        service.leave("right")
        service.enter("right")
        ids = {hand.id for hand in frames_of(run(service, 0.2)[1])[0].hands}
        assert ids == {2, 3}
        service.new_id("left")
        assert {hand.id for hand in frames_of(run(service, 0.3)[1])[0].hands} == {3, 4}

    def test_versions_side_by_side(self):
        service = listening()
        service.connect(2, 1)
        service.enter("left")
        reported = run(service, 0.05)
        assert frames_of(reported[1])[0].hands[0].type == "left"
        assert frames_of(reported[2])[0].hands[0].type == ""


class TestDevice:
    def test_unplug_and_replug(self):
        service = listening()
        service.connect(2, 3)
        service.outgoing()
        service.unplug()
        reported = run(service, 0.1)
        assert [(e.attached, e.streaming) for e in reported[1]] == [(True, False), (False, False)]
        assert reported[2] == [DeviceEvent("", "", False, False)] * 2
        service.replug()
        messages = run(service, 0.2)[1]
        assert [(e.attached, e.streaming) for e in messages[:2]] == [(True, False), (True, True)]
        assert frames_of(messages)

    def test_restart(self):
        service = listening()
        service.enter("right")
        service.new_id("right")
        run(service, 1.0)
        service.restart(0.5)
        assert not service.plugged
        assert service.clients == ()
        assert service.restarts == 1
        run(service, 1.6)
        assert service.plugged
        service.connect(1, 6)
        service.receive(1, BACKGROUND, 1.6)
        frame = frames_of(run(service, 1.7)[1])[0]
        assert frame.hands[0].id == 1
        assert frame.id < 60


class TestFaults:
    @pytest.mark.parametrize("fault", [switch.name for switch in FAULTS])
    def test_each_runs_with_its_default(self, fault):
        switch = next(switch for switch in FAULTS if switch.name == fault)
        faults = {fault: switch.default}
        if fault == "replug":
            faults["unplug"] = 1.0
        service = SimulatedLeapService(faults=faults, rate_hz=30.0)
        service.connect(1, 4)
        service.receive(1, BACKGROUND, 0.0)
        service.enter("right")
        run(service, 6.0)

    def messages(self, fault, value, seconds=1.0):
        service = listening(faults={fault: value})
        service.enter("right")
        return run(service, seconds)[1]

    def test_malformed(self):
        messages = self.messages("malformed", 4.0)
        assert [isinstance(m, Malformed) for m in messages[:8]] == [False, False, False, True] * 2

    def test_hands_that_cannot_be_used(self):
        unreadable = [frame.unreadable_hands for frame in self.messages("no-palm", 2.0)]
        assert unreadable[:4] == [0, 1, 0, 1]
        far = [frame.hands[0].palm_position_mm.z for frame in self.messages("absurd", 2.0)]
        assert far[:4] == [0.0, -5000.0, 0.0, -5000.0]
        assert {f.hands[0].confidence for f in self.messages("confidence", 0.2)} == {0.2}

    def test_ids(self):
        assert [frame.id for frame in self.messages("repeat", 2.0)][:6] == [1, 2, 2, 3, 4, 4]
        ids = [frame.id for frame in self.messages("count-anew", 0.5)]
        assert ids.count(1) == 2
        hands = {frame.hands[0].id for frame in self.messages("new-ids", 0.3)}
        assert hands == {1, 2, 3, 4}

    def test_silences(self):
        stamps = [f.timestamp_us for f in self.messages("stall", 0.5, 6.0)]
        gaps = [b - a for a, b in pairwise(stamps)]
        assert max(gaps) == pytest.approx(500_000, abs=20_000)
        half = self.messages("drop", 0.5, 4.0)
        assert 150 < len(half) < 300
        service = listening(faults={"burst": 0.5})
        assert len(run(service, 0.4)[1]) > 30
        assert run(service, 0.9) == {1: []}
        assert len(run(service, 1.1)[1]) > 70

    def test_unknown_messages_come_between(self):
        messages = self.messages("unknown", 2.0)
        assert (
            sum(not isinstance(m, TrackingFrame) for m in messages) == len(frames_of(messages)) // 2
        )

    def test_lost_focus(self):
        service = SimulatedLeapService(faults={"lost-focus": 0.5})
        service.connect(1, 6)
        service.receive(1, FOCUSED, 0.0)
        assert frames_of(run(service, 0.4)[1])
        run(service, 0.6)
        assert run(service, 1.0)[1] == []

    @pytest.mark.parametrize(
        ("faults", "words"),
        [
            ({"nosuch": 1.0}, "there is no fault"),
            ({"drop": 2.0}, "not in 0 to 1"),
            ({"replug": 1.0}, "needs the fault unplug"),
        ],
    )
    def test_nonsense(self, faults, words):
        with pytest.raises(ScriptError, match=words):
            SimulatedLeapService(faults=faults)


def test_messages_are_compact_json_with_sorted_keys():
    service = SimulatedLeapService()
    service.connect(1, 6)
    service.receive(1, BACKGROUND, 0.0)
    service.enter("right")
    service.advance(0.1)
    for _, text in service.outgoing():
        assert text == json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))
