"""The last gate in front of every robot driver: a command that no limit allows does not pass.

Limits are met by construction before this. The gate is for what construction did not foresee: an
overflow, a mistake of ours, a filter or a plugin that computes nonsense.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cardan.spatial import is_finite, norm, rotation_between
from cardan.types import (
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotCommand,
    TorqueCommand,
    Twist,
)

SLACK = 1.05
"""Of every limit: what rounding and servo tolerances may take beyond it."""

ROUNDING = 1e-12
"""Of a cosine near 1."""

NOISE_M_S, NOISE_RAD_S = 1e-3, 5e-3
"""Speeds and changes of speed that are rounding, whatever the limits are."""


class GateLimits(NamedTuple):
    """What may be sent: of the TCP, and of each joint."""

    linear_speed_m_s: float
    linear_acceleration_m_s2: float
    angular_speed_rad_s: float
    angular_acceleration_rad_s2: float
    joint_lower: tuple[float, ...] = ()
    joint_upper: tuple[float, ...] = ()
    joint_speed: tuple[float, ...] = ()
    joint_acceleration: tuple[float, ...] = ()
    joint_effort: tuple[float, ...] = ()


class Gate:
    """Compares each command with the one before it."""

    def __init__(self, limits: GateLimits) -> None:
        self._limits = limits
        self._last: RobotCommand | None = None
        self._speeds: list[float] | None = None
        """Of the joints, from the last two commands."""
        self._most = [SLACK * speed + NOISE_RAD_S for speed in limits.joint_speed]
        self._range = (
            [each - 1e-3 for each in limits.joint_lower],
            [each + 1e-3 for each in limits.joint_upper],
        )
        self._hardest = [SLACK * each for each in limits.joint_acceleration]

    def reset(self) -> None:
        """The robot is elsewhere, or was not commanded: the next command is only to be finite."""
        self._last = self._speeds = None

    def objection(self, command: RobotCommand, dt_s: float) -> str:
        """Why `command`, for a period of `dt_s`, must not be sent, in words; empty when it may."""
        last = self._last
        if type(command) is JointCommand:
            wrong = self._joints(command, last, dt_s)
        elif type(command) is PoseCommand:
            wrong = self._pose(command, last, dt_s)
        elif type(command) is JointVelocityCommand:
            wrong = self._velocities(command, last, dt_s)
        elif type(command) is TorqueCommand:
            wrong = self._torques(command)
        else:
            wrong = ""
            if last is not None:
                self._speeds = None
        if not wrong and type(command) is not HoldCommand:
            self._last = command
        return wrong

    def _joints(self, command: JointCommand, last: RobotCommand | None, dt_s: float) -> str:
        q, v = command.positions, command.velocities or ()
        if not sum(map(abs, q)) + sum(map(abs, v)) < math.inf:
            return "joint positions that are not numbers"
        most, hardest = self._most, self._hardest
        if not most or type(last) is not JointCommand or dt_s <= 0.0:
            self._speeds = None
            return ""
        gain, slack = 1.0 / dt_s, NOISE_RAD_S
        speeds: list[float] = []
        before = self._speeds or most
        first = self._speeds is None
        for now, then, was, fastest, a, low, high in zip(
            q, last.positions, before, most, hardest, *self._range, strict=True
        ):
            rate = (now - then) * gain
            change = rate - was
            most_change = a * dt_s + slack
            if (
                not -fastest <= rate <= fastest
                or (not first and not -most_change <= change <= most_change)
                # One that is outside anyway may come back.
                or (now > high and rate > 0.0)
                or (now < low and rate < 0.0)
            ):
                self._speeds = None
                joint = len(speeds) + 1
                return (
                    f"joint {joint} to {now:.4g} rad at {rate:.3g} rad/s, accelerated by "
                    f"{0.0 if first else change * gain:.3g} rad/s²; allowed: {low:.4g} to "
                    f"{high:.4g} rad, {fastest:.3g} rad/s, {a:.3g} rad/s²"
                )
            speeds.append(rate)
        self._speeds = speeds
        return ""

    def _pose(self, command: PoseCommand, last: RobotCommand | None, dt_s: float) -> str:
        limits = self._limits
        (x, y, z), (w, i, j, k), _ = command.pose
        if not x * x + y * y + z * z + w * w + i * i + j * j + k * k < math.inf:
            return "a pose that is not numbers"
        twist = command.twist
        if twist is not None:
            wrong = self._twist(twist, last, dt_s)
            if wrong:
                return wrong
        if type(last) is not PoseCommand or dt_s <= 0.0:
            return ""
        (u, v, s), (a, b, c, d), _ = last.pose
        x, y, z = x - u, y - v, z - s
        most_m = (SLACK * limits.linear_speed_m_s + NOISE_M_S) * dt_s
        if x * x + y * y + z * z > most_m * most_m:
            return f"a step of the TCP by {math.sqrt(x * x + y * y + z * z) * 1e3:.3g} mm"
        half_rad = 0.5 * (SLACK * limits.angular_speed_rad_s + NOISE_RAD_S) * dt_s
        if abs(w * a + i * b + j * c + k * d) < 1.0 - 0.5 * half_rad * half_rad - ROUNDING:
            turn_rad = norm(rotation_between(last.pose.orientation, command.pose.orientation))
            return f"a turn of the TCP by {turn_rad:.3g} rad"
        return ""

    def _twist(self, twist: Twist, last: RobotCommand | None, dt_s: float) -> str:
        limits = self._limits
        for unit, now, then, fastest, hardest, noise in (
            (
                "m/s",
                twist.linear,
                last.twist.linear if type(last) is PoseCommand and last.twist else None,
                limits.linear_speed_m_s,
                limits.linear_acceleration_m_s2,
                NOISE_M_S,
            ),
            (
                "rad/s",
                twist.angular,
                last.twist.angular if type(last) is PoseCommand and last.twist else None,
                limits.angular_speed_rad_s,
                limits.angular_acceleration_rad_s2,
                NOISE_RAD_S,
            ),
        ):
            x, y, z = now
            most = SLACK * fastest + noise
            if not x * x + y * y + z * z <= most * most:
                return f"a TCP speed of {math.sqrt(x * x + y * y + z * z):.3g} {unit}"
            if then is not None:
                x, y, z = x - then[0], y - then[1], z - then[2]
                most = SLACK * hardest * dt_s + noise
                if x * x + y * y + z * z > most * most:
                    change = math.sqrt(x * x + y * y + z * z)
                    return f"the TCP to be accelerated by {change / dt_s:.3g} {unit}²"
        return ""

    def _velocities(
        self, command: JointVelocityCommand, last: RobotCommand | None, dt_s: float
    ) -> str:
        v, limits = command.velocities, self._limits
        if not is_finite(v):
            return "joint velocities that are not numbers"
        for index, value in enumerate(v if limits.joint_speed else ()):
            if abs(value) > SLACK * limits.joint_speed[index] + NOISE_RAD_S:
                return f"joint {index + 1} at {value:.3g} rad/s"
            if type(last) is JointVelocityCommand:
                change = abs(value - last.velocities[index])
                if change > SLACK * limits.joint_acceleration[index] * dt_s + NOISE_RAD_S:
                    return f"joint {index + 1} to be accelerated by {change / dt_s:.3g} rad/s²"
        return ""

    def _torques(self, command: TorqueCommand) -> str:
        if not is_finite(command.torques):
            return "joint torques that are not numbers"
        for index, value in enumerate(command.torques if self._limits.joint_effort else ()):
            if abs(value) > SLACK * self._limits.joint_effort[index]:
                return f"joint {index + 1} to exert {value:.3g} N·m"
        return ""
