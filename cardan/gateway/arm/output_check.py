"""The last check in front of every robot driver: commands beyond a limit are not sent.

Limits are met by construction before this. This check is for unforeseen faults: an overflow, a
programming error, a filter or a plugin with wrong results.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.spatial import is_finite
from cardan.types import (
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    Quaternion,
    RobotCommand,
    TorqueCommand,
)

SLACK = 1.05
"""Factor on every limit, for rounding and servo tolerances."""

NOISE_M_S, NOISE_RAD_S = 1e-3, 5e-3
"""Speeds and changes of speed that are rounding, whatever the limits are."""

STILL = 1e-6
"""Largest motion, m or rad, accepted while no time passes: rounding."""

END_RAD, ROUNDING_RAD = 1e-3, 1e-9
"""Largest distance of a joint beyond its range, and largest further motion of a joint that is
farther out."""

UNEVEN = 1.25
"""Largest time between two joint speeds, as a factor on the longer of their periods: each is the
mean over a period, which the servo divides into steps of equal length."""


class OutputLimits(NamedTuple):
    """Limits of commands: of the TCP, and of each joint."""

    linear_speed_m_s: float
    linear_acceleration_m_s2: float
    angular_speed_rad_s: float
    angular_acceleration_rad_s2: float
    joint_lower: tuple[float, ...] = ()
    joint_upper: tuple[float, ...] = ()
    joint_speed: tuple[float, ...] = ()
    joint_acceleration: tuple[float, ...] = ()
    joint_effort: tuple[float, ...] = ()

    @classmethod
    def of_free_body(cls, limits: ReferenceLimits) -> OutputLimits:
        """Limits of the commands of a robot without an arm's model."""
        return cls(
            limits.linear_speed_m_s,
            limits.linear_acceleration_m_s2,
            limits.angular_speed_rad_s,
            limits.angular_acceleration_rad_s2,
        )


class OutputCheck:
    """Compares each command with the one before it."""

    def __init__(self, limits: OutputLimits) -> None:
        self._last: RobotCommand | None = None
        self._limits = limits
        count = len(limits.joint_speed)
        self._joint = [
            (SLACK * speed + NOISE_RAD_S, SLACK * acceleration, low - END_RAD, high + END_RAD)
            for speed, acceleration, low, high in zip(
                limits.joint_speed,
                limits.joint_acceleration,
                limits.joint_lower or (-math.inf,) * count,
                limits.joint_upper or (math.inf,) * count,
                strict=True,
            )
        ]
        """Speed, acceleration and range of each joint; empty if they are not known."""
        self._unknown = [math.nan] * count
        """Speeds without a predecessor: no change from them is too large."""
        self._speeds = self._unknown
        """Speeds of the joints, from the last two commands."""
        self._dt_s = 0.0
        """Period over which those speeds are means."""
        self._linear = (
            SLACK * limits.linear_speed_m_s + NOISE_M_S,
            SLACK * limits.linear_acceleration_m_s2,
        )
        self._angular = (
            SLACK * limits.angular_speed_rad_s + NOISE_RAD_S,
            SLACK * limits.angular_acceleration_rad_s2,
        )

    def reset(self) -> None:
        """Forget the last command, because the robot moved without it: the next need only be
        finite."""
        self._last, self._speeds = None, self._unknown

    def violation(self, command: RobotCommand, dt_s: float) -> str:
        """Return why `command`, for a period of `dt_s`, must not be sent; empty when it may."""
        last = self._last
        if not dt_s > 0.0:
            dt_s = 0.0
        if type(command) is JointCommand:
            wrong = self._joints(command, last, dt_s)
        elif type(command) is PoseCommand:
            wrong = self._pose(command, last, dt_s)
        elif type(command) is JointVelocityCommand:
            wrong = self._velocities(command, last, dt_s)
        elif type(command) is TorqueCommand:
            wrong = self._torques(command)
        elif type(command) is HoldCommand:
            self._speeds = self._unknown
            return ""
        else:
            wrong = f"a command of {command.kind.value}, for which no limits are known"
        if not wrong:
            self._last = command
        return wrong

    def _joints(self, command: JointCommand, last: RobotCommand | None, dt_s: float) -> str:
        q, v, known = command.positions, command.velocities or (), self._joint
        if not math.isfinite(sum(q) + sum(v)):
            return "joint positions that are not numbers"
        if command.external_axes and not is_finite(command.external_axes):
            return "external axes that are not numbers"
        if not known:
            return ""
        if not len(q) == len(known) == len(v or known):
            return f"{len(q)} positions and {len(v)} speeds for {len(known)} joints"
        then, before, gain = q, self._unknown, 0.0
        if type(last) is JointCommand:
            then = last.positions
            if dt_s > 0.0:
                before, gain = self._speeds, 1.0 / dt_s
            else:
                for index, (now, was_at) in enumerate(zip(q, then, strict=True)):
                    if abs(now - was_at) > STILL:
                        step = f"{now - was_at:.3g} rad in zero time"
                        return f"a step of joint {index + 1} by {step}"
        between_s = UNEVEN * (self._dt_s if self._dt_s > dt_s else dt_s)
        speeds: list[float] = []
        for (fastest, hardest, low, high), now, was_at, was, rate_sent in zip(
            known, q, then, before, v or before, strict=True
        ):
            rate = (now - was_at) * gain
            # By two comparisons, which take half the time of `abs`; a NaN passes them.
            if rate_sent > fastest or rate_sent < -fastest:
                return f"joint {len(speeds) + 1} at {rate_sent:.3g} rad/s"
            if rate > fastest or rate < -fastest:
                return f"a step of joint {len(speeds) + 1} by {now - was_at:.3g} rad"
            change, most = rate - was, hardest * between_s + NOISE_RAD_S
            if change > most or change < -most:
                joint = f"joint {len(speeds) + 1}"
                return _too_sudden(joint, abs(change), "rad/s", dt_s)
            if not low <= now <= high and not (
                abs(now - was_at) < ROUNDING_RAD or (now > was_at) is (now < low)
            ):
                return f"joint {len(speeds) + 1} at {now:.4g} rad, beyond its range"
            speeds.append(rate)
        if gain:
            self._speeds, self._dt_s = speeds, dt_s
        elif type(last) is not JointCommand:
            self._speeds = self._unknown
        return ""

    def _pose(self, command: PoseCommand, last: RobotCommand | None, dt_s: float) -> str:
        pose, twist = command.pose, command.twist
        if not math.isfinite(sum(pose.position) + sum(pose.orientation)):
            return "a pose that is not numbers"
        if abs(math.hypot(*pose.orientation) - 1.0) > STILL:
            return "an orientation that is not a rotation"
        if command.external_axes and not is_finite(command.external_axes):
            return "external axes that are not numbers"
        (fastest_m_s, hardest_m_s2), (fastest_rad_s, hardest_rad_s2) = self._linear, self._angular
        if twist is not None:
            if not math.isfinite(sum(twist.linear) + sum(twist.angular)):
                return "a twist that is not numbers"
            speed, turning = math.hypot(*twist.linear), math.hypot(*twist.angular)
            if speed > fastest_m_s:
                return f"a TCP speed of {speed:.3g} m/s"
            if turning > fastest_rad_s:
                return f"a TCP turn of {turning:.3g} rad/s"
        if type(last) is not PoseCommand:
            return ""
        way_m = math.dist(pose.position, last.pose.position)
        if way_m > fastest_m_s * dt_s + STILL:
            return f"a step of the TCP by {way_m * 1e3:.3g} mm"
        turn_rad = _angle(last.pose.orientation, pose.orientation)
        if turn_rad > fastest_rad_s * dt_s + STILL:
            return f"a turn of the TCP by {turn_rad:.3g} rad"
        if twist is not None and last.twist is not None:
            change = math.dist(twist.linear, last.twist.linear)
            if change > hardest_m_s2 * dt_s + NOISE_M_S:
                return _too_sudden("the TCP", change, "m/s", dt_s)
            change = math.dist(twist.angular, last.twist.angular)
            if change > hardest_rad_s2 * dt_s + NOISE_RAD_S:
                return _too_sudden("the TCP", change, "rad/s", dt_s)
        return ""

    def _velocities(
        self, command: JointVelocityCommand, last: RobotCommand | None, dt_s: float
    ) -> str:
        v, limits = command.velocities, self._limits
        if not is_finite(v):
            return "joint velocities that are not numbers"
        if limits.joint_speed and len(v) != len(limits.joint_speed):
            return f"{len(v)} velocities for {len(limits.joint_speed)} joints"
        for index, value in enumerate(v if limits.joint_speed else ()):
            if abs(value) > SLACK * limits.joint_speed[index] + NOISE_RAD_S:
                return f"joint {index + 1} at {value:.3g} rad/s"
            if type(last) is JointVelocityCommand:
                change = abs(value - last.velocities[index])
                if change > SLACK * limits.joint_acceleration[index] * dt_s + NOISE_RAD_S:
                    return _too_sudden(f"joint {index + 1}", change, "rad/s", dt_s)
        return ""

    def _torques(self, command: TorqueCommand) -> str:
        if not is_finite(command.torques):
            return "joint torques that are not numbers"
        effort = self._limits.joint_effort
        if effort and len(command.torques) != len(effort):
            return f"{len(command.torques)} torques for {len(effort)} joints"
        for index, value in enumerate(command.torques if effort else ()):
            if abs(value) > SLACK * effort[index]:
                return f"joint {index + 1} to exert {value:.3g} N·m"
        return ""


def _angle(a: Quaternion, b: Quaternion) -> float:
    """Return the angle between two unit quaternions, rad, by their chord, which is exact for small
    ones."""
    chord = math.dist(a, b)
    if chord > 1.0:
        chord = min(chord, math.dist(a, [-component for component in b]))
    return 4.0 * math.asin(0.5 * chord)


def _too_sudden(what: str, change: float, unit: str, dt_s: float) -> str:
    return f"{what} to change its speed by {change:.3g} {unit} in {dt_s * 1e3:.3g} ms"
