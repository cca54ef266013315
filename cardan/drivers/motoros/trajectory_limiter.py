"""Limiter of the values sent to the controller: they keep the joints' limits, whatever is
commanded.

It owns the commanded positions and velocities and moves them by one control period at a time, at
constant acceleration within the period: q += dt·(v_old + v_new)/2. Controllers do the same with a
point and its velocity, and with a velocity.

Excessive commands are limited, not refused, and no period contains a step:

- A vector of speeds is shortened as a whole, and so is its change, so the direction of motion, and
  that of its change, stay the ones asked for.
- A joint near the end of its range goes no faster than the speed from which it stops there. Its
  own component gives way, those of the others do not.
- On the way to a position all joints arrive together, each at a speed from which it can stop.

Plain floats on purpose: numpy is slower for six numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

from cardan.common.bounds import JOINT_POSITION, JOINT_VELOCITY, POSITIVE
from cardan.common.braking import stopping_speed
from cardan.common.options import check_value
from cardan.drivers.limiters import JointLimiter
from cardan.drivers.robot_core import check_numbers, wrong_kind
from cardan.errors import CommandError, ConfigurationError
from cardan.types import CommandKind, HoldCommand, JointCommand, JointVelocityCommand, RobotCommand

LONGEST_STEP_S: Final = 0.1
"""Longest period; a longer one counts as this."""
SHORTEST_STEP_S: Final = 1e-6
"""Shorter steps are ignored."""

KINDS: Final = frozenset({CommandKind.HOLD, CommandKind.JOINT, CommandKind.JOINT_VELOCITY})
"""Commands that it accepts."""

_PERIODS_AHEAD = 5.0
"""Factor by which the next period may be longer without an abrupt stop of a joint."""
_INF = math.inf
_sqrt = math.sqrt


class JointTrajectoryLimiter(JointLimiter):
    """A limiter for joints that are independent of each other but move as one vector.

    Always, to rounding: |v| <= `velocity`; |Δv| <= `acceleration`·dt; positions stay in `lower` to
    `upper`, whatever sequence of periods is given. A joint that is placed outside its range may
    stay there or move inwards.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        velocity: Sequence[float],
        acceleration: Sequence[float],
    ) -> None:
        """Limits per joint: rad (infinite for a continuous joint), rad/s, rad/s².

        Raises ConfigurationError for lengths that differ, an empty range, or a velocity or an
        acceleration that is not positive and finite.
        """
        count = len(velocity)
        for key, values in (("lower", lower), ("upper", upper), ("acceleration", acceleration)):
            if len(values) != count:
                raise ConfigurationError(key, f"{len(values)} values for {count} joints")
        for key, values in (("velocity", velocity), ("acceleration", acceleration)):
            for value in values:
                check_value(key, value, Annotated[float, POSITIVE])
        for low, high in zip(lower, upper, strict=True):
            if not low < high:
                raise ConfigurationError("upper", f"{high!r} is not above the lower end {low!r}")
        super().__init__(lower, upper, velocity, acceleration, LONGEST_STEP_S)
        self._stop = tuple(0.5 * v * v / a for v, a in zip(velocity, acceleration, strict=True))
        self._free_high = (_INF,) * count
        self._free_low = (-_INF,) * count
        self._forward = [*self._rest]
        self._error = [*self._rest]
        self._moved: Sequence[float] = self._rest
        self._high = [*self._free_high]
        self._low = [*self._free_low]
        self._range_high = [*self._free_high]
        self._range_low = [*self._free_low]
        self.closing_rad_s = _INF
        """Fastest correction of a distance, in addition to a JointCommand's velocities."""

    @property
    def speeds(self) -> tuple[float, ...]:
        """Speed limits, rad/s."""
        return self._speed

    @property
    def accelerations(self) -> tuple[float, ...]:
        """Acceleration limits, rad/s²."""
        return self._acceleration

    def reset(self, positions: Sequence[float], velocities: Sequence[float] | None = None) -> None:
        """Start from `positions`, rad, at rest, or at `velocities`, rad/s, as far as the limits
        allow.

        Raises CommandError, and changes nothing, for a wrong length or an implausible number.
        """
        check_numbers("positions", positions, JOINT_POSITION, len(self._axes))
        if velocities is not None:
            check_numbers("velocities", velocities, JOINT_VELOCITY, len(self._axes))
        super().reset(positions, velocities)

    def coast(self, gap_s: float) -> None:
        """Advance by `gap_s` at the present speeds, slowing down for the ends of the ranges."""
        velocities = tuple(self.velocity)
        while gap_s >= SHORTEST_STEP_S:
            self.drive(velocities, min(gap_s, LONGEST_STEP_S))
            gap_s -= LONGEST_STEP_S

    def step(self, command: RobotCommand, dt_s: float) -> None:
        """Execute `command` for `dt_s`, as far as the limits allow.

        A JointCommand is followed at its velocities, plus a correction of the remaining distance
        without overshoot. Without velocities the target is assumed to move as in both of the two
        previous periods. A HoldCommand brakes along the direction of motion: the slowest joint, max
        |v|/acceleration, determines the time. A period of less than 1 µs, negative or NaN changes
        nothing; one above 0.1 s counts as 0.1 s. Raises CommandError, and changes nothing, for a
        wrong length, an implausible number, external axes, and commands other than these three.
        """
        if isinstance(command, JointCommand):
            forward = command.velocities
            check_numbers("positions", command.positions, JOINT_POSITION, len(self._axes))
            if forward is not None:
                check_numbers("velocities", forward, JOINT_VELOCITY, len(self._axes))
            if command.external_axes:
                raise CommandError("external_axes: the trajectory limiter supports none")
            if dt_s >= SHORTEST_STEP_S:
                self.track(command.positions, forward, min(dt_s, LONGEST_STEP_S))
        elif isinstance(command, JointVelocityCommand):
            check_numbers("velocities", command.velocities, JOINT_VELOCITY, len(self._axes))
            if dt_s >= SHORTEST_STEP_S:
                self.drive(command.velocities, min(dt_s, LONGEST_STEP_S))
        elif isinstance(command, HoldCommand):
            if dt_s >= SHORTEST_STEP_S:
                self.brake(min(dt_s, LONGEST_STEP_S))
        else:
            raise wrong_kind("the guide", command, KINDS)

    def track(
        self, target: Sequence[float], velocities: Sequence[float] | None, dt_s: float
    ) -> None:
        """Advance one period towards `target`, which moves at `velocities`; without them, see
        `step`."""
        positions = self.reference
        speeds = self._speed
        previous = self._target
        before = self._rest if previous is None else self._moved
        goals: list[float] = []
        moved: list[float] = []
        forward = self._forward
        error = self._error
        shrink = 1.0
        for i in self._axes:
            goal = target[i]
            position = positions[i]
            upper = self._upper[i]
            lower = self._lower[i]
            fastest = _INF
            slowest = -_INF
            if goal > upper:
                goal = max(upper, min(goal, position))
                fastest = 0.0
            elif goal < lower:
                goal = min(lower, max(goal, position))
                slowest = 0.0
            rate = 0.0 if previous is None else (goal - previous[i]) / dt_s
            goals.append(goal)
            moved.append(rate)
            if velocities is not None:
                speed = min(max(velocities[i], slowest), fastest)
            elif rate * before[i] <= 0.0:
                # A target with a step does not move.
                speed = 0.0
            else:
                speed = rate if abs(rate) < abs(before[i]) else before[i]
            forward[i] = speed
            if abs(speed) * shrink > speeds[i]:
                shrink = speeds[i] / abs(speed)
        self._target, self._moved = goals, moved

        # The speed at which an error can be closed such that, the period over, joint i can still
        # stop: r·dt + r²/(2a) = |e|, written r = closing·|e|. The smallest `closing` for all keeps
        # the direction, and with it the joints arrive together.
        closing = _INF
        own = [*self._rest]
        for i in self._axes:
            speed = forward[i] * shrink
            forward[i] = speed
            left = goals[i] - positions[i] - 0.5 * dt_s * (self.velocity[i] + speed)
            error[i] = left
            a = self._acceleration[i]
            gain = a * dt_s
            rate = 2.0 * a / (_sqrt(gain * gain + 2.0 * a * abs(left)) + gain)
            own[i] = rate
            if rate < closing:
                closing = rate
            if velocities is not None and closing * abs(left) > self.closing_rad_s:
                closing = self.closing_rad_s / abs(left)
        low = self._low
        high = self._high
        for i in self._axes:
            left = error[i]
            speed = forward[i]
            # Above this a joint on its way to the target could not stop there, even if the
            # direction of the others were given up.
            gain = self._acceleration[i] * dt_s
            low[i] = -_INF
            high[i] = _INF
            if left > 0.0:
                high[i] = max(speed + own[i] * left, self.velocity[i] - gain, 0.0)
            elif left < 0.0:
                low[i] = min(speed + own[i] * left, self.velocity[i] + gain, 0.0)
            own[i] = speed + closing * left
        self._approach(own, low, high, dt_s)

    def _advance(
        self, desired: Sequence[float], target: Sequence[float] | None, dt_s: float
    ) -> None:
        self._approach([*desired], self._free_low, self._free_high, dt_s)

    def _approach(
        self, wanted: list[float], lows: Sequence[float], highs: Sequence[float], dt_s: float
    ) -> None:
        """Advance one period towards the velocities `wanted` (modified in place), within `lows` and
        `highs`.

        The bounds contain zero, or the way to it that the acceleration allows.
        """
        positions = self.reference
        velocities = self.velocity
        speeds = self._speed
        accelerations = self._acceleration
        range_high = self._range_high
        range_low = self._range_low
        later_s = min(_PERIODS_AHEAD * dt_s, LONGEST_STEP_S)
        mean_s = 0.5 * (dt_s + later_s)
        half_s = 0.5 * dt_s
        shrink = 1.0
        for i in self._axes:
            velocity = velocities[i]
            position = positions[i]
            most = speeds[i]
            speed = wanted[i]
            on_the_way = half_s * velocity
            reach = self._stop[i] + mean_s * most  # an end farther away does not matter
            high = _INF
            room = self._upper[i] - position - on_the_way
            if room < reach:
                a = accelerations[i]
                high = max(_speed_towards_end(room, a, dt_s, later_s), velocity - a * dt_s)
                if speed > high:
                    speed = high
            range_high[i] = high
            low = -_INF
            room = position - self._lower[i] + on_the_way
            if room < reach:
                a = accelerations[i]
                low = min(-_speed_towards_end(room, a, dt_s, later_s), velocity + a * dt_s)
                if speed < low:
                    speed = low
            range_low[i] = low
            wanted[i] = speed
            size = abs(speed)
            if size * shrink > most:
                shrink = most / size
        share = 1.0
        for i in self._axes:
            speed = wanted[i] * shrink
            wanted[i] = speed
            size = abs(speed - velocities[i])
            gain = accelerations[i] * dt_s
            if size * share > gain:
                share = gain / size
        for i in self._axes:
            velocity = velocities[i]
            speed = wanted[i]
            if share < 1.0:
                speed = velocity + share * (speed - velocity)
            if speed > highs[i]:
                speed = highs[i]
            elif speed < lows[i]:
                speed = lows[i]
            if speed > range_high[i]:
                speed = range_high[i]
            elif speed < range_low[i]:
                speed = range_low[i]
            position = positions[i]
            after = position + half_s * (velocity + speed)
            # Acts on rounding, and when a joint about to stop at the end meets a period much
            # longer than those before: then it stops within the period.
            if after > self._upper[i]:
                after = min(after, max(self._upper[i], position))
            elif after < self._lower[i]:
                after = max(after, min(self._lower[i], position))
            velocities[i] = speed
            positions[i] = after


def _speed_towards_end(room: float, acceleration: float, dt_s: float, later_s: float) -> float:
    """Return the highest speed at the end of a period of `dt_s` from which a joint can stop in
    time.

    `room` is the distance to the end less dt·v_old/2. In periods of up to `later_s` a joint at v
    needs v²/(2a) and, for the last of them, in which it only stops, at most a·later²/8 more; below
    a·later/2 it may stop in one, which takes v·later/2.
    """
    if room <= 0.0:
        return 0.0
    speed = 2.0 * room / (later_s + dt_s)
    if speed <= 0.5 * acceleration * later_s:
        return speed
    left = room - 0.125 * acceleration * later_s * later_s
    return stopping_speed(left, acceleration, 0.5 * dt_s)
