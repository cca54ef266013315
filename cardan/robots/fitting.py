"""Fit of few capsules and boxes around the convex hull of a mesh.

A control cycle compares an arm's bodies some hundred times a second, which meshes are too slow for.
The fit contains the hull for certain, so that no distance of it is larger than the mesh's: the hull
is cut into convex cells by planes, each piece contains the corners of its cell, and is then made
larger by the error of simplifying the hull. Lengths in m.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cache, cached_property
from typing import Final, Literal, NamedTuple, cast

from cardan.common.arm_libraries import np, npt, pin
from cardan.errors import ConfigurationError
from cardan.robots.arm_model import Capsule, OrientedBox, Shape
from cardan.types import Pose, Quaternion, Vector3

How = Literal["tight", "coarse"]
"""Few pieces that leave little over, or one."""
Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

METHOD: Final = 2
"""Grows with each change that gives other shapes."""

MOST_PIECES: Final = 4
"""Each costs the control cycle its pairs."""
OVER_SHARE: Final = 0.15
OVER_M: Final = 0.010
"""A tight fit is good enough below one of them: of the hull's volume, or beyond its surface."""

FARTHEST_M: Final = 100.0
"""Largest distance of any part of an arm from its frame."""
THINNEST_M: Final = 1e-4
"""Least thickness in any direction, for plates without one."""
ROUNDING_M: Final = 1e-6
"""Margin of all pieces, besides the error of simplifying the hull."""

_MOST_CORNERS: Final = 800
_SIMPLER: Final = 2.5e-4
"""Corners that are nearer to the hull of the others are left out, as a share of its length."""
_JOGGLE: Final = 1e-8
"""Corners are shifted by this share of the length: no four are then in one plane by chance."""
_SLICES: Final = 8
"""Divisions of half of the hull's length along an axis, at which steps may begin."""
_ON_PLANE_M: Final = 1e-9
"""Points so near to a plane are on both its sides: rounding must not take a corner from a cell."""
_SAMPLES: Final = 16384
_SAMPLES_TO_COMPARE: Final = 2048
_AT_ONCE: Final = 4096
"""Points that are compared with all facets at once, which takes memory."""
_WORTH_A_PIECE: Final = 0.95
"""A further piece must make a fit that is not good enough better by 5 %."""


class Fit(NamedTuple):
    """Shapes that contain the convex hull of points, and how much more."""

    shapes: tuple[Shape, ...]
    over_share: float
    """Volume of the shapes beyond the hull's, of the hull's; to about 0.01."""
    over_m: float
    """Largest distance of a point of the shapes from the hull."""

    @property
    def good(self) -> bool:
        """Whether one of both is small enough for a tight fit."""
        return self.badness < 1.0

    @property
    def badness(self) -> float:
        """Smaller is better; below 1 where the fit is good."""
        return min(self.over_share / OVER_SHARE, self.over_m / OVER_M)


def fit(points: npt.ArrayLike, how: How) -> Fit:
    """The shapes that cover the convex hull of `points` (n rows of x, y, z).

    "tight" takes the fewest of up to :data:`MOST_PIECES` that leave less than :data:`OVER_SHARE` or
    :data:`OVER_M` over, or the best found; "coarse" the one with the smallest volume. The same
    points give the same shapes. Raises ConfigurationError for no points, and for such as are not
    numbers or beyond :data:`FARTHEST_M`.
    """
    hull = Hull(_checked(points))
    frames = _frames(hull)
    one = [[_smallest(_pieces(hull.corners, frames, 64))]]
    if how == "coarse":
        return _rated(hull, one, frames[0])
    best = _rated(hull, [*one, [_smallest(_boxes(hull.corners, frames))]], frames[0])
    covers = _covers(hull, frames)
    while not best.good and (next_ones := next(covers, None)):
        found = _rated(hull, next_ones, frames[0])
        if found.good or found.badness < _WORTH_A_PIECE * best.badness:
            best = found
    return best


def _checked(points: npt.ArrayLike) -> Floats:
    found = np.asarray(points, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != 3 or not len(found):
        raise ConfigurationError("", f"points are rows of three numbers, found {found.shape}")
    if not (np.abs(found) <= FARTHEST_M).all():
        raise ConfigurationError("", f"a point is not finite, or more than {FARTHEST_M:g} m away")
    return found


# ---------------------------------------------------------------------------------------------
# The hull


Side = tuple[int, int]


def _sides(facet: list[int]) -> tuple[Side, Side, Side]:
    a, b, c = facet
    return (a, b), (b, c), (c, a)


def _rim(facets: Indices) -> list[Side]:
    """The sides that only one of these facets has."""
    sides = {side for facet in facets.tolist() for side in _sides(facet)}
    return sorted((a, b) for a, b in sides if (b, a) not in sides)


def _is_one_loop(rim: list[Side]) -> bool:
    """Whether these sides are a way through each of their corners once, and back."""
    after = dict(rim)
    if not rim or len(after) < len(rim):
        return False
    start, _ = rim[0]
    at, length = after[start], 1
    while at != start and length < len(rim):
        at = after.get(at, start)
        length += 1
    return at == start and length == len(rim)


class Hull:
    """The convex hull of points, of few corners: all points are within `margin_m` of it."""

    def __init__(self, points: Floats) -> None:
        # Copies of a corner, as STL has them, would be shifted apart and leave slivers between.
        points = _thickened(_once_each(points))
        length = float(np.ptp(points, axis=0).max())
        noise = np.random.Generator(np.random.PCG64(1)).uniform(-1.0, 1.0, points.shape)
        self._points = points + _JOGGLE * length * noise
        self._flat_m = 1e-3 * _JOGGLE * length
        self.facets: Indices = self._first_facets()
        self.normals, self.offsets = self._planes(self.facets)
        self._insert(np.unique(np.argmax(self._points @ _directions(20).T, axis=0)))
        left = np.arange(len(points))
        refused: set[int] = set()
        """Left outside, within the margin."""
        while True:
            beyond, facet = self.beyond(self._points[left])
            outside = beyond > 0.0
            left, beyond, facet = left[outside], beyond[outside], facet[outside]
            far = (beyond > _SIMPLER * length) & ~np.isin(left, [*refused])
            room = _MOST_CORNERS - len(np.unique(self.facets))
            if room <= 0 or not far.any():
                break
            order = np.argsort(-beyond[far], kind="stable")
            _, first = np.unique(facet[far][order], return_index=True)
            refused |= self._insert(left[far][order][np.sort(first)[:room]])
        gaps = Triangles(self._points[self.facets[facet]]).distances(self._points[left])
        triangles = Triangles(self._points[self.facets])
        gap = 0.0
        for index in np.argsort(-gaps):
            # A thin facet may be far from a point that is only a little beyond its plane.
            if gaps[index] <= gap:
                break
            gap = max(gap, float(triangles.distances(self._points[left[index]]).min()))
        self.margin_m = gap + 2.0 * _JOGGLE * length + ROUNDING_M
        used, renamed = np.unique(self.facets, return_inverse=True)
        self.corners: Floats = self._points[used]
        self.facets = renamed.reshape(self.facets.shape)
        sides = np.concatenate([self.facets[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
        self.edges = self.corners[sides[sides[:, 0] < sides[:, 1]]]
        self.triangles = Triangles(self.corners[self.facets])
        centered = self.triangles.corners - self.corners.mean(axis=0)
        self.volume: float = float(np.linalg.det(centered).sum() / 6.0)

    def _first_facets(self) -> Indices:
        """Facets of a first tetrahedron: long, wide and thick."""
        points = self._points
        a = int(np.argmin(points[:, int(np.argmax(np.ptp(points, axis=0)))]))
        b = int(np.argmax(np.linalg.norm(points - points[a], axis=1)))
        along = points[b] - points[a]
        c = int(np.argmax(np.linalg.norm(_crosses(points - points[a], along), axis=1)))
        upward = (points - points[a]) @ _cross(along, points[c] - points[a])
        d = int(np.argmax(np.abs(upward)))
        if upward[d] > 0.0:
            b, c = c, b
        return np.array([[a, b, c], [a, d, b], [b, d, c], [c, d, a]])

    def _planes(self, facets: Indices) -> tuple[Floats, Floats]:
        a, b, c = self._points[facets].transpose(1, 0, 2)
        normals = _crosses(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
        return normals, _dots(normals, a)

    def _insert(self, indices: Iterable[int]) -> set[int]:
        """Make these points corners; return those for which that is impossible."""
        refused = set()
        for index in map(int, indices):
            depths = self.normals @ self._points[index] - self.offsets
            visible = depths > self._flat_m
            if not visible.any():
                refused.add(index)
                continue
            rim = _rim(self.facets[visible])
            if not _is_one_loop(rim):
                # Of facets in nearly one plane, rounding may have some hidden among others.
                visible = self._around(int(np.argmax(depths)), visible)
                rim = _rim(self.facets[visible])
            if not _is_one_loop(rim):
                refused.add(index)
                continue
            new = np.array([(a, b, index) for a, b in rim])
            normals, offsets = self._planes(new)
            hidden = ~visible
            self.facets = np.concatenate((self.facets[hidden], new))
            self.normals = np.concatenate((self.normals[hidden], normals))
            self.offsets = np.concatenate((self.offsets[hidden], offsets))
        return refused

    def _around(self, start: int, visible: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return the visible facets connected to `start`."""
        of_side: dict[tuple[int, int], int] = {}
        for number in np.flatnonzero(visible).tolist():
            of_side.update(dict.fromkeys(_sides(self.facets[number].tolist()), number))
        found = np.zeros_like(visible)
        found[start] = True
        ways = [start]
        for number in ways:
            for a, b in _sides(self.facets[number].tolist()):
                other = of_side.get((b, a), start)
                if not found[other]:
                    found[other] = True
                    ways.append(other)
        return found

    def beyond(self, points: Floats) -> tuple[Floats, Indices]:
        """Return the largest distance of each beyond the facets' planes, and of which."""
        depths, facets = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        for first in range(0, len(points), _AT_ONCE):
            part = points[first : first + _AT_ONCE] @ self.normals.T
            part -= self.offsets
            found = part.argmax(axis=1)
            facets[first : first + _AT_ONCE] = found
            depths[first : first + _AT_ONCE] = part[np.arange(len(part)), found]
        return depths, facets

    def distances(self, points: Floats) -> Floats:
        """Distances from the hull; below 0 inside it, by the depth."""
        depth, _ = self.beyond(points)
        outside = depth > 0.0
        depth[outside] = [self.triangles.distances(point).min() for point in points[outside]]
        return depth


def _once_each(points: Floats) -> Floats:
    """Return points without copies, in order, like np.unique, which is several times slower."""
    ordered = points[np.lexsort(points.T[::-1])]
    new = np.ones(len(ordered), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return ordered[new]


def _thickened(points: Floats) -> Floats:
    """Return the points with a thickness in each direction."""
    centered = points - points.mean(axis=0)
    axes = _axes_of(centered.T @ centered)
    for axis in axes:
        if np.ptp(points @ axis) < THINNEST_M:
            points = np.concatenate(
                (points - THINNEST_M / 2 * axis, points + THINNEST_M / 2 * axis)
            )
    return points


def _axes_of(moments: Floats) -> Floats:
    """Principal axes as rows of a rotation, the longest first."""
    _, columns = np.linalg.eigh(moments)
    axes: Floats = columns.T[::-1].copy()
    for axis in axes:
        axis *= math.copysign(1.0, axis[int(np.argmax(np.abs(axis)))])
    axes[2] = _cross(axes[0], axes[1])
    return axes


def _cross(first: Floats, second: Floats) -> Floats:
    """Cross product of two vectors; twenty times faster than numpy's, which is for many."""
    (a, b, c), (d, e, f) = first.tolist(), second.tolist()
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d])


def _crosses(first: Floats, second: Floats) -> Floats:
    """Row-wise cross products; several times faster than numpy's."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    d, e, f = second[..., 0], second[..., 1], second[..., 2]
    return np.stack((b * f - c * e, c * d - a * f, a * e - b * d), axis=-1)


def _dots(first: Floats, second: Floats) -> Floats:
    """Row-wise dot products."""
    found: Floats = np.einsum("...i,...i->...", first, second)
    return found


def _directions(number: int) -> Floats:
    """Spread evenly over the sphere, with the six along the axes."""
    index = np.arange(number) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * index / number), math.pi * (1.0 + math.sqrt(5.0)) * index
    spiral = np.stack(
        (np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)), axis=1
    )
    return np.concatenate((np.eye(3), -np.eye(3), spiral))


class Triangles:
    """Triangles (n x 3 x 3), for the distances of points from them."""

    def __init__(self, corners: Floats) -> None:
        self.corners = corners
        self._sides = np.roll(corners, -1, axis=1) - corners
        normals = _crosses(self._sides[:, 0], -self._sides[:, 2])
        size = np.linalg.norm(normals, axis=1)
        self._flat = size == 0.0
        self._normals = normals / np.where(self._flat, 1.0, size)[:, None]
        # Into the triangle, in its plane.
        self._inward = _crosses(self._normals[:, None], self._sides)
        squared = _dots(self._sides, self._sides)
        self._per_side = self._sides / np.where(squared > 0.0, squared, 1.0)[..., None]

    def distances(self, points: Floats) -> Floats:
        """Distances from each triangle, of a point or of as many points."""
        offsets = points[..., None, :] - self.corners
        to_plane = np.abs(_dots(offsets[:, 0], self._normals))
        inside = (_dots(offsets, self._inward) >= 0.0).all(axis=1) & ~self._flat
        share = np.clip(_dots(offsets, self._per_side), 0.0, 1.0)
        nearest = offsets - share[..., None] * self._sides
        to_edges = np.sqrt(_dots(nearest, nearest).min(axis=1))
        return np.where(inside, to_plane, to_edges)


# ---------------------------------------------------------------------------------------------
# Pieces


class _BoxPiece(NamedTuple):
    axes: Floats
    """Rows."""
    low: Floats
    high: Floats

    @property
    def volume(self) -> float:
        return float(np.prod(self.high - self.low))

    def larger(self, margin: float) -> _BoxPiece:
        return _BoxPiece(self.axes, self.low - margin, self.high + margin)

    def extremes(self) -> tuple[Floats, float]:
        """Points whose surroundings, of a radius, have this piece for their convex hull."""
        corners = itertools.product(*zip(self.low, self.high, strict=True))
        return np.array(list(corners)) @ self.axes, 0.0

    def holds(self, points: Floats) -> Mask:
        local = points @ self.axes.T
        return cast(Mask, ((local >= self.low) & (local <= self.high)).all(axis=1))

    def shape(self) -> Shape:
        size = self.high - self.low
        center = (self.low + self.high) / 2.0 @ self.axes
        turn = pin.Quaternion(self.axes.T.copy())
        turn.normalize()
        orientation = Quaternion(float(turn.w), float(turn.x), float(turn.y), float(turn.z))
        return OrientedBox(Pose(_vector(center), orientation), _vector(size))


class _CapsulePiece(NamedTuple):
    start: Floats
    end: Floats
    radius: float

    @property
    def volume(self) -> float:
        length = float(np.linalg.norm(self.end - self.start))
        return math.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius)

    def larger(self, margin: float) -> _CapsulePiece:
        return _CapsulePiece(self.start, self.end, self.radius + margin)

    def extremes(self) -> tuple[Floats, float]:
        return np.stack((self.start, self.end)), self.radius

    def holds(self, points: Floats) -> Mask:
        along, offset = self.end - self.start, points - self.start
        squared = float(along @ along)
        share = (
            np.clip(offset @ along / squared, 0.0, 1.0) if squared > 0.0 else np.zeros(len(points))
        )
        nearest = offset - share[:, None] * along
        return _dots(nearest, nearest) <= self.radius**2

    def shape(self) -> Shape:
        return Capsule(_vector(self.start), _vector(self.end), self.radius)


_Piece = _BoxPiece | _CapsulePiece


def _vector(values: Floats) -> Vector3:
    return Vector3(*map(float, values))


def _smallest(pieces: Iterable[_Piece]) -> _Piece:
    return min(pieces, key=lambda piece: piece.volume)


def _boxes(points: Floats, frames: Iterable[Floats]) -> Iterator[_BoxPiece]:
    for axes in frames:
        yield _box(points, axes)


def _box(points: Floats, axes: Floats) -> _BoxPiece:
    local = axes @ points.T
    return _BoxPiece(axes, local.min(axis=1), local.max(axis=1))


def _pieces(points: Floats, frames: Sequence[Floats], steps: int = 0) -> Iterator[_Piece]:
    """Yield all pieces that contain `points` along one of the axes."""
    yield from _boxes(points, frames)
    for axes in frames:
        for which in range(3):
            yield _capsule(points, np.roll(axes, which, axis=0), steps)


_WIDER: Final = np.array([1.0, 1.01, 1.03, 1.06, 1.1, 1.15, 1.25, 1.4, 1.6])
"""A capsule that is wider than needed can be shorter."""


def _capsule(points: Floats, axes: Floats, steps: int) -> _CapsulePiece:
    """Along the first axis; `steps` bring its middle nearer to the best."""
    local = points @ axes.T
    across = local[:, 1:]
    middle = (across.min(axis=0) + across.max(axis=0)) / 2.0
    for step in range(steps):
        offset = across - middle
        far = int(np.argmax(_dots(offset, offset)))
        middle = middle + offset[far] / (step + 2)
    offset = across - middle
    squared = _dots(offset, offset)
    radii = math.sqrt(squared.max()) * _WIDER
    ends = np.sqrt(np.maximum(radii[:, None] ** 2 - squared, 0.0))
    low, high = (local[:, 0] + ends).min(axis=1), (local[:, 0] - ends).max(axis=1)
    middles = (low + high) / 2.0
    round_ = low > high
    low, high = np.where(round_, middles, low), np.where(round_, middles, high)
    best = int(np.argmin(radii**2 * (high - low + 4.0 / 3.0 * radii)))
    start, end = (np.array([float(t[best]), *middle]) @ axes for t in (low, high))
    return _CapsulePiece(start, end, float(radii[best]))


# ---------------------------------------------------------------------------------------------
# Covers of several pieces


def _frames(hull: Hull) -> list[Floats]:
    """Orientations to try: the box of the smallest volume, principal axes, the mesh's own."""
    corners = hull.triangles.corners
    centers = corners.mean(axis=1)
    spans = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(_crosses(spans[:, 0], spans[:, 1]), axis=1)
    centered = centers - np.average(centers, axis=0, weights=areas)
    principal = _axes_of((centered * areas[:, None]).T @ centered)
    largest = hull.normals[np.argsort(-areas, kind="stable")]
    chosen: list[Floats] = []
    for normal in largest:
        if len(chosen) == 40:
            break
        if normal.any() and all(abs(normal @ other) < 0.999 for other in chosen):
            chosen.append(normal)
    sides = np.array(chosen)
    turned = [_turned(hull.corners, normal, sides) for normal in [*chosen, *principal, *np.eye(3)]]
    tried = [*turned, principal, np.eye(3)]
    tightest = min(tried, key=lambda axes: _box(hull.corners, axes).volume)
    return [_longest_first(hull.corners, axes) for axes in (tightest, principal, np.eye(3))]


def _longest_first(points: Floats, axes: Floats) -> Floats:
    first = int(np.argmax(np.ptp(points @ axes.T, axis=0)))
    return np.roll(axes, -first, axis=0)


_ANGLES: Final = np.linspace(0.0, math.pi / 2.0, 30, endpoint=False)


def _turned(points: Floats, normal: Floats, sides: Floats | None = None) -> Floats:
    """The frame about `normal` whose box about the points is smallest; those with a side along one
    of `sides` are tried, too."""
    x = _cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    x /= np.linalg.norm(x)
    y = _cross(normal, x)
    angles = _ANGLES
    if sides is not None:
        angles = np.concatenate((angles, np.arctan2(sides @ y, sides @ x)))
    cosines, sines = np.cos(angles)[:, None], np.sin(angles)[:, None]
    xs, ys = cosines * x + sines * y, cosines * y - sines * x
    sizes = np.ptp(xs @ points.T, axis=1) * np.ptp(ys @ points.T, axis=1)
    best = int(np.argmin(sizes))
    return np.stack((normal, xs[best], ys[best]))


def _covers(hull: Hull, frames: Sequence[Floats]) -> Iterator[list[list[_Piece]]]:
    """Covers of two pieces, of three, and so on."""
    cuts = _cut(hull, frames[0])
    turned = [np.roll(frame, -which, axis=0) for frame in frames for which in range(3)]
    steps = [_steps(hull, axes) for axes in turned]
    for number in range(2, MOST_PIECES + 1):
        covers = [next(cuts), *(_divided(found, number) for found in steps)]
        for axes in turned:
            covers += [_starred(hull, axes, number, share) for share in (0.0, 0.5)]
        yield covers


def _crossings(edges: Floats, normal: Floats, offset: float) -> Floats:
    """Return the points where edges pass through a plane."""
    start, end = edges[:, 0] @ normal - offset, edges[:, 1] @ normal - offset
    through = start * end < 0.0
    start, end, edges = start[through], end[through], edges[through]
    share = (start / (start - end))[:, None]
    return edges[:, 0] + share * (edges[:, 1] - edges[:, 0])


class _Plane(NamedTuple):
    """Half-space on the lower side of a plane: normal · point <= offset."""

    normal: Floats
    offset: float


def _cut(hull: Hull, axes: Floats) -> Iterator[list[_Piece]]:
    """Yield covers of a hull that one plane, two, and so on divide; each divides the cell
    where it saves most."""
    cells = [_Cell(hull, axes, ())]
    while True:
        best = max(range(len(cells)), key=lambda index: cells[index].saved)
        cells[best : best + 1] = cells[best].halves
        yield [cell.piece for cell in cells]


class _Cell:
    """Part of the hull on the lower side of all `planes`."""

    def __init__(self, hull: Hull, axes: Floats, planes: tuple[_Plane, ...]) -> None:
        self._hull, self._axes, self._planes = hull, axes, planes
        self.corners = _corners(hull, planes)
        centered = self.corners - self.corners.mean(axis=0)
        principal = _axes_of(centered.T @ centered)
        frames = [axes, principal, *(_turned(self.corners, plane.normal) for plane in planes[-1:])]
        self.piece = _smallest(
            [*_boxes(self.corners, frames), _capsule(self.corners, principal, 0)]
        )

    @cached_property
    def halves(self) -> tuple[_Cell, _Cell]:
        """The two that the best further plane makes of it."""
        return min(self._cuts(), key=lambda pair: sum(half.piece.volume for half in pair))

    @property
    def saved(self) -> float:
        """Volume saved by taking its halves instead."""
        return self.piece.volume - sum(half.piece.volume for half in self.halves)

    def _cuts(self) -> Iterator[tuple[_Cell, _Cell]]:
        for direction in self._axes:
            along = self.corners @ direction
            low, length = float(along.min()), float(np.ptp(along))
            for share in _CUT_SHARES:
                offset = low + share * length
                yield (
                    self._cut_by(_Plane(direction, offset)),
                    self._cut_by(_Plane(-direction, -offset)),
                )

    def _cut_by(self, plane: _Plane) -> _Cell:
        return _Cell(self._hull, self._axes, (*self._planes, plane))


_CUT_SHARES: Final = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Shares of a cell's length along an axis at which it may be cut."""


def _corners(hull: Hull, planes: tuple[_Plane, ...]) -> Floats:
    """Return all corners of what up to three planes leave of the hull, and some more points."""
    found = [hull.corners, *(_crossings(hull.edges, *plane) for plane in planes)]
    for first, second in itertools.combinations(planes, 2):
        line = _cross(first.normal, second.normal)
        if line.any():
            rows, offsets = np.stack((first.normal, second.normal, line)), (first[1], second[1], 0)
            found.append(_along(hull, np.linalg.solve(rows, np.array(offsets)), line))
    for three in itertools.combinations(planes, 3):
        normals = np.stack([plane.normal for plane in three])
        if abs(np.linalg.det(normals)) > 1e-9:
            point = np.linalg.solve(normals, np.array([plane.offset for plane in three]))
            if (hull.normals @ point <= hull.offsets + _ON_PLANE_M).all():
                found.append(point[None])
    points = np.concatenate(found)
    for plane in planes:
        points = points[points @ plane.normal <= plane.offset + _ON_PLANE_M]
    return points


def _along(hull: Hull, point: Floats, direction: Floats) -> Floats:
    """Return where a line enters and leaves the hull; nothing where it misses it."""
    slope = hull.normals @ direction
    room = hull.offsets - hull.normals @ point
    into, out = slope < 0.0, slope > 0.0
    low, high = (room[into] / slope[into]).max(), (room[out] / slope[out]).min()
    if low > high + _ON_PLANE_M:
        return np.empty((0, 3))
    return point + np.array([[low], [high]]) * direction


def _steps(hull: Hull, axes: Floats) -> _Steps:
    """Boxes inside each other's middle, ever narrower and longer, as steps from both sides: for
    each first and last slice, what such a step adds to the volume, and its box."""
    along = hull.corners @ axes[0]
    low, high = float(along.min()), float(along.max())
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    # Nearer to each other where a round end curves most.
    steps = half * np.sin(np.linspace(0.0, math.pi / 2.0, _SLICES + 1))
    faces = [
        [_crossings(hull.edges, axes[0], middle + sign * step) for sign in (-1.0, 1.0)]
        for step in steps
    ]

    def piece(first: int, last: int) -> tuple[float, _BoxPiece]:
        away = np.abs(along - middle)
        inside = away >= steps[first] - _ON_PLANE_M
        if last < _SLICES:
            inside &= away <= steps[last] + _ON_PLANE_M
        found = _box(np.concatenate((hull.corners[inside], *faces[first], *faces[last])), axes)
        size = found.high - found.low
        return 2.0 * float((steps[last] - steps[first]) * size[1] * size[2]), found

    pairs = itertools.combinations(range(_SLICES + 1), 2)
    return {(first, last): piece(first, last) for first, last in pairs}


_Steps = dict[tuple[int, int], tuple[float, _BoxPiece]]


def _divided(found: _Steps, number: int) -> list[_Piece]:
    """The `number` steps that have the smallest volume."""
    ways = min(
        ((0, *cuts, _SLICES) for cuts in itertools.combinations(range(1, _SLICES), number - 1)),
        key=lambda cuts: sum(found[pair][0] for pair in itertools.pairwise(cuts)),
    )
    return [found[pair][1] for pair in itertools.pairwise(ways)]


def _starred(hull: Hull, axes: Floats, number: int, share: float) -> list[_Piece]:
    """Boxes through the first axis, turned against each other about it."""
    local = hull.corners @ axes[1:].T
    middle = (local.min(axis=0) + local.max(axis=0)) / 2.0 @ axes[1:]
    step = math.pi / number
    angles = step * (np.arange(number + 1) + share)
    normals = np.cos(angles)[:, None] * axes[2] - np.sin(angles)[:, None] * axes[1]
    sides = (hull.corners - middle) @ normals.T
    faces = [_crossings(hull.edges, normal, float(middle @ normal)) for normal in normals]
    # Where the first axis leaves the hull is a corner of each cell.
    on_axis = _along(hull, middle, axes[0])
    pieces: list[_Piece] = []
    for index in range(number):
        first, last = sides[:, index], sides[:, index + 1]
        between = (first * last <= 0.0) | (np.minimum(np.abs(first), np.abs(last)) <= _ON_PLANE_M)
        angle = step * (index + share + 0.5)
        bisector = math.cos(angle) * axes[1] + math.sin(angle) * axes[2]
        frame = np.stack((axes[0], bisector, _cross(axes[0], bisector)))
        cell = (hull.corners[between], faces[index], faces[index + 1], on_axis)
        pieces.append(_box(np.concatenate(cell), frame))
    return pieces


# ---------------------------------------------------------------------------------------------
# How good a cover is


def _rated(hull: Hull, covers: Iterable[Sequence[_Piece]], axes: Floats) -> Fit:
    """The best of them."""
    best: tuple[_Piece, ...] = ()
    least = math.inf
    for cover in covers:
        pieces = tuple(piece.larger(hull.margin_m) for piece in cover)
        share = _over_share(hull, pieces, axes, _SAMPLES_TO_COMPARE)
        badness = min(share / OVER_SHARE, least)
        if _at_least_over_m(hull, pieces) / OVER_M < badness:
            badness = min(badness, _over_m(hull, pieces) / OVER_M)
        if badness < least:
            best, least = pieces, badness
    share = _over_share(hull, best, axes, _SAMPLES)
    return Fit(tuple(piece.shape() for piece in best), share, _over_m(hull, best))


def _over_m(hull: Hull, pieces: Iterable[_Piece]) -> float:
    """Farthest are corners and ends of pieces: the distance from a convex body is convex."""
    ends = (piece.extremes() for piece in pieces)
    return max(float(hull.distances(points).max()) + radius for points, radius in ends)


def _at_least_over_m(hull: Hull, pieces: Iterable[_Piece]) -> float:
    """Return a lower bound of the excess, m: the largest distance beyond a facet's plane."""
    ends = (piece.extremes() for piece in pieces)
    return max(float(hull.beyond(points)[0].max()) + radius for points, radius in ends)


def _over_share(hull: Hull, pieces: Sequence[_Piece], axes: Floats, samples: int) -> float:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for points, radius in (piece.extremes() for piece in pieces):
        local = points @ axes.T
        low = np.minimum(low, local.min(axis=0) - radius)
        high = np.maximum(high, local.max(axis=0) + radius)
    points = (low + _spread(samples) * (high - low)) @ axes
    inside = np.any([piece.holds(points) for piece in pieces], axis=0)
    volume = float(inside.mean() * np.prod(high - low))
    return max(volume / hull.volume - 1.0, 0.0)


@cache
def _spread(number: int) -> Floats:
    """Points that fill the unit cube evenly: Roberts' sequence."""
    # The real root of x⁴ = x + 1.
    root = 1.2207440846057596
    steps = root ** -np.arange(1.0, 4.0)
    return (0.5 + np.arange(number)[:, None] * steps) % 1.0
