"""Interface of devices with force feedback."""

from __future__ import annotations

from abc import abstractmethod

from cardan.common.haptics import FeedbackLimits, HapticCommand, HapticState
from cardan.drivers.base import OperatorDevice
from cardan.errors import DriverError, NotOpenError
from cardan.types import DeviceLink, Pose


class HapticDevice(OperatorDevice):
    """A device with its own force loop, which renders commands; no call waits for the loop.

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
        """Return the newest snapshot, marked if it is too old. Never blocks, never raises."""

    @abstractmethod
    def enable(self) -> None:
        """Allow force, also after a latched fault. Raises CommandError while that is not
        possible."""

    @abstractmethod
    def disable(self) -> None:
        """Ramp the force down to zero until enable()."""

    @abstractmethod
    def pause(self) -> None:
        """Ramp the force down to zero until resume(). Raises CommandError unless enabled."""

    @abstractmethod
    def resume(self) -> None:
        """Allow force after pause(). Raises CommandError unless paused."""

    @property
    @abstractmethod
    def feedback_limits(self) -> FeedbackLimits:
        """Largest feedback that the device exerts."""

    def measured_pose(self) -> Pose:
        """Return the measured pose, also while buttons or the link prevent commands.

        Raises DriverError while the pose is unknown, NotOpenError.
        """
        state = self.state()
        if state.pose is None:
            kind = NotOpenError if state.link is DeviceLink.CLOSED else DriverError
            raise kind(f"the haptic device has no position to give: {state.reason}")
        return state.pose

    def next_sequence(self) -> int:
        """Return a sequence number above those of all earlier commands, from any source."""
        return self.haptics().command_sequence + 1
