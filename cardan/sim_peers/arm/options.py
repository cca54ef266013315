"""Settings of the simulated arm: the plant's, and those of the controller around it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from cardan.bounds import Range
from cardan.errors import ConfigurationError
from cardan.protocols.joint_stream import MAX_JOINTS
from cardan.robots import load_arm
from cardan.sim_peers.arm.faults import FAULTS
from cardan.sim_peers.base import check_faults
from cardan.sim_peers.command import numbers, option
from cardan.types import ZERO3, Vector3

DRIVES = ("dynamic", "ideal")
PERIOD_S = Range(0.0005, 0.1, "s", "three periods without a state are a third of a second")
STANDARD_GRAVITY_M_S2 = Vector3(0.0, 0.0, -9.81)


class Plane(NamedTuple):
    """A half space to touch: solid below `point`, seen along the outward `normal`."""

    point: Vector3
    """m, base frame."""
    normal: Vector3
    """Any length but zero."""

    @classmethod
    def read(cls, text: str) -> Plane:
        """``X,Y,Z,NX,NY,NZ``; ValueError."""
        x, y, z, *normal = numbers(text, 6)
        return cls(Vector3(x, y, z), Vector3(*normal))


class Ball(NamedTuple):
    """A solid sphere to touch."""

    centre: Vector3
    """m, base frame."""
    radius_m: float

    @classmethod
    def read(cls, text: str) -> Ball:
        """``X,Y,Z,R``; ValueError."""
        x, y, z, radius_m = numbers(text, 4)
        return cls(Vector3(x, y, z), radius_m)


@dataclass(frozen=True, kw_only=True)
class PlantOptions:
    """The arm and what it touches.

    Gains and friction are per unit of each joint's own inertia (diagonal of the mass matrix where
    it is largest, rotor included), so that one number suits a shoulder and a wrist.
    """

    drive: Literal["dynamic", "ideal"] = option("dynamic", "ideal: exactly where commanded.")
    """The joints of an ideal one have no dynamics at all."""
    step_s: float = 0.0005
    """Integration step."""
    position_bandwidth_rad_s: float = 60.0
    """Natural frequency of the position servo: stiffness = inertia · bandwidth²."""
    damping_ratio: float = 1.0
    integral_1_s: float = 0.0
    """Integral action of the position servo as a rate; 0: the arm sags by gravity / stiffness."""
    velocity_leak_1_s: float = 0.5
    """How fast the velocity servo forgets its position error: under gravity the arm creeps down
    at leak · gravity torque / stiffness."""
    gravity_feedforward: bool = option(False, "Its servo knows gravity.")
    """Servo torques contain the model's gravity torque (payload unknown to it)."""
    viscous_friction_1_s: float = 2.0
    coulomb_friction_rad_s2: float = 1.0
    coulomb_speed_rad_s: float = 0.02
    """Friction is coulomb · tanh(speed / this): there is no true stiction."""
    rotor_inertia: float = 0.1
    """Of each drive, seen from the joint: kg·m² (kg for a prismatic joint). Keeps the mass matrix
    well-conditioned however light the last links are."""
    payload_kg: float = option(0.0, "A mass at the TCP.")
    """A point."""
    gravity_m_s2: Vector3 = STANDARD_GRAVITY_M_S2
    """In the base frame."""
    start: tuple[float, ...] | None = None
    """Joints at the start, rad or m; None: the arm's home."""
    planes: tuple[Plane, ...] = option(
        (),
        "Solid below this plane, m (repeatable).",
        name="plane",
        metavar="X,Y,Z,NX,NY,NZ",
        read=Plane.read,
        repeatable=True,
    )
    balls: tuple[Ball, ...] = option(
        (),
        "A solid sphere, m (repeatable).",
        name="sphere",
        metavar="X,Y,Z,R",
        read=Ball.read,
        repeatable=True,
    )
    contact_radius_m: float = 0.02
    """Of the sphere about the TCP that touches."""
    contact_stiffness_n_m: float = 1e4
    contact_damping_n_s_m: float = 100.0
    contact_friction_n_s_m: float = 100.0
    """Viscous, along the surface."""
    contact_friction_coefficient: float = 0.5
    """The tangential force is at most this times the normal one."""
    body_contact: bool = False
    """The arm's capsules touch too, as rows of spheres; costs time."""

    def __post_init__(self) -> None:
        def check(key: str, good: bool, allowed: str) -> None:
            if not good:
                raise ConfigurationError(key, f"{getattr(self, key)!r} is not {allowed}")

        check("drive", self.drive in DRIVES, f"one of {', '.join(DRIVES)}")
        check("step_s", 1e-5 <= self.step_s <= 0.002, "within 0.00001 to 0.002 s")
        check("position_bandwidth_rad_s", 1.0 <= self.position_bandwidth_rad_s <= 1e3, "1 to 1000")
        check("damping_ratio", 0.1 <= self.damping_ratio <= 10.0, "within 0.1 to 10")
        check("contact_radius_m", 0.0 <= self.contact_radius_m < 1.0, "within 0 to 1 m")
        # Contact forces are explicit: stiffer than this they outrun the step at a light wrist.
        check("contact_stiffness_n_m", 0.0 < self.contact_stiffness_n_m <= 1e5, "up to 100000 N/m")
        check("rotor_inertia", 1e-3 <= self.rotor_inertia < math.inf, "at least 0.001")
        check("coulomb_speed_rad_s", 1e-4 <= self.coulomb_speed_rad_s < math.inf, "above 0.0001")
        for key in (
            "integral_1_s",
            "velocity_leak_1_s",
            "viscous_friction_1_s",
            "coulomb_friction_rad_s2",
            "payload_kg",
            "contact_damping_n_s_m",
            "contact_friction_n_s_m",
            "contact_friction_coefficient",
        ):
            check(key, 0.0 <= getattr(self, key) < math.inf, "finite and at least 0")
        check(
            "gravity_m_s2",
            len(self.gravity_m_s2) == 3 and all(map(math.isfinite, self.gravity_m_s2)),
            "three finite numbers",
        )
        for plane in self.planes:
            finite = all(map(math.isfinite, (*plane.point, *plane.normal)))
            if not finite or plane.normal == ZERO3:
                raise ConfigurationError("planes", f"{plane} needs a finite point and a direction")
        for ball in self.balls:
            if not (all(map(math.isfinite, ball.centre)) and 0.0 < ball.radius_m < math.inf):
                raise ConfigurationError("balls", f"{ball} needs a finite centre and a radius > 0")


@dataclass(frozen=True, kw_only=True)
class SimulatedArmOptions:
    """The controller around the plant, and where it listens."""

    robot: str = option("ur5", "Which arm: a name, a .toml or a .urdf file.", metavar="NAME|FILE")
    """As :func:`cardan.robots.load_arm` takes it."""
    plant: PlantOptions = field(default_factory=PlantOptions)
    host: str = option(
        "127.0.0.1",
        "Where it takes commands; port 0: any.",
        name="listen",
        metavar="HOST:PORT",
        port_field="port",
    )
    port: int = 6520
    """UDP."""
    period_s: float = option(0.002, "A state is sent this often.")
    command_timeout_s: float = 0.1
    """Without a command for so long the arm brakes and holds."""
    following_error_rad: float = 0.2
    """A joint this far (m for a prismatic one) from its reference stops the arm as a fault."""
    acknowledge_after_s: float = 2.0
    """An operator clears a fault or an emergency stop after this time; inf: never."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by name, from `cardan.sim_peers.base.parse_faults`."""
    seed: int = 0

    def __post_init__(self) -> None:
        def check(key: str, good: bool, allowed: str) -> None:
            if not good:
                raise ConfigurationError(key, f"{getattr(self, key)!r} is not {allowed}")

        check("port", 0 <= self.port <= 65535, "a port, 0 to 65535")
        check("period_s", self.period_s in PERIOD_S, f"within {PERIOD_S}")
        check("command_timeout_s", self.command_timeout_s > 0.0, "above 0")
        check("following_error_rad", self.following_error_rad > 0.0, "above 0")
        check("acknowledge_after_s", self.acknowledge_after_s >= 0.0, "at least 0")
        check_faults(self.faults, FAULTS)
        joints = len(load_arm(self.robot).joints)
        check("robot", joints <= MAX_JOINTS, f"an arm of at most {MAX_JOINTS} joints")
        if "jam" in self.faults and self.faults["jam"] not in range(1, joints + 1):
            raise ConfigurationError(
                "faults", f"jam: {self.faults['jam']:g} is no joint; allowed: 1 to {joints}"
            )
