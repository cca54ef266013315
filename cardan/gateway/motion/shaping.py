"""Shaping tick by tick: a velocity or a pose that follows its target with bounded jerk.

Plain floats, because a tick handles three components. Bounds are Euclidean norms, so that a
change of target is a straight line. Between ticks the motion is continuous: the period may vary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Literal

from cardan.common.extras import missing_extra
from cardan.errors import ConfigurationError
from cardan.spatial import (
    add,
    dot,
    is_finite,
    norm,
    normalized,
    rotation_between,
    scale,
    subtract,
    turned_by,
)
from cardan.types import ZERO3, Frame, Pose, Twist, Vector3

_THESIS_LOOP_S = 0.1
"""Period of the thesis's control loop: its damping factor is the share of one step."""

_SAME_DIRECTION_RAD = 0.2
"""Angle beyond half a turn up to which a rotation keeps its chosen direction."""

_FORMED = 0.98
"""Share of the jerk that plans use; the rest covers rounding."""


def damping_time_s(damping: float) -> float:
    """Return the time constant of the thesis's damping factor, 0.1 (slow) to 1 (undamped: 0 s)."""
    if not 0.1 <= damping <= 1.0:
        raise ValueError(f"damping {damping:g} is not in 0.1 to 1")
    return 0.0 if damping == 1.0 else -_THESIS_LOOP_S / math.log1p(-damping)


def _stop_way(v: float, a: float, most: float, jerk: float) -> float:
    """Return the signed distance of the quickest stop from speed `v` and acceleration `a` along one
    line."""
    if v + 0.5 * a * abs(a) / jerk < 0.0:
        return -_stop_way(-v, -a, most, jerk)
    rising = a / jerk
    squared = max(0.0, jerk * v + 0.5 * a * a)  # Below by rounding, near the end of the stop.
    if squared <= most * most:
        peak = math.sqrt(squared)
        hold = 0.0
    else:
        peak = most
        hold = (squared - peak * peak) / (jerk * peak)
    # Phases -jerk, none, +jerk; the last one ends at rest, so its way is peak³/(6·jerk²).
    first = rising + peak / jerk
    after = v + first * (a - 0.5 * jerk * first)
    return (
        first * (v + first * (0.5 * a - jerk * first / 6.0))
        + hold * (after - 0.5 * peak * hold)
        + peak * peak * peak / (6.0 * jerk * jerk)
    )


def _stop_sample(
    v: float, a: float, most: float, jerk: float, dt: float
) -> tuple[float, float, float]:
    """Return position, speed and acceleration `dt` into the quickest stop along one line."""
    if v + 0.5 * a * abs(a) / jerk < 0.0:
        way, v, a = _stop_sample(-v, -a, most, jerk, dt)
        return -way, -v, -a
    squared = max(0.0, jerk * v + 0.5 * a * a)  # Below by rounding, near the end of the stop.
    peak = math.sqrt(squared) if squared <= most * most else most
    hold = (squared - peak * peak) / (jerk * peak) if squared > most * most else 0.0
    way = 0.0
    for time, rate in (((a + peak) / jerk, -jerk), (hold, 0.0), (peak / jerk, jerk)):
        t = time if time < dt else dt
        way += t * (v + t * (0.5 * a + rate * t / 6.0))
        v += t * (a + 0.5 * rate * t)
        a += rate * t
        dt -= t
        if dt <= 0.0:
            return way, v, a
    return way, 0.0, 0.0


class JerkLimitedVector:
    """A velocity of 1 to 3 components that follows a target, |a| and |jerk| bounded.

    Each tick takes the largest acceleration towards the target from which it can still be reached
    without passing it: a straight change is time-optimal to within a tick, does not overshoot, and
    ends exactly at the target. Only a target that comes nearer than the present acceleration can be
    reduced is overshot, and never beyond `speed`.
    """

    def __init__(self, dimensions: int, speed: float, acceleration: float, jerk: float) -> None:
        if dimensions not in (1, 2, 3):
            raise ValueError(f"{dimensions} dimensions are not 1, 2 or 3")
        for name, value in (("speed", speed), ("acceleration", acceleration), ("jerk", jerk)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} {value:g} is not a finite number above 0")
        self.dimensions = dimensions
        self.speed, self.acceleration, self.jerk = speed, acceleration, jerk
        self._v = self._a = (0.0, 0.0, 0.0)

    @property
    def velocity(self) -> tuple[float, ...]:
        """The present velocity."""
        return self._v[: self.dimensions]

    @property
    def acceleration_now(self) -> tuple[float, ...]:
        """The present acceleration."""
        return self._a[: self.dimensions]

    def reset(self, velocity: tuple[float, ...] | None = None) -> None:
        """Restart from `velocity` (rest when None) without acceleration."""
        values = (0.0,) * self.dimensions if velocity is None else tuple(velocity)
        if len(values) != self.dimensions or not is_finite(values):
            raise ValueError(f"velocity {values} is not {self.dimensions} finite numbers")
        if math.hypot(*values) > self.speed * (1.0 + 1e-9):
            raise ValueError(f"velocity {values} is above the speed {self.speed:g}")
        padded = (*values, 0.0, 0.0)
        self._v, self._a = (padded[0], padded[1], padded[2]), (0.0, 0.0, 0.0)

    def advance(self, target: tuple[float, ...], dt_s: float) -> tuple[float, ...]:
        """Return the velocity `dt_s` later, following `target` (shortened to the speed limit)."""
        dimensions = self.dimensions
        if len(target) != dimensions:
            raise ValueError(f"target {target} has not {dimensions} components")
        if dimensions == 3:
            tx, ty, tz = target
        else:
            tx, ty, tz = target[0], target[1] if dimensions == 2 else 0.0, 0.0
        length = math.sqrt(tx * tx + ty * ty + tz * tz)
        if not (length < math.inf and 0.0 <= dt_s < math.inf):
            raise ValueError(f"target {target}, period {dt_s} s: finite numbers, period from 0")
        if length > self.speed:
            factor = self.speed / length
            tx, ty, tz = tx * factor, ty * factor, tz * factor
        self._v, self._a = _follow(
            self._v, self._a, (tx, ty, tz), self.speed, self.acceleration, self.jerk, dt_s
        )
        return Vector3(*self._v) if dimensions == 3 else self._v[:dimensions]


_Triple = tuple[float, float, float]


def _follow(
    v: _Triple, a: _Triple, target: _Triple, speed: float, most: float, jerk: float, dt: float
) -> tuple[_Triple, _Triple]:
    """Advance velocity and acceleration by one tick towards `target`, which is within `speed`."""
    vx, vy, vz = v
    ax, ay, az = a
    ex, ey, ez = target[0] - vx, target[1] - vy, target[2] - vz
    aa = ax * ax + ay * ay + az * az
    ee = ex * ex + ey * ey + ez * ez
    if dt == 0.0:
        return v, a
    if aa == 0.0 and ee == 0.0:
        return target, (0.0, 0.0, 0.0)
    q = jerk * dt
    e, an = math.sqrt(ee), math.sqrt(aa)
    # Landing within this tick, when everything is along one line and there is time for it.
    if an <= q and 4.0 * e <= 3.0 * q * dt:
        along = (ax * ex + ay * ey + az * ez) / e if e > 0.0 else an
        if aa - along * along <= 1e-12 * aa:
            rest = jerk * e + 0.5 * aa
            outside = along > 0.0 and along * along > 2.0 * jerk * e * (1.0 + 1e-6)
            if not outside and 2.0 * math.sqrt(rest) - along <= q * (1.0 + 1e-9):
                return target, (0.0, 0.0, 0.0)
    # The rest when this tick's share of the present acceleration is spent.
    half = 0.5 * dt
    xx, xy, xz = ex - ax * half, ey - ay * half, ez - az * half
    x = math.sqrt(xx * xx + xy * xy + xz * xz)
    # From acceleration w the rest of the way takes w²/(2·jerk): w²/(2·jerk) + w·dt/2 = x.
    wanted = math.sqrt(0.25 * q * q + 2.0 * jerk * x) - 0.5 * q
    if wanted > most:
        wanted = most
    factor = wanted / x if x > 0.0 else 0.0
    cx, cy, cz = xx * factor - ax, xy * factor - ay, xz * factor - az
    change = math.sqrt(cx * cx + cy * cy + cz * cz)
    if change > q:
        factor = q / change
        cx, cy, cz = cx * factor, cy * factor, cz * factor
    limit = speed * speed * (1.0 + 1e-9)
    # Straight from the kill of the acceleration towards the wanted one, as far as the speed that
    # is still to come allows.
    kill = (1.0 - q / an) if an > q else 0.0
    kx, ky, kz = ax * kill, ay * kill, az * kill
    for share in (1.0, 0.5, 0.25, 0.125):
        nx = kx + share * (ax + cx - kx)
        ny = ky + share * (ay + cy - ky)
        nz = kz + share * (az + cz - kz)
        ux, uy, uz = vx + half * (ax + nx), vy + half * (ay + ny), vz + half * (az + nz)
        n = math.sqrt(nx * nx + ny * ny + nz * nz)
        g = 0.5 * n / jerk
        sx, sy, sz = ux + nx * g, uy + ny * g, uz + nz * g
        if ux * ux + uy * uy + uz * uz <= limit and sx * sx + sy * sy + sz * sz <= limit:
            return (ux, uy, uz), (nx, ny, nz)
    time = dt if an > q else an / jerk
    mean = 0.5 * time
    return (
        (vx + mean * (ax + kx), vy + mean * (ay + ky), vz + mean * (az + kz)),
        (kx, ky, kz),
    )


@dataclass(frozen=True, kw_only=True)
class PoseShaperLimits:
    """Limits of a pose's reference; separate norms for translation and rotation."""

    linear_speed_m_s: float = 0.25
    linear_acceleration_m_s2: float = 1.0
    linear_jerk_m_s3: float = 10.0
    angular_speed_rad_s: float = 1.0
    angular_acceleration_rad_s2: float = 4.0
    angular_jerk_rad_s3: float = 40.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < math.inf:
                raise ConfigurationError(field.name, f"{value!r} is not a finite number above 0")


class _Chaser:
    """Velocity and acceleration of a point that chases another. The end point of the quickest stop
    is steered to the target and not past it: each tick chooses between braking and full speed
    accordingly. Along one line this is exact (the stop has a closed form); across, the stop is
    estimated and corrected tick by tick.
    """

    def __init__(self, speed: float, acceleration: float, jerk: float, time_s: float) -> None:
        self.speed, self.acceleration, self.jerk = speed, acceleration, jerk * _FORMED
        self._margin = jerk * (1.0 - _FORMED)
        self._time_s = time_s
        self._patience_s = 2.0 * (speed / acceleration + acceleration / self.jerk)
        self._stopping = False
        self.v = self.a = ZERO3

    def rest(self) -> None:
        """Come to rest at once."""
        self.v = self.a = ZERO3

    def advance(self, d: Vector3, dt: float, resting_s: float) -> Vector3:
        """Return the displacement of this tick. `d` is the distance vector from the point to its
        target now, `resting_s` the time since when the target rests."""
        if resting_s == 0.0:
            self._stopping = False
        v, a = self.v, self.a
        distance, vn, an = norm(d), norm(v), norm(a)
        if distance == 0.0 and vn == 0.0 and an == 0.0:
            return ZERO3
        # Largest jerk of the quintic from here to rest at the target in one tick.
        if 60.0 * distance + dt * (36.0 * vn + dt * 9.0 * an) <= self.jerk * dt**3:
            self.rest()
            return d
        if distance > 0.0:
            u = scale(d, 1.0 / distance)
        else:
            u = scale(v, 1.0 / vn) if vn > 0.0 else scale(a, 1.0 / an)
        dv = dot(v, u)
        da = dot(a, u)
        across_v = norm(subtract(v, scale(u, dv)))
        across_a = norm(subtract(a, scale(u, da)))
        if 36.0 * across_v + 9.0 * dt * across_a <= self._margin * dt * dt:
            self._stopping = False
            way, dv, da = self._straight(distance, dv, da, dt)
            self.v, self.a = scale(u, dv), scale(u, da)
            return scale(u, way)
        return self._across(d, distance, dt, resting_s)

    def _fastest(self, distance: float) -> float:
        if self._time_s <= 0.0:
            return self.speed
        return min(self.speed, distance / self._time_s)

    def _straight(self, d: float, v: float, a: float, dt: float) -> tuple[float, float, float]:
        most, jerk = self.acceleration, self.jerk
        left = d - _stop_way(v, a, most, jerk)
        stopped = _stop_sample(v, a, most, jerk, dt)
        tolerance = jerk * dt**3 / 200.0
        if abs(left) <= tolerance:
            return stopped
        side = 1.0 if left > 0.0 else -1.0
        fastest = side * self._fastest(abs(d))
        (going, _, _), (gained, _, _) = _follow(
            (v, 0.0, 0.0), (a, 0.0, 0.0), (fastest, 0.0, 0.0), self.speed, most, jerk, dt
        )
        # A tick that lands on the speed has another shape inside than a line: its way is bounded
        # by that of the line and the change of shape, which the next tick's stop takes in.
        way = dt * (v + going) / 2.0 + dt * dt * (a - gained) / 12.0
        over = side * (way + _stop_way(going, gained, most, jerk) - d)
        if over <= 0.0:
            return way, going, gained
        # Between braking (share 0, never past the target) and going (share 1, past it): the
        # secant kept inside its bracket, and only ever the side that is not past.
        lowest, highest, under = 0.0, 1.0, -abs(left)
        best = stopped
        for _ in range(12):
            share = lowest + (highest - lowest) * under / (under - over)
            next_a = stopped[2] + share * (gained - stopped[2])
            next_v = v + 0.5 * dt * (a + next_a)
            way = dt * (v + dt * (2.0 * a + next_a) / 6.0)
            past = side * (way + _stop_way(next_v, next_a, most, jerk) - d)
            if past <= 0.0:
                coming = next_v + 0.5 * next_a * abs(next_a) / jerk
                if max(abs(coming), abs(next_v)) <= self.speed * (1.0 + 1e-9):
                    best = (way, next_v, next_a)
                lowest, under = share, past
                over *= 0.5
                if past > -tolerance:
                    break
            else:
                highest, over = share, past
                under *= 0.5
        return best

    def _stop_estimate(self, v: Vector3, a: Vector3) -> Vector3:
        """Return the end of the quickest stop from here: exact along one line."""
        jerk = self.jerk
        an = norm(a)
        end = add(v, scale(a, 0.5 * an / jerk))
        speed = norm(end)
        if speed <= 1e-12:
            return add(scale(v, an / jerk), scale(a, an * an / (3.0 * jerk * jerk)))
        n = scale(end, 1.0 / speed)
        vn = dot(v, n)
        along = dot(a, n)
        side_v, side_a = subtract(v, scale(n, vn)), subtract(a, scale(n, along))
        side = add(scale(side_v, an / jerk), scale(side_a, an * an / (3.0 * jerk * jerk)))
        return add(scale(n, _stop_way(vn, along, self.acceleration, jerk)), side)

    def _across(self, d: Vector3, distance: float, dt: float, resting_s: float) -> Vector3:
        v, a, most, jerk = self.v, self.a, self.acceleration, self.jerk
        stop = self._stop_estimate(v, a)
        left = subtract(d, stop)
        far = norm(left)
        braked_v, braked_a = _follow(v, a, ZERO3, self.speed, most, jerk, dt)
        chosen_v, chosen_a = Vector3(*braked_v), Vector3(*braked_a)
        if resting_s > self._patience_s and distance < norm(v) * self._patience_s:
            # The estimate can hold the point on an orbit around a target that rests: stop, and
            # go the rest straight.
            self._stopping = True
        if far > jerk * dt**3 / 200.0 and not self._stopping:
            aim = scale(left, self._fastest(distance) / far)
            going_v, going_a = _follow(v, a, aim, self.speed, most, jerk, dt)
            for share in (1.0, 0.75, 0.5, 0.25, 0.125, 0.0625):
                # Both ends keep acceleration and jerk, which are convex.
                next_v = add(chosen_v, scale(subtract(Vector3(*going_v), chosen_v), share))
                next_a = add(chosen_a, scale(subtract(Vector3(*going_a), chosen_a), share))
                moved = add(
                    scale(add(v, next_v), 0.5 * dt), scale(subtract(a, next_a), dt * dt / 12.0)
                )
                reach = subtract(add(moved, self._stop_estimate(next_v, next_a)), stop)
                # The speed that is still to come is no convex thing.
                coming = norm(add(next_v, scale(next_a, 0.5 * norm(next_a) / jerk)))
                fastest = max(coming, norm(next_v))
                if fastest <= self.speed * (1.0 + 1e-9) and dot(reach, left) <= far * far:
                    chosen_v, chosen_a = next_v, next_a
                    break
        way = add(scale(add(v, chosen_v), 0.5 * dt), scale(subtract(a, chosen_a), dt * dt / 12.0))
        self.v, self.a = chosen_v, chosen_a
        return way


class _RuckigChaser:
    """The same chase by ruckig's position interface: bounds per axis, so that norms hold too."""

    def __init__(self, speed: float, acceleration: float, jerk: float, time_s: float) -> None:
        try:
            import ruckig
        except ImportError as error:
            raise missing_extra("this shaping", "ruckig", "ruckig", error) from error
        self._ruckig: Any = ruckig
        self.speed, self.acceleration, self.jerk = speed, acceleration, jerk
        self._time_s = time_s
        self._input = ruckig.InputParameter(3)
        # Phase synchronization is a straight line wherever the state allows one. Ruckig fails on
        # some states that rounding has put just beside one, and then goes without.
        kinds = ruckig.Synchronization
        self._synchronizations = (kinds.Phase, kinds.Time, kinds.No)
        self._trajectory = ruckig.Trajectory(3)
        self._otg = ruckig.Ruckig(3)
        self.v = self.a = ZERO3

    def rest(self) -> None:
        """Come to rest at once."""
        self.v = self.a = ZERO3

    def advance(self, d: Vector3, dt: float, resting_s: float) -> Vector3:
        """Return the displacement of this tick, with the arguments of :meth:`_Chaser.advance`."""
        if d == ZERO3 and self.v == ZERO3 and self.a == ZERO3:
            return ZERO3
        share = 1.0 / math.sqrt(3.0)
        speed = self.speed
        if self._time_s > 0.0:
            speed = max(1e-6 * speed, min(speed, norm(d) / self._time_s))
        given = self._input
        given.current_position = [0.0, 0.0, 0.0]
        given.current_velocity, given.current_acceleration = list(self.v), list(self.a)
        given.target_position = list(d)
        given.max_velocity = [share * speed] * 3
        given.max_acceleration = [share * self.acceleration] * 3
        given.max_jerk = [share * self.jerk] * 3
        for synchronization in self._synchronizations:
            given.synchronization = synchronization
            try:
                if self._otg.calculate(given, self._trajectory) >= 0:
                    break
            except self._ruckig.RuckigError:
                continue
        else:
            return self._brake(dt)
        way, v, a = self._trajectory.at_time(dt)
        if dt >= self._trajectory.duration:
            self.rest()
            return d
        self.v, self.a = Vector3(*v), Vector3(*a)
        return Vector3(*way)

    def _brake(self, dt: float) -> Vector3:
        before_v, before_a = self.v, self.a
        v, a = _follow(before_v, before_a, ZERO3, self.speed, self.acceleration, self.jerk, dt)
        self.v, self.a = Vector3(*v), Vector3(*a)
        return add(
            scale(add(before_v, self.v), 0.5 * dt),
            scale(subtract(before_a, self.a), dt * dt / 12.0),
        )


class PoseShaper:
    """A pose that chases a target pose: straight in position, along the geodesic in rotation.

    Speed, acceleration and jerk stay within `limits` even if the target jumps at every tick. From
    rest a resting target is reached with an overshoot of at most 1e-9 of the distance. `damping` is
    the thesis's factor, 0.1 to 1, as a time constant of :func:`damping_time_s`: the speed is at
    most the distance through it, whatever the tick rate. A rotation near half a turn keeps its
    direction until the other is shorter by 0.4 rad.

    `backend` "ruckig" takes that library's position interface instead; its bounds are per axis: the
    norm divided by the square root of 3.
    """

    def __init__(
        self,
        limits: PoseShaperLimits,
        *,
        damping: float = 1.0,
        backend: Literal["builtin", "ruckig"] = "builtin",
    ) -> None:
        if backend not in ("builtin", "ruckig"):
            raise ConfigurationError("backend", f"{backend!r} is neither 'builtin' nor 'ruckig'")
        make = _Chaser if backend == "builtin" else _RuckigChaser
        try:
            time_s = damping_time_s(damping)
        except ValueError as error:
            raise ConfigurationError("damping", str(error)) from None
        self._linear = make(
            limits.linear_speed_m_s,
            limits.linear_acceleration_m_s2,
            limits.linear_jerk_m_s3,
            time_s,
        )
        self._angular = make(
            limits.angular_speed_rad_s,
            limits.angular_acceleration_rad_s2,
            limits.angular_jerk_rad_s3,
            time_s,
        )
        self.limits = limits
        self.pose: Pose | None = None
        """Reference pose, base frame; None until placed."""
        self._turn: Vector3 | None = None
        self._target: Pose | None = None
        self._resting_s = 0.0

    def place(self, pose: Pose) -> None:
        """Put the reference at `pose` (base frame), at rest."""
        self.pose = Pose(pose.position, normalized(pose.orientation), Frame.BASE)
        self._linear.rest()
        self._angular.rest()
        self._turn = self._target = None

    def adopt(self, pose: Pose, twist: Twist | None = None) -> None:
        """Continue from `pose` (base frame) after another motion has moved the reference, at
        `twist` (base axes) without acceleration if given, else at its own velocity.
        """
        self.pose = pose
        if twist is not None:
            self._linear.rest()
            self._angular.rest()
            self._linear.v, self._angular.v = twist.linear, twist.angular

    @property
    def twist(self) -> Twist:
        """The present velocity, in base axes."""
        return Twist(self._linear.v, self._angular.v, Frame.BASE)

    @property
    def acceleration(self) -> Twist:
        """The present acceleration, m/s² and rad/s², in base axes."""
        return Twist(self._linear.a, self._angular.a, Frame.BASE)

    def advance(self, target: Pose, dt_s: float) -> Pose:
        """Return the pose `dt_s` later, on the way to `target` (base frame)."""
        pose = self.pose
        if pose is None:
            raise RuntimeError("the shaper has not been placed")
        if not (is_finite(target.position) and is_finite(target.orientation)):
            raise ValueError(f"target {target} is not finite")
        if not 0.0 <= dt_s < math.inf:
            raise ValueError(f"period {dt_s} s is not a finite time from 0")
        turn = self._chosen_turn(rotation_between(pose.orientation, normalized(target.orientation)))
        if dt_s == 0.0:
            return pose
        self._resting_s = self._resting_s + dt_s if target == self._target else 0.0
        self._target = target
        resting_s = self._resting_s
        way = self._linear.advance(subtract(target.position, pose.position), dt_s, resting_s)
        turned = self._angular.advance(turn, dt_s, resting_s)
        self._turn = turn
        self.pose = Pose(
            add(pose.position, way),
            turned_by(pose.orientation, turned),
            Frame.BASE,
        )
        return self.pose

    def _chosen_turn(self, short: Vector3) -> Vector3:
        """Return the remaining rotation, rad: `short`, or near pi the direction of the previous
        tick."""
        before = self._turn
        angle = norm(short)
        if before is None or angle < math.pi - _SAME_DIRECTION_RAD:
            return short
        if dot(short, before) >= 0.0:
            return short
        if norm(before) < 0.5 * math.pi:
            return short
        return scale(short, (angle - 2.0 * math.pi) / angle)
