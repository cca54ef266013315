"""The last check in front of every robot driver: commands beyond a limit are not sent.

Limits are met by construction before this. The gate is for what construction did not foresee: an
overflow, a mistake of ours, a filter or a plugin that computes nonsense.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from cardan.gateway.motion.reference import ReferenceLimits
from cardan.spatial import is_finite, norm, rotation_between, subtract
from cardan.types import (
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotCommand,
    TorqueCommand,
    Twist,
    Vector3,
)

SLACK = 1.05
"""Factor on every limit, for rounding and servo tolerances."""

NOISE_M_S, NOISE_RAD_S = 1e-3, 5e-3
"""Speeds and changes of speed that are rounding, whatever the limits are."""

STILL = 1e-6
"""Largest motion, m or rad, in which no time passes: rounding."""

UNEVEN = 1.25
"""Most time between two joint speeds, as a factor on the longer of their periods: each is the mean
over a period, which the servo takes in steps of equal length."""


class OutputLimits(NamedTuple):
    """Limits of what may be sent: of the TCP, and of each joint."""

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
        """Of the commands of a robot without an arm's model."""
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
        self._joint = [
            (SLACK * speed + NOISE_RAD_S, SLACK * acceleration, low, high)
            for speed, acceleration, low, high in zip(
                limits.joint_speed,
                limits.joint_acceleration,
                limits.joint_lower,
                limits.joint_upper,
                strict=False,
            )
        ]
        """Speed, acceleration and range of each joint; empty where one of them is not known."""
        self._speeds: list[float] | None = None
        """Speeds of the joints, from the last two commands."""
        self._dt_s = 0.0
        """The period that those speeds are means over."""

    def reset(self) -> None:
        """Forget the last command (the robot moved without it): the next need only be finite."""
        self._last = self._speeds = None

    def violation(self, command: RobotCommand, dt_s: float) -> str:
        """Why `command`, for a period of `dt_s`, must not be sent; empty when it may."""
        last, dt_s = self._last, max(0.0, dt_s)
        if type(command) is JointCommand:
            wrong = self._joints(command, last, dt_s)
        elif type(command) is PoseCommand:
            wrong = self._pose(command, last, dt_s)
        elif type(command) is JointVelocityCommand:
            wrong = self._velocities(command, last, dt_s)
        elif type(command) is TorqueCommand:
            wrong = self._torques(command)
        elif type(command) is HoldCommand:
            self._speeds = None
            return ""
        else:
            wrong = f"a command of {command.kind.value}, for which no limits are known"
        if not wrong:
            self._last = command
        return wrong

    def _joints(self, command: JointCommand, last: RobotCommand | None, dt_s: float) -> str:
        if type(last) is JointCommand and dt_s > 0.0 and self._speeds is not None:
            # In every control cycle: one pass, and words only where something is beyond a limit.
            gain, between_s = 1.0 / dt_s, UNEVEN * max(dt_s, self._dt_s)
            q, v = command.positions, command.velocities
            if v is not None and not command.external_axes and len(q) == len(v) == len(self._joint):
                speeds: list[float] = []
                for (fastest, hardest, low, high), now, then, was, v_now in zip(
                    self._joint, q, last.positions, self._speeds, v, strict=False
                ):
                    rate = (now - then) * gain
                    most = hardest * between_s + NOISE_RAD_S
                    if not (
                        -fastest <= rate <= fastest
                        and -most <= rate - was <= most
                        and low <= now <= high
                        and -fastest <= v_now <= fastest
                    ):
                        break
                    speeds.append(rate)
                else:
                    self._speeds, self._dt_s = speeds, dt_s
                    return ""
        return self._joints_in_words(command, last, dt_s)

    def _joints_in_words(
        self, command: JointCommand, last: RobotCommand | None, dt_s: float
    ) -> str:
        q, v, limits = command.positions, command.velocities or (), self._limits
        if not (is_finite(q) and is_finite(v)):
            return "joint positions that are not numbers"
        if not is_finite(command.external_axes):
            return "external axes that are not numbers"
        speed, acceleration = limits.joint_speed, limits.joint_acceleration
        if speed and not len(q) == len(speed) == len(v or speed):
            return f"{len(q)} positions and {len(v)} speeds for {len(speed)} joints"
        if speed and v:
            for index, value in enumerate(v):
                if abs(value) > SLACK * speed[index] + NOISE_RAD_S:
                    return f"joint {index + 1} at {value:.3g} rad/s"
        if not speed or type(last) is not JointCommand:
            self._speeds = None
            return ""
        if dt_s == 0.0:
            for index, (now, then) in enumerate(zip(q, last.positions, strict=True)):
                if abs(now - then) > STILL:
                    return f"a step of joint {index + 1} by {now - then:.3g} rad in zero time"
            return ""
        before: Sequence[float] | None = self._speeds
        speeds: list[float] = []
        between_s = UNEVEN * max(dt_s, self._dt_s)
        for index, (now, then) in enumerate(zip(q, last.positions, strict=True)):
            rate = (now - then) / dt_s
            speeds.append(rate)
            if abs(rate) > SLACK * speed[index] + NOISE_RAD_S:
                return f"a step of joint {index + 1} by {now - then:.3g} rad"
            if before is not None:
                change = abs(rate - before[index])
                if change > SLACK * acceleration[index] * between_s + NOISE_RAD_S:
                    return _too_sudden(f"joint {index + 1}", change, "rad/s", dt_s)
            if limits.joint_lower and not (
                limits.joint_lower[index] - 1e-3 <= now <= limits.joint_upper[index] + 1e-3
                or abs(now - then) < 1e-9
                or (now - then > 0.0) is (now < limits.joint_lower[index])
            ):
                return f"joint {index + 1} at {now:.4g} rad, beyond its range"
        self._speeds, self._dt_s = speeds, dt_s
        return ""

    def _pose(self, command: PoseCommand, last: RobotCommand | None, dt_s: float) -> str:
        twist = command.twist
        if (
            type(last) is PoseCommand
            and twist is not None
            and last.twist is not None
            and not command.external_axes
        ):
            # In every control cycle: written out, and words only where something is beyond a limit.
            limits = self._limits
            (x, y, z), (w, i, j, k), _ = command.pose
            (u, v, s), (a, b, c, d), _ = last.pose
            x, y, z = x - u, y - v, z - s
            most_m = (SLACK * limits.linear_speed_m_s + NOISE_M_S) * dt_s
            half_rad = 0.5 * (SLACK * limits.angular_speed_rad_s + NOISE_RAD_S) * dt_s
            if (
                x * x + y * y + z * z <= most_m * most_m
                and abs(w * a + i * b + j * c + k * d) >= 1.0 - 0.5 * half_rad * half_rad
                and abs(w * w + i * i + j * j + k * k - 1.0) <= STILL
                and _within(
                    twist.linear,
                    last.twist.linear,
                    SLACK * limits.linear_speed_m_s + NOISE_M_S,
                    SLACK * limits.linear_acceleration_m_s2 * dt_s + NOISE_M_S,
                )
                and _within(
                    twist.angular,
                    last.twist.angular,
                    SLACK * limits.angular_speed_rad_s + NOISE_RAD_S,
                    SLACK * limits.angular_acceleration_rad_s2 * dt_s + NOISE_RAD_S,
                )
            ):
                return ""
        return self._pose_in_words(command, last, dt_s)

    def _pose_in_words(self, command: PoseCommand, last: RobotCommand | None, dt_s: float) -> str:
        pose, twist, limits = command.pose, command.twist, self._limits
        if not (is_finite(pose.position) and is_finite(pose.orientation)):
            return "a pose that is not numbers"
        if abs(math.hypot(*pose.orientation) - 1.0) > STILL:
            return "an orientation that is no rotation"
        if not is_finite(command.external_axes):
            return "external axes that are not numbers"
        if twist is not None:
            if not (is_finite(twist.linear) and is_finite(twist.angular)):
                return "a twist that is not numbers"
            speed, turning = norm(twist.linear), norm(twist.angular)
            if speed > SLACK * limits.linear_speed_m_s + NOISE_M_S:
                return f"a TCP speed of {speed:.3g} m/s"
            if turning > SLACK * limits.angular_speed_rad_s + NOISE_RAD_S:
                return f"a TCP turn of {turning:.3g} rad/s"
        if type(last) is not PoseCommand:
            return ""
        way_m = norm(subtract(pose.position, last.pose.position))
        if way_m > (SLACK * limits.linear_speed_m_s + NOISE_M_S) * dt_s + STILL:
            return f"a step of the TCP by {way_m * 1e3:.3g} mm"
        turn_rad = norm(rotation_between(last.pose.orientation, pose.orientation))
        if turn_rad > (SLACK * limits.angular_speed_rad_s + NOISE_RAD_S) * dt_s + STILL:
            return f"a turn of the TCP by {turn_rad:.3g} rad"
        if twist is not None and last.twist is not None:
            return self._change(twist, last.twist, dt_s)
        return ""

    def _change(self, twist: Twist, last: Twist, dt_s: float) -> str:
        limits = self._limits
        change = norm(subtract(twist.linear, last.linear))
        if change > SLACK * limits.linear_acceleration_m_s2 * dt_s + NOISE_M_S:
            return _too_sudden("the TCP", change, "m/s", dt_s)
        change = norm(subtract(twist.angular, last.angular))
        if change > SLACK * limits.angular_acceleration_rad_s2 * dt_s + NOISE_RAD_S:
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


def _within(now: Vector3, then: Vector3, fastest: float, most: float) -> bool:
    """True when `now` is no longer than `fastest`, nor farther than `most` from `then`."""
    x, y, z = now
    u, v, w = x - then[0], y - then[1], z - then[2]
    return x * x + y * y + z * z <= fastest * fastest and u * u + v * v + w * w <= most * most


def _too_sudden(what: str, change: float, unit: str, dt_s: float) -> str:
    return f"{what} to change its speed by {change:.3g} {unit} in {dt_s * 1e3:.3g} ms"
