"""Settings of the simulated Motoman controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from cardan.errors import ConfigurationError
from cardan.protocols.simple_message import MAX_GROUPS, MOTION_PORT, ValidFields
from cardan.robots import ArmModel, JointKind, load_arm
from cardan.sim_peers.base import check_faults
from cardan.sim_peers.command import option
from cardan.sim_peers.motoros_controller.faults import ROBOT_FAULTS
from cardan.sim_peers.motoros_controller.plant import PLANTS, PlantModel
from cardan.sim_peers.motoros_controller.server_faults import SERVER_FAULTS

MAX_AXES = 8
"""MP_GRP_AXES_NUM: axes of a group."""

PULSES_PER_TURN_OF_MOTOR = 4096
"""What a controller counts on its motors; gives the default `pulses_per_rad`."""
_GEAR_RATIOS = (100.0, 120.0, 100.0, 80.0, 80.0, 50.0, 60.0, 60.0)


@dataclass(frozen=True, kw_only=True)
class MotorosControllerOptions:
    """How the simulated controller is set up."""

    robot: str = "gp8"
    """A name or file as :func:`cardan.robots.load_arm` takes it."""
    groups: int = option(1, "Control groups, each with such an arm.", metavar="1..4")
    host: str = option("127.0.0.1", "The address it listens on.", metavar="HOST")
    base_port: int = option(
        MOTION_PORT, "Motion; state and I/O are the two after it. 0: any three.", metavar="PORT"
    )
    big_endian: bool = option(False, "As an FS100; others are little-endian.")
    velocity_mode: bool = option(
        True, "As MotoROS is, with trajectories only.", name="no-velocity-mode"
    )
    plant: Literal["ideal", "paper"] | PlantModel = option(
        "ideal", "paper: the arm lags as in Baklouti et al. 2021."
    )
    """How the arm follows its command: one of PLANTS, or one's own."""
    ipc_s: float = 0.004
    """Interpolation period, whole ms."""
    queue_increments: int = 200
    """Entries of each group's queue."""
    pulses_per_rad: tuple[float, ...] | None = None
    """Of each axis (per m for a linear one). None: 4096 pulses a turn of the motor behind gears of
    80 to 120 (wrist roll 50), 32595 to 78228 a rad; makers do not publish them."""
    state_period_s: float = 0.025
    feedback_fields: Literal[2, 6] = 6
    """ValidFields of feedback: positions, or positions and speeds."""
    start: tuple[float, ...] | None = None
    """Joints at the start, rad or m; None: the arm's home."""

    job_start_s: float = 0.11
    """START_TRAJ_MODE takes so long with the servos on; from about two thirds of it on motion is
    possible."""
    servo_on_s: float = 1.0
    """From the order to power the drives until they have it."""
    servo_off_s: float = 0.05
    eco_wake_s: float = 0.2
    """Leaving energy saving."""

    acceleration_limits: tuple[float, ...] | None = None
    """Of each axis in velocity mode, rad/s²; None: the arm model's."""
    speed_limits: tuple[float, ...] | None = None
    """Of each axis, rad/s; None: the arm model's."""
    servo_on: bool = option(False, "Its drives have power from the start.")
    play: bool = True
    """At the start, as the one below."""
    remote: bool = True
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by name, from `cardan.sim_peers.base.parse_faults`."""
    seed: int = 0
    log: str = option("", "A CSV row for each interpolation cycle.", metavar="FILE")
    """Empty: none is kept."""

    def __post_init__(self) -> None:
        def check(key: str, good: bool, allowed: str) -> None:
            if not good:
                raise ConfigurationError(key, f"{getattr(self, key)!r} is not {allowed}")

        check("groups", self.groups in range(1, MAX_GROUPS + 1), f"1 to {MAX_GROUPS}")
        check("base_port", 0 <= self.base_port <= 65533, "a port, 0 to 65533")
        if isinstance(self.plant, PlantModel):
            self.plant.check("plant")
        else:
            check("plant", self.plant in PLANTS, f"one of {', '.join(PLANTS)}")
        ms = self.ipc_s * 1000.0
        check("ipc_s", 1.0 <= ms <= 16.0 and abs(ms - round(ms)) < 1e-6, "1 to 16 whole ms")
        check("queue_increments", 2 <= self.queue_increments <= 10_000, "2 to 10000")
        check("state_period_s", 0.001 <= self.state_period_s <= 10.0, "within 0.001 to 10 s")
        fields = (ValidFields.POSITION, ValidFields.POSITION | ValidFields.VELOCITY)
        check("feedback_fields", self.feedback_fields in fields, "2 or 6")
        for key in ("job_start_s", "servo_on_s", "servo_off_s", "eco_wake_s"):
            check(key, 0.0 <= getattr(self, key) <= 60.0, "within 0 to 60 s")
        arm = load_arm(self.robot)
        axes = len(arm.joints)
        check("robot", axes <= MAX_AXES, f"an arm of at most {MAX_AXES} joints")
        for key in ("pulses_per_rad", "acceleration_limits", "speed_limits"):
            values = getattr(self, key)
            check(
                key,
                values is None
                or (len(values) == axes and all(0.0 < value < math.inf for value in values)),
                f"{axes} numbers above 0",
            )
        if self.start is not None:
            inside = len(self.start) == axes and all(
                joint.lower <= value <= joint.upper
                for joint, value in zip(arm.joints, self.start, strict=True)
            )
            check("start", inside, f"{axes} joints inside their ranges")
        check_faults(self.faults, ROBOT_FAULTS + SERVER_FAULTS)

    @property
    def arm(self) -> ArmModel:
        """The arm of every group."""
        return load_arm(self.robot)

    @property
    def plant_model(self) -> PlantModel:
        """How the arm follows its command."""
        return self.plant if isinstance(self.plant, PlantModel) else PLANTS[self.plant]

    @property
    def old_firmware(self) -> bool:
        """The switch "old-firmware"."""
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
