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
    """YARP's IHapticDevice for `device`, which the caller opens and enables.

    YARP's defects are corrected: units are SI and radians, only the transformation's rotation acts
    on forces, the norm is clamped instead of each axis, and a feedback that is not repeated ends.
    """

    def __init__(self, device: HapticDevice, force_mode: ForceMode | None = None) -> None:
        """Set the initial mode of set_feedback() to `force_mode`; None: the device's option of that
        name, or forces if it has none. Raises OptionError for another mode, CommandError for joint
        torques if the device takes none."""
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
        """Return position and orientation in the frame of the transformation.

        Raises DriverError while they are unknown.
        """
        return spatial.compose(self._transformation, self._device.measured_pose())

    def get_position(self) -> Vector3:
        """Return the position of the gimbal's center in the frame of the transformation, m.

        Raises DriverError while it is unknown.
        """
        return self.get_pose().position

    def get_orientation(self) -> Vector3:
        """Orientation of the stylus in the frame of the transformation: roll, pitch, yaw, rad.

        Raises DriverError while it is unknown.
        """
        return spatial.to_euler_zyx(self.get_pose().orientation)

    def get_buttons(self) -> tuple[bool, ...]:
        """Return for each button, in the order of the device's capabilities, whether it is
        pressed."""
        held = self._device.state().buttons
        return tuple(label in held for label in self._device.capabilities.buttons)

    def is_cartesian_force_mode_enabled(self) -> bool:
        """True: feedback is a force; False: joint torques."""
        return not self._joint_torques

    def set_cartesian_force_mode(self) -> None:
        """Switch feedback to a force in N; it becomes zero first."""
        self._set_mode(joint_torques=False)

    def set_joint_torque_mode(self) -> None:
        """Switch feedback to joint torques in N·m; it becomes zero first.

        Raises CommandError if the device takes none.
        """
        self._require_joint_torques()
        self._set_mode(joint_torques=True)

    def get_max_feedback(self) -> Vector3:
        """Return the largest feedback: in Cartesian mode the norm in N, in joint torque mode each
        joint's in N·m. Torques are also limited as the force that they exert at the gimbal, to the
        same norm."""
        limits = self._device.feedback_limits
        most = limits.joint_torque_n_m if self._joint_torques else limits.force_n
        return Vector3(*(most or 0.0,) * 3)

    def to_hand(self, force: Vector3) -> Vector3:
        """Rotate a force from the transformation's axes to those of the hand frame."""
        return spatial.rotate(spatial.conjugate(self._transformation.orientation), force)

    def from_hand(self, force: Vector3) -> Vector3:
        """Rotate a force from the axes of the hand frame to the transformation's."""
        return spatial.rotate(self._transformation.orientation, force)

    def set_feedback(self, feedback: Vector3) -> None:
        """Exert a force in N along the transformation's axes, or joint torques in N·m.

        It ramps up, and ends by the device's watchdog unless repeated. Raises CommandError unless
        it is three finite numbers, NotOpenError.
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
        """Ramp the feedback down to zero. Raises NotOpenError."""
        with self._commands:
            self._send(engaged=False)

    def set_transformation(self, transformation: Pose) -> None:
        """Set the pose of the hand frame in the user's frame, applied to positions; its rotation is
        applied to forces.

        Raises CommandError if it is no pose.
        """
        position, turn, frame = transformation
        if not spatial.is_finite((*position, *turn)):
            raise CommandError(f"the transformation {transformation} is not finite")
        try:
            unit = spatial.normalized(turn)
        except ValueError as error:
            raise CommandError(f"the transformation is not a pose: {error}") from None
        self._transformation = Pose(Vector3(*position), unit, frame)

    def get_transformation(self) -> Pose:
        """Return the pose of the hand frame in the user's frame."""
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
        """Send `command`; the caller holds `_commands`."""
        self._sequence = max(self._sequence + 1, self._device.next_sequence())
        self._device.render(
            HapticCommand(
                self._sequence, time.monotonic(), engaged, force=force, joint_torques_n_m=torques
            )
        )
