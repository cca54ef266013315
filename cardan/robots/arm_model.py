"""Arm models as data. Joints are in kinematic order, angles in rad, lengths in m.

Body 0 is the base with everything that no joint moves; body i is moved by joint i. Links that are
joined by fixed or held joints are one body.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from cardan.common import bounds
from cardan.common.options import Options, require
from cardan.errors import ConfigurationError
from cardan.spatial import add, compose, from_rotation_vector, scale, subtract
from cardan.types import IDENTITY, IDENTITY_POSE, ZERO3, JointLimits, Pose, Vector3

TIME_TO_FULL_SPEED_S = 0.2
"""Time to full speed that is assumed for joints without an acceleration in the arm's file, since
makers rarely publish it: within the performance of industrial arms of this size at full load."""


class JointKind(enum.Enum):
    """Kind of a joint's motion, named as in URDF."""

    REVOLUTE = "revolute"
    CONTINUOUS = "continuous"
    """Revolute without limits; its range is infinite."""
    PRISMATIC = "prismatic"


class ArmJoint(NamedTuple):
    """Joint transform: T(placement), then the motion along or about `axis`."""

    name: str
    kind: JointKind
    placement: Pose
    """Pose of the joint in the previous body, at zero."""
    axis: Vector3
    """Unit vector in the joint's frame."""
    lower: float
    """Lower end of the range, rad or m; -inf for a continuous joint."""
    upper: float
    velocity: float
    """Highest speed, rad/s or m/s."""
    acceleration: float
    """Highest acceleration, rad/s² or m/s²."""
    effort: float
    """Highest torque or force, N·m or N; infinite if it is not published."""


class BodyInertia(NamedTuple):
    """Mass of one body, in the body's frame."""

    mass_kg: float
    center_m: Vector3
    moments: Moments
    """Inertia about the center of mass, body axes, kg·m²: xx, xy, xz, yy, yz, zz."""


class Capsule(NamedTuple):
    """All points within `radius_m` of a segment; a sphere when its ends coincide."""

    start: Vector3
    end: Vector3
    radius_m: float


class OrientedBox(NamedTuple):
    """A box centered at its `pose`."""

    pose: Pose
    size_m: Vector3

    @classmethod
    def between(cls, low: Vector3, high: Vector3) -> OrientedBox:
        """Make an axis-aligned box by two corners, lowest first, m. Raises ConfigurationError."""
        size = subtract(high, low)
        if min(size) <= 0.0:
            raise ConfigurationError(
                "", f"lowest corner {tuple(low)} first, then the highest, found {tuple(high)}"
            )
        return cls(Pose(scale(add(low, high), 0.5), IDENTITY), size)


Shape = Capsule | OrientedBox
Moments = tuple[float, float, float, float, float, float]
Weight = Annotated[float, bounds.NOT_NEGATIVE]
SixWeights = tuple[Weight, Weight, Weight, Weight, Weight, Weight]


class BodyShape(NamedTuple):
    """A collision shape fixed to a body, in the body's frame."""

    name: str
    body: int
    shape: Shape


@dataclass(frozen=True, kw_only=True)
class Task(Options):
    """``[task]``: the directions that the arm follows, and their weights."""

    axes: Literal["tcp", "base"] = "tcp"
    """Frame of the weights."""
    weights: SixWeights = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """Weights of x y z rx ry rz; 0 leaves a direction free."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(any(self.weights), "weights", self.weights, "six, one at least above 0")


class ArmModel(NamedTuple):
    """A serial arm: kinematics, limits, masses and collision shapes."""

    name: str
    joints: tuple[ArmJoint, ...]
    flange: Pose
    """Pose of the flange in the last body."""
    tcp: Pose
    """Tool center point without an additional tool, in the last body."""
    inertias: tuple[BodyInertia, ...]
    """Inertias of bodies 1 to n; zero if the URDF has none."""
    shapes: tuple[BodyShape, ...]
    """Shapes of the arm, and of links fixed to its base (body 0)."""
    ignored_pairs: frozenset[tuple[int, int]]
    """Bodies that always touch besides neighbors, lower index first."""
    home: tuple[float, ...]
    """Initial configuration, rad or m, inside the limits."""
    task: Task
    urdf: str
    """URDF of the arm alone: no other joint moves, and its base is the root."""
    counterbalanced_joints: int = 0
    """Number of joints from the base whose weight springs carry; 0: none."""
    solid_links: tuple[str, ...] = ()
    """Moved links that ought to have a body: those with a visual or collision shape, and the first
    link that a joint moves if none of its links has one."""
    bare_links: tuple[str, ...] = ()
    """Members of `solid_links` without a body, which no collision check protects."""
    missing_meshes: tuple[str, ...] = ()
    """Missing meshes of these, and the places searched for them."""
    disabled_shapes: frozenset[tuple[int, int]] = frozenset()
    """Pairs of `shapes` that an SRDF excludes from checks, by number, lower first."""
    touching_shapes: frozenset[tuple[int, int]] = frozenset()
    """Pairs of shapes of links that touch in every posture, likewise."""
    held_rows: tuple[tuple[str, str], ...] = ()
    """Other arms of the same description, which are held: the first and the last joint of each."""

    def keeps_apart(self, bodies: tuple[int, int], shapes: tuple[int, int]) -> bool:
        """True if two of `shapes`, by number, lower first, are checked for collisions."""
        low, high = sorted(bodies)
        return (
            high - low > 1
            and (low, high) not in self.ignored_pairs
            and shapes not in self.disabled_shapes
            and shapes not in self.touching_shapes
        )

    def touching_names(self) -> list[tuple[str, str]]:
        """Return each pair of names of `touching_shapes` once."""
        pairs = sorted(self.touching_shapes)
        return list(
            dict.fromkeys((self.shapes[one].name, self.shapes[other].name) for one, other in pairs)
        )

    def held_words(self) -> str:
        """Message that other arms are held, with the consequences; empty: there are none."""
        if not self.held_rows:
            return ""
        rows = ", ".join(f"{first} to {last}" for first, last in self.held_rows)
        return (
            f"joints that are held: {rows}; their links are obstacles where [hold] has them, and "
            "once they move, nothing keeps the arm away from them"
        )

    @property
    def home_tcp(self) -> Pose:
        """TCP in the base frame with the joints at `home`, computed without Pinocchio."""
        pose = IDENTITY_POSE
        for joint, value in zip(self.joints, self.home, strict=True):
            way = scale(joint.axis, value)
            if joint.kind is JointKind.PRISMATIC:
                moved = Pose(way, IDENTITY)
            else:
                moved = Pose(ZERO3, from_rotation_vector(way))
            pose = compose(pose, compose(joint.placement, moved))
        return compose(pose, self.tcp)

    @property
    def home_deg(self) -> tuple[float, ...]:
        """Home in units of the arm's file: deg, m for prismatic joints."""
        return tuple(
            value if joint.kind is JointKind.PRISMATIC else math.degrees(value)
            for joint, value in zip(self.joints, self.home, strict=True)
        )

    def home_words(self) -> str:
        """Describe the position of each joint at home, with its unit."""
        return ", ".join(
            f"{round(value, 3):g}{' m' if joint.kind is JointKind.PRISMATIC else '°'}"
            for joint, value in zip(self.joints, self.home_deg, strict=True)
        )

    def links_without_body(self) -> str:
        """Describe the links without a body; empty if all have one."""
        bare = self.bare_links
        if not bare:
            return ""
        words = f"{len(bare)} of {len(self.solid_links)} links have no body: {', '.join(bare)}"
        return "; ".join((words, *self.missing_meshes))

    def without(self, other: ArmModel) -> ArmModel:
        """Return the arm without links that `other`, an arm of the same robot, moves and that are
        held here."""
        theirs = {shape.name for shape in other.shapes if shape.body > 0}
        retained = [
            number
            for number, shape in enumerate(self.shapes)
            if shape.body > 0 or shape.name not in theirs
        ]
        now = {number: index for index, number in enumerate(retained)}

        def renumbered(pairs: frozenset[tuple[int, int]]) -> frozenset[tuple[int, int]]:
            return frozenset((now[a], now[b]) for a, b in pairs if a in now and b in now)

        return self._replace(
            shapes=tuple(self.shapes[number] for number in retained),
            disabled_shapes=renumbered(self.disabled_shapes),
            touching_shapes=renumbered(self.touching_shapes),
            held_rows=tuple(row for row in self.held_rows if row[0] not in other.joint_names),
        )

    def require_bodies(self, key: str) -> None:
        """Raise ConfigurationError of the setting `key` if links have no body."""
        if bare := self.links_without_body():
            raise ConfigurationError(
                key,
                f"{bare}; no obstacle stops them: give each a [[collision.shape]] in the arm's "
                ".toml, or accept it with i_accept_links_without_bodies = true in [arm]; a "
                "program, in its ControllerOptions",
            )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in kinematic order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def lower(self) -> tuple[float, ...]:
        """Lower ends of the ranges, rad or m."""
        return tuple(joint.lower for joint in self.joints)

    @property
    def upper(self) -> tuple[float, ...]:
        """Upper ends of the ranges, rad or m."""
        return tuple(joint.upper for joint in self.joints)

    def holds(self, positions: Sequence[float]) -> bool:
        """True if this has a position for each joint, inside its range."""
        return len(positions) == len(self.joints) and all(
            joint.lower <= value <= joint.upper
            for joint, value in zip(self.joints, positions, strict=True)
        )

    @property
    def velocity(self) -> tuple[float, ...]:
        """Highest speeds, rad/s or m/s."""
        return tuple(joint.velocity for joint in self.joints)

    @property
    def limits(self) -> JointLimits:
        """Limits of all joints."""
        return JointLimits(
            self.lower, self.upper, self.velocity, tuple(j.acceleration for j in self.joints)
        )
