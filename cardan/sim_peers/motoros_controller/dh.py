"""Denavit-Hartenberg parameters of any serial arm, from its joint axes.

The classical convention: frame i sits on the axis of joint i + 1, x along the common normal of
the axes before and after link i, and link i is Rot_z(theta + q) Trans_z(d) Trans_x(a) Rot_x(alpha)
(of a prismatic joint q adds to d). The last frame keeps the direction of the last axis and lies
where the flange is along it: four numbers a link cannot hold the flange's offset beside that axis
or its rotation against it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cardan.protocols.simple_message.messages import DhLink
from cardan.robots import ArmModel
from cardan.spatial import add, compose, cross, dot, norm, rotate, scale, subtract
from cardan.types import IDENTITY_POSE, Vector3

_PARALLEL = 1e-7
_COINCIDENT_M = 1e-7


class DhTable(NamedTuple):
    """Frame 0 in the arm's base, and the links from it."""

    origin: Vector3
    x: Vector3
    z: Vector3
    links: tuple[DhLink, ...]


def dh_table(arm: ArmModel) -> DhTable:
    """Return the parameters of `arm`; lengths in m, angles in rad."""
    points, axes = [], []
    pose = IDENTITY_POSE
    for joint in arm.joints:
        pose = compose(pose, joint.placement)
        points.append(pose.position)
        axes.append(rotate(pose.orientation, joint.axis))
    flange = compose(pose, arm.flange).position
    z0, origin0 = axes[0], points[0]
    x0 = _unit_a_cross(Vector3(1.0, 0.0, 0.0), z0) or _unit_a_cross(Vector3(0.0, 1.0, 0.0), z0)
    assert x0 is not None
    origin, x, z = origin0, x0, z0
    links = []
    for point, axis in zip(points[1:], axes[1:], strict=True):
        x_next, origin_next = _common_normal(origin, x, z, point, axis)
        links.append(_link(origin, x, z, origin_next, x_next, axis))
        origin, x, z = origin_next, x_next, axis
    along = dot(subtract(flange, origin), z)
    links.append(DhLink(0.0, along, 0.0, 0.0))
    return DhTable(origin0, x0, z0, tuple(links))


def _unit_a_cross(vector: Vector3, axis: Vector3) -> Vector3 | None:
    """Return the unit component of `vector` across `axis`; None if it is zero."""
    across = subtract(vector, scale(axis, dot(vector, axis)))
    length = norm(across)
    return scale(across, 1.0 / length) if length > _PARALLEL else None


def _common_normal(
    origin: Vector3, x: Vector3, z: Vector3, point: Vector3, axis: Vector3
) -> tuple[Vector3, Vector3]:
    """Return the direction of the common normal of two axes, and its foot on the second."""
    normal = cross(z, axis)
    sine = norm(normal)
    between = subtract(point, origin)
    if sine < _PARALLEL:
        # Parallel axes have many normals; the one through `origin` makes d zero.
        across = subtract(between, scale(z, dot(between, z)))
        length = norm(across)
        if length < _COINCIDENT_M:
            return x, point
        return scale(across, 1.0 / length), add(origin, across)
    x_next = scale(normal, 1.0 / sine)
    # Point of the second axis closest to the first.
    along = dot(cross(between, z), normal) / (sine * sine)
    foot = add(point, scale(axis, along))
    a = dot(between, x_next)
    if a < -_COINCIDENT_M or (abs(a) <= _COINCIDENT_M and dot(x_next, x) < -_PARALLEL):
        x_next = scale(x_next, -1.0)
    return x_next, foot


def _link(
    origin: Vector3, x: Vector3, z: Vector3, origin_next: Vector3, x_next: Vector3, z_next: Vector3
) -> DhLink:
    between = subtract(origin_next, origin)
    theta = math.atan2(dot(cross(x, x_next), z), dot(x, x_next))
    alpha = math.atan2(dot(cross(z, z_next), x_next), dot(z, z_next))
    return DhLink(theta, dot(between, z), dot(between, x_next), alpha)
