"""The interface of devices that give force back to the hand."""

from __future__ import annotations

from abc import abstractmethod

from cardan.drivers.base import OperatorDevice
from cardan.errors import DriverError, NotOpenError
from cardan.haptics import FeedbackLimits, HapticCommand, HapticState
from cardan.types import DeviceLink, Pose


class HapticDevice(OperatorDevice):
    """A device with a force loop of its own, which is told what to render and never waited for.

    :class:`cardan.drivers.ihaptic.IHapticDevice` gives any of them the functions of YARP.
    """

    @abstractmethod
    def render(self, command: HapticCommand) -> None:
        """Render `command` from the next tick on. Never blocks.

        Raises CommandError for values that are not finite, no rotation, or too many fixtures;
        the command before it then stays.
        """

    @abstractmethod
    def haptics(self) -> HapticState:
        """The newest snapshot. Never blocks, never raises, never old without saying so."""

    @abstractmethod
    def enable(self) -> None:
        """Let force out, after a latched fault too. Raises CommandError while it cannot be."""

    @abstractmethod
    def disable(self) -> None:
        """No force, by ramp, until enable()."""

    @abstractmethod
    def pause(self) -> None:
        """No force, by ramp, until resume(). Raises CommandError unless enabled."""

    @abstractmethod
    def resume(self) -> None:
        """Go on after pause(). Raises CommandError unless paused."""

    @property
    @abstractmethod
    def feedback_limits(self) -> FeedbackLimits:
        """The largest feedback that is let out."""

    def measured_pose(self) -> Pose:
        """Where the hand is, also while buttons or the link keep it from driving anything.

        Raises DriverError in words while the device cannot tell, NotOpenError.
        """
        state = self.state()
        if state.pose is None:
            kind = NotOpenError if state.link is DeviceLink.CLOSED else DriverError
            raise kind(f"the haptic device has no position to give: {state.reason}")
        return state.pose

    def next_sequence(self) -> int:
        """A sequence for a command that shall count, whoever gave those before."""
        return self.haptics().command_sequence + 1
