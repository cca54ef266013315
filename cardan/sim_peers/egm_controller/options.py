"""Settings of the simulated controller, and the messages of each RobotWare release."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options, require_each
from cardan.sim_peers.base import check_faults
from cardan.sim_peers.command import numbers, option
from cardan.sim_peers.egm_controller.arguments import EgmMode
from cardan.sim_peers.egm_controller.contact import ContactSurface
from cardan.sim_peers.egm_controller.faults import FAULTS
from cardan.sim_peers.kinematics import AXES, GOFA

REAL_PERIOD_S = 0.004032
"""Control period of a real controller."""
VIRTUAL_PERIOD_S = 0.004
"""Control period of RobotStudio's virtual controller."""


class RobotWareProfile(NamedTuple):
    """Fields that a RobotWare release fills, beyond those of all releases."""

    fc_active: bool
    """measuredForce in the RobotWare 7 layout."""
    utilization_rate: bool
    move_index: bool
    """moveIndex, and CollisionInfo."""
    rapid_data: bool
    torque_ref: bool
    """torqueRef, and PTP time stamps if configured."""


PROFILES: Mapping[str, RobotWareProfile] = {
    "6.08": RobotWareProfile(False, False, False, False, False),
    "6.10": RobotWareProfile(False, True, False, False, False),
    "7.6": RobotWareProfile(True, True, True, False, False),
    "7.7": RobotWareProfile(True, True, True, True, False),
    "7.16": RobotWareProfile(True, True, True, True, True),
}

ROBOTWARE: Mapping[str, str] = {"6": "6.10", "7": "7.16", **{name: name for name in PROFILES}}
"""Accepted names, and the release for each."""


def _within_range(joints_deg: Sequence[float]) -> bool:
    joints = map(math.radians, joints_deg)
    return all(
        low <= q <= high for q, low, high in zip(joints, GOFA.lower, GOFA.upper, strict=True)
    )


GAIN = Range(0.0, 20.0, "1/s", "RAPID takes no more")
LP_FILTER_HZ = Range(0.0, 100.0, "Hz", "RAPID takes no more", zero="no filter")
RAMP_TIME_S = Range(0.005, 10.0, "s", "the system parameter takes no others")
PERIOD_S = Range(0.001, 0.1, "s", "no controller has another cycle")
SERVO_DELAY_S = Range(0.0, 1.0, "s", "no arm is farther behind")
QUEUE_LENGTH = Range(1, 1_000_000, "", "as many as an operating system keeps")
SAMPLE_RATE_MS = Range(4, 100_000, "ms", "a cycle is 4 ms")

_Size = Annotated[float, bounds.NOT_NEGATIVE]
_Positive = Annotated[float, bounds.POSITIVE]


@dataclass(frozen=True, kw_only=True)
class EgmControllerOptions(Options):
    """Settings of the simulated controller. None means: the script's value."""

    pc_host: Annotated[str, bounds.HOST] = option(
        "127.0.0.1",
        "The PC to send to, as the controller's UdpUc.",
        name="to",
        metavar="HOST:PORT",
        port_field="pc_port",
    )
    """Remote Address of the UDP Unicast Device."""
    pc_port: Annotated[int, bounds.PORT] = 6510
    """Remote Port Number."""
    robotware: str = option("7", "What its datagrams contain.", metavar="6|7|RELEASE")
    """A key of ROBOTWARE."""
    mode: EgmMode = option(EgmMode.POSE, "What its RAPID program runs.")
    """Mode of script lines that name none."""
    script: str = "teleop"
    """A built-in name or a file; in mode PATH "teleop" is "path"."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by name, from `cardan.sim_peers.base.parse_faults`."""
    seed: int = 0
    joints_deg: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 0.0, 30.0, 0.0),
        "Initial joint positions, deg.",
        metavar="J1,...,J6",
        read=lambda text: numbers(text, AXES),
    )

    comm_timeout_s: _Positive | None = option(None, "RAPID's \\CommTimeout.")
    max_speed_deviation_deg_s: _Positive | None = option(None, "RAPID's \\MaxSpeedDeviation.")
    max_pos_deviation_deg: _Positive | None = None
    lp_filter_hz: float | None = option(None, "RAPID's \\LpFilter.")
    sample_rate_ms: Annotated[int, SAMPLE_RATE_MS] | None = None
    cond_time_s: float | None = None
    ramp_in_s: float | None = None
    pos_corr_gain: Annotated[float, bounds.SHARE_OR_NONE] | None = option(
        None, "RAPID's \\PosCorrGain; 0: speed only.", metavar="0..1"
    )

    k: Annotated[float, GAIN] = option(
        5.0, "Default Proportional Position Gain.", name="gain", metavar="1/S"
    )
    """A system parameter."""
    level: Literal[0, 1, 2] | None = None
    """System parameter Level: 0 raw, 1 filtering, 2 path; None is 1, for path correction 2."""
    default_lp_filter_hz: Annotated[float, LP_FILTER_HZ] = 20.0
    """System parameter Default Low Pass Filter Bandwidth; 0 is no filter."""
    ramp_time_s: Annotated[float, RAMP_TIME_S] = 0.5
    """System parameter Default Ramp Time."""
    do_not_restart_after_motors_off: bool = False

    virtual: bool = option(False, "4.000 ms cycle, as RobotStudio's controller.")
    """`period_s` is VIRTUAL_PERIOD_S."""
    period_s: Annotated[float, PERIOD_S] = option(
        REAL_PERIOD_S, "Another cycle, for a computer too slow for it."
    )
    servo_delay_s: Annotated[float, SERVO_DELAY_S] = 0.016
    """Delay of the arm behind the reference; real arms: 10 to 20 ms."""
    encoder_noise_deg: _Size = 1e-4
    """Standard deviation of measured joints."""
    dynamic_load_factor: _Size = 20.0
    """A demand of more than this many times the joint accelerations stops the arm with "dynamic
    load", as real arms do after a jump of the reference; 0 never does."""
    singularity_threshold: _Size = 0.02
    """Smallest singular value of the Jacobian (m, rad) at which Cartesian motion stops."""
    queue_length: Annotated[int, QUEUE_LENGTH] = 64
    """Most datagrams of the PC that wait; more are lost."""
    newest_wins: bool = False
    """Take the newest waiting datagram, as no real controller does; for comparison."""
    strict_mtype: bool = False
    """Ignore messages whose mtype does not fit the mode (else only count them)."""
    strict_seqno: bool = False
    """Ignore messages whose seqno does not advance (else only count them)."""
    nan_is_fatal: bool = False
    """A NaN ends in 10014 System failure, as on some controllers, instead of being ignored."""
    path_correction_absolute: bool = False
    """Read path corrections as shifts of the programmed path; else as measurements of a sensor on
    the tool, relative to where the tool was."""
    seqno_restarts: bool = True
    """Count from `seqno_start` again in each session."""
    seqno_start: int = 0
    tm_start_ms: int = 1_000_000
    """The ms clock at the start; it wraps at 2^32."""
    euler: bool = True
    """Poses carry Euler angles beside the quaternion."""
    force: bool = True
    """measuredForce is sent."""
    force_control: bool = option(False, "Measured force is compensated, not raw.")
    """Report active force control."""
    surface: ContactSurface | None = option(
        None,
        "A table to press on: height, stiffness, damping, friction.",
        metavar="M[:N/M[:N.S/M[:MU]]]",
        read=ContactSurface.read,
    )
    """Surface that the TCP can touch; its force is in measuredForce."""
    force_frame: Literal["tool", "base"] = option("tool", "Frame of the measured force.")
    """Frame of contact forces; ABB's manual does not say."""
    force_sense: Literal["exerted", "reaction"] = option(
        "exerted", "Force of the tool on the world, or its reaction."
    )
    """Sign of contact forces; ABB's manual does not say. `RobotState.wrench` is always the exerted
    one."""
    collision_force_n: _Size = 150.0
    """Contact force at which motion supervision reports a collision; 0: never. The default has the
    order of magnitude of collaborative arms; a real one depends on load and speed."""
    ptp: bool = False
    """timeStamp is sent (RobotWare 7.16)."""
    rapid_echo: bool = True
    """The RAPID program sends the data of RAPIDtoRobot back."""

    def __post_init__(self) -> None:
        mode: Any = self.mode
        if mode in [each.value for each in EgmMode]:
            object.__setattr__(self, "mode", EgmMode(mode))
        super().__post_init__()
        if self.virtual:
            periods = (REAL_PERIOD_S, VIRTUAL_PERIOD_S)
            allowed = "left out, because virtual is a period, too: give one of them"
            require_each(self, ("period_s", self.period_s in periods, allowed))
            object.__setattr__(self, "period_s", VIRTUAL_PERIOD_S)
        rate = self.sample_rate_ms
        require_each(
            self,
            ("robotware", self.robotware in ROBOTWARE, f"one of {', '.join(ROBOTWARE)}"),
            ("joints_deg", len(self.joints_deg) == AXES, f"{AXES} joint values"),
            ("sample_rate_ms", rate is None or rate % 4 == 0, "a multiple of 4"),
        )
        require_each(
            self, ("joints_deg", _within_range(self.joints_deg), "within the joints' ranges")
        )
        check_faults(self.faults, FAULTS)

    @property
    def program(self) -> str:
        """Script to run."""
        return "path" if self.mode is EgmMode.PATH and self.script == "teleop" else self.script

    @property
    def release(self) -> str:
        """Simulated RobotWare release."""
        return ROBOTWARE[self.robotware]

    @property
    def profile(self) -> RobotWareProfile:
        """Message profile of that release."""
        return PROFILES[self.release]
