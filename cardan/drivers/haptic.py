"""The interface of devices with force feedback."""

from __future__ import annotations

from abc import abstractmethod

from cardan.common.haptics import FeedbackLimits, HapticCommand, HapticState
from cardan.drivers.base import OperatorDevice
from cardan.errors import DriverError, NotOpenError
from cardan.types import DeviceLink, Pose


class HapticDevice(OperatorDevice):
    """A device with a force loop of its own, which renders commands; no call waits for it.

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
        """The newest snapshot. Never blocks, never raises; one that is too old is marked so."""

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
        """The measured pose, also while buttons or the link keep it from commanding anything.

        Raises DriverError while the device cannot tell, NotOpenError.
        """
        state = self.state()
        if state.pose is None:
            kind = NotOpenError if state.link is DeviceLink.CLOSED else DriverError
            raise kind(f"the haptic device has no position to give: {state.reason}")
        return state.pose

    def next_sequence(self) -> int:
        """A sequence number above those of all commands so far, from any source."""
        return self.haptics().command_sequence + 1
