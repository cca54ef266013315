"""Fixtures: made of their tables, put where the TCP is, and evaluated.

In a session the device's own loop evaluates them, 1000 times a second on the place of the stylus.
The evaluation here is for a force node, which does it on the robot's TCP as the paper of 2026 has
it, and for contacts that are computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.gateway.force.tables import FixtureTable
from cardan.haptics import (
    IDENTITY3,
    Box,
    Cylinder,
    Fixture,
    Matrix3,
    Plane,
    Sphere,
    Spring,
    Viscous,
    WorldMap,
)
from cardan.spatial import add, dot, from_euler_zyx, limit_norm, norm, rotate, scale, subtract
from cardan.types import ZERO3, Quaternion, Vector3

UP = Vector3(0.0, 0.0, 1.0)
"""Where a body pushes whose very centre the point is in: every direction is as near."""


def matrix_of(q: Quaternion) -> Matrix3:
    """The rotation `q` as a matrix, row by row."""
    x, y, z = (
        rotate(q, unit)
        for unit in (Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0))
    )
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])


def turned(matrix: Matrix3, v: Vector3) -> Vector3:
    """`matrix` · `v`."""
    a, b, c, d, e, f, g, h, i = matrix
    x, y, z = v
    return Vector3(a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)


def turned_back(matrix: Matrix3, v: Vector3) -> Vector3:
    """`matrix`ᵀ · `v`."""
    a, b, c, d, e, f, g, h, i = matrix
    x, y, z = v
    return Vector3(a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z)


def world_point(world: WorldMap, hand: Vector3) -> Vector3:
    """Where `hand` is in the world."""
    return add(turned(world.linear, hand), world.offset)


def unit(direction: Sequence[float]) -> Vector3:
    """`direction` at length 1."""
    v = Vector3(*direction)
    return scale(v, 1.0 / norm(v))


def make_fixture(table: FixtureTable, tcp: Vector3 | None = None) -> Fixture:
    """The fixture of `table`; one with `at` stands where `tcp` is."""
    shape, cap, damping = table.shape, table.cap_n, table.damping_n_s_m
    if shape == "viscous":
        return Viscous(damping, cap)
    k = table.stiffness_n_m
    assert k is not None
    if shape in ("plane", "spring"):
        given = table.point_m if shape == "plane" else table.target_m
        place = tcp if given is None else Vector3(*given)
        assert place is not None
        if shape == "spring":
            return Spring(place, k, cap, damping)
        assert table.normal is not None
        return Plane(place, unit(table.normal), k, cap, damping)
    if shape == "box":
        assert table.centre_m is not None
        assert table.half_sides_m is not None
        rotation = IDENTITY3
        if table.rpy_deg is not None:
            rotation = matrix_of(from_euler_zyx(*map(math.radians, table.rpy_deg)))
        sides = Vector3(*table.half_sides_m)
        return Box(Vector3(*table.centre_m), sides, k, cap, damping, table.inside, rotation)
    assert table.radius_m is not None
    if shape == "sphere":
        assert table.centre_m is not None
        centre = Vector3(*table.centre_m)
        return Sphere(centre, table.radius_m, k, cap, damping, table.inside)
    assert table.point_m is not None
    assert table.axis is not None
    point, axis = Vector3(*table.point_m), unit(table.axis)
    return Cylinder(point, axis, table.radius_m, k, cap, damping, table.inside)


class FixtureSet:
    """The fixtures of a session, those with `at` where the TCP was when their moment came."""

    def __init__(self, tables: Sequence[FixtureTable]) -> None:
        self._tables = tuple(tables)
        self._made: list[Fixture | None] = [
            make_fixture(table) if table.at is None else None for table in tables
        ]
        self.fixtures: tuple[Fixture, ...] = ()
        """Those whose place is known. The same object until that changes."""
        self._gather()

    def place(self, moment: str, tcp: Vector3) -> None:
        """Put those whose `at` is `moment` at `tcp`."""
        if not any(table.at == moment for table in self._tables):
            return
        for index, table in enumerate(self._tables):
            if table.at == moment:
                self._made[index] = make_fixture(table, tcp)
        self._gather()

    def _gather(self) -> None:
        self.fixtures = tuple(each for each in self._made if each is not None)


def fixture_force(fixture: Fixture, point: Vector3, velocity: Vector3 = ZERO3) -> Vector3:
    """The force of `fixture` on a body at `point` that moves at `velocity` (m, m/s, N; world)."""
    if isinstance(fixture, Viscous):
        return limit_norm(scale(velocity, -fixture.damping_n_s_m), fixture.cap_n)
    if isinstance(fixture, Spring):
        pull = scale(subtract(fixture.target, point), fixture.stiffness_n_m)
        drag = scale(velocity, -fixture.damping_n_s_m)
        return limit_norm(add(pull, drag), fixture.cap_n)
    if isinstance(fixture, Box):
        return _box_force(fixture, point, velocity)
    if isinstance(fixture, Plane):
        outward, depth = fixture.normal, dot(subtract(fixture.point, point), fixture.normal)
    elif isinstance(fixture, Sphere):
        outward, depth = _round(subtract(point, fixture.centre), fixture.radius_m, fixture.inside)
    else:
        away = subtract(point, fixture.point)
        radial = subtract(away, scale(fixture.axis, dot(away, fixture.axis)))
        outward, depth = _round(radial, fixture.radius_m, fixture.inside)
    return _push(outward, depth, velocity, fixture)


def _round(away: Vector3, radius: float, inside: bool) -> tuple[Vector3, float]:
    distance = norm(away)
    outward = scale(away, 1.0 / distance) if distance > 1e-9 else UP
    return (scale(outward, -1.0), distance - radius) if inside else (outward, radius - distance)


def _push(
    outward: Vector3, depth: float, velocity: Vector3, fixture: Sphere | Plane | Cylinder | Box
) -> Vector3:
    if depth <= 0.0:
        return ZERO3
    pressed = fixture.stiffness_n_m * depth - fixture.damping_n_s_m * dot(velocity, outward)
    return scale(outward, min(max(pressed, 0.0), fixture.cap_n))


def _box_force(box: Box, point: Vector3, velocity: Vector3) -> Vector3:
    local = turned_back(box.rotation, subtract(point, box.centre))
    moving = turned_back(box.rotation, velocity)
    depths = [half - abs(at) for half, at in zip(box.half_sides_m, local, strict=True)]
    units = (Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0))
    force = ZERO3
    if box.inside:
        for axis in range(3):
            inward = scale(units[axis], -1.0 if local[axis] > 0.0 else 1.0)
            force = add(force, _push(inward, -depths[axis], moving, box))
        force = limit_norm(force, box.cap_n)
    elif min(depths) > 0.0:
        nearest = depths.index(min(depths))
        outward = scale(units[nearest], math.copysign(1.0, local[nearest]))
        force = _push(outward, depths[nearest], moving, box)
    return turned(box.rotation, force)
