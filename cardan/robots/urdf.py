"""Reader of a URDF for facts that Pinocchio's parser does not report: validity for other programs,
names and connections of joints and links, limits, soft limits, mimic.

Pinocchio reads poses, axes, masses and shapes, from :func:`normal_form`, in which every number has
been checked.
"""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple
from xml.parsers import expat

from cardan.common.options import suggestion
from cardan.errors import ConfigurationError, about
from cardan.robots.arm_model import TIME_TO_FULL_SPEED_S, JointKind
from cardan.spatial import compose, from_euler_zyx, normalized
from cardan.types import IDENTITY, IDENTITY_POSE, ZERO3, JointLimits, Pose, Quaternion, Vector3

LARGEST_NUMBER = 1e6
"""Largest plausible length, angle, speed or mass of an arm: beyond it products would overflow."""

WIDEST = 1000.0
"""Largest end of a range, rad or m: beyond it the joint counts as unlimited."""

MOST_LINKS = 1000
"""Most links in one file; humanoids have 100. Pinocchio recurses along the tree."""

MOST_NESTED = 100
"""Most nested elements; a URDF has 5, simulators' extensions some more."""

MOVING = tuple(kind.value for kind in JointKind)
LOOSE = ("planar", "floating")
"""Joints with several directions, which are always held."""

ARM_BASE = "arm_base"
"""Link that `arm_form` adds, with as many "_" behind it as make the name unique."""

_VERSIONS = ("1.0", "1.1", "1.2")
_LENGTHS: Mapping[str, tuple[str, ...]] = {
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_SHORTEST_M = 1e-9
_ROUNDING_KG_M2 = 1e-12
"""Largest magnitude of moments that CAD programs compute in place of 0."""


class Limits(NamedTuple):
    """Limits of a joint, rad or m; NaN if the file has no usable one."""

    lower: float
    """Lower end; -inf for a continuous joint."""
    upper: float
    velocity: float
    acceleration: float
    effort: float
    """Effort; infinite if it is not published."""

    @property
    def accelerated(self) -> Limits:
        """Return the limits, with a default acceleration if the file has none."""
        if math.isnan(self.acceleration):
            return self._replace(acceleration=self.velocity / TIME_TO_FULL_SPEED_S)
        return self


class TreeJoint(NamedTuple):
    """A joint of any kind."""

    name: str
    kind: str
    parent: str
    child: str
    element: ET.Element

    @property
    def mimic(self) -> ET.Element | None:
        """<mimic> element with the joint that this one follows."""
        return self.element.find("mimic")

    @property
    def moves(self) -> bool:
        """True if it has one direction of its own."""
        return self.kind in MOVING and self.mimic is None

    def axis(self) -> Vector3:
        """Unit vector of its axis in its own frame. Raises ConfigurationError."""
        axis = self.element.find("axis")
        if axis is None or axis.get("xyz") is None:
            return Vector3(1.0, 0.0, 0.0)
        numbers = _numbers(axis, "xyz", f"the axis of {self.name!r}")
        length = math.hypot(*numbers)
        if length < 1e-6:
            raise _wrong(f"the axis of joint {self.name!r} has no direction")
        return Vector3(*(each / length for each in numbers))

    def orientation(self) -> Quaternion:
        """Return the orientation of its frame in its parent's. Raises ConfigurationError."""
        origin, of = self.element.find("origin"), f"the origin of joint {self.name!r}"
        if origin is not None and origin.get("quat_xyzw") is not None:
            x, y, z, w = _numbers(origin, "quat_xyzw", of, 4)
            with about(of):
                return normalized(Quaternion(w, x, y, z))
        if origin is None or origin.get("rpy") is None:
            return IDENTITY
        return from_euler_zyx(*_numbers(origin, "rpy", of))

    def placement(self) -> Pose:
        """Its frame in its parent's, with its own direction at 0. Raises ConfigurationError."""
        origin, at = self.element.find("origin"), ZERO3
        if origin is not None and origin.get("xyz") is not None:
            at = Vector3(*_numbers(origin, "xyz", f"the origin of joint {self.name!r}"))
        return Pose(at, self.orientation())

    def refused(self) -> ConfigurationError:
        """Make the error of a joint of a kind that is not allowed in its place."""
        return _wrong(f"joint {self.name!r} is {self.kind!r}; allowed: fixed, {', '.join(MOVING)}")

    def limits(self) -> tuple[Limits, dict[str, str]]:
        """Return the file's limits, and for missing ones the text in their place. Raises
        ConfigurationError."""
        return _limits(self.element)

    def range(self) -> tuple[float, float]:
        """Return its range, if the file has one; a continuous joint has none."""
        with about(f"limits of joint {self.name!r}"):
            return _range(self.element)


class Tree(NamedTuple):
    """Contents of a file: links and joints by name, each link after its parent."""

    robot: ET.Element
    text: str
    root: str
    links: dict[str, ET.Element]
    joints: dict[str, TreeJoint]
    above: dict[str, TreeJoint]
    """Parent joint of each link; the root has none."""

    def path(self, link: str) -> list[TreeJoint]:
        """Return the joints from the root to a link."""
        found = []
        while link != self.root:
            found.append(self.above[link])
            link = found[-1].parent
        return found[::-1]

    def fixed_links(self) -> dict[str, Pose]:
        """Return the links that are fixed to the root, with their poses in its frame."""
        found = {self.root: IDENTITY_POSE}
        for link in self.links:
            joint = self.above.get(link)
            if joint is not None and joint.kind == "fixed" and joint.parent in found:
                found[link] = compose(found[joint.parent], joint.placement())
        return found

    def home(self) -> dict[str, float]:
        """Return positions by joint, rad or m, of a <group_state> "home" (SRDF's element, here from
        an MJCF's keyframe). Empty if there is none. Raises ConfigurationError."""
        found = {}
        for state in self.robot.iterfind("group_state"):
            for joint in state.iterfind("joint") if state.get("name") == "home" else ():
                with about("home"):
                    found[joint.get("name", "")] = _bounded(joint, "value", "0")
        return found

    def ends(self) -> list[str]:
        """Return the links without children."""
        parents = {joint.parent for joint in self.joints.values()}
        return [link for link in self.links if link not in parents]

    def leader(self, name: str) -> tuple[TreeJoint, float, float]:
        """Return the joint that `name` follows in the end (itself if none), factor and offset. If
        the returned joint mimics, its leader is missing or the chain is circular. Raises
        ConfigurationError."""
        factor, offset, passed = 1.0, 0.0, {name}
        joint = self.joints[name]
        while (mimic := joint.mimic) is not None:
            leader = mimic.get("joint", "")
            if leader not in self.joints or leader in passed:
                break
            with about(f"mimic of joint {joint.name!r}"):
                offset += factor * _bounded(mimic, "offset", "0")
                factor *= _bounded(mimic, "multiplier", "1")
                if not abs(factor) + abs(offset) <= LARGEST_NUMBER:
                    raise ValueError(f"it turns {factor:g} times as far")
            passed.add(leader)
            joint = self.joints[leader]
        return joint, factor, offset

    def resting(self, name: str, held: Mapping[str, float]) -> float:
        """Return the position of a held joint, rad or m: that in `held`, that of the joint it
        follows, or nearest to 0 in its range. Raises ConfigurationError."""
        if name in held:
            return held[name]
        joint, factor, offset = self.leader(name)
        value = held.get(joint.name, 0.0)
        if joint.name not in held and joint.kind in MOVING:
            lower, upper = joint.range()
            value = max(lower, min(upper, 0.0))
        if not abs(value) <= LARGEST_NUMBER:
            raise _wrong(f"joint {joint.name!r} has no value of at most {LARGEST_NUMBER:g}")
        return factor * value + offset


def limits_in(text: str, names: Sequence[str]) -> JointLimits:
    """Return the limits of the joints `names` in a robot's complete URDF as published, which may
    branch and have meshes.

    Raises ConfigurationError for text that is not URDF, and for missing, duplicate or unlimited
    joints.
    """
    there = list(_parsed(text).iterfind("joint"))
    limits, lacking = [], []
    for name in names:
        found = [each for each in there if each.get("name", "") == name]
        if not found:
            its = [each.get("name", "") for each in there]
            raise _wrong(
                f"the URDF has no joint {name!r}; it has {', '.join(its)}{suggestion(name, its)}"
            )
        if len(found) > 1:
            raise _wrong(f"the URDF has {len(found)} joints {name!r}")
        kind = found[0].get("type", "")
        if kind not in MOVING:
            raise _wrong(f"joint {name!r} of the URDF is {kind!r}, which does not move")
        its_limits, missing = _limits(found[0])
        limits.append(its_limits.accelerated)
        if missing:
            lacking.append(f"limits of joint {name!r}: {', '.join(missing.values())}")
    if lacking:
        raise _wrong("; ".join(lacking))
    return JointLimits(
        tuple(each.lower for each in limits),
        tuple(each.upper for each in limits),
        tuple(each.velocity for each in limits),
        tuple(each.acceleration for each in limits),
    )


def disabled_pairs(text: str) -> frozenset[tuple[str, str]]:
    """Return the pairs of links that an SRDF excludes from collision checks, each in alphabetical
    order; unknown names are ignored. Raises ConfigurationError."""
    pairs = set()
    for element in _parsed(text, "SRDF").iterfind("disable_collisions"):
        names = [element.get(name, "") for name in ("link1", "link2")]
        if not all(names):
            raise _wrong("<disable_collisions> of the arm's SRDF lacks its link1 or link2")
        low, high = sorted(names)
        pairs.add((low, high))
    return frozenset(pairs)


def _wrong(message: str) -> ConfigurationError:
    return ConfigurationError("", message)


def parse_xml(text: str, kind: str, root: str) -> ET.Element:
    """Return the element `root` of a description of this kind. Prefixes need no declaration, as in
    urdfdom, and stay part of the names. Raises ConfigurationError."""
    of = f"the arm's {kind}"
    builder, parser = ET.TreeBuilder(), expat.ParserCreate()
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MOST_NESTED:
            raise _wrong(f"{of} has elements in more than {MOST_NESTED} others")
        if tag.startswith("xacro:"):
            raise _wrong(f"{of} has <{tag}>: expand it first, by `xacro FILE > arm.{kind.lower()}`")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def entity(name: str, *_: object) -> None:
        raise _wrong(f"{of} declares the entity {name!r}: write what it stands for")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, UnicodeError) as error:
        raise _wrong(f"{of} is not XML: {error}") from None
    element = builder.close()
    if element.tag != root:
        raise _wrong(f"{of} is a <{element.tag}>, not a <{root}>")
    return element


def _parsed(text: str, kind: str = "URDF") -> ET.Element:
    robot, of = parse_xml(text, kind, "robot"), f"the arm's {kind}"
    if (version := _version(robot)) not in _VERSIONS:
        raise _wrong(f"{of} is of version {version!r}; allowed: {', '.join(_VERSIONS)}")
    return robot


def _version(robot: ET.Element) -> str:
    return robot.get("version", _VERSIONS[0])


def _cycle(joints: list[TreeJoint]) -> str:
    """Return why `joints` have no base link, in words."""
    if not joints:
        return "it has no joint"
    parents = {joint.child: joint.parent for joint in joints}
    link, path = joints[0].parent, dict[str, None]()
    while link not in path:
        path[link] = None
        link = parents[link]
    links = [*path]
    cycle = [*links[links.index(link) :], link]
    return f"its links form a cycle: {' -> '.join(reversed(cycle))}"


def read_tree(text: str) -> Tree:
    """Parse a URDF. Raises ConfigurationError for text that is not URDF, and if its links and
    joints are no tree."""
    robot = _parsed(text)
    joints = [_tree_joint(element) for element in robot.iterfind("joint")]
    declared = _declared_links(robot, joints)
    names = [joint.name for joint in joints]
    if len(set(names)) < len(names) or "" in names:
        raise _wrong(f"every joint has a name of its own, not {names}")
    for joint in joints:
        if joint.kind not in ("fixed", *MOVING, *LOOSE):
            raise joint.refused()
    roots = {joint.parent for joint in joints} - {joint.child for joint in joints}
    if len(roots) != 1:
        why = "" if roots else f": {_cycle(joints)}"
        raise _wrong(f"an arm has one base link, not {sorted(roots)}{why}")
    (root,) = roots
    below: dict[str, list[TreeJoint]] = {}
    above: dict[str, TreeJoint] = {}
    for joint in joints:
        if joint.child in above:
            raise _wrong(f"link {joint.child!r} is reached twice: not one arm")
        below.setdefault(joint.parent, []).append(joint)
        above[joint.child] = joint
    links, left = {}, [root]
    while left:
        link = left.pop()
        links[link] = declared[link]
        left += [joint.child for joint in reversed(below.get(link, []))]
    if loose := declared.keys() - links.keys():
        raise _wrong(f"links {sorted(loose)} are not joined to the base")
    return Tree(
        robot,
        text,
        root,
        links,
        {joint.name: joint for joint in joints},
        above,
    )


def _tree_joint(element: ET.Element) -> TreeJoint:
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        ends.append("" if end is None else end.get("link", ""))
    name = element.get("name", "")
    if not all(ends):
        raise _wrong(f"joint {name!r} lacks its parent or child")
    return TreeJoint(name, element.get("type", ""), ends[0], ends[1], element)


def _declared_links(robot: ET.Element, joints: Collection[TreeJoint]) -> dict[str, ET.Element]:
    """Return all <link> elements. Raises ConfigurationError for duplicate names, and for a joint
    between undeclared links: their mass and body would be lost."""
    elements = list(robot.iterfind("link"))
    names = [element.get("name", "") for element in elements]
    if len(names) > MOST_LINKS:
        raise _wrong(f"{len(names)} links are more than {MOST_LINKS}")
    declared = dict(zip(names, elements, strict=True))
    if len(declared) < len(names) or "" in declared:
        raise _wrong(f"every link has a name of its own, not {names}")
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in declared:
                raise _wrong(
                    f"joint {joint.name!r} names link {link!r}, there are {names}; capitals "
                    "and spaces count"
                )
    return declared


# ---------------------------------------------------------------------------------------------
# Numbers


def _child(element: ET.Element, tag: str) -> ET.Element:
    """Return the child; raises ValueError that names a missing one."""
    child = element.find(tag)
    if child is None:
        raise ValueError(f"no <{tag}>")
    return child


def _attribute(element: ET.Element | None, name: str, default: str | None = None) -> float:
    """Return an attribute's number. Raises ValueError that names the attribute and its value."""
    text = default if element is None else element.get(name, default)
    if text is None:
        raise ValueError(f"no {name}")
    try:
        return to_number(text)
    except ValueError:
        raise ValueError(f"{name} {text!r} is not a number") from None


def to_number(text: str) -> float:
    """Convert a text. Raises ValueError, also for digits grouped by "_", which only Python
    allows."""
    return float(text if "_" not in text else "")


def _bounded(element: ET.Element, name: str, default: str) -> float:
    value = _attribute(element, name, default)
    if not abs(value) <= LARGEST_NUMBER:
        raise ValueError(f"{name} {value:g} is not a number of at most {LARGEST_NUMBER:g}")
    return value


def _numbers(element: ET.Element, attribute: str, of: str, count: int = 3) -> list[float]:
    text = element.get(attribute, "")
    try:
        numbers = [to_number(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(each) <= LARGEST_NUMBER for each in numbers):
        words = {3: "three", 4: "four"}[count]
        raise _wrong(
            f"{attribute} of {of}: {text!r} is not {words} numbers of at most {LARGEST_NUMBER:g}"
        )
    return numbers


def _range(element: ET.Element) -> tuple[float, float]:
    """Return the ends of the range; infinite if the file has none."""
    if element.get("type") == JointKind.CONTINUOUS.value:
        return -math.inf, math.inf
    limit, soft = element.find("limit"), element.find("safety_controller")
    lower = _attribute(limit, "lower", "-inf")
    upper = _attribute(limit, "upper", "inf")
    lower = max(lower, _attribute(soft, "soft_lower_limit", "-inf"))
    upper = min(upper, _attribute(soft, "soft_upper_limit", "inf"))
    if not lower <= upper:
        raise ValueError(f"lower {lower:g} and upper {upper:g} are not a range")
    return lower, upper


def fastest(kind: str) -> float:
    """Return the largest plausible speed of a joint, rad/s or m/s."""
    return 10.0 if kind == JointKind.PRISMATIC.value else 30.0


def _limits(element: ET.Element) -> tuple[Limits, dict[str, str]]:
    kind, limit = element.get("type", ""), element.find("limit")
    missing: dict[str, str] = {}

    def miss(name: str, value: float) -> float:
        there = limit is not None and limit.get(name) is not None
        missing[name] = f"{name} {value:g}" if there else f"no {name}"
        return math.nan

    with about(f"limits of joint {element.get('name', '')!r}"):
        velocity = _attribute(limit, "velocity", "0")
        effort = _attribute(limit, "effort", "0")
        if not effort >= 0.0:
            raise ValueError(f"effort {effort:g} is not a torque or force")
        if not velocity >= 0.0:
            raise ValueError(f"velocity {velocity:g} is not a speed")
        if not 0.0 < velocity <= fastest(kind):
            velocity = miss("velocity", velocity)
        lower, upper = _range(element)
        if kind != JointKind.CONTINUOUS.value:
            none = lower == upper
            if none or abs(lower) > WIDEST:
                lower = miss("lower", lower)
            if none or abs(upper) > WIDEST:
                upper = miss("upper", upper)
        acceleration = math.nan if limit is None else _acceleration(limit)
    return Limits(lower, upper, velocity, acceleration, effort or math.inf), missing


def _acceleration(limit: ET.Element) -> float:
    """Return the acceleration: the lower of URDF 1.2's two; 0 counts as not published."""
    published = []
    for name in ("acceleration", "deceleration"):
        value = _bounded(limit, name, "0")
        if value < 0.0:
            raise ValueError(f"{name} {value:g} is below 0")
        published += [value] if value else []
    return min(published, default=math.nan)


# ---------------------------------------------------------------------------------------------
# Pinocchio's input


class Mesh(NamedTuple):
    """Shape from a mesh file."""

    uri: str
    scale: Vector3


def mesh_in(collision: ET.Element, link: str) -> Mesh | None:
    """Return the mesh of a collision element of `link`; None if that is something else. Raises
    ConfigurationError."""
    primitive = _primitive(collision, link)
    if primitive.tag != "mesh":
        return None
    uri = primitive.get("filename", "")
    if not uri:
        raise _wrong(f"the mesh of link {link!r} has no filename")
    if primitive.get("scale") is None:
        return Mesh(uri, Vector3(1.0, 1.0, 1.0))
    return Mesh(uri, Vector3(*_numbers(primitive, "scale", f"the mesh of link {link!r}")))


def normal_form(
    tree: Tree, bodiless: Collection[str], left_out: Collection[ET.Element] = ()
) -> str:
    """Return a URDF of the same tree with links and joints numbered in the order of `tree`
    ("link_0", "joint_0"), valid numbers, and nothing that Pinocchio reads differently from this
    package: no mimic, limits or missing moments. Joints with several directions are fixed. Links in
    `bodiless` have no shapes, collision elements in `left_out` are removed, and a box of 1 m
    replaces a mesh.

    Raises ConfigurationError for invalid numbers or shapes.
    """
    robot = ET.Element("robot", name="arm", version="1.1")
    numbers = {link: f"link_{number}" for number, link in enumerate(tree.links)}
    old = _version(tree.robot) == _VERSIONS[0]
    for link, element in tree.links.items():
        made = ET.SubElement(robot, "link", name=numbers[link])
        if (inertial := element.find("inertial")) is not None:
            _put_inertial(made, inertial, f"the inertial of link {link!r}", old)
        for collision in element.iterfind("collision") if link not in bodiless else ():
            if collision not in left_out:
                put = ET.SubElement(made, "collision")
                _put_origin(put, collision, f"a collision element of link {link!r}", old)
                ET.SubElement(put, "geometry").append(_shape(collision, link))
    for number, joint in enumerate(tree.joints.values()):
        one_direction = joint.kind in MOVING
        kind = "prismatic" if joint.kind == "prismatic" else "revolute"
        made = ET.SubElement(
            robot, "joint", name=f"joint_{number}", type=kind if one_direction else "fixed"
        )
        ET.SubElement(made, "parent", link=numbers[joint.parent])
        ET.SubElement(made, "child", link=numbers[joint.child])
        _put_origin(made, joint.element, f"joint {joint.name!r}", old)
        if one_direction:
            ET.SubElement(made, "axis", xyz=_text(*joint.axis()))
            ET.SubElement(made, "limit", lower="-1", upper="1", velocity="1", effort="1")
    return ET.tostring(robot, encoding="unicode")


class Origin(NamedTuple):
    """An <origin>: a pose, m and rad."""

    xyz: tuple[float, ...]
    rpy: tuple[float, ...]


def arm_form(
    tree: Tree, held: Mapping[str, Origin], root: Origin | None, limits: Mapping[str, Limits]
) -> str:
    """Return the file with the joints in `held` fixed, each at its place, and with the given
    `limits`. A `root` pose places the root in an added parent link."""
    robot = copy.deepcopy(tree.robot)
    for joint in robot.iterfind("joint"):
        if (place := held.get(joint.get("name", ""))) is not None:
            for element in [each for each in joint if each.tag not in ("parent", "child")]:
                joint.remove(element)
            joint.set("type", "fixed")
            _put_place(joint, place)
        elif (of_joint := limits.get(joint.get("name", ""))) is not None:
            _put_limits(joint, of_joint)
    if root is not None:
        name = ARM_BASE
        while name in tree.links or name in tree.joints:
            name += "_"
        ET.SubElement(robot, "link", name=name)
        joint = ET.SubElement(robot, "joint", name=name, type="fixed")
        ET.SubElement(joint, "parent", link=name)
        ET.SubElement(joint, "child", link=tree.root)
        _put_place(joint, root)
    return ET.tostring(robot, encoding="unicode")


def _text(*values: float) -> str:
    """Write numbers as urdfdom reads them: it accepts no denormal ones."""
    return " ".join(repr(value if abs(value) > 1e-100 else 0.0) for value in values)


def _put_place(joint: ET.Element, place: Origin) -> None:
    ET.SubElement(joint, "origin", xyz=_text(*place.xyz), rpy=_text(*place.rpy))


def _put_limits(joint: ET.Element, limits: Limits) -> None:
    if (soft := joint.find("safety_controller")) is not None:
        joint.remove(soft)
    limit = joint.find("limit")
    if limit is None:
        limit = ET.SubElement(joint, "limit")
    limit.set("velocity", _text(limits.velocity))
    limit.set("effort", _text(limits.effort if math.isfinite(limits.effort) else 0.0))
    if math.isfinite(limits.lower):
        limit.set("lower", _text(limits.lower))
        limit.set("upper", _text(limits.upper))


def _put_origin(made: ET.Element, element: ET.Element, of: str, old: bool) -> None:
    origin, of = element.find("origin"), f"the origin of {of}"
    if origin is None:
        return
    put = ET.SubElement(made, "origin")
    for name, count in (("xyz", 3), ("rpy", 3), ("quat_xyzw", 4)):
        if origin.get(name) is not None:
            numbers = _numbers(origin, name, of, count)
            if count == 4:
                if old or origin.get("rpy") is not None:
                    raise _wrong(f'{of}: quat_xyzw is for version="1.1", without an rpy')
                if abs(math.hypot(*numbers) - 1.0) > 1e-3:
                    raise _wrong(f"quat_xyzw of {of}: {origin.get(name)!r} has not the length 1")
            put.set(name, _text(*numbers))


def _put_inertial(made: ET.Element, element: ET.Element, of: str, old: bool) -> None:
    with about(of):
        mass_kg, tensor = _attribute(_child(element, "mass"), "value"), element.find("inertia")
        moments = [_attribute(tensor, name, "0") for name in _MOMENTS]
        if not 0.0 <= mass_kg <= LARGEST_NUMBER:
            raise ValueError(f"mass {mass_kg:g} kg is not 0 to {LARGEST_NUMBER:g}")
        if not all(abs(entry) <= LARGEST_NUMBER for entry in moments):
            raise ValueError(f"moments {moments} are not numbers of at most {LARGEST_NUMBER:g}")
        if min(moments[0], moments[3], moments[5]) < -_ROUNDING_KG_M2:
            raise ValueError(f"moments {moments} have a negative ixx, iyy or izz")
    put = ET.SubElement(made, "inertial")
    _put_origin(put, element, of, old)
    ET.SubElement(put, "mass", value=_text(mass_kg))
    entries = {name: _text(value) for name, value in zip(_MOMENTS, moments, strict=True)}
    ET.SubElement(put, "inertia", entries)


def _primitive(element: ET.Element, link: str) -> ET.Element:
    geometry = element.find("geometry")
    primitive = None if geometry is None else next(iter(geometry), None)
    if primitive is None:
        raise _wrong(f"a collision element of link {link!r} has no geometry")
    return primitive


def _shape(element: ET.Element, link: str) -> ET.Element:
    primitive = _primitive(element, link)
    tag = primitive.tag
    if lengths := _LENGTHS.get(tag):
        with about(f"{tag} of link {link!r}"):
            return ET.Element(tag, {name: _text(_positive(primitive, name)) for name in lengths})
    if tag == "box":
        size = _numbers(primitive, "size", f"the box of link {link!r}")
        if min(size) <= 0.0:
            raise _wrong(f"the box of link {link!r} has no size")
        return ET.Element("box", size=_text(*size))
    if tag == "mesh":
        return ET.Element("box", size="1 1 1")
    raise _wrong(
        f"the collision geometry of link {link!r} is a {tag}; allowed: sphere, cylinder, capsule, "
        "box, mesh"
    )


def _positive(element: ET.Element, attribute: str) -> float:
    value = _attribute(element, attribute)
    if not _SHORTEST_M <= value <= LARGEST_NUMBER:
        raise ValueError(f"{attribute} {element.get(attribute)!r} is not a length")
    return value
