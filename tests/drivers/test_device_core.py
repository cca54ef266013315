"""Tests common to the cores of all devices: link, buttons, counters, and diagnosis texts."""

from typing import ClassVar

import pytest

from cardan.drivers import buttons
from cardan.drivers.core import DeviceCore
from cardan.drivers.spacemouse import SpaceMouseCore, SpaceMouseOptions
from cardan.types import NEVER_S, DeviceLink, Pose, Quaternion, Vector3, Wrench

REST = (0.0,) * 6
AWAY = (0.5, 0.0, 0.0, 0.0, 0.0, -1.0)
POSE = Pose(Vector3(0.1, 0.0, 0.2), Quaternion(1.0, 0.0, 0.0, 0.0))
SETTLE_S = 0.02


class Lever(DeviceCore):
    """Core of a lever with a button, which reports continuously and is silent while it is
    faulty."""

    _counters: ClassVar = {"silences": "silences", "odd": "odd reports"}

    def __init__(self):
        super().__init__()
        self.axes = REST
        self.wrench = None
        self.dropped = 0

    def on_opened(self, now_s):
        self._begin("touch it once", now_s)

    def on_report(self, axes, labels, now_s):
        if self._link is DeviceLink.STALE:
            self._resume("the device fell silent", SETTLE_S, now_s)
        self._heard = True
        self._stamp_s = now_s
        self.axes = axes
        self._buttons.set(labels, now_s)
        at_rest = not any(axes) and now_s >= self._ignore_rest_until_s
        if self._link is DeviceLink.NEEDS_NEUTRAL and at_rest:
            self._link = DeviceLink.LIVE
        self._cached = None

    def _watch(self, now_s):
        if self._link is DeviceLink.LIVE and now_s - self._stamp_s > 0.1:
            self._fall_silent("no report for 0.1 s", now_s)

    def _drop_input(self, now_s):
        self.axes = REST
        self.dropped += 1

    def _axes(self, now_s):
        return self.axes

    def _pose(self):
        return POSE

    def _wrench(self):
        return self.wrench

    def _notes(self, now_s):
        return ["its cable is worn"] if self._open else []

    def _figures(self, now_s):
        return {"report_age_s": now_s - self._stamp_s}


@pytest.fixture
def live():
    lever = Lever()
    lever.on_opened(1.0)
    lever.on_report(REST, (), 1.0)
    lever.on_report(AWAY, ("trigger",), 1.01)
    return lever


def test_before_it_is_opened():
    lever = Lever()
    state = lever.state(0.0)
    assert (state.link, state.reason) == (DeviceLink.CLOSED, "not opened")
    assert (state.stamp_s, state.axes, state.buttons) == (NEVER_S, REST, frozenset())
    assert (state.pose, state.battery, state.wrench) == (None, None, None)
    assert not lever.heard
    assert lever.diagnosis(0.0) == ["not opened"]


def test_it_counts_once_it_was_seen_at_rest(live):
    state = live.state(1.02)
    assert (state.link, state.reason, state.stamp_s) == (DeviceLink.LIVE, "", 1.01)
    assert (state.axes, state.pose, state.buttons) == (AWAY, POSE, {"trigger"})
    assert live.heard
    assert [(event.button, event.pressed) for event in live.events()] == [("trigger", True)]


def test_a_state_is_built_once_for_each_change(live):
    first = live.state(1.02)
    assert live.state(1.03) is first
    live.on_report(AWAY, ("trigger",), 1.04)
    assert live.state(1.04) is not first


def test_silence_takes_everything_away_and_is_counted(live):
    live.events()
    state = live.state(1.2)
    assert (state.link, state.reason) == (DeviceLink.STALE, "no report for 0.1 s")
    assert (state.axes, state.pose, state.buttons) == (REST, None, frozenset())
    assert [event.pressed for event in live.events()] == [False]
    assert live.metrics(1.2)["silences"] == 1
    assert "1 silences" in live.diagnosis(1.2)


def test_rest_right_after_a_silence_may_be_an_old_report(live):
    assert live.state(1.2).link is DeviceLink.STALE
    live.on_report(REST, (), 1.3)
    state = live.state(1.3)
    assert (state.link, state.reason) == (DeviceLink.NEEDS_NEUTRAL, "the device fell silent")
    live.on_report(REST, (), 1.3 + SETTLE_S)
    assert live.state(1.32).link is DeviceLink.LIVE


def test_a_button_that_was_held_through_trouble_is_no_press(live):
    assert live.state(1.2).buttons == frozenset()
    live.on_report(REST, ("trigger",), 1.3)
    assert live.state(1.3).buttons == frozenset()
    assert live.state(1.3).masked == {"trigger"}
    live.on_report(REST, (), 1.31)
    assert live.state(1.31).masked == frozenset()
    live.on_report(REST, ("trigger",), 1.32)
    assert live.state(1.32).buttons == {"trigger"}


@pytest.mark.parametrize(
    ("end", "link", "reason"),
    [
        (lambda core: core.on_lost("unplugged", 1.02), DeviceLink.LOST, "unplugged"),
        (lambda core: core.on_closed(1.02), DeviceLink.CLOSED, "closed"),
    ],
)
def test_lost_and_closed(live, end, link, reason):
    end(live)
    state = live.state(1.02)
    assert (state.link, state.reason) == (link, reason)
    assert (state.axes, state.pose, state.buttons) == (REST, None, frozenset())
    assert live.diagnosis(1.02) == [reason]
    live.on_opened(2.0)
    assert not live.heard
    assert live.state(2.0).link is DeviceLink.NEEDS_NEUTRAL


def test_a_wrench_is_reported_whatever_the_link(live):
    live.wrench = Wrench(Vector3(1.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.0))
    assert live.state(1.2).link is DeviceLink.STALE
    assert live.state(1.2).wrench == live.wrench


def test_the_charge_is_unknown_when_it_is_opened_again(live):
    live._battery = 0.5
    live.on_report(AWAY, (), 1.05)
    assert live.state(1.05).battery == 0.5
    live.on_opened(2.0)
    assert live.state(2.0).battery is None


def test_the_diagnosis_is_in_one_order(live, monkeypatch):
    live.events()
    monkeypatch.setattr(buttons, "MAX_EVENTS", 0)
    for _ in range(2):
        live._on_malformed("cut short", 0x21)
    live._on_malformed("of no kind", -1)
    live._counts["odd"] = 3
    assert live.protocol_errors() == {"malformed": 3}
    assert live.diagnosis(1.2) == [
        "no report for 0.1 s",
        "its cable is worn",
        "1 button edges dropped: no program reads them",
        "1 silences",
        "3 odd reports",
        "2 reports cut short (id 0x21), ignored",
        "1 reports of no kind, ignored",
    ]
    assert live.metrics(1.2) == {
        "report_age_s": pytest.approx(0.19),
        "silences": 1,
        "odd": 3,
        "lost_edges": 1,
    }


def test_a_core_has_to_say_what_silence_and_loss_mean():
    with pytest.raises(TypeError, match="abstract"):
        DeviceCore()


def test_the_core_that_has_to_be_fast_keeps_its_attributes_in_the_fast_place():
    """See `DeviceCore.__init__`: one more attribute makes each report take an eighth longer."""
    assert len(vars(SpaceMouseCore(SpaceMouseOptions()))) <= 29
