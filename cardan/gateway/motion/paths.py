"""Paths in time: straight lines of poses, joints that arrive together.

A path answers where it is at any time since its start, and brakes along itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

from cardan.common.arm_libraries import np, npt
from cardan.errors import ConfigurationError
from cardan.gateway.motion.profiles import JerkLimited, Profile
from cardan.spatial import (
    add,
    compose,
    from_rotation_vector,
    multiply,
    norm,
    normalized,
    rotation_between,
    same_hemisphere,
    scale,
    subtract,
)
from cardan.types import Frame, Pose, Twist, Vector3

FloatArray = npt.NDArray[np.float64]
ProfileName = Literal["trapezoid", "jerk"]

_NO_WAY = 1e-12
"""Ways (m or rad) below this count as none: limits that they could not reach are left out."""

_HALF_TURN_RAD = 1e-9
"""Nearer than this to pi, both ways round are the same and the axis is chosen by its sign."""


@dataclass(frozen=True, kw_only=True)
class PathLimits:
    """Limits of a Cartesian path; norms, for translation and rotation separately."""

    linear_speed_m_s: float = 0.05
    linear_acceleration_m_s2: float = 0.1
    linear_jerk_m_s3: float = 1.0
    angular_speed_rad_s: float = 0.2
    angular_acceleration_rad_s2: float = 0.4
    angular_jerk_rad_s3: float = 4.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0.0:
                raise ConfigurationError(field.name, f"{value!r} is not above 0")


def _strictest(bounds: Sequence[float], ways: Sequence[float]) -> float:
    """The bound of a path variable that goes from 0 to 1 while each way is covered."""
    return min(
        (bound / way for bound, way in zip(bounds, ways, strict=True) if way > _NO_WAY), default=1.0
    )


def _fixed_sign(rotation: Vector3) -> Vector3:
    """`rotation`, or at half a turn the one of both ways whose first large component is above 0."""
    angle = norm(rotation)
    if angle < math.pi - _HALF_TURN_RAD:
        return rotation
    leading = next(c for c in rotation if abs(c) > 1e-6)
    return rotation if leading > 0.0 else scale(rotation, (angle - 2.0 * math.pi) / angle)


def _cartesian_bounds(
    limits: PathLimits, distance_m: float, angle_rad: float, profile: ProfileName
) -> tuple[float, float, float]:
    """Speed, acceleration and jerk of the path variable."""
    if profile not in ("trapezoid", "jerk"):
        raise ValueError(f"profile {profile!r} is neither 'trapezoid' nor 'jerk'")
    ways = (distance_m, angle_rad)
    return (
        _strictest((limits.linear_speed_m_s, limits.angular_speed_rad_s), ways),
        _strictest((limits.linear_acceleration_m_s2, limits.angular_acceleration_rad_s2), ways),
        _strictest((limits.linear_jerk_m_s3, limits.angular_jerk_rad_s3), ways)
        if profile == "jerk"
        else math.inf,
    )


def _based(start: Pose) -> Pose:
    if start.frame is not Frame.BASE:
        raise ValueError("the start of a path is a pose in the base frame")
    return Pose(start.position, normalized(start.orientation), Frame.BASE)


class _ScrewPath:
    """Position straight, rotation about one fixed axis, both by one path variable."""

    def __init__(self, start: Pose, linear: Vector3, angular: Vector3, profile: Profile) -> None:
        self.start = start
        self._linear, self._angular, self._profile = linear, angular, profile

    @property
    def duration_s(self) -> float:
        """Time until rest, s; infinite where there is no end."""
        return self._profile.duration_s

    def at(self, t_s: float) -> tuple[Pose, Twist]:
        """Pose and twist, both in the base frame, at `t_s` since the start of the path."""
        u, du, _ = self._profile.at(t_s)
        turned = multiply(from_rotation_vector(scale(self._angular, u)), self.start.orientation)
        return (
            Pose(add(self.start.position, scale(self._linear, u)), turned, Frame.BASE),
            Twist(scale(self._linear, du), scale(self._angular, du), Frame.BASE),
        )

    def brake(self, t_s: float) -> _ScrewPath:
        """The quickest stop along the same path from the state at `t_s`, which is its time 0."""
        return _ScrewPath(self.start, self._linear, self._angular, self._profile.brake(t_s))


class LinePath(_ScrewPath):
    """From rest to rest along a straight line, turning about one fixed axis the short way.

    Both parts share one path variable, bounded by the stricter of the two, and end together. At
    half a turn the axis is the one whose first component that is not zero is positive. A `goal`
    in the tool frame is taken from `start`. `duration_s` stretches the motion; below the quickest
    it raises ValueError naming both times.
    """

    def __init__(
        self,
        start: Pose,
        goal: Pose,
        limits: PathLimits,
        *,
        profile: ProfileName = "trapezoid",
        duration_s: float | None = None,
    ) -> None:
        start = _based(start)
        if goal.frame is Frame.TOOL:
            goal = compose(start, Pose(goal.position, normalized(goal.orientation)))
        linear = subtract(goal.position, start.position)
        angular = _fixed_sign(rotation_between(start.orientation, normalized(goal.orientation)))
        distance_m, angle_rad = norm(linear), norm(angular)
        bounds = _cartesian_bounds(limits, distance_m, angle_rad, profile)
        length = 1.0 if max(distance_m, angle_rad) > _NO_WAY else 0.0
        super().__init__(start, linear, angular, JerkLimited(length, *bounds, duration_s))
        end = multiply(from_rotation_vector(angular), start.orientation)
        self.goal = Pose(
            goal.position, same_hemisphere(normalized(goal.orientation), end), Frame.BASE
        )

    def at(self, t_s: float) -> tuple[Pose, Twist]:
        """Pose and twist, both in the base frame, at `t_s`; from the end on exactly the goal."""
        pose, twist = super().at(t_s)
        return (self.goal if t_s >= self.duration_s else pose), twist


def wrap_angle(angle_rad: float) -> float:
    """`angle_rad` in (-pi, pi]."""
    turn = 2.0 * math.pi
    return angle_rad - turn * math.ceil((angle_rad - math.pi) / turn)


class JointPath:
    """From rest to rest in joint space: a straight line, so that all joints arrive together.

    `start`, `goal` and limits by joint in kinematic order, rad (m) and per s, s², s³; `jerks`
    None: accelerations jump. Joints marked in `continuous` take the short way round, also when
    that ends a turn beside `goal`. `duration_s` as in :class:`LinePath`.
    """

    def __init__(
        self,
        start: Sequence[float] | FloatArray,
        goal: Sequence[float] | FloatArray,
        speeds: Sequence[float] | FloatArray,
        accelerations: Sequence[float] | FloatArray,
        jerks: Sequence[float] | FloatArray | None = None,
        *,
        continuous: Sequence[bool] | None = None,
        duration_s: float | None = None,
    ) -> None:
        self.start = np.array(start, dtype=np.float64)
        self.goal = np.array(goal, dtype=np.float64)
        """Where the path ends, whole turns included."""
        joints = self.start.size
        given = {"goal": self.goal, "speeds": speeds, "accelerations": accelerations}
        for name, values in (*given.items(), ("jerks", jerks), ("continuous", continuous)):
            if values is not None and len(values) != joints:
                raise ValueError(f"{name} has {len(values)} values for {joints} joints")
        if not (np.isfinite(self.start).all() and np.isfinite(self.goal).all()):
            raise ValueError("start and goal must be finite")
        self._way = self.goal - self.start
        for joint, turns in enumerate(continuous or ()):
            if turns and abs(self._way[joint]) > math.pi:
                self._way[joint] = wrap_angle(float(self._way[joint]))
                self.goal[joint] = self.start[joint] + self._way[joint]
            elif turns and self._way[joint] == -math.pi:
                self._way[joint] = math.pi
                self.goal[joint] = self.start[joint] + math.pi
        ways = np.abs(self._way).tolist()
        bounds = []
        for name, values in (("speeds", speeds), ("accelerations", accelerations)):
            if not all(value > 0.0 for value in values):
                raise ValueError(f"{name} {list(values)} are not all above 0")
            bounds.append(_strictest([float(value) for value in values], ways))
        if jerks is not None and not all(value > 0.0 for value in jerks):
            raise ValueError(f"jerks {list(jerks)} are not all above 0")
        jerk = math.inf if jerks is None else _strictest([float(value) for value in jerks], ways)
        self._length = 1.0 if max(ways, default=0.0) > _NO_WAY else 0.0
        self._run(JerkLimited(self._length, bounds[0], bounds[1], jerk, duration_s))

    def _run(self, profile: Profile) -> None:
        self._profile = profile
        self._q, self._v = self.start.copy(), np.zeros_like(self.start)

    @property
    def duration_s(self) -> float:
        """Time until rest, s."""
        return self._profile.duration_s

    def at(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities at `t_s` since the start; the next call reuses the arrays."""
        u, du, _ = self._profile.at(t_s)
        np.multiply(self._way, du, out=self._v)
        if u >= self._length:
            np.copyto(self._q, self.goal)
        else:
            np.multiply(self._way, u, out=self._q)
            self._q += self.start
        return self._q, self._v

    def brake(self, t_s: float) -> JointPath:
        """The quickest stop along the same line from the state at `t_s`, which is its time 0."""
        stop = JointPath.__new__(JointPath)
        stop.start, stop.goal = self.start, self.goal
        stop._way, stop._length = self._way, self._length
        stop._run(self._profile.brake(t_s))
        return stop
