"""YARP's IHapticDevice over any haptic device."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Literal

from cardan import spatial
from cardan.common.haptics import HapticCommand
from cardan.common.options import check_value
from cardan.drivers.haptic import HapticDevice
from cardan.errors import CommandError, NotOpenError
from cardan.types import IDENTITY_POSE, ZERO3, Pose, Vector3

ForceMode = Literal["cartesian", "joint"]


class IHapticDevice:
    """The functions of YARP's IHapticDevice for `device`, which is opened and enabled by itself.

    Its defects are corrected: SI units and radians, the transformation's rotation alone acts on
    forces, the norm is clamped and not each axis, and a feedback that is not repeated ends.
    """

    def __init__(self, device: HapticDevice, force_mode: ForceMode | None = None) -> None:
        """`force_mode` is what set_feedback() takes at first; None: the device's option of that
        name, or forces where it has none. Raises OptionError for another mode, CommandError for
        joint torques of a device that takes none."""
        if force_mode is None:
            force_mode = getattr(device.options, "force_mode", "cartesian")
        check_value("force_mode", force_mode, ForceMode)
        self._device = device
        self._joint_torques = force_mode == "joint"
        if self._joint_torques:
            self._require_joint_torques()
        self._transformation = IDENTITY_POSE
        self._sequence = 0
        self._commands = threading.Lock()
        """Held while the mode is read or changed, and while a command is sent."""

    def get_pose(self) -> Pose:
        """Position and orientation in the frame of the transformation.

        Raises DriverError while the device cannot tell.
        """
        return spatial.compose(self._transformation, self._device.measured_pose())

    def get_position(self) -> Vector3:
        """Position of the gimbal's center in the frame of the transformation, m.

        Raises DriverError while the device cannot tell.
        """
        return self.get_pose().position

    def get_orientation(self) -> Vector3:
        """Orientation of the stylus in the frame of the transformation: roll, pitch, yaw, rad.

        Raises DriverError while the device cannot tell.
        """
        return spatial.to_euler_zyx(self.get_pose().orientation)

    def get_buttons(self) -> tuple[bool, ...]:
        """Whether each button is down, in the order of the device's capabilities."""
        held = self._device.state().buttons
        return tuple(label in held for label in self._device.capabilities.buttons)

    def is_cartesian_force_mode_enabled(self) -> bool:
        """True: feedback is a force; False: joint torques."""
        return not self._joint_torques

    def set_cartesian_force_mode(self) -> None:
        """Feedback is a force in N from now on; it becomes zero first."""
        self._set_mode(joint_torques=False)

    def set_joint_torque_mode(self) -> None:
        """Feedback is torques in N·m from now on; it becomes zero first.

        Raises CommandError for a device that takes none.
        """
        self._require_joint_torques()
        self._set_mode(joint_torques=True)

    def get_max_feedback(self) -> Vector3:
        """The largest feedback: N in Cartesian mode, of the norm; N·m in joint torque mode, of each
        joint. Torques are limited as a force, too: theirs at the gimbal is within the same norm."""
        limits = self._device.feedback_limits
        most = limits.joint_torque_n_m if self._joint_torques else limits.force_n
        return Vector3(*(most or 0.0,) * 3)

    def to_hand(self, force: Vector3) -> Vector3:
        """Rotate a force from the transformation's axes to those of the hand frame."""
        return spatial.rotate(spatial.conjugate(self._transformation.orientation), force)

    def from_hand(self, force: Vector3) -> Vector3:
        """A force along the axes of the hand frame, along the transformation's."""
        return spatial.rotate(self._transformation.orientation, force)

    def set_feedback(self, feedback: Vector3) -> None:
        """Force in N along the transformation's axes, or joint torques in N·m.

        It starts small and lasts as long as the device's watchdog lets it: repeat it. Raises
        CommandError for what is not three finite numbers, NotOpenError.
        """
        try:
            x, y, z = map(float, feedback)
        except (TypeError, ValueError, OverflowError):
            raise CommandError(f"the feedback {feedback!r:.60} is not three numbers") from None
        asked = Vector3(x, y, z)
        if not spatial.is_finite(asked):
            raise CommandError(f"the feedback {asked} is not finite")
        with self._commands:
            if self._joint_torques:
                self._send(torques=asked)
            else:
                self._send(force=self.to_hand(asked))

    def stop_feedback(self) -> None:
        """No feedback, by ramp. Raises NotOpenError."""
        with self._commands:
            self._send(engaged=False)

    def set_transformation(self, transformation: Pose) -> None:
        """Where the hand frame is in the user's: applied to positions; its rotation to forces.

        Raises CommandError for what is no pose.
        """
        position, turn, frame = transformation
        if not spatial.is_finite((*position, *turn)):
            raise CommandError(f"the transformation {transformation} is not finite")
        try:
            unit = spatial.normalized(turn)
        except ValueError as error:
            raise CommandError(f"the transformation is no pose: {error}") from None
        self._transformation = Pose(Vector3(*position), unit, frame)

    def get_transformation(self) -> Pose:
        """The transformation."""
        return self._transformation

    def _require_joint_torques(self) -> None:
        if self._device.feedback_limits.joint_torque_n_m is None:
            raise CommandError(f"{type(self._device).__name__} takes forces, no joint torques")

    def _set_mode(self, *, joint_torques: bool) -> None:
        with self._commands:
            if self._joint_torques is not joint_torques:
                with contextlib.suppress(NotOpenError):
                    self._send(engaged=False)
            self._joint_torques = joint_torques

    def _send(
        self, *, engaged: bool = True, force: Vector3 = ZERO3, torques: Vector3 | None = None
    ) -> None:
        """Send `command` and nothing else; `_commands` is held."""
        self._sequence = max(self._sequence + 1, self._device.next_sequence())
        self._device.render(
            HapticCommand(
                self._sequence, time.monotonic(), engaged, force=force, joint_torques_n_m=torques
            )
        )
