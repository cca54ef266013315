"""Distances between the bodies of an arm and to obstacles around it, on Coal.

Capsules, spheres, boxes and half-spaces only: the distance of two meshes costs 500 times more
than that of two capsules, and the loop has 50 µs for all of them.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple

from cardan.common.arm_libraries import coal, np, pin
from cardan.errors import below
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import SE3, FloatArray
from cardan.robots import ArmModel, BodyShape, Capsule, JointKind, OrientedBox, Shape
from cardan.robots.arm_bodies import coal_shape, to_se3
from cardan.spatial import add, norm, rotate
from cardan.types import Vector3

ADVANCE_STOP = 1e-3
"""Smallest gain of distance by conservative advancement: below it, the pair counts as in
contact."""


LEAST_ROOM_M = 5e-4
"""Distance that a pair in contact may move to show that it separates."""


TINY = 1e-30
"""Squared length of a capsule's axis below which it is a sphere, m²."""

_MIN_DISTANCE = operator.attrgetter("min_distance")


class HalfSpace(NamedTuple):
    """Everything below a plane: points p with normal·p <= offset are solid."""

    normal: Vector3
    """Unit vector, base axes, out of the solid."""
    offset_m: float


class Obstacle(NamedTuple):
    """A solid body that does not move, in the base frame."""

    name: str
    shape: Shape | HalfSpace


class Solid(NamedTuple):
    """A shape of the arm or an obstacle, in the frame of its body."""

    name: str
    body: int
    """0: the base."""
    shape: Shape | HalfSpace


class Closest(NamedTuple):
    """The pair of bodies nearest to each other."""

    distance_m: float
    """Distance of the pair, m; negative: overlap."""
    names: tuple[str, str]
    grown_m: float = 0.0
    """Extra distance that the pair is kept apart, for bodies that move by themselves."""


class CollisionModel:
    """All pairs of an arm's shapes that could touch, and all obstacles against the arm.

    A shape wholly inside another of its body is left out of pairs that the outer one has: it is
    never nearer.
    """

    def __init__(
        self,
        kinematics: ArmKinematics,
        obstacles: Iterable[Obstacle] = (),
        tool: Iterable[BodyShape] = (),
        movers: Iterable[Sequence[BodyShape]] = (),
        ignored: Collection[tuple[str, str]] = (),
    ) -> None:
        """`tool` are further shapes of the arm's bodies, such as a gripper of the last; `movers`
        those of each body that others move, in frames that are at the base until `move`. `ignored`:
        names of a mover and of a shape of the arm that are not kept apart."""
        self.kinematics = kinematics
        self.ignored = ignored
        arm, n = kinematics.arm, kinematics.joints
        self._geometry: Any = pin.GeometryModel()
        self.solids: list[Solid] = []
        """The arm's shapes, the tool's, the obstacles, and bodies that others move."""
        for shape in (*arm.shapes, *tool):
            self._add(shape.name, shape.body, shape.shape)
        fixed_to_base = len(self.solids)
        for obstacle in obstacles:
            self._add(obstacle.name, 0, obstacle.shape)
        self.first_mover = len(self.solids)
        """Index of the first mover in `solids`; the movers are the last."""
        moved = [(number, each) for number, shapes in enumerate(movers, 2) for each in shapes]
        for _, mover in moved:
            self._add(mover.name, 0, mover.shape)
        self._local = [_coal_shape(each.shape)[1] for each in self.solids[self.first_mover :]]
        self._solid_grown_m = [0.0] * len(self.solids)
        reach = reach_of(arm, (*arm.shapes, *tool))
        pairs = [
            (first, second)
            for first in range(len(self.solids))
            for second in range(first + 1, len(self.solids))
            if self._can_touch(first, second, fixed_to_base)
            and (self.solids[second].name, self.solids[first].name) not in ignored
        ]
        owners = [(0, solid.body) for solid in self.solids[:fixed_to_base]]
        owners += [(1, 0)] * (self.first_mover - fixed_to_base)
        owners += [(number, each.body) for number, each in moved]
        pairs = _without_inner(pairs, [solid.shape for solid in self.solids], owners)
        bodies = [solid.body for solid in self.solids]
        pairs = [(a, b) if bodies[a] <= bodies[b] else (b, a) for a, b in pairs]
        masks, sweeps = np.zeros((len(pairs), n)), np.zeros((len(pairs), n))
        for row, (first, second) in enumerate(pairs):
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))
            low, high = bodies[first], bodies[second]
            masks[row, low:high] = 1.0
            sweeps[row, low:high] = reach[low:high, second]
        self.pairs = tuple((self.solids[a].name, self.solids[b].name) for a, b in pairs)
        """Names of the two shapes of each pair; the second's body moves more."""
        self.pair_solids = tuple(pairs)
        """Indices in `solids` of the two shapes of each pair."""
        self.with_obstacle = np.array([b >= fixed_to_base or a >= fixed_to_base for a, b in pairs])
        """True for pairs of which one is an obstacle, False within the arm."""
        self.grown_m: list[float] = [0.0] * len(pairs)
        """Extra distance that each pair is kept apart, for bodies that move by themselves, m."""
        self._masks = masks
        self.sweeps = sweeps
        """Largest approach of each pair per motion of each joint; pairs × n."""
        self._farthest = sweeps.max(axis=0) if pairs else np.zeros(n)
        self._data = self._geometry.createData()
        self._own = kinematics.model.createData()
        for index in range(len(pairs)):
            self._data.distanceRequests[index].enable_signed_distance = True
        self._results = [self._data.distanceResults[index] for index in range(len(pairs))]
        self.distances: list[float] = [math.inf] * len(pairs)
        """Distance of each pair at the last `update`, m."""

    def _add(self, name: str, body: int, shape: Shape | HalfSpace) -> None:
        geometry, placement = _coal_shape(shape)
        label = f"{name}#{len(self.solids)}"
        self._geometry.addGeometryObject(pin.GeometryObject(label, body, placement, geometry))
        self.solids.append(Solid(name, body, shape))

    def _can_touch(self, first: int, second: int, fixed_to_base: int) -> bool:
        bodies = self.solids[first].body, self.solids[second].body
        if bodies[0] == bodies[1]:
            return False
        if second >= fixed_to_base:
            return True  # An obstacle against a body of the arm.
        return self.kinematics.arm.keeps_apart(bodies, (first, second))

    def move(self, first: int, frames: Sequence[SE3], grown_m: Sequence[float]) -> None:
        """Place movers, from number `first` on, at their `frames` in the base, and keep each
        farther away by `grown_m`."""
        objects = self._geometry.geometryObjects
        for index, frame in enumerate(frames, first):
            objects[self.first_mover + index].placement = frame * self._local[index]
        self.grow(first, grown_m)
        self.grown_m = list(map(self.grown_of, range(len(self.pairs))))

    def grow(self, first: int, grown_m: Sequence[float]) -> None:
        """Set the extra distance of movers, from number `first` on: for `grown_of` alone."""
        begin = self.first_mover + first
        self._solid_grown_m[begin : begin + len(grown_m)] = grown_m

    def grown_of(self, pair: int) -> float:
        """Return the extra distance of `pair`, m."""
        return self._solid_grown_m[self.pair_solids[pair][0]]

    def update(self) -> list[float]:
        """Return the distances of all pairs where the kinematics was last updated, m; negative:
        overlap."""
        pin.updateGeometryPlacements(
            self.kinematics.model, self.kinematics._data, self._geometry, self._data
        )
        pin.computeDistances(self._geometry, self._data)
        self.distances = list(map(_MIN_DISTANCE, self._results))
        return self.distances

    def at(self, q: FloatArray) -> list[float]:
        """Return the distances of all pairs for `q`, m. Invalidates `gradients` until the next
        `update`."""
        pin.computeDistances(self.kinematics.model, self._own, self._geometry, self._data, q)
        return list(map(_MIN_DISTANCE, self._results))

    def closest(self) -> Closest:
        """Return the nearest pair of the last `update`, by its distance less the extra one for
        bodies that move by themselves."""
        if not self.distances:
            return Closest(math.inf, ("", ""))
        left = list(map(operator.sub, self.distances, self.grown_m))
        nearest = left.index(min(left))
        return Closest(self.distances[nearest], self.pairs[nearest], self.grown_m[nearest])

    def gradients(self, pairs: list[int], out: FloatArray) -> None:
        """Compute the growth of the distance of each of `pairs` per joint speed, at the last
        `update`.

        Fills the first rows of `out` (len(pairs) × n). The nearest points of both bodies lie on the
        normal, so one moment serves both.
        """
        edges = []
        for pair in pairs:
            result = self._results[pair]
            nx, ny, nz = result.normal.tolist()
            px, py, pz = result.getNearestPoint2().tolist()
            edges.append((nx, ny, nz, py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx))
        found = np.array(edges).dot(self.kinematics.joint_jacobians)
        np.multiply(found, self._masks[pairs], out=out[: len(pairs)])

    def sweep(self, step: FloatArray) -> FloatArray:
        """Return the largest approach of each pair, m, while joints move by `step`."""
        bound: FloatArray = self.sweeps.dot(np.abs(step))
        return bound

    def fastest_closing(self, v: FloatArray) -> float:
        """Return the upper bound, m/s, of the closing speed of any pair at the joint velocities
        `v`."""
        return float(self._farthest.dot(np.abs(v)))

    def free_share(
        self, start: FloatArray, end: FloatArray, margin_m: float
    ) -> tuple[float, tuple[str, str] | None]:
        """Return the share of the straight joint motion from `start` to `end` that keeps `margin_m`
        everywhere. Conservative advancement misses no body between the samples, however thin. A
        pair that is nearer than the margin already may give up a quarter of its distance, which is
        enough to detect that it separates. Returns 1.0 and None, or the share and the names of the
        pair that ends it.
        """
        if not self.pairs:
            return 1.0, None
        motion = self.sweep(end - start)
        moving = motion > 1e-9
        if not moving.any():
            return 1.0, None
        share, margins = 0.0, None
        while True:
            distances = np.array(self.at(start + share * (end - start)))
            if margins is None:
                give = np.maximum(0.25 * np.abs(distances), LEAST_ROOM_M)
                margins = np.minimum(margin_m, distances - give)
            room = np.where(moving, (distances - margins) / np.maximum(motion, 1e-12), np.inf)
            nearest = int(np.argmin(room))
            gain = float(room[nearest])
            if share + gain >= 1.0:
                return 1.0, None
            if gain < ADVANCE_STOP:
                return share, self.pairs[nearest]
            share += gain


def _without_inner(
    pairs: list[tuple[int, int]],
    shapes: Sequence[Shape | HalfSpace],
    owners: Sequence[tuple[int, int]],
) -> list[tuple[int, int]]:
    """Return the pairs without those of an inner shape whose outer shape has the same pair;
    `owners`: the body to which each of `shapes` is fixed. The lower index is the first of each
    pair."""
    around: list[list[int]] = [[] for _ in shapes]
    for one, other in itertools.permutations(range(len(shapes)), 2):
        if owners[one] != owners[other] or not _is_inside(shapes[one], shapes[other]):
            continue
        # Of two that are the same, the first is kept.
        if one > other or not _is_inside(shapes[other], shapes[one]):
            around[one].append(other)
    retained = set(pairs)
    return [
        (a, b)
        for a, b in pairs
        if not any((min(each, b), max(each, b)) in retained for each in around[a])
        and not any((min(a, each), max(a, each)) in retained for each in around[b])
    ]


def _is_inside(shape: Shape | HalfSpace, other: Shape | HalfSpace) -> bool:
    """Return whether no point of `shape` is outside `other`."""
    if isinstance(shape, HalfSpace) or isinstance(other, HalfSpace):
        return False
    corners, radius_m = hull_of(shape)
    points = np.array(corners)
    if isinstance(other, OrientedBox):
        local = (points - other.pose.position) @ to_se3(other.pose).rotation
        return bool((np.abs(local) + radius_m <= 0.5 * np.array(other.size_m)).all())
    along, offset = np.subtract(other.end, other.start), points - other.start
    share = np.clip(offset @ along / max(along @ along, TINY), 0.0, 1.0)
    away = np.linalg.norm(offset - share[:, None] * along, axis=1)
    return bool((away + radius_m <= other.radius_m).all())


def hull_of(shape: Shape) -> tuple[list[Vector3], float]:
    """Return points around which a ball of the radius sweeps the convex shape."""
    if isinstance(shape, Capsule):
        return [shape.start, shape.end], shape.radius_m
    half = [0.5 * size for size in shape.size_m]
    corners = itertools.product(*((-each, each) for each in half))
    turn, at = shape.pose.orientation, shape.pose.position
    return [add(at, rotate(turn, Vector3(*corner))) for corner in corners], 0.0


def _coal_shape(shape: Shape | HalfSpace) -> tuple[Any, Any]:
    if isinstance(shape, HalfSpace):
        return coal.Halfspace(np.array(shape.normal), shape.offset_m), pin.SE3.Identity()
    return coal_shape(shape)


def reach_of(arm: ArmModel, shapes: tuple[BodyShape, ...]) -> FloatArray:
    """Return the largest distance of any point of each shape from each joint's axis (1.0 for a
    prismatic one: meters per meter), for any position of the joints between them. n × shapes."""
    n = len(arm.joints)
    reach = np.zeros((n, len(shapes)))
    for column, shape in enumerate(shapes):
        farthest = _extent(shape.shape)
        for joint in range(shape.body - 1, -1, -1):
            if arm.joints[joint].kind is JointKind.PRISMATIC:
                reach[joint, column] = 1.0
                farthest += max(abs(arm.joints[joint].lower), abs(arm.joints[joint].upper))
            else:
                reach[joint, column] = farthest
            farthest += norm(arm.joints[joint].placement.position)
    return reach


def _extent(shape: Shape) -> float:
    if isinstance(shape, Capsule):
        return max(norm(shape.start), norm(shape.end)) + shape.radius_m
    return norm(shape.pose.position) + 0.5 * norm(shape.size_m)


def box_obstacle(name: str, low: Vector3, high: Vector3) -> Obstacle:
    """A box from its lowest to its highest corner, base axes, m."""
    with below(name):
        return Obstacle(name, OrientedBox.between(low, high))
