"""Reader of meshes: their corners, and the triangles between them.

STL, OBJ and COLLADA (DAE) are not read by Assimp, which Coal includes: a damaged COLLADA file can
crash it, and it does not apply units. Lengths in m.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple, NoReturn, cast

from cardan.common.arm_libraries import np, npt
from cardan.errors import ConfigurationError, shown
from cardan.types import Vector3

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

UNSCALED: Final = Vector3(1.0, 1.0, 1.0)
FORMATS: Final = (".stl", ".obj", ".dae")
LARGEST_SCALE: Final = 1e6
MOST_POINTS: Final = 10_000_000
"""Most points of all copies of all parts of a COLLADA file."""
MOST_NODES: Final = 10_000
MOST_ELEMENTS: Final = 500_000
DEEPEST: Final = 64
"""Most nested nodes of a COLLADA file."""


class Surface(NamedTuple):
    """Surface of a mesh."""

    points: Points
    """Corners of its faces, in rows; some may be repeated."""
    triangles: Indices
    """Triangles, each by the rows of its three corners."""

    @classmethod
    def of(cls, parts: Sequence[Surface]) -> Surface:
        """Join surfaces."""
        firsts = np.cumsum([0, *(len(each.points) for each in parts)])
        shifted = (each.triangles + first for each, first in zip(parts, firsts, strict=False))
        return cls(
            np.concatenate([np.empty((0, 3)), *(each.points for each in parts)]),
            np.concatenate([np.empty((0, 3), dtype=np.int64), *shifted]),
        )

    def packed(self) -> bytes:
        """Encode for a browser: the number of distinct corners and of triangles (uint32); the
        corners' coordinates (float32); each triangle's corners (uint32). All little-endian. Raises
        ValueError for a corner farther away than a float32 can be."""
        with np.errstate(all="ignore"):
            corners = np.ascontiguousarray(self.points, dtype="<f4") + np.float32(0.0)  # No -0.0.
        if not np.isfinite(corners).all():
            _refuse("has a corner that is not finite")
        rows = corners.view(np.dtype((np.void, 12))).reshape(-1)
        _, first, which = np.unique(rows, return_index=True, return_inverse=True)
        triangles = which.reshape(-1)[self.triangles].astype("<u4")
        counts = np.array([len(first), len(triangles)], dtype="<u4")
        return b"".join(each.tobytes() for each in (counts, corners[first], triangles))


def points_in(data: bytes, path: Path, scale: Vector3 = UNSCALED) -> Points:
    """Return the corners of the mesh at `path` with these bytes, like `surface_in`. Raises
    ConfigurationError that names the file."""
    for factor in scale:
        if not 0.0 < abs(factor) <= LARGEST_SCALE:
            raise ConfigurationError(
                "", f"scale {tuple(scale)} of mesh {path}: three numbers, none of them 0"
            )
    with np.errstate(all="ignore"):
        points = surface_in(data, path).points * np.array(scale)
    if not np.isfinite(points).all():
        raise ConfigurationError("", f"mesh {path} has a corner that is not finite")
    return cast(Points, points)


def surface_in(data: bytes, path: Path) -> Surface:
    """Read the mesh at `path` with these bytes.

    For a COLLADA file its unit is applied, and its upward axis is not, as in RViz. Raises
    ConfigurationError that names the file.
    """
    reader = {".stl": _stl, ".obj": _obj, ".dae": _dae}.get(path.suffix.lower())
    try:
        if reader is None:
            _refuse(f"is not a format that can be read: {', '.join(FORMATS)}")
        with np.errstate(all="ignore"):
            surface = reader(data)
        if not len(surface.points):
            _refuse("has no faces")
        if not np.isfinite(surface.points).all():
            _refuse("has a corner that is not finite")
    except (ValueError, OverflowError) as error:
        raise ConfigurationError("", f"mesh {path} {error}") from None
    return surface


def _refuse(reason: str) -> NoReturn:
    raise ValueError(reason)


def _corners_of(points: Points, corners: Indices, triangles: Indices) -> Surface:
    """Return the surface of faces with these corners and `triangles`: each corner once."""
    used, which = np.unique(corners, return_inverse=True)
    return Surface(points[used], which.reshape(-1)[triangles])


def _fans(counts: Indices) -> Indices:
    """Return the triangles of polygons with these numbers of corners, one after the other."""
    triangles = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    turn = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack((first, first + turn + 1, first + turn + 2), axis=1)


# ---------------------------------------------------------------------------------------------
# STL and OBJ

_STL_HEAD: Final = 84
_STL_FACET: Final = np.dtype([("numbers", "<f4", (4, 3)), ("attribute", "<u2")])


def _stl(data: bytes) -> Surface:
    count = int.from_bytes(data[80:_STL_HEAD], "little")
    room = len(data) - _STL_HEAD
    # Some programs begin binary files with "solid", too.
    if room >= 0 and count * _STL_FACET.itemsize == room:
        facets = np.frombuffer(data, _STL_FACET, count, _STL_HEAD)
        return _facets(facets["numbers"][:, 1:].reshape(-1, 3).astype(np.float64))
    if data.lstrip()[:5].lower() == b"solid":
        return _ascii_stl(data)
    if room < 0:
        _refuse(f"is cut off: it has {len(data)} bytes, and an STL file {_STL_HEAD} at least")
    _refuse(
        f"is cut off or no STL: it says {count} facets, which take "
        f"{_STL_HEAD + count * _STL_FACET.itemsize} bytes, and has {len(data)}"
    )


def _facets(corners: Points) -> Surface:
    """Return three corners per facet."""
    return Surface(corners, np.arange(len(corners)).reshape(-1, 3))


def _ascii_stl(data: bytes) -> Surface:
    text = data.lower()
    if b"endsolid" not in text:
        _refuse("is cut off: it has no endsolid")
    corners = re.findall(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", text)
    if len(corners) != text.count(b"vertex") or len(corners) != 3 * text.count(b"endfacet"):
        _refuse("is damaged: a facet has not three corners of three numbers")
    return _facets(_numbers([number for corner in corners for number in corner]))


def _obj(data: bytes) -> Surface:
    lines = [line.split() for line in data.replace(b"\\\n", b" ").splitlines()]
    corners = [line[1:4] for line in lines if line[:1] == [b"v"]]
    if any(len(corner) < 3 for corner in corners):
        _refuse("is damaged: a corner has not three numbers")
    points = _numbers([number for corner in corners for number in corner])
    used, counts, known = [], [], 0
    for line in lines:
        if line[:1] == [b"v"]:
            known += 1
        elif line[:1] == [b"f"]:
            face = [int(corner.partition(b"/")[0]) for corner in line[1:]]
            # A negative index counts back from the corners so far.
            used += [each if each > 0 else known + 1 + each if each else 0 for each in face]
            counts.append(len(face))
    indices = np.array(used, dtype=np.int64)
    if len(indices) and not 1 <= indices.min() <= indices.max() <= len(points):
        _refuse(f"is cut off or damaged: a face has a corner that is not one of its {len(points)}")
    return _corners_of(points, indices - 1, _fans(np.array(counts, dtype=np.int64)))


def _numbers(words: Sequence[bytes | str]) -> Points:
    return np.array(words, dtype=np.float64).reshape(-1, 3) if words else np.empty((0, 3))


# ---------------------------------------------------------------------------------------------
# COLLADA

_FACES: Final = ("triangles", "polylist", "polygons", "trifans", "tristrips")


class _Plain(ET.TreeBuilder):
    """Parser without namespaces, and without document types, which could define any entity."""

    def __init__(self) -> None:
        super().__init__()
        self._count = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ET.Element:
        self._count += 1
        if self._count > MOST_ELEMENTS:
            _refuse(f"has more than {MOST_ELEMENTS} elements")
        return super().start(tag.rpartition("}")[2], attrs)

    def end(self, tag: str, /) -> ET.Element:
        return super().end(tag.rpartition("}")[2])

    def doctype(self, name: str, pubid: str | None, system: str | None, /) -> None:
        _refuse("has a DOCTYPE, which COLLADA has not")


def _dae(data: bytes) -> Surface:
    parser = ET.XMLParser(target=_Plain())
    try:
        parser.feed(data)
        root = parser.close()
    except (ET.ParseError, LookupError) as error:
        _refuse(f"is not XML: {error}")
    if root.tag != "COLLADA":
        _refuse(f"is not COLLADA: it begins with <{root.tag}>")
    unit = root.find("asset/unit")
    meter = float(unit.get("meter", "1")) if unit is not None else 1.0
    if not 0.0 < meter <= LARGEST_SCALE:
        _refuse(f"has a unit of {meter} m")
    surface = _Collada(root).surface()
    return surface._replace(points=meter * surface.points)


class _Collada:
    def __init__(self, root: ET.Element) -> None:
        self._by_id: Mapping[str, ET.Element] = {
            name: each for each in root.iter() if (name := each.get("id"))
        }
        self._root = root
        self._known: dict[ET.Element, Surface] = {}
        self._read: dict[ET.Element, Points] = {}
        self._nodes = self._count = 0

    def surface(self) -> Surface:
        scene = self._root.find("scene/instance_visual_scene")
        if scene is None:
            _refuse("has no scene")
        return Surface.of(list(self._placed(self._called(scene, "url"), np.eye(4), 0)))

    def _called(self, element: ET.Element, key: str) -> ET.Element:
        name = element.get(key, "")
        if name[1:] not in self._by_id:
            _refuse(f"has a <{element.tag}> with {key} {shown(name)}, which is not there")
        return self._by_id[name[1:]]

    def _placed(self, node: ET.Element, outer: Points, depth: int) -> Iterator[Surface]:
        self._nodes += 1
        if depth > DEEPEST or self._nodes > MOST_NODES:
            _refuse(f"has more than {DEEPEST} nodes in each other, or {MOST_NODES} in all")
        here = outer
        for element in node:
            if element.tag in ("matrix", "translate", "rotate", "scale", "lookat", "skew"):
                here = here @ _transform(element)
            elif element.tag == "node":
                yield from self._placed(element, here, depth + 1)
            elif element.tag == "instance_node":
                yield from self._placed(self._called(element, "url"), here, depth + 1)
            elif element.tag == "instance_geometry":
                local = self._geometry(self._called(element, "url"))
                self._count += max(map(len, local))
                if self._count > MOST_POINTS:
                    _refuse(f"has more than {MOST_POINTS} corners")
                yield local._replace(points=local.points @ here[:3, :3].T + here[:3, 3])
            elif element.tag == "instance_controller":
                _refuse("has a skin over bones, which is not read: export the mesh alone")

    def _geometry(self, geometry: ET.Element) -> Surface:
        if geometry not in self._known:
            faces = [each for each in geometry.iterfind("mesh/*") if each.tag in _FACES]
            found = [surface for each in faces for surface in self._corners(each)]
            self._known[geometry] = Surface.of(found)
        return self._known[geometry]

    def _corners(self, faces: ET.Element) -> Iterator[Surface]:
        """Yield surfaces of some faces of one geometry, with each corner once."""
        inputs = faces.findall("input")
        offsets = [int(each.get("offset", "0")) for each in inputs]
        step = max(offsets, default=0) + 1
        for each, offset in zip(inputs, offsets, strict=True):
            if each.get("semantic") != "VERTEX":
                continue
            points = self._positions(self._called(each, "source"))
            for listed in faces.iter():
                if listed.tag not in ("p", "h"):
                    continue
                words = (listed.text or "").split()
                if len(words) % step or offset < 0:
                    _refuse(f"has a <p> of {len(words)} indices, {step} for each corner")
                indices = np.array(words, dtype=np.int64).reshape(-1, step)[:, offset]
                if len(indices) and not 0 <= indices.min() <= indices.max() < len(points):
                    _refuse(f"has a face with a corner that is not one of its {len(points)}")
                yield _corners_of(points, indices, _triangles(faces, listed, len(indices)))

    def _positions(self, vertices: ET.Element) -> Points:
        if vertices not in self._read:
            self._read[vertices] = self._read_positions(vertices)
        return self._read[vertices]

    def _read_positions(self, vertices: ET.Element) -> Points:
        for each in vertices.findall("input"):
            if each.get("semantic") == "POSITION":
                source = self._called(each, "source")
                accessor = source.find("technique_common/accessor")
                if accessor is None:
                    _refuse("has positions that nothing describes")
                numbers = (self._called(accessor, "source").text or "").split()
                step, first = (
                    int(accessor.get(key, d)) for key, d in (("stride", "1"), ("offset", "0"))
                )
                count = int(accessor.get("count", "0"))
                if step < 3 or min(first, count) < 0 or first + count * step > len(numbers):
                    _refuse(f"has {len(numbers)} numbers for {count} positions of {step}")
                rows = np.array(numbers[first : first + count * step], dtype=np.float64)
                return rows.reshape(-1, step)[:, :3]
        _refuse("has faces without positions")


def _triangles(faces: ET.Element, listed: ET.Element, count: int) -> Indices:
    """Return the triangles between `count` corners of some faces."""
    if listed.tag == "h":  # A hole.
        return np.empty((0, 3), dtype=np.int64)
    if faces.tag == "tristrips":
        first = np.arange(max(count - 2, 0))
        return np.stack((first, first + 1 + first % 2, first + 2 - first % 2), axis=1)
    if faces.tag == "triangles":
        counts = np.full(count // 3, 3)
    elif faces.tag == "polylist":
        counts = np.array(faces.findtext("vcount", "").split(), dtype=np.int64)
        if (counts < 0).any() or counts.sum() != count:
            _refuse(f"has a <vcount> that is not that of its {count} corners")
    else:
        counts = np.array([count])
    return _fans(counts)


def _transform(element: ET.Element) -> Points:
    """Transform of a node, 4 x 4."""
    numbers = np.array((element.text or "").split(), dtype=np.float64)
    found = np.eye(4)
    match element.tag, len(numbers):
        case "matrix", 16:
            return cast(Points, numbers.reshape(4, 4))
        case "translate", 3:
            found[:3, 3] = numbers
        case "scale", 3:
            found[:3, :3] = np.diag(numbers)
        case "rotate", 4:
            axis, angle = numbers[:3], math.radians(numbers[3])
            length = float(np.linalg.norm(axis))
            if length > 0.0:
                x, y, z = axis / length
                across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
                found[:3, :3] += math.sin(angle) * across
                found[:3, :3] += (1.0 - math.cos(angle)) * across @ across
        case tag, count:
            _refuse(f"has a <{tag}> of {count} numbers, which is not read")
    return found
