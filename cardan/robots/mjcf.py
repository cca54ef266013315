"""Conversion of MJCF, MuJoCo's XML, to a URDF of the same robot.

Pinocchio's parser is not used: it takes meters of slide joints for degrees, shifts ranges by `ref`,
keeps those that ``limited="false"`` switches off, and does not report bodies with several joints.
Joint positions are those of MuJoCo's qpos: a joint's `ref` is part of its position. Sites with a
name are links. A joint coupled by an equality or a tendon becomes a mimic joint; a free or ball
joint a floating one.
"""

from __future__ import annotations

import math
import posixpath
import xml.etree.ElementTree as ET
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

from cardan.errors import ConfigurationError
from cardan.robots.urdf import LARGEST_NUMBER, MOST_LINKS, parse_xml, to_number
from cardan.spatial import (
    add,
    compose,
    cross,
    dot,
    from_axes,
    from_rotation_vector,
    multiply,
    norm,
    normalized,
    rotate,
    scale,
    subtract,
)
from cardan.types import IDENTITY_POSE, ZERO3, Pose, Quaternion, Vector3

_ACTUATORS = (
    "general",
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
    "dcmotor",
    "plugin",
)
"""Elements that share one default in each class."""
_REFUSED = ("include", "attach", "replicate", "composite", "flexcomp")
_WORLD = "world"
_X, _Y, _Z = Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0)
_ORIENTATIONS = ("euler", "axisangle", "xyaxes", "zaxis", "quat")
_FLOOR_M = (20.0, 20.0, 1.0)
"""Size of the box that replaces a plane, which is infinite in MuJoCo, m."""
_WATER_KG_M3 = 1000.0
_ALIKE = "0 1 0 0 0"
"""Coefficients of an equality between joints that follow each other one to one."""

_Attributes: TypeAlias = ChainMap[str, str]


class _Item(NamedTuple):
    """An element of a body, with the defaults of its class."""

    tag: str
    name: str
    attributes: _Attributes
    element: ET.Element
    frame: Pose
    """Pose of the surrounding frames in the body."""
    childclass: str

    def words(self) -> str:
        return f"{self.tag} {self.name!r}" if self.name else f"a {self.tag} without a name"


class _Solid(NamedTuple):
    """Mass properties of a geom."""

    mass: float
    pose: Pose
    moments: Vector3
    """Inertia about its own axes."""


def urdf_of(text: str) -> str:
    """Return the URDF of an MJCF's robot, with the root link "world".

    The keyframe "home" becomes a <group_state>, an element of SRDF. Raises ConfigurationError for
    text that is not MJCF, and for content that URDF cannot express.
    """
    return ET.tostring(_Translation(parse_xml(text, "MJCF", "mujoco")).robot, encoding="unicode")


def _wrong(message: str) -> ConfigurationError:
    return ConfigurationError("", message)


def _numbers(words: str, attributes: Mapping[str, str], name: str, default: str) -> list[float]:
    """Return the numbers of an attribute, as many as `default` has."""
    text = attributes.get(name, default)
    count = len(default.split())
    try:
        found = [to_number(word) for word in text.split()]
    except ValueError:
        found = []
    if len(found) != count or not all(abs(each) <= LARGEST_NUMBER for each in found):
        raise _wrong(
            f"{name} of {words}: {text!r} is not {count} numbers of at most {LARGEST_NUMBER:g}"
        )
    return found


def _overlaid(texts: Iterable[str]) -> str:
    """Complete a short list of numbers by the defaults: the first text, then the rest of the
    next."""
    found: list[str] = []
    for text in texts:
        found += text.split()[len(found) :]
    return " ".join(found)


def _sizes(words: str, attributes: _Attributes, count: int) -> list[float]:
    """Return the first `count` sizes of a geom, which may have more."""
    text = _overlaid(each.get("size", "") for each in attributes.maps)
    text = " ".join(text.split()[:count])
    found = _numbers(words, {"size": text}, "size", "0 " * count)
    if not all(each > 0.0 for each in found):
        raise _wrong(f"size of {words}: {text!r} is not a length")
    return found


def _direction(words: str, vector: Vector3) -> Vector3:
    length = norm(vector)
    if length < 1e-9:
        raise _wrong(f"{words} has a vector without a direction")
    return scale(vector, 1.0 / length)


def _turned_z(direction: Vector3) -> Quaternion:
    """Return the least rotation that turns z into a direction."""
    axis = cross(_Z, direction)
    sine = norm(axis)
    if sine < 1e-10:
        return IDENTITY_POSE.orientation if direction.z > 0.0 else Quaternion(0.0, 1.0, 0.0, 0.0)
    return from_rotation_vector(scale(axis, math.atan2(sine, direction.z) / sine))


def _rpy(q: Quaternion) -> tuple[float, float, float]:
    """Return the angles of R = Rz·Ry·Rx; exact also if y is ±90° and x and z turn about the same
    axis."""
    x, y, z = (rotate(q, axis) for axis in (_X, _Y, _Z))
    yaw = math.atan2(x.y, x.x)
    sine, cosine = math.sin(yaw), math.cos(yaw)
    pitch = math.atan2(-x.z, math.hypot(x.x, x.y))
    return math.atan2(sine * z.x - cosine * z.y, cosine * y.y - sine * y.x), pitch, yaw


def _text(*values: float) -> str:
    return " ".join(repr(value + 0.0) for value in values)


def _is_true(words: str, attributes: Mapping[str, str], name: str, auto: bool) -> bool:
    text = attributes.get(name, "auto")
    if text not in ("true", "false", "auto"):
        raise _wrong(f"{name} of {words}: {text!r} must be true, false or auto")
    return auto if text == "auto" else text == "true"


def _put_origin(element: ET.Element, pose: Pose) -> None:
    ET.SubElement(element, "origin", xyz=_text(*pose.position), rpy=_text(*_rpy(pose.orientation)))


class _Translation:
    """Translation of the elements of an MJCF into `robot`."""

    def __init__(self, model: ET.Element) -> None:
        for element in model.iter():
            if element.tag in _REFUSED:
                raise _wrong(
                    f"the arm's MJCF has <{element.tag}>, which is not expanded here: let MuJoCo "
                    "do it, by mj_saveLastXML"
                )
        for tag in ("body", "joint", "site"):
            if (count := sum(1 for _ in model.iter(tag))) > MOST_LINKS:
                raise _wrong(f"{count} {tag} elements are more than {MOST_LINKS}")
        self._model = model
        self.robot = ET.Element("robot", name=model.get("model", ""), version="1.1")
        self._compiler: _Attributes = ChainMap(
            *(each.attrib for each in reversed(model.findall("compiler")))
        )
        self._read_compiler()
        self._classes: dict[str, dict[str, list[dict[str, str]]]] = {"main": {}}
        for element in model.iterfind("default"):
            self._read_class(element, "main", self._classes["main"])
            self._classes[element.get("class", "main")] = self._classes["main"]
        self._meshes = dict(self._read_meshes())
        bodies = {each.get("name", "") for each in model.iter("body")}
        self._links, self._joint_names = bodies | {_WORLD}, {_WORLD}
        self._joint_names |= {each.get("name", "") for each in model.iter("joint")}
        self._joints: dict[str, ET.Element] = {}
        self._refs: dict[str, float] = {}
        self._above: dict[str, tuple[str, list[str]]] = {}
        """Parent of each body, and the joints between."""
        self._body_of_site: dict[str, str] = {}
        self._qpos: list[tuple[str, int]] = []
        ET.SubElement(self.robot, "link", name=_WORLD)
        for world in model.iterfind("worldbody"):
            items = list(self._items(world, IDENTITY_POSE, "main"))
            self._fill(self.robot[0], _WORLD, items)
        self._read_efforts()
        self._read_couplings()
        self._read_home()

    def _read_compiler(self) -> None:
        compiler = self._compiler
        angle = compiler.get("angle", "degree")
        if angle not in ("degree", "radian"):
            raise _wrong(f"angle of compiler: {angle!r} must be degree or radian")
        self._rad = 1.0 if angle == "radian" else math.pi / 180.0
        self._sequence = compiler.get("eulerseq", "xyz")
        if len(self._sequence) != 3 or not set(self._sequence.lower()) <= set("xyz"):
            raise _wrong(f"eulerseq of compiler: {self._sequence!r} must be three of x, y, z")
        if compiler.get("coordinate", "local") != "local":
            raise _wrong(
                'compiler has coordinate="global", which MuJoCo no longer reads: save it '
                "again by mj_saveLastXML of MuJoCo 2.3.3 or before"
            )
        if _numbers("compiler", compiler, "settotalmass", "-1")[0] > 0.0:
            raise _wrong(
                "compiler has settotalmass, which is not done here: let MuJoCo do it, by "
                "mj_saveLastXML"
            )

    # -----------------------------------------------------------------------------------------
    # Elements

    def _read_class(
        self, element: ET.Element, name: str, inherited: Mapping[str, list[dict[str, str]]]
    ) -> None:
        mine = dict(inherited)
        for child in element:
            if child.tag != "default":
                tag = "actuator" if child.tag in _ACTUATORS else child.tag
                mine[tag] = [child.attrib, *mine.get(tag, [])]
        self._classes[name] = mine
        for child in element.iterfind("default"):
            self._read_class(child, child.get("class", ""), mine)

    def _attributes(self, element: ET.Element, childclass: str) -> _Attributes:
        name = element.get("class", childclass)
        if name not in self._classes:
            raise _wrong(f"there is no default class {name!r}")
        tag = "actuator" if element.tag in _ACTUATORS else element.tag
        return ChainMap(element.attrib, *self._classes[name].get(tag, []))

    def _items(self, element: ET.Element, frame: Pose, childclass: str) -> Iterator[_Item]:
        """Yield the items of a body, with its own frames resolved."""
        for child in element:
            if child.tag in ("frame", "body"):
                name = child.get("name", "")
                inner = child.get("childclass", childclass)
                item = _Item(child.tag, name, ChainMap(child.attrib), child, frame, inner)
                if child.tag == "frame":
                    yield from self._items(child, self._pose(item), inner)
                else:
                    yield item
            elif child.tag in ("joint", "freejoint", "geom", "site", "inertial"):
                attributes = self._attributes(child, childclass)
                yield _Item(child.tag, child.get("name", ""), attributes, child, frame, childclass)

    def _pose(self, item: _Item) -> Pose:
        if item.tag == "site" and "fromto" in item.attributes:
            return self._between_ends(item)[0]
        position = Vector3(*_numbers(item.words(), item.attributes, "pos", "0 0 0"))
        return compose(item.frame, Pose(position, self._orientation(item)))

    def _orientation(self, item: _Item) -> Quaternion:
        """Return an orientation: the element's own, in any form, precedes its class's."""
        words, maps = item.words(), item.attributes.maps
        given = next((each for each in maps if any(key in each for key in _ORIENTATIONS)), {})
        keys = [key for key in _ORIENTATIONS if key in given]
        if len(keys) > 1:
            raise _wrong(f"{words} has {' and '.join(keys)}: one orientation is enough")
        if "euler" in given:
            found = IDENTITY_POSE.orientation
            angles = _numbers(words, given, "euler", "0 0 0")
            for letter, angle in zip(self._sequence, angles, strict=True):
                axis = {"x": _X, "y": _Y, "z": _Z}[letter.lower()]
                turn = from_rotation_vector(scale(axis, angle * self._rad))
                pair = (found, turn) if letter.islower() else (turn, found)
                found = multiply(*pair)
            return found
        if "axisangle" in given:
            x, y, z, angle = _numbers(words, given, "axisangle", "0 0 0 0")
            axis = _direction(words, Vector3(x, y, z))
            return from_rotation_vector(scale(axis, angle * self._rad))
        if "xyaxes" in given:
            values = _numbers(words, given, "xyaxes", "0 0 0 0 0 0")
            x_axis = _direction(words, Vector3(*values[:3]))
            second = Vector3(*values[3:])
            y_axis = _direction(words, subtract(second, scale(x_axis, dot(x_axis, second))))
            return from_axes(x_axis, y_axis)
        if "zaxis" in given:
            return _turned_z(_direction(words, Vector3(*_numbers(words, given, "zaxis", "0 0 0"))))
        try:
            return normalized(Quaternion(*_numbers(words, given, "quat", "1 0 0 0")))
        except ValueError:
            raise _wrong(f"quat of {words} has no direction") from None

    def _free_name(self, wanted: str, taken: set[str]) -> str:
        name, number = wanted, 1
        while name in taken:
            number += 1
            name = f"{wanted}_{number}"
        taken.add(name)
        return name

    # -----------------------------------------------------------------------------------------
    # Links and joints

    def _fill(self, link: ET.Element, name: str, items: Sequence[_Item]) -> None:
        """Add a link with the content of its body, and its children."""
        geoms = [item for item in items if item.tag == "geom"]
        if name != _WORLD:
            self._put_inertial(link, [each for each in items if each.tag == "inertial"], geoms)
        for geom in geoms:
            self._put_geom(link, geom)
        for site in items:
            if site.tag == "site" and site.name:
                self._body_of_site[site.name] = name
                taken = site.name in self._links
                frame = self._free_name(site.name + "_site" * taken, self._links)
                self._put_fixed(name, frame, self._pose(site))
                ET.SubElement(self.robot, "link", name=frame)
        for body in items:
            if body.tag == "body":
                self._put_body(body, name)

    def _put_body(self, body: _Item, parent: str) -> None:
        name = body.name or self._free_name("body", self._links)
        items = list(self._items(body.element, IDENTITY_POSE, body.childclass))
        joints = [item for item in items if item.tag in ("joint", "freejoint")]
        outer, here = parent, self._pose(body)
        passed = []
        for number, joint in enumerate(joints, start=1):
            words = joint.words()
            anchor = Pose(
                Vector3(*_numbers(words, joint.attributes, "pos", "0 0 0")),
                IDENTITY_POSE.orientation,
            )
            anchor = Pose(compose(joint.frame, anchor).position, IDENTITY_POSE.orientation)
            inner = name
            if number < len(joints) or anchor != IDENTITY_POSE:
                inner = self._free_name(f"{name}_{number}", self._links)
                ET.SubElement(self.robot, "link", name=inner)
            passed.append(self._put_moving(joint, outer, inner, compose(here, anchor)))
            outer, here = inner, Pose(scale(anchor.position, -1.0), anchor.orientation)
        if outer != name:
            self._put_fixed(outer, name, here)
        self._above[name] = (parent, passed)
        self._fill(ET.SubElement(self.robot, "link", name=name), name, items)

    def _put_fixed(self, outer: str, inner: str, at: Pose) -> None:
        name = self._free_name(f"{inner}_fixed", self._joint_names)
        self._put_joint(name, "fixed", outer, inner, at)

    def _put_joint(self, name: str, kind: str, outer: str, inner: str, at: Pose) -> ET.Element:
        joint = ET.SubElement(self.robot, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=outer)
        ET.SubElement(joint, "child", link=inner)
        _put_origin(joint, at)
        return joint

    def _put_moving(self, item: _Item, outer: str, inner: str, at: Pose) -> str:
        """Add a moving joint; return its name."""
        words, attributes = item.words(), item.attributes
        name = item.name or self._free_name(f"{inner}_joint", self._joint_names)
        kind = "free" if item.tag == "freejoint" else attributes.get("type", "hinge")
        if kind in ("free", "ball"):
            self._joints[name] = self._put_joint(name, "floating", outer, inner, at)
            self._qpos.append((name, 7 if kind == "free" else 4))
            return name
        if kind not in ("hinge", "slide"):
            raise _wrong(f"{words} is {kind!r}; allowed: hinge, slide, ball, free")
        self._qpos.append((name, 1))
        unit = self._rad if kind == "hinge" else 1.0
        axis = _direction(words, Vector3(*_numbers(words, attributes, "axis", "0 0 1")))
        axis = rotate(item.frame.orientation, axis)
        ref = self._refs[name] = _numbers(words, attributes, "ref", "0")[0] * unit
        back = scale(axis, -ref)
        moved = (
            Pose(ZERO3, from_rotation_vector(back))
            if kind == "hinge"
            else Pose(back, IDENTITY_POSE.orientation)
        )
        lower, upper = _numbers(words, attributes, "range", "0 0")
        has_range = "range" in attributes and (lower, upper) != (0.0, 0.0)
        automatic = self._compiler.get("autolimits", "true") == "true"
        if has_range and not automatic and attributes.get("limited", "auto") == "auto":
            raise _wrong(f'{words} has a range: with autolimits="false" say whether it is limited')
        limited = _is_true(words, attributes, "limited", has_range)
        urdf_kind = "prismatic" if kind == "slide" else "revolute" if limited else "continuous"
        joint = self._put_joint(name, urdf_kind, outer, inner, compose(at, moved))
        ET.SubElement(joint, "axis", xyz=_text(*axis))
        limit = ET.SubElement(joint, "limit")
        if limited:
            limit.set("lower", _text(lower * unit))
            limit.set("upper", _text(upper * unit))
        force = _numbers(words, attributes, "actuatorfrcrange", "0 0")
        if _is_true(words, attributes, "actuatorfrclimited", force != [0.0, 0.0]):
            _lower_effort(limit, min(-force[0], force[1]))
        self._joints[name] = joint
        return name

    # -----------------------------------------------------------------------------------------
    # Bodies

    def _read_meshes(self) -> Iterator[tuple[str, ET.Element]]:
        """Read the meshes as URDF elements, by name; those without a file are empty."""
        compiler = self._compiler
        folder = compiler.get("meshdir", compiler.get("assetdir", ""))
        for asset in self._model.iterfind("asset"):
            for element in asset.iterfind("mesh"):
                attributes = self._attributes(element, "main")
                file = attributes.get("file", "")
                name = element.get("name") or posixpath.splitext(posixpath.basename(file))[0]
                words = f"mesh {name!r}"
                for key, none in (("refpos", [0.0] * 3), ("refquat", [1.0, 0.0, 0.0, 0.0])):
                    if _numbers(words, attributes, key, _text(*none)) != none:
                        raise _wrong(f"{words} has {key}, which is not applied here")
                made = ET.Element("mesh")
                if file:
                    if compiler.get("strippath") == "true":
                        file = posixpath.basename(file)
                    made.set("filename", posixpath.join(folder, file))
                factors = _numbers(words, attributes, "scale", "1 1 1")
                if factors != [1.0] * 3:
                    made.set("scale", _text(*factors))
                yield name, made

    def _put_geom(self, link: ET.Element, geom: _Item) -> None:
        """Add a geom to a link; without contacts it is only a visual."""
        attributes = geom.attributes
        seen = attributes.get("contype") == "0" and attributes.get("conaffinity") == "0"
        kind = self._geom_kind(geom)
        if seen and kind in ("plane", "hfield", "sdf"):
            return
        shape, at = self._shape(geom, kind)
        put = ET.SubElement(link, "visual" if seen else "collision")
        _put_origin(put, at)
        ET.SubElement(put, "geometry").append(shape)

    def _geom_kind(self, geom: _Item) -> str:
        return "mesh" if "mesh" in geom.attributes else geom.attributes.get("type", "sphere")

    def _shape(self, geom: _Item, kind: str) -> tuple[ET.Element, Pose]:
        words = geom.words()
        if kind == "mesh":
            name = geom.attributes.get("mesh", "")
            mesh = self._meshes.get(name)
            if mesh is None:
                raise _wrong(f"{words}: there is no mesh {name!r}")
            if mesh.get("filename") is None:
                raise _wrong(f"{words}: mesh {name!r} has no file")
            return mesh, self._pose(geom)
        if kind == "plane":
            down = Pose(Vector3(0.0, 0.0, -0.5 * _FLOOR_M[2]), IDENTITY_POSE.orientation)
            return ET.Element("box", size=_text(*_FLOOR_M)), compose(self._pose(geom), down)
        size, at = self._size(geom, kind)
        if kind == "sphere":
            return ET.Element("sphere", radius=_text(size[0])), at
        if kind in ("capsule", "cylinder"):
            radius, half = size
            return ET.Element(kind, radius=_text(radius), length=_text(2.0 * half)), at
        return ET.Element("box", size=_text(*(2.0 * half for half in size))), at

    def _size(self, geom: _Item, kind: str) -> tuple[list[float], Pose]:
        """Return radius and half lengths, and the pose of a primitive. `fromto` gives its long half
        length."""
        words = geom.words()
        counts = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}
        if kind not in counts:
            raise _wrong(f"{words} is a {kind}; allowed: {', '.join(counts)}, plane, mesh")
        if "fromto" not in geom.attributes:
            return _sizes(words, geom.attributes, counts[kind]), self._pose(geom)
        (radius,) = _sizes(words, geom.attributes, 1)
        at, half = self._between_ends(geom)
        return [radius] * (counts[kind] - 1) + [half], at

    def _between_ends(self, item: _Item) -> tuple[Pose, float]:
        """Return its pose by `fromto`, and half its length."""
        words = item.words()
        values = _numbers(words, item.attributes, "fromto", "0 0 0 0 0 0")
        start, end = Vector3(*values[:3]), Vector3(*values[3:])
        along = subtract(start, end)
        turned = _turned_z(_direction(words, along))
        return compose(item.frame, Pose(scale(add(start, end), 0.5), turned)), 0.5 * norm(along)

    def _put_inertial(
        self, link: ET.Element, given: Sequence[_Item], geoms: Sequence[_Item]
    ) -> None:
        """Add an inertial, unless it is a mesh's, which is not computed."""
        source = self._compiler.get("inertiafromgeom", "auto")
        if given and source != "true":
            self._put_given(link, given[0])
            return
        if source == "false":
            return
        solids = [self._solid(geom) for geom in geoms if self._weighs(geom)]
        weighed = [each for each in solids if each is not None]
        mass = sum(each.mass for each in weighed)
        if len(weighed) < len(solids) or not mass > 0.0:
            return
        center = ZERO3
        for each in weighed:
            center = add(center, scale(each.pose.position, each.mass / mass))
        rows = [[0.0] * 3 for _ in range(3)]
        for each in weighed:
            off = subtract(each.pose.position, center)
            axes = [rotate(each.pose.orientation, axis) for axis in (_X, _Y, _Z)]
            for i in range(3):
                for j in range(3):
                    about_own = sum(
                        m * axis[i] * axis[j] for m, axis in zip(each.moments, axes, strict=True)
                    )
                    moved = (dot(off, off) if i == j else 0.0) - off[i] * off[j]
                    rows[i][j] += about_own + each.mass * moved
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = rows
        _put_mass(link, Pose(center, IDENTITY_POSE.orientation), mass, (xx, xy, xz, yy, yz, zz))

    def _put_given(self, link: ET.Element, item: _Item) -> None:
        words, attributes = f"the inertial of {link.get('name')!r}", item.attributes
        (mass,) = _numbers(words, attributes, "mass", "0")
        if "fullinertia" in attributes:
            xx, yy, zz, xy, xz, yz = _numbers(words, attributes, "fullinertia", "0 0 0 0 0 0")
        else:
            xx, yy, zz = _numbers(words, attributes, "diaginertia", "0 0 0")
            xy = xz = yz = 0.0
        _put_mass(link, self._pose(item), mass, (xx, xy, xz, yy, yz, zz))

    def _weighs(self, geom: _Item) -> bool:
        words, attributes = geom.words(), geom.attributes
        first, last = _numbers("compiler", self._compiler, "inertiagrouprange", "0 5")
        (group,) = _numbers(words, attributes, "group", "0")
        key = "mass" if "mass" in attributes else "density"
        (weight,) = _numbers(words, attributes, key, str(_WATER_KG_M3))
        return first <= group <= last and weight > 0.0

    def _solid(self, geom: _Item) -> _Solid | None:
        """Return the mass properties of a geom; None if they are not computed here."""
        kind, words = self._geom_kind(geom), geom.words()
        if kind in ("mesh", "plane", "hfield", "sdf") or "shellinertia" in geom.attributes:
            return None
        size, at = self._size(geom, kind)
        a, b, c = (size[0], size[0], size[-1]) if len(size) < 3 else size
        volume = {
            "sphere": 4.0 / 3.0 * math.pi * a**3,
            "capsule": math.pi * a * a * (2.0 * c + 4.0 / 3.0 * a),
            "cylinder": math.pi * a * a * 2.0 * c,
            "box": 8.0 * a * b * c,
            "ellipsoid": 4.0 / 3.0 * math.pi * a * b * c,
        }[kind]
        if "mass" in geom.attributes:
            (mass,) = _numbers(words, geom.attributes, "mass", "0")
        else:
            (density,) = _numbers(words, geom.attributes, "density", str(_WATER_KG_M3))
            mass = density * volume
        if kind == "capsule":
            ends = mass * 2.0 * a / (2.0 * a + 3.0 * c)
            rod = mass - ends
            across = rod * (a * a / 4.0 + c * c / 3.0)
            across += ends * (0.4 * a * a + c * c + 0.75 * c * a)
            moments = Vector3(across, across, rod * a * a / 2.0 + ends * 0.4 * a * a)
        elif kind == "cylinder":
            across = mass * (a * a / 4.0 + c * c / 3.0)
            moments = Vector3(across, across, mass * a * a / 2.0)
        else:
            share = mass / (3.0 if kind == "box" else 5.0)
            moments = Vector3(
                share * (b * b + c * c), share * (a * a + c * c), share * (a * a + b * b)
            )
        return _Solid(mass, at, moments)

    # -----------------------------------------------------------------------------------------
    # Joint settings in other elements

    def _read_efforts(self) -> None:
        """Read the effort from an actuator's force, or from a motor's control by its gear."""
        for element in self._sections("actuator"):
            attributes = self._attributes(element, "main")
            joint = self._joints.get(attributes.get("joint", attributes.get("jointinparent", "")))
            limit = None if joint is None else joint.find("limit")
            if limit is None:
                continue
            words = f"{element.tag} {element.get('name', '')!r}"
            gear = _overlaid([*(each.get("gear", "") for each in attributes.maps), "1"]).split()[0]
            (factor,) = _numbers(words, {"gear": gear}, "gear", "1")
            for key in ("force", "ctrl") if element.tag == "motor" else ("force",):
                low, high = _numbers(words, attributes, f"{key}range", "0 0")
                if _is_true(words, attributes, f"{key}limited", (low, high) != (0.0, 0.0)):
                    _lower_effort(limit, min(-low, high) * abs(factor))

    def _sections(self, tag: str) -> Iterable[ET.Element]:
        return (element for each in self._model.iterfind(tag) for element in each)

    def _read_couplings(self) -> None:
        bound = set()
        for element in self._sections("equality"):
            if element.get("active", "true") != "true":
                continue
            words = f"the equality {element.get('name') or element.tag!r}"
            if element.tag == "joint":
                self._couple(element, words)
            elif element.tag == "tendon":
                bound |= {element.get("tendon1"), element.get("tendon2")}
            elif element.tag in ("connect", "weld"):
                ends = [
                    self._body_of_site.get(element.get(f"site{n}", ""), "")
                    or element.get(f"body{n}", _WORLD)
                    for n in (1, 2)
                ]
                self._bind(self._between(ends), words)
        for element in self._sections("tendon"):
            attributes = self._attributes(element, "main")
            name = element.get("name", "")
            words = f"the tendon {name!r}"
            held = _numbers(words, attributes, "range", "0 0") != [0.0, 0.0]
            if not (name in bound or _is_true(words, attributes, "limited", held)):
                continue
            if element.tag == "fixed":
                joints = [each.get("joint", "") for each in element]
            else:
                sites = [each.get("site", "") for each in element.iterfind("site")]
                joints = self._between([self._body_of_site.get(each, _WORLD) for each in sites])
            self._bind(joints, words)

    def _couple(self, element: ET.Element, words: str) -> None:
        name, leader = element.get("joint1", ""), element.get("joint2", "")
        coefficients = _overlaid([element.get("polycoef", ""), _ALIKE])
        offset, factor, *rest = _numbers(words, {"polycoef": coefficients}, "polycoef", _ALIKE)
        if leader not in self._refs or name not in self._refs or any(rest):
            self._bind([name], words)
            return
        offset += self._refs[name] - factor * self._refs[leader]
        ET.SubElement(
            self._joints[name],
            "mimic",
            joint=leader,
            multiplier=_text(factor),
            offset=_text(offset),
        )

    def _between(self, bodies: Sequence[str]) -> list[str]:
        """Return the joints that move these against each other."""
        paths = []
        for body in bodies:
            path = []
            while body in self._above:
                body, joints = self._above[body]
                path += joints
            paths.append(dict.fromkeys(path))
        shared = set(paths[0]).intersection(*paths[1:]) if paths else set()
        return [joint for path in paths for joint in path if joint not in shared]

    def _bind(self, joints: Iterable[str], words: str) -> None:
        """Mark the joints as coupled to something that is no joint: none of them can be an
        arm's."""
        for name in joints:
            joint = self._joints.get(name)
            if joint is not None and joint.find("mimic") is None:
                ET.SubElement(joint, "mimic", joint=words)

    def _read_home(self) -> None:
        for key in self._sections("keyframe"):
            if key.get("name") != "home" or key.get("qpos") is None:
                continue
            count = sum(width for _, width in self._qpos)
            values = _numbers("the keyframe 'home'", key.attrib, "qpos", "0 " * count)
            state = ET.SubElement(self.robot, "group_state", name="home", group="")
            at = 0
            for name, width in self._qpos:
                if width == 1:
                    ET.SubElement(state, "joint", name=name, value=_text(values[at]))
                at += width


def _lower_effort(limit: ET.Element, effort: float) -> None:
    """Lower the effort of `limit` to `effort`; values of 0 or less are ignored."""
    known = float(limit.get("effort", "inf"))
    if 0.0 < effort < known:
        limit.set("effort", _text(effort))


def _put_mass(link: ET.Element, at: Pose, mass: float, moments: tuple[float, ...]) -> None:
    inertial = ET.SubElement(link, "inertial")
    _put_origin(inertial, at)
    ET.SubElement(inertial, "mass", value=_text(mass))
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    ET.SubElement(
        inertial,
        "inertia",
        {name: _text(value) for name, value in zip(names, moments, strict=True)},
    )
