"""Every device with every kind of loss, in virtual time: it becomes neutral in time, and only a
neutral state makes it live again.

The device is deflected (the clutch held); then its reports stop, arrive cut short or as noise, or
it is unplugged. 100 ms after the last good report the state must be neutral (a few devices have a
longer `within_s`). It must stay neutral after the fault as long as the device is still deflected.
The table of docs/devices.md has these measurements: ``make device-table``.
"""

import random

import pytest

from cardan.drivers.spnav import SpnavCore, SpnavOptions, core as spnav
from cardan.protocols.connexion.devices import model_by_key
from cardan.types import DeviceLink
from cardan_spnav_server.protocol import encode_button, encode_motion
from tests.drivers import (
    evdev_bench,
    handheld_bench,
    ros2_node_bench,
)
from tests.drivers.test_spacemouse_simulated import Bench as SpaceMouseBench

NEUTRAL_WITHIN_S = 0.1
STEP_S = 0.002
REST = (0.0,) * 6
FAULTS = ("silence", "short", "garbled", "unplugged")
HALF = (0.5, 0.0, 0.0, 0.0, 0.0, 0.2)


class Subject:
    """Device that is deflected. Subclasses define how, and where its reports can be intercepted."""

    name = ""
    step_s = STEP_S
    within_s = NEUTRAL_WITHIN_S
    """Time limit from the last good report to the first neutral state."""
    silent = ""
    """Words of the reason after a silence; empty if the device then counts as lost."""

    def __init__(self):
        self.fault = ""
        self.good_s = 0.0
        """Time of the last good report."""
        self._rng = random.Random(7)

    def passed(self, report, now_s):
        """Return the report, a corrupted one, or None."""
        if not self.fault:
            self.good_s = now_s
            return report
        if self.fault == "short":
            return self.shortened(report)
        if self.fault == "garbled":
            return self.garbled(report)
        return None

    def shortened(self, report):
        return report[: len(report) // 2]

    def garbled(self, report):
        return self._rng.randbytes(len(report))

    @property
    def now_s(self):
        return self.bench.now_s

    @property
    def core(self):
        return self.bench.core

    @property
    def state(self):
        return self.core.state(self.now_s)

    @property
    def acts(self):
        """Return whether the device would move a robot."""
        state = self.state
        return any(state.axes) or state.pose is not None or bool(state.buttons)

    def run(self, seconds):
        self.bench.run(seconds)

    def unplug(self):
        self.core.on_lost("unplugged", self.now_s)

    def replug(self):
        self.core.on_opened(self.now_s)


class Intercepted(Subject):
    """Interception of reports at a method of the core."""

    method = "on_report"

    def __init__(self):
        super().__init__()
        self.bench = self.make()
        genuine = getattr(self.core, self.method)

        def between(report, now_s):
            report = self.passed(report, now_s)
            if report is not None:
                genuine(report, now_s)

        setattr(self.core, self.method, between)


class SpaceMouse(Intercepted):
    name = "SpaceMouse, HID"
    silent = "no motion report for 0.09 s"

    def make(self):
        bench = SpaceMouseBench(model_by_key("spacenavigator"))
        bench.run(0.5)
        bench.touch()
        return bench

    def deflect(self):
        self.bench.device.press("left")
        self.bench.run(0.3, HALF)

    def let_go(self):
        self.bench.device.release("left")
        self.bench.run(0.3, REST)

    def garbled(self, report):
        # USB has checksums: only a report that this device does not have gets through.
        return b"\xee" + super().garbled(report)[1:]

    def replug(self):
        self.core.on_opened(self.now_s, self.bench.device.model)


class SpnavBench:
    """Daemon that repeats a deflection every 16 ms."""

    def __init__(self):
        self.core = SpnavCore(SpnavOptions())
        self.now_s = 0.0
        self.counts = (0,) * 6
        self.next_s = 0.0
        self.core.on_opened(0.0)
        self.core.on_bytes(encode_motion(self.counts, 16), 0.0)

    def run(self, seconds):
        end_s = self.now_s + seconds - 1e-9
        while self.now_s < end_s:
            self.now_s += STEP_S
            if self.now_s >= self.next_s and any(self.counts):
                self.core.on_bytes(encode_motion(self.counts, 16), self.now_s)
                self.next_s = self.now_s + 0.016
            self.core.on_time(self.now_s)


class Spnav(Intercepted):
    """The daemon does not report which devices are serial: the time limits are theirs."""

    name = "spacenavd's socket"
    silent = "no motion for 0.1 s"
    method = "on_bytes"
    within_s = spnav.USUAL_STALE_AFTER_S + STEP_S
    cut = False

    def shortened(self, report):
        """A stream loses no bytes in its middle: it ends inside a record."""
        self.cut, was = True, self.cut
        return None if was else super().shortened(report)

    def make(self):
        bench = SpnavBench()
        bench.run(0.5)
        return bench

    def deflect(self):
        self.core.on_bytes(encode_button(0, True), self.now_s)
        self.bench.counts = (0, 20, 175, 0, 0, 90)
        self.bench.run(0.2)

    def let_go(self):
        self.core.on_bytes(encode_button(0, False), self.now_s)
        self.bench.counts = (0,) * 6
        self.core.on_bytes(encode_motion(self.bench.counts, 16), self.now_s)
        self.bench.run(0.1)


class Gamepad(Subject):
    name = "gamepad"
    step_s = 0.008
    turn = 0
    model = "xbox-360"
    holds = False

    def __init__(self):
        super().__init__()
        self.bench = evdev_bench.Bench(self.model)
        self.bench.mangle = self.mangle

    def mangle(self, packet):
        packet = self.passed(packet, self.now_s)
        return [] if packet is None else [packet]

    def deflect(self):
        self.bench.press("left-shoulder")
        self.holds = True
        self.run(0.2)

    def run(self, seconds):
        """Only changes are reported: a device that is never quite still causes them."""
        for _ in range(max(1, round(seconds / self.step_s))):
            self.turn += 1
            sticks = (0.01 * (self.turn % 3), 0.7, 0.0, 0.0, 0.0, 0.0) if self.holds else REST
            self.bench.run(self.step_s, sticks)

    def let_go(self):
        self.bench.release("left-shoulder")
        self.holds = False
        self.run(0.2)

    def unplug(self):
        self.bench.device.unplug()
        self.bench.run(self.step_s)

    def replug(self):
        self.bench.device.replug()


class Keyboard(Gamepad):
    name = "keyboard"
    model = "keyboard"

    def deflect(self):
        self.bench.press("space", "a")
        self.run(0.6)  # the kernel begins to repeat the key

    def run(self, seconds):
        self.bench.run(seconds)

    def let_go(self):
        self.bench.release("space", "a")


class SpacenavNode(Subject):
    name = "spacenav_node, Zenoh"
    silent = "no message for 0.1 s"
    node = "spacenav"

    def __init__(self):
        super().__init__()
        self.bench = ros2_node_bench.Bench(self.node)
        self.bench.touch()
        self.bench.mangle = lambda data: self.passed(data, self.bench.now_s)

    def deflect(self):
        self.bench.device.press("button-0")
        self.bench.run(0.3, HALF)

    def let_go(self):
        self.bench.device.release("button-0")
        self.bench.run(0.3, REST)


class JoyNode(SpacenavNode):
    """20 messages per second: four missing ones count as silence."""

    name = "joy_node, Zenoh"
    silent = "no message for 0.2 s"
    node = "joy_node"
    within_s = 0.2 + STEP_S


class PhonePage(Subject):
    """60 frames per second; the newest one counts for 0.15 s after its creation."""

    name = "phone, page"
    silent = "no frame for 150 ms"
    kind = "phone"
    within_s = 0.15 + STEP_S

    def __init__(self):
        super().__init__()
        self.bench = handheld_bench.Bench(self.kind)
        self.bench.live()
        self.bench.mangle = lambda data: self.passed(data, self.bench.now_s)

    def deflect(self):
        self.bench.device.press("hold")
        self.bench.run(0.1)
        self.bench.run(0.2, HALF)

    def let_go(self):
        self.bench.device.release("hold")
        self.bench.run(0.3, REST)

    def replug(self):
        super().replug()
        # A new page, on which Align is pressed again.
        self.bench.device.aligns_until_s = self.bench.device.next_due_s + 0.1


class XrPage(PhonePage):
    name = "XR, page"
    kind = "xr"


SUBJECTS = (
    SpaceMouse,
    Spnav,
    Gamepad,
    Keyboard,
    SpacenavNode,
    JoyNode,
    PhonePage,
    XrPage,
)
UNSEEN = {("gamepad", "silence"), ("keyboard", "silence")}
"""The kernel reports changes only, so that silence may mean a steady device: docs/gamepad.md."""


def cases(subjects):
    """Return every subject with every fault, as parameters."""
    return [
        pytest.param(subject, fault, id=f"{subject.name}-{fault}")
        for subject in subjects
        for fault in FAULTS
        if (subject.name, fault) not in UNSEEN
    ]


def time_to_neutral_s(subject, fault):
    """Return the time from the last good report to the first neutral state."""
    subject.fault = fault
    if fault == "unplugged":
        subject.unplug()
    while subject.acts:
        subject.run(subject.step_s)
        assert subject.now_s - subject.good_s < 10 * NEUTRAL_WITHIN_S, subject.state
    return subject.now_s - subject.good_s


def held(kind):
    subject = kind()
    subject.deflect()
    assert subject.acts
    assert subject.state.link is DeviceLink.LIVE
    return subject


@pytest.mark.parametrize(("kind", "fault"), cases(SUBJECTS))
def test_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    check_neutral_in_time_and_only_neutral_leads_back(kind, fault)


def check_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    """Check one subject with one fault; plugins/ use it for their devices, too."""
    subject = held(kind)
    assert time_to_neutral_s(subject, fault) <= subject.within_s + 1e-9
    for _ in range(100):
        subject.run(0.01)
        assert not subject.acts
    state = subject.state
    assert state.link is not DeviceLink.LIVE
    assert state.reason
    assert state.link is DeviceLink.LOST or fault != "unplugged"
    if fault == "silence" and subject.silent:
        assert state.link is DeviceLink.STALE
        assert subject.silent in state.reason
    subject.fault = ""
    if fault == "unplugged":
        subject.replug()
    for _ in range(200):  # All is well again, and the device is still deflected
        subject.run(0.01)
        state = subject.state
        assert not any(state.axes)
        assert not state.buttons
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    subject.let_go()
    subject.run(0.5)
    assert not any(subject.state.axes)
    subject.deflect()
    assert subject.acts


def table(subjects=SUBJECTS):
    """Return milliseconds from the last good report to neutral, in Markdown."""
    lines = ["| device | " + " | ".join(FAULTS) + " |", "|---" * (1 + len(FAULTS)) + "|"]
    for kind in subjects:
        cells = [
            "–"
            if (kind.name, fault) in UNSEEN
            else f"{time_to_neutral_s(held(kind), fault) * 1e3:.0f}"
            for fault in FAULTS
        ]
        lines.append(f"| {kind.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"
