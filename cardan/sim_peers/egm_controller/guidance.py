"""Conversion of the PC's messages to joint speeds in each mode.

Source: ABB Application manual, Externally Guided Motion (3HAC073318-001): joint and pose mode,
path correction, and the RAPID instructions that start them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

from cardan.protocols.egm.messages import EgmPose, EgmSensor, EgmSensorPathCorr
from cardan.sim_peers.egm_controller.arguments import EgmAct, EgmRun, PathMove
from cardan.sim_peers.egm_controller.events import NEAR_SINGULARITY, UNNUMBERED
from cardan.sim_peers.egm_controller.motion import ControlLaw, ServoAxes
from cardan.sim_peers.kinematics import (
    AXES,
    Differential,
    Frames,
    forward,
    pose_error,
)
from cardan.spatial import (
    cross,
    from_euler_zyx,
    from_rotation_vector,
    multiply,
    norm,
    normalized,
    scale,
)
from cardan.types import Pose, Vector3

_ZERO = (0.0,) * AXES
_UNIT_TOLERANCE = 1e-5
"""Deviation of a quaternion's length beyond which it counts as not normalized."""

LARGEST_NUMBER = 1e9
"""Bound of references and speeds in m, rad and seconds: far beyond any robot's, with powers in the
kinematics far below a float's overflow."""

_R = TypeVar("_R")


class MotionError(Exception):
    """Stop of the motion by the controller, with an event."""

    def __init__(
        self, code: int, text: str, *, needs_jog: bool = False, motors_off: bool = False
    ) -> None:
        super().__init__(text)
        self.code = code
        self.text = text
        self.needs_jog = needs_jog
        """True if only jogging the arm away by hand ends the error."""
        self.motors_off = motors_off


class Tuning(NamedTuple):
    """System parameters of the External Motion Interface, and limits of the arm's controller."""

    k: float
    filter_hz: float | None
    """None: no filter."""
    delay_cycles: int
    """Additional delay of a reference compared with Level 0."""
    singularity_threshold: float
    path_correction_absolute: bool


def beyond_any_robot(message: EgmSensor | EgmSensorPathCorr) -> bool:
    """Return True if a reference or speed of the message is out of the range of computation.

    The reaction of a real controller to such a number is not known; the simulated one ignores the
    message.
    """
    if not isinstance(message, EgmSensor):
        return _largest(message.pos) > LARGEST_NUMBER
    planned, speed_ref = message.planned, message.speed_ref
    most = 0.0
    if planned is not None:
        most = max(_largest(planned.joints), _largest(planned.external_joints))
        if planned.cartesian is not None:
            most = max(most, *map(_largest, planned.cartesian))
    if speed_ref is not None:
        most = max(most, *map(_largest, speed_ref))
    return most > LARGEST_NUMBER


def _largest(values: Sequence[float] | None) -> float:
    return max(map(abs, values), default=0.0) if values else 0.0


class GuidedMotion(ABC):
    """An EGMRun, or EGMMove with path correction."""

    done = False
    """True when a programmed path has ended."""

    def __init__(self, servo: ServoAxes, tuning: Tuning, flaws: Counter[str]) -> None:
        self.servo = servo
        self.tuning = tuning
        self.flaws = flaws

    @abstractmethod
    def accept(self, message: EgmSensor | EgmSensorPathCorr) -> str:
        """Handle one message; return the reason if it is ignored, else empty.

        Raises MotionError for a reference that the controller stops at.
        """

    @abstractmethod
    def speeds(self, elapsed_s: float) -> list[float]:
        """Return joint speeds for this cycle, rad/s, before any limit; call once a cycle."""

    @abstractmethod
    def converged(self) -> bool:
        """True when every selected axis is inside its window about the reference."""


class _Guided(GuidedMotion, Generic[_R]):
    """Joint and pose mode: a reference with feed-forward, delayed, ramped in, through the law."""

    def __init__(
        self,
        servo: ServoAxes,
        tuning: Tuning,
        act: EgmAct,
        run: EgmRun,
        flaws: Counter[str],
        start: _R,
    ) -> None:
        super().__init__(servo, tuning, flaws)
        self._law = ControlLaw(tuning.k * run.pos_corr_gain, tuning.filter_hz, servo.period_s)
        self._selected = tuple(axis in run.axes for axis in range(AXES))
        self._ramp_in_s = run.ramp_in_s
        self._window_rad = math.radians(act.window_deg)
        self._window_m = act.window_mm * 1e-3
        self._start = start
        self._reference = start
        self._feed_forward: Sequence[float] = _ZERO
        self._line: deque[tuple[_R, Sequence[float]]] = deque(maxlen=tuning.delay_cycles + 1)

    def accept(self, message: EgmSensor | EgmSensorPathCorr) -> str:
        if not isinstance(message, EgmSensor):
            return "path correction in guidance mode"
        return self._accept(message)

    @abstractmethod
    def _accept(self, message: EgmSensor) -> str:
        """Handle a message of joint or pose mode, as `accept` does."""

    @abstractmethod
    def _error(self, reference: _R, ramp: float) -> Sequence[float]:
        """Return the error from the arm to `reference`, scaled by the share `ramp`."""

    def _controlled(self, elapsed_s: float) -> list[float]:
        self._line.append((self._reference, self._feed_forward))
        reference, feed_forward = self._line[0]
        ramp = min(1.0, elapsed_s / self._ramp_in_s) if self._ramp_in_s > 0.0 else 1.0
        return self._law.speeds(
            [
                e if chosen else 0.0
                for e, chosen in zip(self._error(reference, ramp), self._selected, strict=True)
            ],
            [
                ramp * v if chosen else 0.0
                for v, chosen in zip(feed_forward, self._selected, strict=True)
            ],
        )


class GuidedJointMotion(_Guided[Sequence[float]]):
    """EGMRunJoint."""

    def __init__(
        self, servo: ServoAxes, tuning: Tuning, act: EgmAct, run: EgmRun, flaws: Counter[str]
    ) -> None:
        super().__init__(servo, tuning, act, run, flaws, tuple(servo.planned))

    def _accept(self, message: EgmSensor) -> str:
        planned, speed_ref = message.planned, message.speed_ref
        joints = planned.joints if planned is not None else None
        speeds = speed_ref.joints if speed_ref is not None else None
        if not joints and not speeds:
            cartesian = (planned is not None and planned.cartesian is not None) or (
                speed_ref is not None and speed_ref.cartesians is not None
            )
            return "pose in joint mode" if cartesian else "no reference"
        if (joints and len(joints) != AXES) or (speeds and len(speeds) != AXES):
            return "wrong number of joints"
        if joints:
            arm = self.servo.arm
            for axis, (q, low, high) in enumerate(zip(joints, arm.lower, arm.upper, strict=True)):
                if not low <= q <= high:
                    raise MotionError(
                        UNNUMBERED,
                        "External Motion Interface input out of bounds: "
                        f"joint {axis + 1} = {math.degrees(q):.3f} deg",
                        motors_off=True,
                    )
            self._reference = joints
        self._feed_forward = speeds or _ZERO
        return ""

    def _error(self, reference: Sequence[float], ramp: float) -> Sequence[float]:
        if ramp == 1.0:
            return [r - q for r, q in zip(reference, self.servo.planned, strict=True)]
        return [
            s + ramp * (r - s) - q
            for s, r, q in zip(self._start, reference, self.servo.planned, strict=True)
        ]

    def speeds(self, elapsed_s: float) -> list[float]:
        return self._controlled(elapsed_s)

    def converged(self) -> bool:
        return all(
            abs(r - q) < self._window_rad
            for r, q, chosen in zip(
                self._reference, self.servo.measured, self._selected, strict=True
            )
            if chosen
        )


def _joint_speeds(
    servo: ServoAxes, twist: Sequence[float], frames: Frames, threshold: float
) -> list[float]:
    """Joint speeds for the TCP velocity `twist` (v over w, base frame) of this cycle.

    Solution nearest to the present configuration. Raises MotionError close to a singularity.
    """
    if not any(twist):
        return [0.0] * AXES
    differential = Differential(frames)
    if differential.is_singular(threshold):
        raise MotionError(NEAR_SINGULARITY, "Close to singularity", needs_jog=True)
    period = servo.period_s
    vx, vy, vz, wx, wy, wz = (v * period for v in twist)
    (x, y, z), orientation, _ = frames.pose
    target = Pose(
        Vector3(x + vx, y + vy, z + vz),
        multiply(from_rotation_vector(Vector3(wx, wy, wz)), orientation),
    )
    step = differential.joints((vx, vy, vz, wx, wy, wz))
    # The Jacobian alone is off by the curvature of the step; one correction leaves nanometers.
    reached = forward([q + dq for q, dq in zip(servo.planned, step, strict=True)], servo.arm.links)
    rest = differential.joints(pose_error(target, reached.pose))
    return [(a + b) / period for a, b in zip(step, rest, strict=True)]


class GuidedPoseMotion(_Guided[Pose]):
    """EGMRunPose, with correction and sensor frame equal to the work object."""

    def __init__(
        self, servo: ServoAxes, tuning: Tuning, act: EgmAct, run: EgmRun, flaws: Counter[str]
    ) -> None:
        super().__init__(servo, tuning, act, run, flaws, servo.planned_frames.pose)

    def _accept(self, message: EgmSensor) -> str:
        planned, speed_ref = message.planned, message.speed_ref
        pose = planned.cartesian if planned is not None else None
        speeds = speed_ref.cartesians if speed_ref is not None else None
        if pose is None and not speeds:
            joints = (planned is not None and planned.joints is not None) or (
                speed_ref is not None and speed_ref.joints is not None
            )
            return "joints in pose mode" if joints else "no reference"
        if speeds and len(speeds) != AXES:
            return "wrong number of Cartesian speeds"
        if pose is not None:
            reason = self._accept_pose(pose)
            if reason:
                return reason
        self._feed_forward = speeds or _ZERO
        return ""

    def _accept_pose(self, pose: EgmPose) -> str:
        position, orientation, _ = self._reference
        if pose.euler is not None:
            orientation = from_euler_zyx(*pose.euler)
            if pose.orient is not None:
                self.flaws["Euler over quaternion"] += 1
        elif pose.orient is not None:
            length = math.sqrt(sum(c * c for c in pose.orient))
            try:
                orientation = normalized(pose.orient)
            except ValueError:
                return "quaternion without direction"
            if abs(length - 1.0) > _UNIT_TOLERANCE:
                self.flaws["quaternion not normalized"] += 1
        if pose.pos is not None:
            position = pose.pos
        self._reference = Pose(position, orientation)
        return ""

    def _error(self, reference: Pose, ramp: float) -> Sequence[float]:
        actual = self.servo.planned_frames.pose
        if ramp != 1.0:
            start = self._start
            way = pose_error(reference, start)
            reference = Pose(
                Vector3(*(s + ramp * d for s, d in zip(start.position, way[:3], strict=True))),
                multiply(from_rotation_vector(scale(Vector3(*way[3:]), ramp)), start.orientation),
            )
        return pose_error(reference, actual)

    def speeds(self, elapsed_s: float) -> list[float]:
        return _joint_speeds(
            self.servo,
            self._controlled(elapsed_s),
            self.servo.planned_frames,
            self.tuning.singularity_threshold,
        )

    def converged(self) -> bool:
        measured = forward(self.servo.measured, self.servo.arm.links).pose
        error = pose_error(self._reference, measured)
        windows = (self._window_m,) * 3 + (self._window_rad,) * 3
        return all(
            abs(e) < window
            for e, window, chosen in zip(error, windows, self._selected, strict=True)
            if chosen
        )


class PathCorrectedMotion(GuidedMotion):
    """EGMMoveL with path correction: a straight programmed path, shifted sideways.

    The path frame: x along the path, y = x cross the tool's z, z = x cross y. Only y and z act.
    """

    _ACCELERATION_M_S2 = 1.0
    _AGE_AT_MOST_S = 1.0

    def __init__(
        self, servo: ServoAxes, tuning: Tuning, move: PathMove, flaws: Counter[str]
    ) -> None:
        super().__init__(servo, tuning, flaws)
        frames = servo.planned_frames
        self._from = frames.pose
        way = Vector3(*(c * 1e-3 for c in move.displacement_mm))
        self._length = norm(way)
        if self._length == 0.0:
            raise MotionError(UNNUMBERED, "the programmed path has no length")
        self._x = scale(way, 1.0 / self._length)
        self._y = cross(self._x, frames.approach)
        if norm(self._y) < 1e-6:
            raise MotionError(UNNUMBERED, "the path runs along the tool's z axis")
        self._y = scale(self._y, 1.0 / norm(self._y))
        self._z = cross(self._x, self._y)
        self._top_speed = move.speed_mm_s * 1e-3
        self._left = move.repeats
        self._traveled = 0.0
        self._speed = 0.0
        self._backwards = False
        self._offset = (0.0, 0.0)
        self._wanted = (0.0, 0.0)
        self._share = 1.0 - math.exp(-tuning.k * servo.period_s)
        self._past: deque[tuple[float, float]] = deque(
            [self._offset], maxlen=math.ceil(self._AGE_AT_MOST_S / servo.period_s)
        )

    @property
    def offset_m(self) -> tuple[float, float]:
        """Present shift of the path along y and z of the path frame, m."""
        return self._offset

    def accept(self, message: EgmSensor | EgmSensorPathCorr) -> str:
        if isinstance(message, EgmSensor):
            return "guidance in path correction mode"
        _, y, z = message.pos
        base = (0.0, 0.0)
        if not self.tuning.path_correction_absolute:
            cycles = round(message.age_ms * 1e-3 / self.servo.period_s)
            base = self._past[max(0, len(self._past) - 1 - cycles)]
        self._wanted = (base[0] + y, base[1] + z)
        return ""

    def speeds(self, elapsed_s: float) -> list[float]:
        period = self.servo.period_s
        left = self._length - self._traveled
        reachable = math.sqrt(2.0 * self._ACCELERATION_M_S2 * max(0.0, left))
        self._speed = min(
            self._speed + self._ACCELERATION_M_S2 * period, self._top_speed, reachable
        )
        self._traveled = min(self._length, self._traveled + self._speed * period)
        if self._length - self._traveled < 1e-7:
            self._next_leg()
        share = self._share
        offset_y, offset_z = (
            o + share * (w - o) for o, w in zip(self._offset, self._wanted, strict=True)
        )
        self._offset = (offset_y, offset_z)
        self._past.append(self._offset)
        along = self._length - self._traveled if self._backwards else self._traveled
        target = Vector3(
            *(
                p + along * x + offset_y * y + offset_z * z
                for p, x, y, z in zip(self._from.position, self._x, self._y, self._z, strict=True)
            )
        )
        frames = self.servo.planned_frames
        error = pose_error(Pose(target, self._from.orientation), frames.pose)
        return _joint_speeds(
            self.servo, [e / period for e in error], frames, self.tuning.singularity_threshold
        )

    def _next_leg(self) -> None:
        self._left -= 1
        if self._left <= 0:
            self._traveled = self._length
            self.done = True
            return
        self._traveled = 0.0
        self._speed = 0.0
        self._backwards = not self._backwards

    def converged(self) -> bool:
        return False
