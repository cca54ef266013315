"""The last gate in front of every robot driver: a command that no limit allows does not pass.

Limits are met by construction before this. The gate is for what construction did not foresee: an
overflow, a mistake of ours, a filter or a plugin that computes nonsense.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan.spatial import is_finite, norm, rotation_between, subtract
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
        self._speeds: tuple[float, ...] | None = None
        """Of the joints, from the last two commands."""
        self._last_dt_s = 0.0
        """Between those."""

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
        q, v, limits = command.positions, command.velocities or (), self._limits
        if not (is_finite(q) and is_finite(v)):
            return "joint positions that are not numbers"
        speed, acceleration = limits.joint_speed, limits.joint_acceleration
        if speed and v:
            for index, value in enumerate(v):
                if abs(value) > SLACK * speed[index] + NOISE_RAD_S:
                    return f"joint {index + 1} at {value:.3g} rad/s"
        if not speed or type(last) is not JointCommand or dt_s <= 0.0:
            self._speeds = None
            return ""
        # Means over periods, whose middles are so far apart; within a long one speeds change twice.
        apart_s = max(dt_s, 0.5 * (dt_s + self._last_dt_s))
        self._last_dt_s = dt_s
        before, speeds = self._speeds, []
        for index, (now, then) in enumerate(zip(q, last.positions, strict=True)):
            rate = (now - then) / dt_s
            speeds.append(rate)
            if abs(rate) > SLACK * speed[index] + NOISE_RAD_S:
                return f"a step of joint {index + 1} by {now - then:.3g} rad"
            if before is not None:
                change = abs(rate - before[index])
                if change > SLACK * acceleration[index] * apart_s + NOISE_RAD_S:
                    return f"joint {index + 1} to be accelerated by {change / apart_s:.3g} rad/s²"
            if limits.joint_lower and not (
                limits.joint_lower[index] - 1e-3 <= now <= limits.joint_upper[index] + 1e-3
                or abs(now - then) < 1e-9
                or (now - then > 0.0) is (now < limits.joint_lower[index])
            ):
                return f"joint {index + 1} at {now:.4g} rad, beyond its range"
        self._speeds = tuple(speeds)
        return ""

    def _pose(self, command: PoseCommand, last: RobotCommand | None, dt_s: float) -> str:
        pose, twist, limits = command.pose, command.twist, self._limits
        if not (is_finite(pose.position) and is_finite(pose.orientation)):
            return "a pose that is not numbers"
        if twist is not None:
            if not (is_finite(twist.linear) and is_finite(twist.angular)):
                return "a twist that is not numbers"
            speed, turning = norm(twist.linear), norm(twist.angular)
            if speed > SLACK * limits.linear_speed_m_s + NOISE_M_S:
                return f"a TCP speed of {speed:.3g} m/s"
            if turning > SLACK * limits.angular_speed_rad_s + NOISE_RAD_S:
                return f"a TCP turn of {turning:.3g} rad/s"
        if type(last) is not PoseCommand or dt_s <= 0.0:
            return ""
        way_m = norm(subtract(pose.position, last.pose.position))
        if way_m > (SLACK * limits.linear_speed_m_s + NOISE_M_S) * dt_s:
            return f"a step of the TCP by {way_m * 1e3:.3g} mm"
        turn_rad = norm(rotation_between(last.pose.orientation, pose.orientation))
        if turn_rad > (SLACK * limits.angular_speed_rad_s + NOISE_RAD_S) * dt_s:
            return f"a turn of the TCP by {turn_rad:.3g} rad"
        if twist is not None and last.twist is not None:
            return self._change(twist, last.twist, dt_s)
        return ""

    def _change(self, twist: Twist, last: Twist, dt_s: float) -> str:
        limits = self._limits
        change = norm(subtract(twist.linear, last.linear))
        if change > SLACK * limits.linear_acceleration_m_s2 * dt_s + NOISE_M_S:
            return f"the TCP to be accelerated by {change / dt_s:.3g} m/s²"
        change = norm(subtract(twist.angular, last.angular))
        if change > SLACK * limits.angular_acceleration_rad_s2 * dt_s + NOISE_RAD_S:
            return f"the TCP to be accelerated by {change / dt_s:.3g} rad/s²"
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
