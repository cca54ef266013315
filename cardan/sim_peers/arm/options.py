"""Settings of the simulated arm's plant and of the controller around it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options, require, require_each
from cardan.protocols.joint_stream.codec import MAX_JOINTS
from cardan.robots import load_arm
from cardan.sim_peers.arm.faults import FAULTS
from cardan.sim_peers.base import check_faults, check_jam
from cardan.sim_peers.command import listen_option, numbers, option
from cardan.types import ZERO3, Vector3

PERIOD_S = Range(0.0005, 0.1, "s", "three periods without a state are a third of a second")
STEP_S = Range(1e-5, 0.002, "s", "longer steps of the integration are unstable")
BANDWIDTH_RAD_S = Range(1.0, 1e3, "rad/s", "no servo is faster, and a slower one hardly moves")
DAMPING_RATIO = Range(0.1, 10.0, "", "less oscillates, more creeps")
CONTACT_RADIUS_M = Range(0.0, 1.0, "m", "no tool's tip is larger", below=True)
CONTACT_STIFFNESS_N_M = Range(
    0.0, 1e5, "N/m", "a stiffer one outruns the step at a light wrist", above=True
)
ROTOR_INERTIA = replace(bounds.POSITIVE, lowest=1e-3, above=False)
COULOMB_SPEED_RAD_S = replace(bounds.POSITIVE, lowest=1e-4, above=False, unit="rad/s")
EVER_S = Range(0.0, math.inf, "s", "")
"""inf: never."""
BEYOND_NONE = replace(EVER_S, unit="", above=True)

_Size = Annotated[float, bounds.NOT_NEGATIVE]

STANDARD_GRAVITY_M_S2 = Vector3(0.0, 0.0, -9.81)


class TouchPlane(NamedTuple):
    """Half space for contact: solid below `point`, with the outward `normal`."""

    point: Vector3
    """m, base frame."""
    normal: Vector3
    """Any length but zero."""

    @classmethod
    def read(cls, text: str) -> TouchPlane:
        """Parse ``X,Y,Z,NX,NY,NZ``; raise ValueError."""
        x, y, z, *normal = numbers(text, 6)
        return cls(Vector3(x, y, z), Vector3(*normal))


class Ball(NamedTuple):
    """Solid sphere for contact."""

    center: Vector3
    """m, base frame."""
    radius_m: Annotated[float, bounds.POSITIVE]

    @classmethod
    def read(cls, text: str) -> Ball:
        """Parse ``X,Y,Z,R``; raise ValueError."""
        x, y, z, radius_m = numbers(text, 4)
        return cls(Vector3(x, y, z), radius_m)


@dataclass(frozen=True, kw_only=True)
class PlantOptions(Options):
    """The arm and its contacts.

    Gains and friction are per unit of each joint's own inertia (diagonal of the mass matrix where
    it is largest, rotor included), thus one number suits a shoulder and a wrist.
    """

    drive: Literal["dynamic", "ideal"] = option("dynamic", "ideal: exactly where commanded.")
    """"ideal": joints without dynamics."""
    step_s: Annotated[float, STEP_S] = 0.0005
    """Integration step."""
    position_bandwidth_rad_s: Annotated[float, BANDWIDTH_RAD_S] = 60.0
    """Natural frequency of the position servo: stiffness = inertia · bandwidth²."""
    damping_ratio: Annotated[float, DAMPING_RATIO] = 1.0
    integral_1_s: _Size = 0.0
    """Integral action of the position servo as a rate; 0: the arm sags by gravity / stiffness."""
    velocity_leak_1_s: _Size = 0.5
    """Rate at which the velocity servo's position error decays: under gravity the arm creeps down
    at leak · gravity torque / stiffness."""
    gravity_feedforward: bool = option(False, "Its servo knows gravity.")
    """Servo torques contain the model's gravity torque (payload unknown to it)."""
    viscous_friction_1_s: _Size = 2.0
    coulomb_friction_rad_s2: _Size = 1.0
    coulomb_speed_rad_s: Annotated[float, COULOMB_SPEED_RAD_S] = 0.02
    """Friction is coulomb · tanh(speed / this): there is no true stiction."""
    rotor_inertia: Annotated[float, ROTOR_INERTIA] = 0.1
    """Rotor inertia of each drive, seen from the joint: kg·m² (kg for a prismatic joint). Keeps the
    mass matrix well-conditioned however light the last links are."""
    payload_kg: _Size = option(0.0, "A mass at the TCP.")
    """Point mass."""
    gravity_m_s2: Vector3 = STANDARD_GRAVITY_M_S2
    """In the base frame."""
    start: tuple[float, ...] | None = None
    """Joints at the start, rad or m; None: the arm's home."""
    planes: tuple[TouchPlane, ...] = option(
        (),
        "Solid below this plane, m (repeatable).",
        name="plane",
        metavar="X,Y,Z,NX,NY,NZ",
        read=TouchPlane.read,
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
    contact_radius_m: Annotated[float, CONTACT_RADIUS_M] = 0.02
    """Radius of the contact sphere about the TCP."""
    contact_stiffness_n_m: Annotated[float, CONTACT_STIFFNESS_N_M] = 1e4
    contact_damping_n_s_m: _Size = 100.0
    contact_friction_n_s_m: _Size = 100.0
    """Viscous, along the surface."""
    contact_friction_coefficient: _Size = 0.5
    """Largest tangential force as a share of the normal force."""
    body_contact: bool = False
    """The arm's capsules make contact too, as rows of spheres; costs time."""

    def __post_init__(self) -> None:
        super().__post_init__()
        finite = all(map(math.isfinite, self.gravity_m_s2))
        require(finite, "gravity_m_s2", self.gravity_m_s2, "three finite numbers")
        for plane in self.planes:
            finite = all(map(math.isfinite, (*plane.point, *plane.normal)))
            good = finite and plane.normal != ZERO3
            require(good, "planes", plane, "with a finite point and a direction")
        for ball in self.balls:
            require(all(map(math.isfinite, ball.center)), "balls", ball, "with a finite center")


@dataclass(frozen=True, kw_only=True)
class SimulatedArmOptions(Options):
    """Settings of the controller around the plant, and its address."""

    robot: str = option("ur5", "Which arm: a name, a .toml or a .urdf file.", metavar="NAME|FILE")
    """Argument of :func:`cardan.robots.load_arm`."""
    plant: PlantOptions = field(default_factory=PlantOptions)
    host: Annotated[str, bounds.LISTEN_HOST] = listen_option("Address at which it takes commands")
    port: Annotated[int, bounds.ANY_PORT] = 6520
    """UDP."""
    period_s: Annotated[float, PERIOD_S] = option(0.002, "A state is sent this often.")
    command_timeout_s: Annotated[float, BEYOND_NONE] = 0.1
    """Time without a command after which the arm brakes and holds."""
    following_error_rad: Annotated[float, BEYOND_NONE] = 0.2
    """Distance of a joint from its reference that is a fault and stops the arm (prismatic: m)."""
    acknowledge_after_s: Annotated[float, EVER_S] = 2.0
    """Time after which an operator clears a fault or an emergency stop; inf: never."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by name, from `cardan.sim_peers.base.parse_faults`."""
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_faults(self.faults, FAULTS)
        joints = len(load_arm(self.robot, "robot").joints)
        allowed = f"an arm of at most {MAX_JOINTS} joints"
        require_each(self, ("robot", joints <= MAX_JOINTS, allowed))
        check_jam(self.faults, joints)
