"""Haptic fixtures: construction from their tables, placement at the TCP, evaluation. In a session
the device's own loop evaluates them, 1000 times a second at the position of the stylus. The
evaluation here is for a force node, which uses the robot's TCP as in the paper of 2026, and for
computed contacts."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.common.haptics import (
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
from cardan.common.options import Options
from cardan.spatial import add, dot, limit_norm, norm, rotate, scale, subtract
from cardan.types import ZERO3, Quaternion, Vector3

UP = Vector3(0.0, 0.0, 1.0)
"""Direction of the push at a body's very center, where all directions are equally near."""


def matrix_of(q: Quaternion) -> Matrix3:
    """Return the rotation `q` as a matrix, row by row."""
    x, y, z = (
        rotate(q, unit)
        for unit in (Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0))
    )
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])


def turned(matrix: Matrix3, v: Vector3) -> Vector3:
    """Return `matrix` · `v`."""
    a, b, c, d, e, f, g, h, i = matrix
    x, y, z = v
    return Vector3(a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)


def turned_back(matrix: Matrix3, v: Vector3) -> Vector3:
    """Return `matrix`ᵀ · `v`."""
    a, b, c, d, e, f, g, h, i = matrix
    x, y, z = v
    return Vector3(a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z)


def world_point(world: WorldMap, hand: Vector3) -> Vector3:
    """Return the position of `hand` in the world."""
    return add(turned(world.linear, hand), world.offset)


def unit(direction: Sequence[float]) -> Vector3:
    """Return `direction` scaled to length 1."""
    v = Vector3(*direction)
    return scale(v, 1.0 / norm(v))


@dataclass(frozen=True, kw_only=True)
class FixtureTable(Options, ABC):
    """One of ``[[fixtures]]``: geometry in the robot's base frame that pushes the hand."""

    cap_n: Annotated[float, bounds.HAND_FORCE_N] = 3.0

    @property
    def moment(self) -> str:
        """Event at which it is placed at the TCP; empty: its position is configured."""
        return ""

    @abstractmethod
    def made(self, tcp: Vector3 = ZERO3) -> Fixture:
        """Make the fixture; without a configured position it stands at `tcp`."""


class FixtureSet:
    """The fixtures of a session, those with `at` placed at the TCP when that event comes."""

    def __init__(self, tables: Sequence[FixtureTable]) -> None:
        self._tables = tuple(tables)
        self._made: list[Fixture | None] = [
            None if table.moment else table.made() for table in tables
        ]
        self.fixtures: tuple[Fixture, ...] = ()
        """Fixtures with a known position. The same object until that changes."""
        self._gather()

    def place(self, moment: str, tcp: Vector3) -> None:
        """Place those with the event `moment` at `tcp`."""
        if not any(table.moment == moment for table in self._tables):
            return
        for index, table in enumerate(self._tables):
            if table.moment == moment:
                self._made[index] = table.made(tcp)
        self._gather()

    def _gather(self) -> None:
        self.fixtures = tuple(each for each in self._made if each is not None)


def fixture_force(fixture: Fixture, point: Vector3, velocity: Vector3 = ZERO3) -> Vector3:
    """Return the force of `fixture` on a body at `point` that moves at `velocity` (m, m/s, N;
    world)."""
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
        outward, depth = outward_of_round(
            subtract(point, fixture.center), fixture.radius_m, fixture.inside
        )
    else:
        away = subtract(point, fixture.point)
        radial = subtract(away, scale(fixture.axis, dot(away, fixture.axis)))
        outward, depth = outward_of_round(radial, fixture.radius_m, fixture.inside)
    return _push(outward, depth, velocity, fixture)


def outward_of_round(away: Vector3, radius: float, inside: bool = False) -> tuple[Vector3, float]:
    """Return the unit vector out of a round body's material, and the depth, m, of the point that is
    `away` from its center or axis."""
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
    local = turned_back(box.rotation, subtract(point, box.center))
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
