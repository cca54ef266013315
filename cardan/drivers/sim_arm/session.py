"""Client side of the joint stream, sans I/O: datagrams to states, commands to datagrams."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.drivers.datagram_robot import DatagramSession
from cardan.drivers.missed_cycles import SlipCompensation
from cardan.drivers.robot_core import check_command, check_count, joint_values
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.errors import CommandError
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ArmState,
    ControlMode,
    MalformedDatagram,
    decode_state,
    encode_command,
)
from cardan.robots import load_arm
from cardan.types import (
    CommandKind,
    JointCommand,
    JointVelocityCommand,
    Pose,
    Quaternion,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
    TorqueCommand,
    Vector3,
    Wrench,
)

_TOLERANCE = 1e-9

_STOP_TOLERANCE = 0.02
"""Tolerance of a joint measured, and so commanded, beyond its stop, rad or m."""
_SEQUENCES = 1 << 32


class SimArmSession(DatagramSession[ArmState]):
    """Protocol session with a simulated arm."""

    controller = "the simulated arm"
    advice = "is `cardan sim arm` running?"

    def __init__(self, options: SimArmOptions) -> None:
        self.options = options
        arm = load_arm(options.robot)
        self._joints = n = len(arm.joints)
        self._limits = options.joint_limits
        lower, upper, speed, _ = self._limits
        efforts = tuple(joint.effort for joint in arm.joints)
        self._ranges: dict[str, tuple[Sequence[float], Sequence[float]]] = {
            "positions": (
                tuple(value - _STOP_TOLERANCE for value in lower),
                tuple(value + _STOP_TOLERANCE for value in upper),
            ),
            "velocities": (tuple(-v for v in speed), speed),
            "torques": (tuple(-t for t in efforts), efforts),
        }
        kinds = {CommandKind.HOLD, CommandKind.JOINT, CommandKind.JOINT_VELOCITY}
        if options.drive != "ideal":
            kinds.add(CommandKind.TORQUE)
        super().__init__(
            RobotCapabilities(
                commands=frozenset(kinds),
                period_s=options.period_s,
                joints=n,
                limits=self._limits,
                robot=options.robot,
            ),
            options.lost_after_s,
        )
        self._sequence = 0
        self._lost = SlipCompensation(n)
        self._asked: tuple[JointCommand, float] | None = None
        """Last commanded positions, and the agreed time of the state that they answered."""

    # -- states ---------------------------------------------------------------------------------

    def _decode(self, data: bytes, now_s: float) -> ArmState | str:
        state = decode_state(data)
        if isinstance(state, MalformedDatagram):
            return state.reason
        if len(state.positions) != self._joints:
            return f"a state of {len(state.positions)} joints, not {self._joints}"
        return state

    def _begin(self, message: ArmState) -> None:
        self._asked = None
        self._lost.reset()

    def _time_s(self, message: ArmState) -> float:
        return message.stamp_s

    def _state_of(self, message: ArmState, before: ArmState | None, now_s: float) -> RobotState:
        period_s = message.period_s
        if before is not None:
            period_s = max(message.stamp_s - before.stamp_s, 0.0)
        x, y, z, *turn = message.pose
        return RobotState(
            stamp_s=now_s,
            link=RobotLink.LIVE,
            session=self.sessions,
            sequence=message.sequence,
            period_s=period_s,
            joints=message.positions,
            external_axes=(),
            pose=Pose(Vector3(x, y, z), Quaternion(*turn)),
            hold_reason=message.reason,
            wrench=Wrench(Vector3(*message.wrench[:3]), Vector3(*message.wrench[3:])),
            velocities=message.velocities,
            torques=message.torques,
        )

    # -- commands -------------------------------------------------------------------------------

    def keepalive(self, now_s: float) -> bytes:
        return self._encode(0, now_s, ControlMode.HOLD)

    def command(self, command: RobotCommand, now_s: float) -> bytes | None:
        """Return the datagram of `command`; None before any state. Raises CommandError for an
        invalid one."""
        self.check(command)
        if self.message is None:
            return None
        values: tuple[float, ...] = ()
        speeds: tuple[float, ...] = ()
        mode = ControlMode.HOLD
        if isinstance(command, JointCommand):
            mode = ControlMode.POSITION
            values, speeds = self._going_on(command, self.message)
            return self._encode(self.message.session, now_s, mode, values, speeds)
        self._asked = None
        self._lost.reset()
        if isinstance(command, JointVelocityCommand):
            mode, values = ControlMode.VELOCITY, command.velocities
        elif isinstance(command, TorqueCommand):
            mode, values = ControlMode.TORQUE, command.torques
        return self._encode(self.message.session, now_s, mode, values, speeds)

    def _going_on(
        self, command: JointCommand, state: ArmState
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Positions and speeds of `command`, adjusted not to make up for missed time."""
        time_s = self.clock.time_s
        asked, self._asked = self._asked, (command, time_s)
        lost, speeds = self._lost, command.velocities
        if asked is not None and asked[0].velocities is not None and speeds is not None:
            gap_s = time_s - asked[1] - state.period_s
            if gap_s > 0.5 * state.period_s:
                self._pass(gap_s, asked[0].velocities, state)
        if not lost.working:
            return command.positions, speeds or ()
        before = None if asked is None else asked[0][:2]
        positions, sent = lost.follow(before, command.positions, speeds, state.period_s)
        if not lost.working or sent is None:
            return positions, speeds or ()
        lower, upper, most, _ = self._limits
        return (
            tuple(
                min(max(q, min(sent_speeds, low)), max(sent_speeds, high))
                for q, sent_speeds, low, high in zip(
                    positions, command.positions, lower, upper, strict=True
                )
            ),
            tuple(min(max(v, -top), top) for v, top in zip(sent, most, strict=True)),
        )

    def _pass(self, gap_s: float, before: tuple[float, ...], state: ArmState) -> None:
        """Account for `gap_s` in which the arm continued by itself; after a long gap it has
        braked."""
        if state.mode is not ControlMode.HOLD:
            self._lost.passed(gap_s)
            return
        sent_speeds = [v + more for v, more in zip(before, self._lost.rate, strict=True)]
        late_s = self.options.command_timeout_s - gap_s
        braking = self._limits.acceleration
        self._lost.passed(
            gap_s,
            [v * (late_s + 0.5 * abs(v) / a) for v, a in zip(sent_speeds, braking, strict=True)],
            [-v for v in sent_speeds],
        )

    def _encode(
        self,
        session: int,
        now_s: float,
        mode: ControlMode,
        values: tuple[float, ...] = (),
        speeds: tuple[float, ...] = (),
    ) -> bytes:
        self._sequence = (self._sequence + 1) % _SEQUENCES
        command = ArmCommand(session, self._sequence, now_s, mode, values, speeds)
        return encode_command(command, self._joints)

    def check(self, command: RobotCommand) -> None:
        """Raise CommandError for a command of a wrong kind or length, or beyond the limits."""
        check_command("the simulated arm", command, self._check)

    def _check(self, command: RobotCommand) -> None:
        kinds = self.capabilities.commands
        for name, values, _ in joint_values("the simulated arm", command, kinds):
            check_count(name, values, self._joints)
            self._within(name, values, *self._ranges[name])

    def _within(
        self, name: str, values: Sequence[float], lower: Sequence[float], upper: Sequence[float]
    ) -> None:
        for joint, (value, low, high) in enumerate(zip(values, lower, upper, strict=True), 1):
            if not (math.isfinite(value) and low - _TOLERANCE <= value <= high + _TOLERANCE):
                raise CommandError(
                    f"{name}: joint {joint} at {value:g}; allowed: {low:.6g} to {high:.6g}"
                )
