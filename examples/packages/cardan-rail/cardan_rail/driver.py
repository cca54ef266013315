"""The driver of the rail: a session without I/O, and the socket around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from cardan.common import bounds
from cardan.common.options import check_options
from cardan.drivers.datagram_robot import (
    DatagramRobot,
    DatagramSession,
    DatagramTransport,
    UdpTransport,
)
from cardan.drivers.limiters import JointLimiter
from cardan.drivers.missed_cycles import SlipCompensation
from cardan.drivers.robot_core import check_numbers, joint_values
from cardan.robots import load_arm
from cardan.types import (
    CommandKind,
    JointCommand,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
)

from cardan_rail.protocol import (
    LARGEST_STATE,
    PERIOD_S,
    Condition,
    RailCommand,
    RailState,
    decode_state,
    encode_command,
)

ARM = "cardan_rail:rail.toml"
AXES = 3

LOST_AFTER_S = 0.1
"""Twice the controller's own timeout, after which the axes brake."""

LAG_S = 0.03
"""Measured axes lag two cycles behind commanded ones, plus the network's delay."""

WHY = {
    Condition.FOLLOWING: "",
    Condition.BRAKING: "the rail is braking",
    Condition.EMERGENCY_STOP: "emergency stop: release it at the rail",
    Condition.TOO_FAST: "the controller was asked for too much speed: restart it",
}


@dataclass(frozen=True, kw_only=True)
class RailOptions:
    """Options of :class:`Rail`."""

    host: Annotated[str, bounds.HOST] = "127.0.0.1"
    """The controller's address."""
    port: Annotated[int, bounds.PORT] = 7400
    """UDP port of the controller."""

    def __post_init__(self) -> None:
        check_options(self)


class RailSession(DatagramSession[RailState]):
    """A connection to the rail's controller.

    Each command sent is a reference within the axes' ranges, speeds and accelerations, whatever
    the caller commands. Cycles without a command are not made up for.
    """

    controller = "the rail's controller"
    advice = "check that it is switched on, and host and port"

    def __init__(self) -> None:
        limits = load_arm(ARM).limits
        kinds = frozenset({CommandKind.HOLD, CommandKind.JOINT})
        capabilities = RobotCapabilities(kinds, PERIOD_S, AXES, limits, lag_s=LAG_S)
        super().__init__(capabilities, LOST_AFTER_S)
        self._limiter = JointLimiter(*limits, longest_period_s=PERIOD_S)
        self._lost = SlipCompensation(AXES)
        self._asked: tuple[Sequence[float], Sequence[float] | None] | None = None
        """Positions of the previous command, and their speeds."""
        self._answered: int | None = None
        """Sequence number of the last state that was answered."""

    def _decode(self, data: bytes, now_s: float) -> RailState | str:
        return decode_state(data)

    def _begin(self, message: RailState) -> None:
        self._limiter.reset(message.positions)
        self._lost.reset()
        self._asked = self._answered = None

    def _state_of(self, message: RailState, before: RailState | None, now_s: float) -> RobotState:
        cycles = 1 if before is None else (message.sequence - before.sequence) & 0xFFFFFFFF
        return RobotState(
            stamp_s=now_s,
            link=RobotLink.LIVE,
            session=self.sessions,
            sequence=message.sequence,
            period_s=cycles * PERIOD_S,
            joints=message.positions,
            external_axes=(),
            pose=None,
            hold_reason=WHY[message.condition],
        )

    def check(self, command: RobotCommand) -> None:
        kinds = self.capabilities.commands
        for name, values, allowed in joint_values("the rail", command, kinds):
            check_numbers(name, values, allowed, AXES, "axes")

    def command(self, command: RobotCommand, now_s: float) -> bytes | None:
        """Return the answer to the newest state; None if it was already answered."""
        self.check(command)
        message = self.message
        if message is None or message.sequence == self._answered:
            return None
        if self._answered is not None:
            missed = (message.sequence - self._answered - 1) & 0xFFFFFFFF
            if missed:
                # The axes have continued with the last command.
                self._limiter.coast(missed * PERIOD_S)
                self._lost.passed(missed * PERIOD_S)
        self._answered = message.sequence
        if isinstance(command, JointCommand):
            self._track(command.positions, command.velocities)
        else:
            self._asked = None
            self._lost.reset()
            self._limiter.brake(PERIOD_S)
        x, y, z = self._limiter.reference
        return encode_command(RailCommand(message.session, message.sequence, (x, y, z)))

    def _track(self, positions: Sequence[float], speeds: Sequence[float] | None) -> None:
        asked, self._asked = self._asked, (positions, speeds)
        if self._lost.working:
            positions, speeds = self._lost.follow(asked, positions, speeds, PERIOD_S)
        self._limiter.track(positions, speeds, PERIOD_S)

    def keepalive(self, now_s: float) -> bytes:
        return encode_command(RailCommand(0, 0, None))

    def final_command(self, now_s: float) -> bytes:
        session = 0 if self.message is None else self.message.session
        return encode_command(RailCommand(session, 0, None))


class Rail(DatagramRobot[RailSession]):
    """The rail, over UDP."""

    Options: ClassVar[type[RailOptions]] = RailOptions
    summary = "a gantry of three linear axes"
    page = "https://rail.example/cardan"
    peer = "rail"
    options: RailOptions
    title = "the rail's driver"

    def _make_session(self) -> RailSession:
        return RailSession()

    def _join(self) -> DatagramTransport:
        host, port = self.options.host, self.options.port
        return UdpTransport(host, port, f"cannot send to {host}:{port}", LARGEST_STATE)
