"""Kinematics of the simulated arms, from UR's Denavit-Hartenberg tables.

Independent of the package's other kinematics on purpose: the models of the arms are checked against
this. Poses are those of the controller: in its own base, which is turned by pi about z from
`base_link`; of tool0.

Source: UR's article on DH parameters (nominal values).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cardan.spatial import compose, from_rotation_vector, to_rotation_vector
from cardan.types import IDENTITY_POSE, Pose, Vector3


class Dh(NamedTuple):
    """One link, Rz(q)·Tz(d)·Tx(a)·Rx(alpha); m, rad."""

    d: float
    a: float
    alpha: float


_QUARTER = 0.5 * math.pi

TABLES: Mapping[str, tuple[Dh, ...]] = {
    "ur5": (
        Dh(0.089159, 0.0, _QUARTER),
        Dh(0.0, -0.425, 0.0),
        Dh(0.0, -0.39225, 0.0),
        Dh(0.10915, 0.0, _QUARTER),
        Dh(0.09465, 0.0, -_QUARTER),
        Dh(0.0823, 0.0, 0.0),
    ),
    "ur5e": (
        Dh(0.1625, 0.0, _QUARTER),
        Dh(0.0, -0.425, 0.0),
        Dh(0.0, -0.3922, 0.0),
        Dh(0.1333, 0.0, _QUARTER),
        Dh(0.0997, 0.0, -_QUARTER),
        Dh(0.0996, 0.0, 0.0),
    ),
}


def tcp_pose(links: Sequence[Dh], joints: Sequence[float]) -> Pose:
    """Where tool0 is."""
    pose = IDENTITY_POSE
    for link, angle in zip(links, joints, strict=True):
        turn = Pose(Vector3(0.0, 0.0, link.d), from_rotation_vector(Vector3(0.0, 0.0, angle)))
        twist = Pose(Vector3(link.a, 0.0, 0.0), from_rotation_vector(Vector3(link.alpha, 0.0, 0.0)))
        pose = compose(compose(pose, turn), twist)
    return pose


def as_vector(pose: Pose) -> tuple[float, ...]:
    """x y z in m and the rotation vector in rad, as a controller gives poses."""
    return (*pose.position, *to_rotation_vector(pose.orientation))
