"""Settings of the simulated Motoman controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options, require_each
from cardan.protocols.simple_message.codes import MOTION_PORT
from cardan.protocols.simple_message.messages import MAX_GROUPS
from cardan.robots import ArmModel, JointKind, load_arm
from cardan.sim_peers.base import check_faults
from cardan.sim_peers.command import option
from cardan.sim_peers.motoros_controller.faults import FAULTS
from cardan.sim_peers.motoros_controller.plant import PLANTS, PlantModel

MAX_AXES = 8
"""MP_GRP_AXES_NUM: axes of a group."""

GROUPS = Range(1, MAX_GROUPS, "", "a controller has no more")
BASE_PORT = replace(bounds.ANY_PORT, highest=65533, reason="two more come after it")
IPC_S = Range(0.001, 0.016, "s", "no controller interpolates in other steps")
QUEUE_INCREMENTS = Range(2, 10_000, "", "one is being driven, one waits")
STATE_PERIOD_S = Range(0.001, 10.0, "s", "a client gives a silent state port up sooner")
TAKES_S = Range(0.0, 60.0, "s", "no controller takes longer")

_Takes = Annotated[float, TAKES_S]
_EachAxis = tuple[Annotated[float, bounds.POSITIVE], ...]

PULSES_PER_TURN_OF_MOTOR = 4096
"""Encoder counts per turn of a motor; basis of the default `pulses_per_rad`."""
_GEAR_RATIOS = (100.0, 120.0, 100.0, 80.0, 80.0, 50.0, 60.0, 60.0)


@dataclass(frozen=True, kw_only=True)
class MotorosControllerOptions(Options):
    """Settings of the simulated controller."""

    robot: str = "gp8"
    """Name or file of the arm, for :func:`cardan.robots.load_arm`."""
    groups: Annotated[int, GROUPS] = option(
        1, "Control groups, each with such an arm.", metavar="1..4"
    )
    host: Annotated[str, bounds.LISTEN_HOST] = option(
        "127.0.0.1", "The address it listens on.", metavar="HOST"
    )
    base_port: Annotated[int, BASE_PORT] = option(
        MOTION_PORT, "Motion; state and I/O are the two after it. 0: any three.", metavar="PORT"
    )
    big_endian: bool = option(False, "As an FS100; others are little-endian.")
    velocity_mode: bool = option(
        True, "As MotoROS is, with trajectories only.", name="no-velocity-mode"
    )
    plant: Literal["ideal", "paper"] | PlantModel = option(
        "ideal", "paper: the arm lags as in Baklouti et al. 2021."
    )
    """Lag of the arm behind its command: a name from PLANTS, or a custom model."""
    ipc_s: Annotated[float, IPC_S] = 0.004
    """Interpolation period, whole ms."""
    queue_increments: Annotated[int, QUEUE_INCREMENTS] = 200
    """Entries of each group's queue."""
    pulses_per_rad: _EachAxis | None = None
    """Pulses per rad of each axis (per m for a linear one). None: 4096 pulses a turn of the motor
    behind gears of 80 to 120 (wrist roll 50), 32595 to 78228 a rad; makers do not publish them."""
    state_period_s: Annotated[float, STATE_PERIOD_S] = 0.025
    feedback_fields: Literal[2, 6] = 6
    """ValidFields of feedback: positions, or positions and speeds."""
    start: tuple[float, ...] | None = None
    """Joints at the start, rad or m; None: the arm's home."""

    job_start_s: _Takes = 0.11
    """Duration of START_TRAJ_MODE with the servos on; after about two thirds of it motion is
    possible."""
    servo_on_s: _Takes = 1.0
    """Time from the order to power the drives until they have power."""
    servo_off_s: _Takes = 0.05
    eco_wake_s: _Takes = 0.2
    """Time to leave energy saving."""

    acceleration_limits: _EachAxis | None = None
    """Highest acceleration of each axis in velocity mode, rad/s²; None: the arm model's."""
    speed_limits: _EachAxis | None = None
    """Highest speed of each axis, rad/s; None: the arm model's."""
    servo_on: bool = option(False, "Its drives have power from the start.")
    play: bool = True
    """Initial state, like the next field."""
    remote: bool = True
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by name, from `cardan.sim_peers.base.parse_faults`."""
    seed: int = 0
    log: str = option("", "A CSV row for each interpolation cycle.", metavar="FILE")
    """File of the log; empty: none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        ms = self.ipc_s * 1000.0
        arm = load_arm(self.robot, "robot")
        axes = len(arm.joints)
        inside = self.start is None or arm.holds(self.start)
        require_each(
            self,
            ("ipc_s", abs(ms - round(ms)) < 1e-6, "1 to 16 whole ms"),
            ("robot", axes <= MAX_AXES, f"an arm of at most {MAX_AXES} joints"),
            ("start", inside, f"{axes} joints inside their ranges"),
            *(
                (key, each is None or len(each) == axes, f"{axes} numbers above 0")
                for key in ("pulses_per_rad", "acceleration_limits", "speed_limits")
                for each in (getattr(self, key),)
            ),
        )
        check_faults(self.faults, FAULTS)

    @property
    def arm(self) -> ArmModel:
        """Arm of every group."""
        return load_arm(self.robot)

    @property
    def plant_model(self) -> PlantModel:
        """Lag of the arm behind its command."""
        return self.plant if isinstance(self.plant, PlantModel) else PLANTS[self.plant]

    @property
    def old_firmware(self) -> bool:
        """True with the switch "old-firmware"."""
        return self.faults.get("old-firmware", 0.0) != 0.0

    @property
    def axis_pulses(self) -> tuple[float, ...]:
        """Pulses per rad (per m) of each axis."""
        if self.pulses_per_rad is not None:
            return self.pulses_per_rad
        per_rad = PULSES_PER_TURN_OF_MOTOR / (2.0 * math.pi)
        return tuple(
            1e5 if joint.kind is JointKind.PRISMATIC else per_rad * ratio
            for joint, ratio in zip(self.arm.joints, _GEAR_RATIOS, strict=False)
        )

    @property
    def axis_speeds(self) -> tuple[float, ...]:
        """Highest speed of each axis, rad/s."""
        return self.speed_limits or self.arm.velocity

    @property
    def axis_accelerations(self) -> tuple[float, ...]:
        """Highest acceleration of each axis in velocity mode, rad/s²."""
        return self.acceleration_limits or tuple(joint.acceleration for joint in self.arm.joints)
