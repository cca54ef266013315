"""The curve through the points of a joint trajectory."""

from __future__ import annotations

import math
from bisect import bisect_right

from cardan.common.arm_libraries import np, npt
from cardan.errors import MotionRefusedError
from cardan.gateway.motion.joint_trajectory import SHORTEST_STEP_S, JointTrajectory

FloatArray = npt.NDArray[np.float64]


class TrajectoryPath:
    """The smooth curve through the points of a trajectory, from rest to rest.

    Cubic between points; of the fifth degree where accelerations are given, too.
    """

    def __init__(self, trajectory: JointTrajectory, start: FloatArray) -> None:
        """`start`: where the arm is; the first point, where it is at time 0, is moved there."""
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
        """The segment's coefficients, and the time in it."""
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
    """Coefficients of the polynomial from one point to the next, lowest first."""
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
    """Velocities at the points with which no joint leaves the range of the points beside it.

    Source: Fritsch and Butland 1984, the weighted harmonic mean of the slopes.
    """
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


def samples(path: TrajectoryPath, step_rad: float, most: int) -> FloatArray:
    """Times, as the trajectory has them, between which no joint moves by more than `step_rad`
    along the points. Raises MotionRefusedError where that takes more than `most`."""
    found = [0.0]
    ways = np.abs(np.diff(path.positions, axis=0)).max(axis=1, initial=0.0)
    for index, way in enumerate(ways.tolist()):
        begin, end = path.times_s[index], path.times_s[index + 1]
        count = max(2, math.ceil(way / step_rad))
        found += [begin + (end - begin) * part / count for part in range(1, count + 1)]
        if len(found) > most:
            raise MotionRefusedError(
                f"trajectory: its way is too long to be looked through ({most} samples)"
            )
    return np.array(found)
