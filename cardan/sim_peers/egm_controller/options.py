"""Settings of the simulated controller, and what each RobotWare release sends."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from cardan.errors import ConfigurationError
from cardan.sim_peers.base import check_faults
from cardan.sim_peers.command import numbers, option
from cardan.sim_peers.egm_controller.arguments import Mode
from cardan.sim_peers.egm_controller.contact import Surface
from cardan.sim_peers.egm_controller.faults import FAULTS
from cardan.sim_peers.egm_controller.kinematics import AXES, GOFA

REAL_PERIOD_S = 0.004032
"""Control period of a real controller."""
VIRTUAL_PERIOD_S = 0.004
"""That of RobotStudio's virtual controller."""


class Profile(NamedTuple):
    """Which fields a RobotWare release fills, beyond those all have."""

    fc_active: bool
    """measuredForce in the RobotWare 7 layout."""
    utilization_rate: bool
    move_index: bool
    """And CollisionInfo."""
    rapid_data: bool
    torque_ref: bool
    """And PTP time stamps, where configured."""


PROFILES: Mapping[str, Profile] = {
    "6.08": Profile(False, False, False, False, False),
    "6.10": Profile(False, True, False, False, False),
    "7.6": Profile(True, True, True, False, False),
    "7.7": Profile(True, True, True, True, False),
    "7.16": Profile(True, True, True, True, True),
}

ROBOTWARE: Mapping[str, str] = {"6": "6.10", "7": "7.16", **{name: name for name in PROFILES}}
"""What may be asked for, and the release it means."""


def _within_range(joints_deg: Sequence[float]) -> bool:
    joints = map(math.radians, joints_deg)
    return all(
        low <= q <= high for q, low, high in zip(joints, GOFA.lower, GOFA.upper, strict=True)
    )


FORCE_FRAMES = ("tool", "base")
FORCE_SENSES = ("exerted", "felt")


@dataclass(frozen=True, kw_only=True)
class EgmControllerOptions:
    """How the simulated controller is set up. None means: as the script says."""

    pc_host: str = option(
        "127.0.0.1",
        "The PC to send to, as the controller's UdpUc.",
        name="to",
        metavar="HOST:PORT",
        port_field="pc_port",
    )
    """Remote Address of the UDP Unicast Device."""
    pc_port: int = 6510
    """Remote Port Number."""
    robotware: str = option("7", "What its datagrams contain.", metavar="6|7|RELEASE")
    """A key of ROBOTWARE."""
    mode: Mode = option(Mode.POSE, "What its RAPID program runs.")
    """Of script lines that name none."""
    script: str = "teleop"
    """A built-in name or a file; in mode PATH "teleop" is "path"."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by name, from `cardan.sim_peers.base.parse_faults`."""
    seed: int = 0
    joints_deg: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 0.0, 30.0, 0.0),
        "Where the arm stands at first, deg.",
        metavar="J1,...,J6",
        read=lambda text: numbers(text, AXES),
    )

    comm_timeout_s: float | None = option(None, "RAPID's \\CommTimeout.")
    max_speed_deviation_deg_s: float | None = option(None, "RAPID's \\MaxSpeedDeviation.")
    max_pos_deviation_deg: float | None = None
    lp_filter_hz: float | None = option(None, "RAPID's \\LpFilter.")
    sample_rate_ms: int | None = None
    cond_time_s: float | None = None
    ramp_in_s: float | None = None
    pos_corr_gain: float | None = option(
        None, "RAPID's \\PosCorrGain; 0: speed only.", metavar="0..1"
    )

    k: float = option(5.0, "Default Proportional Position Gain.", name="gain", metavar="1/S")
    """A system parameter."""
    level: int | None = None
    """System parameter Level: 0 raw, 1 filtering, 2 path; None is 1, for path correction 2."""
    default_lp_filter_hz: float = 20.0
    """System parameter Default Low Pass Filter Bandwidth; 0 is no filter."""
    ramp_time_s: float = 0.5
    """System parameter Default Ramp Time."""
    do_not_restart_after_motors_off: bool = False

    virtual: bool = option(False, "4.000 ms cycle, as RobotStudio's controller.")
    """`period_s` is VIRTUAL_PERIOD_S."""
    period_s: float = option(REAL_PERIOD_S, "Another cycle, for a computer too slow for it.")
    servo_delay_s: float = 0.016
    """How far the arm is behind the reference; real arms: 10 to 20 ms."""
    encoder_noise_deg: float = 1e-4
    """Standard deviation of measured joints."""
    dynamic_load_factor: float = 20.0
    """A demand of more than this many times the joint accelerations stops the arm with "dynamic
    load", as real arms do after a jump of the reference; 0 never does."""
    singularity_threshold: float = 0.02
    """Smallest singular value of the Jacobian (m, rad) at which Cartesian motion stops."""
    queue_length: int = 64
    """Datagrams of the PC that may wait; more are lost."""
    newest_wins: bool = False
    """Take the newest waiting datagram, as no real controller does; for comparison."""
    strict_mtype: bool = False
    """Ignore messages whose mtype does not fit the mode (else only note them)."""
    strict_seqno: bool = False
    """Ignore messages whose seqno does not advance (else only note them)."""
    nan_is_fatal: bool = False
    """A NaN ends in 10014 System failure, as on some controllers, instead of being ignored."""
    path_correction_absolute: bool = False
    """Read path corrections as shifts of the programmed path; else as what a sensor on the tool
    measures, relative to where the tool was."""
    seqno_restarts: bool = True
    """Count from `seqno_start` again in each session."""
    seqno_start: int = 0
    tm_start_ms: int = 1_000_000
    """What the ms clock shows at the start; it wraps at 2^32."""
    euler: bool = True
    """Poses carry Euler angles beside the quaternion."""
    force: bool = True
    """measuredForce is sent."""
    force_control: bool = option(False, "Measured force is compensated, not raw.")
    """As while force control is active."""
    surface: Surface | None = option(
        None,
        "A table to press on: height, stiffness, damping, friction.",
        metavar="M[:N/M[:N.S/M[:MU]]]",
        read=Surface.read,
    )
    """What the TCP can touch; felt in measuredForce."""
    force_frame: Literal["tool", "base"] = option("tool", "Whose axes the measured force is along.")
    """Of contact forces; ABB's manual does not say."""
    force_sense: Literal["exerted", "felt"] = option(
        "exerted", "Force of the tool on the world, or back."
    )
    """Of contact forces; ABB's manual does not say. Exerted is what `RobotState.wrench` is
    everywhere here."""
    collision_force_n: float = 150.0
    """A contact force at which the motion supervision sees a collision; 0: never. The order of
    magnitude at which collaborative arms stop; the real one depends on load and speed."""
    ptp: bool = False
    """timeStamp is sent (RobotWare 7.16)."""
    rapid_echo: bool = True
    """The RAPID program sends back what it got in RAPIDtoRobot."""

    def __post_init__(self) -> None:
        def check(key: str, good: bool, allowed: str) -> None:
            if not good:
                raise ConfigurationError(key, f"{getattr(self, key)!r} is not {allowed}")

        if not isinstance(self.mode, Mode):
            check("mode", self.mode in {m.value for m in Mode}, "joint, pose or path")
            object.__setattr__(self, "mode", Mode(self.mode))
        if self.virtual:
            if self.period_s not in (REAL_PERIOD_S, VIRTUAL_PERIOD_S):
                raise ConfigurationError(
                    "period_s", f"{self.period_s!r}: virtual is a period, too: give one of them"
                )
            object.__setattr__(self, "period_s", VIRTUAL_PERIOD_S)
        check("robotware", self.robotware in ROBOTWARE, f"one of {', '.join(ROBOTWARE)}")
        check("pc_port", 1 <= self.pc_port <= 65535, "a port, 1 to 65535")
        check("joints_deg", len(self.joints_deg) == AXES, f"{AXES} joint values")
        check("joints_deg", _within_range(self.joints_deg), "within the joints' ranges")
        check("level", self.level in (None, 0, 1, 2), "0, 1 or 2")
        check("k", 0.0 <= self.k <= 20.0, "within 0 to 20")
        check("default_lp_filter_hz", 0.0 <= self.default_lp_filter_hz <= 100.0, "within 0 to 100")
        check("ramp_time_s", 0.005 <= self.ramp_time_s <= 10.0, "within 0.005 to 10 s")
        check("period_s", 0.001 <= self.period_s <= 0.1, "within 0.001 to 0.1 s")
        check("servo_delay_s", 0.0 <= self.servo_delay_s <= 1.0, "within 0 to 1 s")
        check("queue_length", self.queue_length >= 1, "at least 1")
        gain = self.pos_corr_gain
        check("pos_corr_gain", gain is None or 0.0 <= gain <= 1.0, "within 0 to 1")
        for key in ("comm_timeout_s", "max_speed_deviation_deg_s", "max_pos_deviation_deg"):
            value = getattr(self, key)
            check(key, value is None or value > 0.0, "above 0")
        rate = self.sample_rate_ms
        check("sample_rate_ms", rate is None or (rate >= 4 and rate % 4 == 0), "a multiple of 4")
        check("force_frame", self.force_frame in FORCE_FRAMES, f"one of {', '.join(FORCE_FRAMES)}")
        check("force_sense", self.force_sense in FORCE_SENSES, f"one of {', '.join(FORCE_SENSES)}")
        check("collision_force_n", self.collision_force_n >= 0.0, "at least 0")
        if self.surface is not None:
            height_m, *others = self.surface
            check("surface", math.isfinite(height_m), "at a finite height")
            check(
                "surface",
                all(math.isfinite(value) and value >= 0.0 for value in others),
                "of a finite stiffness, damping and friction of at least 0",
            )
        check_faults(self.faults, FAULTS)

    @property
    def program(self) -> str:
        """The script to run."""
        return "path" if self.mode is Mode.PATH and self.script == "teleop" else self.script

    @property
    def release(self) -> str:
        """The RobotWare release that is played."""
        return ROBOTWARE[self.robotware]

    @property
    def profile(self) -> Profile:
        """What that release sends."""
        return PROFILES[self.release]
