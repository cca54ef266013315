"""Options of the MotoROS driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.bounds import LONGEST_BLIND_S, Range
from cardan.common.options import Options, require_each
from cardan.protocols.simple_message.codes import IO_PORT, MOTION_PORT, STATE_PORT
from cardan.protocols.simple_message.framing import ByteOrder
from cardan.protocols.simple_message.messages import JOINTS, MAX_GROUPS
from cardan.robots import load_arm
from cardan.types import JointLimits

STATE_PERIOD_S = 0.025
"""Period at which the controller publishes its state."""

WATCHDOG_MS = Range(20, 500, "ms", "a controller in velocity mode accepts no other watchdog")
GROUP = Range(0, MAX_GROUPS - 1, "", "a controller has no more groups, counted from 0")
QUEUE_LOW = Range(2, 100, "", "an interpolation period each: queued motion cannot be changed")
REPLY_EVERY = Range(1, 10_000, "", "rarer answers come too late to show a limit")
COMMAND_PERIOD_S = Range(0.001, 0.05, "s", "slower commands are steps, faster ones are not taken")
SPACING_S = Range(0.002, 0.2, "s", "a stream of sparser points follows the operator too late")
IPC_S = Range(0.001, 0.02, "s", "no controller interpolates in other steps")
STATE_TIMEOUT_S = Range(
    STATE_PERIOD_S, LONGEST_BLIND_S, "s", "an arm at 0.25 m/s moves 12 cm unobserved"
)
REQUEST_TIMEOUT_S = Range(0.01, 10.0, "s", "a controller that answers later counts as lost")
START_TIMEOUT_S = Range(0.1, 60.0, "s", "servos are on and a job is started sooner")


@dataclass(frozen=True)
class MotorosOptions(Options):
    """Options of :class:`Motoros`. Joints are in rad, base to tool, as in MotoROS."""

    host: Annotated[str, bounds.HOST] = "127.0.0.1"
    """Address of the robot controller."""
    motion_port: Annotated[int, bounds.PORT] = MOTION_PORT
    """Motion: commands and their replies."""
    state_port: Annotated[int, bounds.PORT] = STATE_PORT
    """Joint feedback and robot status."""
    io_port: Annotated[int, bounds.PORT] = IO_PORT
    """Inputs and outputs."""
    robot: Annotated[str, bounds.ARM_FILE] = "gp8"
    """An arm's name, or the path of a .toml or .urdf file, for the joints and their limits."""
    velocity_rad_s: tuple[Annotated[float, bounds.JOINT_SPEED_RAD_S], ...] = ()
    """Highest joint speeds; empty: the arm's."""
    acceleration_rad_s2: tuple[Annotated[float, bounds.JOINT_ACCELERATION_RAD_S2], ...] = ()
    """Highest joint accelerations; empty: the arm's. MotoROS itself has no such limit."""
    speed_share: Annotated[float, bounds.SHARE] = 1.0
    """Share of the highest speeds that is used, above 0 to 1."""
    group: Annotated[int, GROUP] = 0
    """Control group, counted from 0."""
    mode: Literal["auto", "velocity", "stream"] = "auto"
    """velocity: joint speeds to a controller with the velocity mode. stream: one endless trajectory
    with a shallow queue, for any MotoROS. auto: velocity where the controller has it, or stream."""
    enable: Literal["on-request", "at-start"] = "on-request"
    """at-start: motion is enabled once, after the first connection, and never again
    automatically."""
    byte_order: Literal["auto", "little", "big"] = "auto"
    """auto: learned from the first message on the state port. FS100 is big, all others are
    little."""
    command_period_s: Annotated[float, COMMAND_PERIOD_S] = 0.004
    """Time between two commands in velocity mode."""
    watchdog_ms: Annotated[int, WATCHDOG_MS] = 100
    """Time without a command after which the controller brakes in velocity mode."""
    point_spacing_s: Annotated[float, SPACING_S] = 0.020
    """Time between two points of a stream; rounded to a whole number of `ipc_s`."""
    queue_low: Annotated[int, QUEUE_LOW] = 3
    """Increments left in the controller's queue at which the next point is computed; those executed
    during two replies are added."""
    ipc_s: Annotated[float, IPC_S] = 0.004
    """The controller's interpolation period: whole ms, usually 4."""
    reply_every: Annotated[int, REPLY_EVERY] = 25
    """Velocity mode: one in this many commands queries what the controller had to limit."""
    state_timeout_s: Annotated[float, STATE_TIMEOUT_S] = 3.0 * STATE_PERIOD_S
    """Time without a state after which the link is LOST."""
    request_timeout_s: Annotated[float, REQUEST_TIMEOUT_S] = 0.5
    """Longest wait for a reply; then the connection is closed."""
    start_timeout_s: Annotated[float, START_TIMEOUT_S] = 12.0
    """Longest start of motion: the controller may need to switch servos on and start a job."""
    trust_velocity: bool = False
    """Report the controller's own joint speeds, which lag and have had wrong signs."""
    lag_s: Annotated[float, bounds.LAG_S] = 0.4
    """Longest normal lag of the arm behind its command, due to the controller's filter and
    servos."""
    record: Annotated[str, bounds.PATH] = ""
    """A CSV file for commands and feedback, written at close, in times of
    CLOCK_MONOTONIC; empty: none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        joints = len(load_arm(self.robot, "robot").joints)
        ipc_ms = 1e3 * self.ipc_s
        longest_queue = LONGEST_BLIND_S / self.ipc_s
        ports = {self.motion_port, self.state_port, self.io_port}
        require_each(
            self,
            ("ipc_s", abs(ipc_ms - round(ipc_ms)) < 1e-6, "whole milliseconds"),
            (
                "point_spacing_s",
                2.0 * self.ipc_s <= self.point_spacing_s + 1e-9,
                f"two interpolation periods ({2.0 * self.ipc_s:g} s) or more",
            ),
            (
                "queue_low",
                self.queue_low * self.ipc_s <= LONGEST_BLIND_S,
                f"at most {longest_queue:.0f}: more takes longer than {LONGEST_BLIND_S:g} s to "
                "drive, and cannot be changed",
            ),
            (
                "watchdog_ms",
                self.watchdog_ms >= 3e3 * self.command_period_s,
                "three command periods or more",
            ),
            ("state_port", len(ports) == 3, "another one than the others"),
            ("robot", joints <= JOINTS, f"an arm of at most {JOINTS} joints"),
            *(
                (key, len(getattr(self, key)) in (0, joints), f"{joints} numbers, or none")
                for key in ("velocity_rad_s", "acceleration_rad_s2")
            ),
        )

    @property
    def joints(self) -> int:
        """Number of joints of the arm."""
        return len(load_arm(self.robot).joints)

    @property
    def limits(self) -> JointLimits:
        """Limits of every command."""
        own = load_arm(self.robot).limits
        return own.reduced(self.velocity_rad_s, self.acceleration_rad_s2, self.speed_share)

    @property
    def spacing_increments(self) -> int:
        """Interpolation periods between two points of a stream."""
        return max(2, round(self.point_spacing_s / self.ipc_s))

    @property
    def ipc_ms(self) -> int:
        """The interpolation period, ms."""
        return round(1e3 * self.ipc_s)

    @property
    def known_byte_order(self) -> ByteOrder | None:
        """Byte order; None: to be learned from the state port."""
        return {"little": ByteOrder.LITTLE, "big": ByteOrder.BIG}.get(self.byte_order)
