"""Trajectories: a pose or joint positions, and their velocity, at any time since the start."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

from cardan.common.arm_libraries import np
from cardan.errors import ConfigurationError, MotionRefusedError
from cardan.gateway.kinematics.base import FloatArray
from cardan.gateway.motion.joint_trajectory import SHORTEST_STEP_S, JointTrajectory
from cardan.gateway.motion.profiles import Profile
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

ProfileName = Literal["trapezoid", "jerk"]

_NO_WAY = 1e-12
"""Length (m or rad) below which a motion counts as none: its limits are left out."""

_HALF_TURN_RAD = 1e-9
"""Angle to pi below which both directions of rotation are equal and the sign of the axis is
fixed."""


@dataclass(frozen=True, kw_only=True)
class LineLimits:
    """Limits of a line; norms, for translation and rotation separately."""

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
    """Return the strictest bound of a path variable that goes from 0 to 1 over each of `ways`."""
    return min(
        (bound / way for bound, way in zip(bounds, ways, strict=True) if way > _NO_WAY), default=1.0
    )


def _fixed_sign(rotation: Vector3) -> Vector3:
    """Return `rotation`, or at half a turn the one of both directions whose first large component
    is above 0."""
    angle = norm(rotation)
    if angle < math.pi - _HALF_TURN_RAD:
        return rotation
    leading = next(c for c in rotation if abs(c) > 1e-6)
    return rotation if leading > 0.0 else scale(rotation, (angle - 2.0 * math.pi) / angle)


def _cartesian_bounds(
    limits: LineLimits, distance_m: float, angle_rad: float, profile: ProfileName
) -> tuple[float, float, float]:
    """Return speed, acceleration and jerk of the path variable."""
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
        raise ValueError("the start of a line is a pose in the base frame")
    return Pose(start.position, normalized(start.orientation), Frame.BASE)


class LineTrajectory:
    """Motion from rest to rest along a straight line, turning about one fixed axis the short way.

    Both parts share one path variable, bounded by the stricter of the two, and end together. At
    half a turn the axis is the one whose first component that is not zero is positive. A `goal` in
    the tool frame is taken from `start`. `duration_s` stretches the motion; below the quickest it
    raises ValueError naming both times.
    """

    def __init__(
        self,
        start: Pose,
        goal: Pose,
        limits: LineLimits,
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
        self._profile = Profile(length, *bounds, duration_s)
        self.start, self._linear, self._angular = start, linear, angular
        end = multiply(from_rotation_vector(angular), start.orientation)
        self.goal = Pose(
            goal.position, same_hemisphere(normalized(goal.orientation), end), Frame.BASE
        )

    @property
    def duration_s(self) -> float:
        """Time until rest, s."""
        return self._profile.duration_s

    def at(self, t_s: float) -> tuple[Pose, Twist]:
        """Return pose and twist, both in the base frame, at `t_s`; from the end on exactly the
        goal."""
        u, du, _ = self._profile.at(t_s)
        twist = Twist(scale(self._linear, du), scale(self._angular, du), Frame.BASE)
        if t_s >= self.duration_s:
            return self.goal, twist
        turned = multiply(from_rotation_vector(scale(self._angular, u)), self.start.orientation)
        return Pose(add(self.start.position, scale(self._linear, u)), turned, Frame.BASE), twist


class PointToPointTrajectory:
    """Motion from rest to rest along a straight line in joint space: all joints arrive together.

    `start`, `goal` and limits by joint in kinematic order, rad (m) and per s, s².
    """

    def __init__(
        self,
        start: Sequence[float] | FloatArray,
        goal: Sequence[float] | FloatArray,
        speeds: Sequence[float] | FloatArray,
        accelerations: Sequence[float] | FloatArray,
    ) -> None:
        self.start = np.array(start, dtype=np.float64)
        self.goal = np.array(goal, dtype=np.float64)
        joints = self.start.size
        bounds = (("speeds", speeds), ("accelerations", accelerations))
        for name, values in (("goal", self.goal), *bounds):
            if len(values) != joints:
                raise ValueError(f"{name} has {len(values)} values for {joints} joints")
        if not (np.isfinite(self.start).all() and np.isfinite(self.goal).all()):
            raise ValueError("start and goal must be finite")
        for name, values in bounds:
            if not all(value > 0.0 for value in values):
                raise ValueError(f"{name} {list(values)} are not all above 0")
        self._way = self.goal - self.start
        ways = np.abs(self._way).tolist()
        speed, acceleration = (
            _strictest([float(value) for value in values], ways) for _, values in bounds
        )
        self._length = 1.0 if max(ways, default=0.0) > _NO_WAY else 0.0
        self._profile = Profile(self._length, speed, acceleration, math.inf)
        self._q, self._v = self.start.copy(), np.zeros_like(self.start)

    @property
    def duration_s(self) -> float:
        """Time until rest, s."""
        return self._profile.duration_s

    def at(self, t_s: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities at `t_s` since the start; the next call reuses the
        arrays."""
        u, du, _ = self._profile.at(t_s)
        np.multiply(self._way, du, out=self._v)
        if u >= self._length:
            np.copyto(self._q, self.goal)
        else:
            np.multiply(self._way, u, out=self._q)
            self._q += self.start
        return self._q, self._v


class HoldTrajectory:
    """Trajectory of an arm that is commanded to stay."""

    duration_s = 0.0

    def __init__(self, q: FloatArray) -> None:
        self._here = q, np.zeros_like(q)

    def at(self, _t_s: float, /) -> tuple[FloatArray, FloatArray]:
        """Return its positions, at rest."""
        return self._here


class SplineTrajectory:
    """The smooth curve through the points of a trajectory, from rest to rest.

    Cubic between points; of the fifth degree where accelerations are given, too.
    """

    def __init__(self, trajectory: JointTrajectory, start: FloatArray) -> None:
        """`start`: the arm's joint positions; the first point, if it is at time 0, is moved
        there."""
        times, positions = np.array(trajectory.times_s), np.array(trajectory.positions)
        velocities, accelerations = (
            None if rows is None else np.array(rows)
            for rows in (trajectory.velocities, trajectory.accelerations)
        )
        if times[0] < SHORTEST_STEP_S:
            positions = np.vstack((start, positions[1:]))
            times = np.concatenate(([0.0], times[1:]))
        else:
            rest = np.zeros((1, len(start)))
            positions = np.vstack((start, positions))
            times = np.concatenate(([0.0], times))
            velocities = None if velocities is None else np.vstack((rest, velocities))
            accelerations = None if accelerations is None else np.vstack((rest, accelerations))
        if velocities is None:
            velocities, accelerations = _without_swinging(times, positions), None
        velocities = velocities.copy()
        velocities[0] = velocities[-1] = 0.0
        self.positions: FloatArray = positions
        self.times_s: list[float] = times.tolist()
        self.duration_s = self.times_s[-1]
        self._pace = 1.0
        self._coefficients = [
            _segment(
                times[i + 1] - times[i],
                positions[i : i + 2],
                velocities[i : i + 2],
                None if accelerations is None else accelerations[i : i + 2],
            )
            for i in range(len(times) - 1)
        ]

    def slow(self, share: float) -> None:
        """Follow the same curve at this share of the speed from now on."""
        self._pace *= share
        self.duration_s /= share

    def at(self, t_s: float, /) -> tuple[FloatArray, FloatArray]:
        """Joint positions and velocities at `t_s` since the start."""
        c, t = self._place(t_s)
        position = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
        velocity = c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * (4.0 * c[4] + t * 5.0 * c[5])))
        return position, self._pace * velocity

    def acceleration(self, t_s: float) -> FloatArray:
        """Joint accelerations at `t_s` since the start."""
        c, t = self._place(t_s)
        value: FloatArray = 2.0 * c[2] + t * (6.0 * c[3] + t * (12.0 * c[4] + t * 20.0 * c[5]))
        return self._pace**2 * value

    def _place(self, t_s: float) -> tuple[FloatArray, float]:
        """Return the segment's coefficients, and the time in it."""
        if not self._coefficients:
            return self._at_rest, 0.0
        time_s = min(max(t_s * self._pace, 0.0), self.times_s[-1])
        index = min(bisect_right(self.times_s, time_s), len(self._coefficients)) - 1
        return self._coefficients[index], time_s - self.times_s[index]

    @property
    def _at_rest(self) -> FloatArray:
        still = np.zeros((6, self.positions.shape[1]))
        still[0] = self.positions[0]
        return still


def _segment(time_s: float, q: FloatArray, v: FloatArray, a: FloatArray | None) -> FloatArray:
    """Return the coefficients of the polynomial from one point to the next, lowest first."""
    found = np.zeros((6, q.shape[1]))
    found[0], found[1] = q[0], v[0]
    way = q[1] - q[0]
    t = time_s
    if a is None:
        found[2] = (3.0 * way / t - 2.0 * v[0] - v[1]) / t
        found[3] = (-2.0 * way / t + v[0] + v[1]) / t**2
        return found
    found[2] = 0.5 * a[0]
    found[3] = (20.0 * way / t - 12.0 * v[0] - 8.0 * v[1] - (3.0 * a[0] - a[1]) * t) / (2.0 * t**2)
    found[4] = (-30.0 * way / t + 16.0 * v[0] + 14.0 * v[1] + (3.0 * a[0] - 2.0 * a[1]) * t) / (
        2.0 * t**3
    )
    found[5] = (12.0 * way / t - 6.0 * (v[0] + v[1]) - (a[0] - a[1]) * t) / (2.0 * t**4)
    return found


def _without_swinging(times: FloatArray, positions: FloatArray) -> FloatArray:
    """Return velocities at the points with which no joint overshoots the neighboring points.
    Source: Fritsch and Butland 1984, the weighted harmonic mean of the slopes."""
    velocities = np.zeros_like(positions)
    steps = np.diff(times)[:, None]
    if len(steps) < 2:
        return velocities
    slopes = np.diff(positions, axis=0) / steps
    before, after = slopes[:-1], slopes[1:]
    one, other = 2.0 * steps[1:] + steps[:-1], steps[1:] + 2.0 * steps[:-1]
    same_way = before * after > 0.0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        mean = (one + other) / (one / before + other / after)
    velocities[1:-1] = np.where(same_way, mean, 0.0)
    return velocities


def samples(path: SplineTrajectory, step_rad: float, most: int) -> FloatArray:
    """Return times of the trajectory between which no joint moves by more than `step_rad` along the
    points. Raises MotionRefusedError if these are more than `most`."""
    found = [0.0]
    ways = np.abs(np.diff(path.positions, axis=0)).max(axis=1, initial=0.0)
    for index, way in enumerate(ways.tolist()):
        begin, end = path.times_s[index], path.times_s[index + 1]
        count = max(2, math.ceil(way / step_rad))
        found += [begin + (end - begin) * part / count for part in range(1, count + 1)]
        if len(found) > most:
            raise MotionRefusedError(
                f"trajectory: its path is too long to be checked ({most} samples); send parts"
            )
    return np.array(found)
