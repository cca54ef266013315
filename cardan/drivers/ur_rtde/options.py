"""Options of the Universal Robots driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.bounds import LONGEST_BLIND_S, Range
from cardan.common.options import Options, require_each
from cardan.protocols.ur.dashboard import DASHBOARD_PORT
from cardan.protocols.ur.primary import PRIMARY_PORT
from cardan.protocols.ur.program import JOINTS, Servoing
from cardan.protocols.ur.rtde import RTDE_PORT
from cardan.protocols.ur.variables import UPPER_REGISTERS
from cardan.robots import load_arm
from cardan.types import JointLimits

RATE_HZ = Range(
    50.0, 500.0, "Hz", "no controller sends more; with less an operator feels the steps"
)
LOOKAHEAD_S = Range(0.03, 0.2, "s", "servoj takes no other")
GAIN = Range(100, 2000, "", "servoj takes no other")
WATCHDOG_S = Range(0.02, LONGEST_BLIND_S, "s", "an arm at 0.25 m/s moves 12 cm unobserved")
STOP_RAD_S2 = Range(
    0.5, 40.0, "rad/s²", "more than the joints can brake, or too little to stop the arm"
)
FOLLOWING_RAD = Range(
    0.02, 2.0, "rad", "a working arm lags by as much; with more lag it does not follow"
)
REQUEST_TIMEOUT_S = Range(0.05, 10.0, "s", "a controller that answers later counts as lost")
START_TIMEOUT_S = Range(1.0, 120.0, "s", "power is on and the brakes are released sooner")


@dataclass(frozen=True)
class UrRtdeOptions(Options):
    """Options of :class:`UrRtde`. Joints are in rad, base to tool."""

    host: Annotated[str, bounds.HOST] = "127.0.0.1"
    """Address of the robot controller."""
    rtde_port: Annotated[int, bounds.PORT] = RTDE_PORT
    """RTDE port, for states and commands."""
    primary_port: Annotated[int, bounds.PORT] = PRIMARY_PORT
    """Port that takes the program; connected only during a start."""
    dashboard_port: Annotated[int, bounds.PORT] = DASHBOARD_PORT
    """Port for power and brakes; connected only during a start."""
    robot: Annotated[str, bounds.ARM_FILE] = "ur5e"
    """An arm's name, or the path of a .toml or .urdf file of six joints, for the limits."""
    rate_hz: Annotated[float, RATE_HZ] = 500.0
    """States and commands per second; a CB3 has at most 125, and gets no higher request."""
    enable: Literal["on-request", "at-start"] = "on-request"
    """at-start: motion is enabled once, after the first connection, and never again
    automatically."""
    velocity_rad_s: tuple[Annotated[float, bounds.JOINT_SPEED_RAD_S], ...] = ()
    """Highest joint speeds; empty: the arm's."""
    acceleration_rad_s2: tuple[Annotated[float, bounds.JOINT_ACCELERATION_RAD_S2], ...] = ()
    """Highest joint accelerations; empty: the arm's, which are not UR's."""
    speed_share: Annotated[float, bounds.SHARE] = 1.0
    """Share of the highest speeds that is used, above 0 to 1."""
    registers: Literal["upper", "lower"] = "upper"
    """Registers that carry commands: from 24, reserved for RTDE clients, or from 0, the only ones
    of old controllers (before 3.9 and 5.3)."""
    watchdog_s: Annotated[float, WATCHDOG_S] = 0.1
    """Time without a command after which the program at the controller stops the arm and ends."""
    stop_rad_s2: Annotated[float, STOP_RAD_S2] = 5.0
    """Deceleration of the fastest joint in that stop."""
    lookahead_s: Annotated[float, LOOKAHEAD_S] = 0.03
    """servoj's `lookahead_time`: a longer one is smoother and later."""
    gain: Annotated[int, GAIN] = 500
    """servoj's `gain`."""
    state_timeout_s: Annotated[float, bounds.BLIND_S] = 0.1
    """Time without a state after which the link is LOST."""
    simulated_time: bool = False
    """The controller is a simulation (URSim) whose time may pass faster or slower than this
    computer's: no difference in speed is a fault. The arm is never faster than commanded, and
    slower if the simulation is."""
    following_error_rad: Annotated[float, FOLLOWING_RAD] = 0.2
    """Distance of a joint from the controller's target that ends motion if it lasts for
    FOLLOWING_S."""
    request_timeout_s: Annotated[float, REQUEST_TIMEOUT_S] = 1.0
    """Longest wait for an answer of RTDE; then the connection is closed."""
    start_timeout_s: Annotated[float, START_TIMEOUT_S] = 30.0
    """Longest start of motion: power may need to be switched on and brakes released."""
    lag_s: Annotated[float, bounds.LAG_S] = 0.2
    """Longest normal lag of the arm behind its command; an arm farther behind counts as held."""

    def __post_init__(self) -> None:
        super().__post_init__()
        joints = len(load_arm(self.robot, "robot").joints)
        ports = {self.rtde_port, self.primary_port, self.dashboard_port}
        require_each(
            self,
            ("robot", joints == JOINTS, f"an arm of {JOINTS} joints"),
            ("rtde_port", len(ports) == 3, "another one than the others"),
            (
                "watchdog_s",
                self.watchdog_s * self.rate_hz >= 5.0,
                f"five periods ({5.0 / self.rate_hz:g} s) or more",
            ),
            *(
                (key, len(getattr(self, key)) in (0, joints), f"{joints} numbers, or none")
                for key in ("velocity_rad_s", "acceleration_rad_s2")
            ),
        )

    @property
    def limits(self) -> JointLimits:
        """Limits of every command."""
        own = load_arm(self.robot).limits
        return own.reduced(self.velocity_rad_s, self.acceleration_rad_s2, self.speed_share)

    @property
    def first_register(self) -> int:
        """First of the registers in use."""
        return UPPER_REGISTERS if self.registers == "upper" else 0

    @property
    def servoing(self) -> Servoing:
        """Parameters of the program at the controller."""
        return Servoing(
            self.first_register, self.watchdog_s, self.lookahead_s, self.gain, self.stop_rad_s2
        )
