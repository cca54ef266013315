"""Reads arm models: a URDF of primitives and, beside it, a few lines of TOML.

`cardan/robots` holds ours, and :func:`load_arm` takes the path of anybody's. Joints are in
kinematic order, angles in rad, lengths in m. Body 0 is the base, body i is what joint i moves;
fixed joints are folded into the bodies they weld together.
"""

from __future__ import annotations

import enum
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, ClassVar, Literal, NamedTuple

from cardan.common import bounds
from cardan.common.bounds import Length, Point, Range
from cardan.common.files import MODEL_BYTES
from cardan.common.options import Options, require
from cardan.common.tables import read_table, read_text, read_toml
from cardan.errors import ConfigurationError, about, below
from cardan.spatial import (
    add,
    compose,
    from_euler_zyx,
    from_rotation_vector,
    norm,
    rotate,
    scale,
    subtract,
    transform,
)
from cardan.types import IDENTITY, IDENTITY_POSE, ZERO3, JointLimits, Pose, Vector3

_FOLDER = Path(str(resources.files("cardan").joinpath("robots")))

TIME_TO_FULL_SPEED_S = 0.2
"""Makers rarely publish joint accelerations. Where the arm's file gives none, a joint is taken to
reach full speed in this time: within what industrial arms of this size do at full load."""

LARGEST_NUMBER = 1e6
"""No length, angle, speed or mass of an arm is larger: a mistake, and products would overflow."""

_SHORTEST_M = 1e-9

_END_CAP_TOLERANCE_M = 1e-4
"""A sphere that sticks out of a cylinder's rounded end by less is the end of that capsule."""


class JointKind(enum.Enum):
    """How a joint moves, named as in URDF."""

    REVOLUTE = "revolute"
    CONTINUOUS = "continuous"
    """Turns for ever; its range is infinite."""
    PRISMATIC = "prismatic"


class ArmJoint(NamedTuple):
    """One joint: T(placement) and then the motion along or about `axis`."""

    name: str
    kind: JointKind
    placement: Pose
    """Of the joint in the body before it, at zero."""
    axis: Vector3
    """Unit vector in the joint's frame."""
    lower: float
    """rad or m; -inf for a continuous joint."""
    upper: float
    velocity: float
    """rad/s or m/s."""
    acceleration: float
    """rad/s² or m/s²."""
    effort: float
    """N·m or N; infinite where it is not published."""


class Inertia(NamedTuple):
    """Mass of one body, in the body's frame."""

    mass_kg: float
    centre_m: Vector3
    moments: Moments
    """xx, xy, xz, yy, yz, zz about the centre of mass, body axes, kg·m²."""


class Capsule(NamedTuple):
    """All points within `radius_m` of a segment; a sphere when its ends coincide."""

    start: Vector3
    end: Vector3
    radius_m: float


class Box(NamedTuple):
    """A box about its `pose`."""

    pose: Pose
    size_m: Vector3

    @classmethod
    def between(cls, low: Vector3, high: Vector3) -> Box:
        """From its lowest corner to its highest, m, along the axes. Raises ConfigurationError."""
        size = subtract(high, low)
        if min(size) <= 0.0:
            raise ConfigurationError(
                "", f"lowest corner {tuple(low)} first, then the highest, found {tuple(high)}"
            )
        return cls(Pose(scale(add(low, high), 0.5), IDENTITY), size)


Shape = Capsule | Box
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
    """``[task]``: which of the six directions the arm is to follow, and how much they count."""

    axes: Literal["tcp", "base"] = "tcp"
    """Of the weights."""
    weights: SixWeights = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    """x y z rx ry rz; 0 leaves a direction free."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(any(self.weights), "weights", self.weights, "six, one at least above 0")


class ArmModel(NamedTuple):
    """A serial arm: kinematics, limits, masses and collision shapes."""

    name: str
    joints: tuple[ArmJoint, ...]
    flange: Pose
    """In the last body."""
    tcp: Pose
    """Tool centre point without any further tool, in the last body."""
    inertias: tuple[Inertia, ...]
    """Of bodies 1 to n; zero where the URDF gives none."""
    shapes: tuple[BodyShape, ...]
    """Of the arm, and of what is fixed to its base (body 0)."""
    ignored_pairs: frozenset[tuple[int, int]]
    """Bodies that always touch besides neighbours, lower index first."""
    home: tuple[float, ...]
    """A configuration to start from, rad or m: inside limits, not singular."""
    task: Task
    urdf: str
    counterbalanced_joints: int = 0
    """So many joints from the base are relieved of the arm's weight by springs; 0: none."""
    solid_links: tuple[str, ...] = ()
    """Links that the joints move and that ought to have a body: those with a shape to see or to
    touch, and of what one joint moves the first where none has."""
    bare_links: tuple[str, ...] = ()
    """Those of `solid_links` without a body: nothing keeps them away from anything."""

    @property
    def home_tcp(self) -> Pose:
        """The TCP in the base with the joints at `home`, without Pinocchio."""
        pose = IDENTITY_POSE
        for joint, value in zip(self.joints, self.home, strict=True):
            way = scale(joint.axis, value)
            if joint.kind is JointKind.PRISMATIC:
                moved = Pose(way, IDENTITY)
            else:
                moved = Pose(ZERO3, from_rotation_vector(way))
            pose = compose(pose, compose(joint.placement, moved))
        return compose(pose, self.tcp)

    def links_without_body(self) -> str:
        """How many links have no body, and which, in words; empty: all have one."""
        bare = self.bare_links
        if not bare:
            return ""
        return f"{len(bare)} of {len(self.solid_links)} links have no body: {', '.join(bare)}"

    def require_bodies(self, key: str) -> None:
        """Raise ConfigurationError of the setting `key` where links have no body."""
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
        """rad or m."""
        return tuple(joint.lower for joint in self.joints)

    @property
    def upper(self) -> tuple[float, ...]:
        """rad or m."""
        return tuple(joint.upper for joint in self.joints)

    def holds(self, positions: Sequence[float]) -> bool:
        """Whether this is a position of each joint, inside its range."""
        return len(positions) == len(self.joints) and all(
            joint.lower <= value <= joint.upper
            for joint, value in zip(self.joints, positions, strict=True)
        )

    @property
    def velocity(self) -> tuple[float, ...]:
        """rad/s or m/s."""
        return tuple(joint.velocity for joint in self.joints)

    @property
    def limits(self) -> JointLimits:
        """Of all joints."""
        return JointLimits(
            self.lower, self.upper, self.velocity, tuple(j.acceleration for j in self.joints)
        )


# ---------------------------------------------------------------------------------------------
# The TOML beside a URDF

_Number = Annotated[float, Range(-LARGEST_NUMBER, LARGEST_NUMBER, "", "")]
_Positive = Annotated[float, Range(0.0, LARGEST_NUMBER, "", "", above=True)]


@dataclass(frozen=True, kw_only=True)
class SolidTable(Options):
    """Something solid: its name, and one of the keys that give it a shape."""

    FORMS: ClassVar[Mapping[str, str]] = {
        "box": "[corner, corner]",
        "capsule": "[end, end, radius]",
    }

    name: str
    box: tuple[Point, Point] | None = None
    """Lowest and highest corner, m."""
    capsule: tuple[Point, Point, Length] | None = None
    """Ends and radius, m; the same point twice: a sphere."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [key for key in self.FORMS if getattr(self, key) is not None]
        if len(given) != 1:
            name = repr(self.name) if self.name else "it"
            forms = ", ".join(f"{key} = {form}" for key, form in self.FORMS.items())
            raise ConfigurationError(
                "", f"{name} has {' and '.join(given) or 'no shape'}; give one of {forms}"
            )
        with below("box"):
            self.shape()

    def shape(self) -> Shape | None:
        """The box or the capsule; None where it is neither."""
        if self.box is not None:
            return Box.between(*(Vector3(*corner) for corner in self.box))
        if self.capsule is not None:
            start, end, radius_m = self.capsule
            return Capsule(Vector3(*start), Vector3(*end), radius_m)
        return None


@dataclass(frozen=True, kw_only=True)
class ShapeTable(SolidTable):
    """``[[collision.shape]]``: along the axes of the link that it is fixed to."""

    name: str = ""
    """Empty: the link's."""
    link: str = ""
    """Empty: the base."""


@dataclass(frozen=True, kw_only=True)
class CollisionTable(Options):
    """``[collision]``"""

    ignore: tuple[tuple[str, str], ...] = ()
    """Pairs of links that always touch, besides neighbours."""
    meshes: Literal["refuse", "ignore"] = "refuse"
    shape: tuple[ShapeTable, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ArmFile(Options):
    """The whole file."""

    urdf: str
    tcp: str = ""
    """Link whose frame is the TCP; default: the last one."""
    flange: str = ""
    home_deg: tuple[_Number, ...] | None = None
    """Revolute joints in deg, prismatic ones in m."""
    acceleration_deg_s2: _Positive | tuple[_Positive, ...] | None = None
    """One for all joints or one each; prismatic ones in m/s²."""
    counterbalance: str = ""
    """Last joint from the base that springs relieve of the arm's weight; empty: there are none."""
    task: Task = field(default_factory=Task)
    collision: CollisionTable = field(default_factory=CollisionTable)


def arm_names() -> tuple[str, ...]:
    """The arms there are, sorted."""
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.urdf")))


@cache
def load_arm(name_or_file: str, key: str = "") -> ArmModel:
    """One of our arms by name, or one from a ``.toml`` or ``.urdf`` file.

    The file is given as a path, or as ``PACKAGE:FILE`` where an installed package brings it.

    Raises ConfigurationError that names the option `key` which asks for it, the file, what is
    wrong in it, and what is allowed.
    """
    if key:
        with below(key):
            return load_arm(name_or_file)
    if name_or_file in arm_names():
        path = _FOLDER / f"{name_or_file}.toml"
        return _read(path if path.exists() else path.with_suffix(".urdf"))
    if not name_or_file.endswith((".toml", ".urdf")):
        raise ConfigurationError(
            "",
            f"there is no arm {name_or_file!r}; allowed: {', '.join(arm_names())}, "
            "the path of a .toml or .urdf file, or PACKAGE:FILE for one in a package",
        )
    package, colon, file = name_or_file.partition(":")
    if colon and package.isidentifier():
        spec = find_spec(package)
        if spec is None or not spec.submodule_search_locations:
            raise ConfigurationError("", f"{name_or_file!r}: there is no package {package!r}")
        return _read(Path(spec.submodule_search_locations[0], file))
    return _read(Path(name_or_file))


def _read(path: Path) -> ArmModel:
    if path.suffix == ".urdf":
        text = read_text(path, MODEL_BYTES)
        with about(path):
            return parse_urdf(text)
    table = read_toml(path)
    with about(path):
        file = read_table(ArmFile, table)
        return _build(read_text(path.parent / file.urdf, MODEL_BYTES), file)


def parse_urdf(text: str) -> ArmModel:
    """The arm that a URDF describes, from base to tip, with defaults for all it cannot say.

    Raises ConfigurationError for text that is not URDF, branches, lacks a limit, has numbers
    that are none, or has meshes where primitives are needed.
    """
    return _build(text, ArmFile(urdf=""))


def limits_in(text: str, names: Sequence[str]) -> JointLimits:
    """The limits of the joints called `names` in a robot's whole URDF, which may branch and have
    meshes: as robots publish it.

    Raises ConfigurationError for text that is not URDF, and for a joint that is missing, is there
    twice or has no limits.
    """
    there = list(_parsed(text).iterfind("joint"))
    joints = []
    for name in names:
        found = [each for each in there if each.get("name", "") == name]
        if not found:
            its = ", ".join(each.get("name", "") for each in there)
            raise _wrong(f"the URDF has no joint {name!r}; it has {its}")
        if len(found) > 1:
            raise _wrong(f"the URDF has {len(found)} joints {name!r}")
        kind = found[0].get("type", "")
        if kind not in [each.value for each in JointKind]:
            raise _wrong(f"joint {name!r} of the URDF is {kind!r}, which does not move")
        joints.append(_joint(found[0], JointKind(kind), IDENTITY_POSE))
    return JointLimits(
        tuple(joint.lower for joint in joints),
        tuple(joint.upper for joint in joints),
        tuple(joint.velocity for joint in joints),
        tuple(joint.acceleration for joint in joints),
    )


# ---------------------------------------------------------------------------------------------
# URDF


class _Link(NamedTuple):
    """Where a link is: the body that it is part of, and its frame in that body's."""

    body: int
    pose: Pose


class _Links(dict[str, _Link]):
    """The links by name, the base first."""

    def get_link(self, name: str, key: str) -> _Link:
        """ConfigurationError of the setting `key` where there is none of that name."""
        if name not in self:
            raise ConfigurationError(key, f"there is no link {name!r}; allowed: {', '.join(self)}")
        return self[name]


def _wrong(message: str) -> ConfigurationError:
    return ConfigurationError("", message)


def _parsed(text: str) -> ET.Element:
    try:
        robot = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise _wrong(f"the arm's URDF is not XML: {error}") from None
    if robot.tag != "robot":
        raise _wrong(f"the arm's URDF is a <{robot.tag}>, not a <robot>")
    return robot


def _build(text: str, file: ArmFile) -> ArmModel:
    robot = _parsed(text)
    joints: list[ArmJoint] = []
    weld, chain, moving = IDENTITY_POSE, _chain(robot), [kind.value for kind in JointKind]
    declared = _declared_links(robot, chain.values())
    last = _root(chain)
    links = _Links({last: _Link(0, weld)})
    while last in chain:
        element = chain.pop(last)
        last = _link_of(element, "child")
        if last in links:
            raise _wrong(f"link {last!r} is reached twice: not one arm")
        name, kind = element.get("name", ""), element.get("type", "")
        placement = compose(weld, _origin(element, f"joint {name!r}"))
        if kind == "fixed":
            weld = placement
        elif kind in moving:
            joints.append(_joint(element, JointKind(kind), placement))
            weld = IDENTITY_POSE
        else:
            raise _wrong(f"joint {name!r} is {kind!r}; allowed: fixed, {', '.join(moving)}")
        links[last] = _Link(len(joints), weld)
    if loose := declared - set(links):
        raise _wrong(f"links {sorted(loose)} are not joined to the base")
    if not joints:
        raise _wrong("the arm's URDF has no moving joint")
    names = [joint.name for joint in joints]
    if len(set(names)) < len(names) or "" in names:
        raise _wrong(f"every joint has a name of its own, not {names}")
    if file.acceleration_deg_s2 is not None:
        joints = _accelerated(joints, file.acceleration_deg_s2)
    frames = {}
    for key, name in (("tcp", file.tcp or last), ("flange", file.flange or file.tcp or last)):
        body, frames[key] = links.get_link(name, key)
        if body != len(joints):
            raise ConfigurationError(key, f"link {name!r} is not moved by the last joint")
    shapes, solid = _shapes(robot, links, file.collision), _solid_links(robot, links)
    with_body = {shape.name for shape in shapes} | {each.link for each in file.collision.shape}
    return ArmModel(
        name=robot.get("name", ""),
        joints=tuple(joints),
        **frames,
        inertias=_inertias(robot, links, len(joints)),
        shapes=(*shapes, *_own_shapes(links, file.collision)),
        ignored_pairs=_pairs(links, file.collision),
        home=_home(joints, file.home_deg),
        task=file.task,
        urdf=text,
        counterbalanced_joints=_counterbalanced(names, file.counterbalance),
        solid_links=solid,
        bare_links=tuple(link for link in solid if link not in with_body),
    )


def _link_of(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    link = "" if element is None else element.get("link", "")
    if not link:
        raise _wrong(f"joint {joint.get('name')!r} lacks its parent or child")
    return link


def _chain(robot: ET.Element) -> dict[str, ET.Element]:
    """Joints by the link they start from."""
    by_parent: dict[str, ET.Element] = {}
    for joint in robot.iterfind("joint"):
        parent = _link_of(joint, "parent")
        if parent in by_parent:
            raise _wrong(f"link {parent!r} branches: not one arm")
        by_parent[parent] = joint
    return by_parent


def _declared_links(robot: ET.Element, joints: Iterable[ET.Element]) -> set[str]:
    """The names of all <link>. Raises ConfigurationError where two are the same, and for a joint
    between others: what such a link has of mass and body would be lost."""
    names = [element.get("name", "") for element in robot.iterfind("link")]
    if len(set(names)) < len(names) or "" in names:
        raise _wrong(f"every link has a name of its own, not {names}")
    for joint in joints:
        for tag in ("parent", "child"):
            if (link := _link_of(joint, tag)) not in names:
                raise _wrong(
                    f"joint {joint.get('name')!r} names link {link!r}, there are {names}; capitals "
                    "and spaces count"
                )
    return set(names)


def _root(by_parent: dict[str, ET.Element]) -> str:
    roots = set(by_parent) - {_link_of(joint, "child") for joint in by_parent.values()}
    if len(roots) != 1:
        raise _wrong(f"an arm has one base link, not {sorted(roots)}")
    return roots.pop()


def _numbers(element: ET.Element | None, attribute: str, default: Vector3, of: str) -> Vector3:
    text = None if element is None else element.get(attribute)
    if text is None:
        return default
    try:
        x, y, z = (float(word) for word in text.split())
    except ValueError:
        x = y = z = math.nan
    if not all(abs(number) <= LARGEST_NUMBER for number in (x, y, z)):
        raise _wrong(
            f"{attribute} of {of}: {text!r} is not three numbers of at most {LARGEST_NUMBER:g}"
        )
    return Vector3(x, y, z)


def _origin(element: ET.Element, of: str) -> Pose:
    origin, of = element.find("origin"), f"the origin of {of}"
    rpy = _numbers(origin, "rpy", ZERO3, of)
    return Pose(_numbers(origin, "xyz", ZERO3, of), from_euler_zyx(*rpy))


def _child(element: ET.Element, tag: str) -> ET.Element:
    """Raises ValueError that names it where there is none."""
    child = element.find(tag)
    if child is None:
        raise ValueError(f"no <{tag}>")
    return child


def _attribute(element: ET.Element | None, name: str, default: str | None = None) -> float:
    """Raises ValueError that names the attribute and what it is."""
    text = default if element is None else element.get(name, default)
    if text is None:
        raise ValueError(f"no {name}")
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} {text!r} is not a number") from None


def _joint(element: ET.Element, kind: JointKind, placement: Pose) -> ArmJoint:
    name = element.get("name", "")
    if element.find("mimic") is not None:
        raise _wrong(
            f"joint {name!r} mimics another: give the arm without it, a gripper's joints as fixed"
        )
    axis = _numbers(element.find("axis"), "xyz", Vector3(1.0, 0.0, 0.0), f"the axis of {name!r}")
    if norm(axis) < 1e-6:
        raise _wrong(f"the axis of joint {name!r} has no direction")
    lower, upper = -math.inf, math.inf
    with about(f"limits of joint {name!r}"):
        limit, soft = _child(element, "limit"), element.find("safety_controller")
        velocity = _attribute(limit, "velocity")
        effort = _attribute(limit, "effort", "0")
        if not effort >= 0.0:
            raise ValueError(f"effort {effort:g} is not a torque or force")
        if kind is not JointKind.CONTINUOUS:
            lower, upper = _attribute(limit, "lower"), _attribute(limit, "upper")
            lower = max(lower, _attribute(soft, "soft_lower_limit", "-inf"))
            upper = min(upper, _attribute(soft, "soft_upper_limit", "inf"))
            if not -LARGEST_NUMBER <= lower < upper <= LARGEST_NUMBER:
                raise ValueError(f"lower {lower:g} and upper {upper:g} are no range")
        if not 0.0 < velocity <= LARGEST_NUMBER:
            raise ValueError(f"velocity {velocity:g} is not a speed")
    return ArmJoint(
        name,
        kind,
        placement,
        scale(axis, 1.0 / norm(axis)),
        lower,
        upper,
        velocity,
        velocity / TIME_TO_FULL_SPEED_S,
        effort if effort > 0.0 else math.inf,
    )


def _unit(joint: ArmJoint) -> float:
    """What one deg (m for a prismatic joint) of the arm's file is."""
    return 1.0 if joint.kind is JointKind.PRISMATIC else math.pi / 180.0


def _each(key: str, values: Sequence[float], joints: list[ArmJoint]) -> list[float]:
    if len(values) != len(joints):
        raise ConfigurationError(key, f"has {len(values)} values for {len(joints)} joints")
    return [value * _unit(joint) for value, joint in zip(values, joints, strict=True)]


def _accelerated(joints: list[ArmJoint], given: float | tuple[float, ...]) -> list[ArmJoint]:
    values = given if isinstance(given, tuple) else [given] * len(joints)
    accelerations = _each("acceleration_deg_s2", values, joints)
    return [j._replace(acceleration=a) for j, a in zip(joints, accelerations, strict=True)]


def _counterbalanced(names: list[str], last: str) -> int:
    if not last:
        return 0
    if last not in names:
        raise ConfigurationError(
            "counterbalance", f"there is no joint {last!r}; allowed: {', '.join(names)}"
        )
    return names.index(last) + 1


def _home(joints: list[ArmJoint], given: tuple[float, ...] | None) -> tuple[float, ...]:
    if given is None:
        return tuple(
            0.0 if joint.lower == -math.inf else 0.5 * (joint.lower + joint.upper)
            for joint in joints
        )
    home = _each("home_deg", given, joints)
    for joint, value in zip(joints, home, strict=True):
        if not joint.lower <= value <= joint.upper:
            raise ConfigurationError(
                "home_deg",
                f"{joint.name} at {value / _unit(joint):g} is outside "
                f"{joint.lower / _unit(joint):g} to {joint.upper / _unit(joint):g}",
            )
    return tuple(home)


def _placed_links(robot: ET.Element, links: _Links) -> Iterator[tuple[ET.Element, str, _Link]]:
    """Each <link>, its name, and where it is."""
    for element in robot.iterfind("link"):
        name = element.get("name", "")
        yield element, name, links[name]


def _inertias(robot: ET.Element, links: _Links, bodies: int) -> tuple[Inertia, ...]:
    """Masses of the links, those of welded links put together; tensors are added as they are
    turned, about their common centre."""
    parts: list[list[Inertia]] = [[] for _ in range(bodies + 1)]
    for link, name, (body, pose) in _placed_links(robot, links):
        element = link.find("inertial")
        if element is not None:
            parts[body].append(_inertia(element, pose, f"the inertial of link {name!r}"))
    return tuple(_joined(each) for each in parts[1:])


def _inertia(element: ET.Element, pose: Pose, of: str) -> Inertia:
    with about(of):
        mass_kg, tensor = _attribute(_child(element, "mass"), "value"), element.find("inertia")
        entries = [
            _attribute(tensor, name, "0") for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        ]
        if not 0.0 <= mass_kg <= LARGEST_NUMBER:
            raise ValueError(f"mass {mass_kg:g} kg is not 0 to {LARGEST_NUMBER:g}")
        if not all(abs(entry) <= LARGEST_NUMBER for entry in entries):
            raise ValueError(f"moments {entries} are not numbers of at most {LARGEST_NUMBER:g}")
        if min(entries[0], entries[3], entries[5]) < 0.0:
            raise ValueError(f"moments {entries} have a negative ixx, iyy or izz")
    placed = compose(pose, _origin(element, of))
    xx, xy, xz, yy, yz, zz = entries
    rows = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    # R·I·Rᵀ: turn the columns, then the rows.
    turned = [rotate(placed.orientation, Vector3(*column)) for column in zip(*rows, strict=True)]
    full = [rotate(placed.orientation, Vector3(*row)) for row in zip(*turned, strict=True)]
    moments = (full[0].x, full[0].y, full[0].z, full[1].y, full[1].z, full[2].z)
    return Inertia(mass_kg, placed.position, moments)


def _joined(parts: list[Inertia]) -> Inertia:
    mass_kg = math.fsum(part.mass_kg for part in parts)
    if mass_kg == 0.0:
        return Inertia(0.0, ZERO3, (0.0,) * 6)
    centre = ZERO3
    for part in parts:
        centre = add(centre, scale(part.centre_m, part.mass_kg / mass_kg))
    total = [0.0] * 6
    for part in parts:
        x, y, z = subtract(part.centre_m, centre)
        steiner = (y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y)
        for i in range(6):
            total[i] += part.moments[i] + part.mass_kg * steiner[i]
    return Inertia(mass_kg, centre, (total[0], total[1], total[2], total[3], total[4], total[5]))


# ---------------------------------------------------------------------------------------------
# Collision shapes


def _placed(shape: Shape, pose: Pose) -> Shape:
    """`shape` in the frame that `pose` is in."""
    if isinstance(shape, Box):
        return Box(compose(pose, shape.pose), shape.size_m)
    return Capsule(transform(pose, shape.start), transform(pose, shape.end), shape.radius_m)


def _shapes(robot: ET.Element, links: _Links, table: CollisionTable) -> list[BodyShape]:
    found: list[BodyShape] = []
    given = {shape.link for shape in table.shape}
    for link, name, (body, pose) in _placed_links(robot, links):
        if name in given:
            continue
        capsules: list[Capsule] = []
        for element in link.iterfind("collision"):
            origin = _origin(element, f"a collision element of link {name!r}")
            shape = _shape(element, name, table.meshes)
            if shape is None:
                continue
            shape = _placed(shape, compose(pose, origin))
            if isinstance(shape, Capsule):
                capsules.append(shape)
            else:
                found.append(BodyShape(name, body, shape))
        found += (BodyShape(name, body, capsule) for capsule in _without_end_caps(capsules))
    return found


def _solid_links(robot: ET.Element, links: _Links) -> tuple[str, ...]:
    """As `ArmModel` has them."""
    solid: dict[int, list[str]] = {}
    first: dict[int, str] = {}
    for name, link in links.items():
        first.setdefault(link.body, name)
    for element, name, link in _placed_links(robot, links):
        if element.find("collision") is not None or element.find("visual") is not None:
            solid.setdefault(link.body, []).append(name)
    return tuple(name for body in first if body > 0 for name in solid.get(body, (first[body],)))


def _own_shapes(links: _Links, table: CollisionTable) -> Iterator[BodyShape]:
    for each in table.shape:
        link = each.link or next(iter(links))
        body, pose = links.get_link(link, "collision.shape.link")
        if (shape := each.shape()) is not None:
            yield BodyShape(each.name or link, body, _placed(shape, pose))


def _shape(element: ET.Element, link: str, meshes: str) -> Shape | None:
    """In the frame of the element; None for a mesh that counts as nothing.

    A cylinder counts as the capsule around it: 500 times cheaper than a mesh, and safe.
    """
    geometry = element.find("geometry")
    primitive = None if geometry is None else next(iter(geometry), None)
    if primitive is None:
        raise _wrong(f"a collision element of link {link!r} has no geometry")
    tag = primitive.tag
    with about(f"{tag} of link {link!r}"):
        if tag == "sphere":
            return Capsule(ZERO3, ZERO3, _positive(primitive, "radius"))
        if tag in ("cylinder", "capsule"):
            half = Vector3(0.0, 0.0, 0.5 * _positive(primitive, "length"))
            return Capsule(scale(half, -1.0), half, _positive(primitive, "radius"))
    if tag == "box":
        size = _numbers(primitive, "size", ZERO3, f"the box of link {link!r}")
        if min(size) <= 0.0:
            raise _wrong(f"the box of link {link!r} has no size")
        return Box(IDENTITY_POSE, size)
    if tag == "mesh" and meshes == "ignore":
        return None
    raise _wrong(
        f"the collision geometry of link {link!r} is a {tag}; allowed: sphere, cylinder, "
        "capsule, box. In the arm's .toml give it a [[collision.shape]], or set "
        'collision.meshes = "ignore"'
    )


def _positive(element: ET.Element, attribute: str) -> float:
    value = _attribute(element, attribute)
    if not _SHORTEST_M <= value <= LARGEST_NUMBER:
        raise ValueError(f"{attribute} {element.get(attribute)!r} is not a length")
    return value


def _without_end_caps(capsules: list[Capsule]) -> list[Capsule]:
    """URDF has no capsule: one is written as a cylinder and two spheres, which it swallows."""
    long = [c for c in capsules if c.start != c.end]

    def swallowed(sphere: Capsule) -> bool:
        return any(
            _segment_distance(c, sphere.start) + sphere.radius_m
            <= c.radius_m + _END_CAP_TOLERANCE_M
            for c in long
        )

    return [c for c in capsules if c.start != c.end or not swallowed(c)]


def _segment_distance(capsule: Capsule, point: Vector3) -> float:
    along, to = subtract(capsule.end, capsule.start), subtract(point, capsule.start)
    share = (along.x * to.x + along.y * to.y + along.z * to.z) / norm(along) ** 2
    return norm(subtract(to, scale(along, max(0.0, min(1.0, share)))))


def _pairs(links: _Links, table: CollisionTable) -> frozenset[tuple[int, int]]:
    pairs = set()
    for pair in table.ignore:
        low, high = sorted(links.get_link(name, "collision.ignore").body for name in pair)
        pairs.add((low, high))
    return frozenset(pairs)
