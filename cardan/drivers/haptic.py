"""The interface of devices that give force back to the hand."""

from __future__ import annotations

from abc import abstractmethod

from cardan.drivers.base import OperatorDevice
from cardan.haptics import HapticCommand, HapticState
from cardan.types import Pose, Vector3


class HapticDevice(OperatorDevice):
    """A device with a force loop of its own, which is told what to render and never waited for.

    The second half are the functions of YARP's IHapticDevice, with their defects corrected: SI
    units, the rotation alone for forces, the norm clamped and not each axis.
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

    # -- IHapticDevice -------------------------------------------------------------------------

    @abstractmethod
    def get_position(self) -> Vector3:
        """Of the gimbal's centre in the frame of the transformation, m."""

    @abstractmethod
    def get_orientation(self) -> Vector3:
        """Of the stylus in the frame of the transformation: roll, pitch, yaw, rad."""

    @abstractmethod
    def get_buttons(self) -> tuple[bool, ...]:
        """Whether each button is down."""

    @abstractmethod
    def is_cartesian_force_mode_enabled(self) -> bool:
        """True: feedback is a force; False: joint torques."""

    @abstractmethod
    def set_cartesian_force_mode(self) -> None:
        """Feedback is a force in N from now on; it becomes zero first."""

    @abstractmethod
    def set_joint_torque_mode(self) -> None:
        """Feedback is torques in N·m from now on; it becomes zero first."""

    @abstractmethod
    def get_max_feedback(self) -> Vector3:
        """The largest feedback: N in Cartesian mode (of the norm), N·m in joint torque mode."""

    @abstractmethod
    def set_feedback(self, feedback: Vector3) -> None:
        """Force in N along the transformation's axes, or joint torques in N·m.

        It lasts as long as the watchdog lets it: repeat it. Raises CommandError for what is not
        finite.
        """

    @abstractmethod
    def stop_feedback(self) -> None:
        """No feedback, by ramp."""

    @abstractmethod
    def set_transformation(self, transformation: Pose) -> None:
        """Where the hand frame is in the user's: applied to positions; its rotation to forces."""

    @abstractmethod
    def get_transformation(self) -> Pose:
        """The transformation."""
