"""A haptic device that records its commands, and a robot whose states the test sets."""

from __future__ import annotations

from dataclasses import dataclass

from cardan.common.haptics import FeedbackLimits, HapticCommand, HapticState, OperatingState
from cardan.drivers.base import OperatorDevice
from cardan.drivers.haptic import HapticDevice
from cardan.errors import CommandError
from cardan.types import (
    IDENTITY,
    NEVER_S,
    ZERO3,
    ButtonEvent,
    DeviceCapabilities,
    DeviceLink,
    DeviceState,
    Frame,
    Pose,
    RobotLink,
    RobotState,
    Vector3,
    Wrench,
)

PERIOD_S = 0.004
REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class FakeHapticOptions:
    damping_n_s_m: float = 0.5
    hold_s: float = 0.02


class FakeHaptic(HapticDevice):
    """A haptic device whose state the test sets in `pose`, `buttons` and `now_s`."""

    Options = FakeHapticOptions
    capabilities = DeviceCapabilities(True, ("button_1", "button_2"), frozenset(), False)

    def __init__(self, options=None):
        super().__init__(options)
        self.pose = Pose(ZERO3, IDENTITY)
        self.buttons = frozenset()
        self.events = []
        self.now_s = NEVER_S
        self.haptic_state = HapticState()
        self.commands: list[HapticCommand] = []
        self.calls = []
        self.obstacle = ""
        self.lets_out = True
        """True if the enabled device renders engaged commands."""

    def open(self):
        self.calls.append("open")

    def close(self):
        self.calls.append("close")

    def diagnosis(self):
        return ()

    def state(self):
        return DeviceState(self.now_s, DeviceLink.LIVE, REST, self.buttons, self.pose)

    def button_events(self):
        events, self.events = self.events, []
        return events

    def press(self, button):
        self.events.append(ButtonEvent(self.now_s, button, True))
        self.events.append(ButtonEvent(self.now_s, button, False))

    def render(self, command):
        self.commands.append(command)
        enabled = self.haptic_state.state is OperatingState.ENABLED
        self.haptic_state = self.haptic_state._replace(
            command_sequence=command.sequence,
            rendering=enabled and command.engaged and self.lets_out,
        )

    def haptics(self):
        return self.haptic_state

    def enable(self):
        self.calls.append("enable")
        if self.obstacle:
            raise CommandError(self.obstacle)
        self.haptic_state = self.haptic_state._replace(state=OperatingState.ENABLED)

    def disable(self):
        self.calls.append("disable")
        self.haptic_state = self.haptic_state._replace(state=OperatingState.DISABLED)

    def pause(self):
        raise NotImplementedError

    resume = pause
    feedback_limits = FeedbackLimits(3.0)


class FakeSensor(OperatorDevice):
    """A force-torque sensor whose reading the test sets in `sensed`."""

    Options = FakeHapticOptions
    capabilities = DeviceCapabilities(False, (), frozenset(), False)

    def __init__(self, options=None):
        super().__init__(options)
        self.sensed = DeviceState(NEVER_S, DeviceLink.LOST, REST, frozenset(), reason="unplugged")
        self.calls = []

    def open(self):
        self.calls.append("open")

    def close(self):
        self.calls.append("close")

    def zero(self):
        self.calls.append("zero")

    def diagnosis(self):
        return (self.sensed.reason, "it is fake")

    def state(self):
        return self.sensed

    def button_events(self):
        return ()

    def measure(self, now_s, *force):
        wrench = Wrench(Vector3(*force), ZERO3, Frame.TOOL)
        self.sensed = DeviceState(now_s, DeviceLink.LIVE, REST, frozenset(), wrench=wrench)


def robot_state(now_s, place=(0.5, 0.0, 0.4), force=None, frame=Frame.BASE, **fields):
    """A live robot at `place`, which reports `force`."""
    wrench = None if force is None else Wrench(Vector3(*force), ZERO3, frame)
    turn = fields.pop("turn", IDENTITY)
    values = {
        "link": RobotLink.LIVE,
        "session": 1,
        "sequence": round(now_s / PERIOD_S),
        "period_s": PERIOD_S,
        "joints": (0.0,) * 6,
        "external_axes": (),
        "pose": Pose(Vector3(*place), turn),
        "hold_reason": "",
        "wrench": wrench,
    }
    return RobotState(stamp_s=now_s, **{**values, **fields})
