"""Kinematics of an arm for the servo: the pose of its TCP, and the motion by each joint."""

from __future__ import annotations

import math
from typing import Protocol

from cardan.common.arm_libraries import np, npt, pin
from cardan.robots.arm_bodies import (
    SE3 as SE3,
    FloatArray as FloatArray,
    to_se3 as to_se3,
)
from cardan.types import Frame, Pose, Quaternion, Vector3

TURN = 2.0 * math.pi


class Kinematics(Protocol):
    """An arm, or any other mechanism whose joints move one TCP. Angles in rad, lengths in m."""

    joints: int
    names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    continuous: npt.NDArray[np.bool_]
    placement: SE3
    """Placement of the TCP in the base at the last `update`."""
    jacobian: FloatArray
    """6×n: twist of the TCP along its own axes, linear part first, a column a joint."""

    def update(self, q: FloatArray) -> None:
        """Set `placement` and `jacobian` for the joint positions `q` (n)."""

    def forward(self, q: FloatArray) -> SE3:
        """Return the TCP in the base for `q`, without changing `placement` and `jacobian`."""

    def inverse(self, placement: SE3, near: FloatArray) -> FloatArray | None:
        """Return joint positions inside the limits that put the TCP at `placement`, on the branch
        nearest to `near`; None if there are none."""


def short_way(difference: FloatArray, continuous: npt.NDArray[np.bool_]) -> FloatArray:
    """Return joint differences without the whole turns of `continuous` joints."""
    turns = np.rint(difference / TURN)
    return np.where(continuous, difference - TURN * turns, difference)


def to_pose(placement: SE3) -> Pose:
    """Convert a placement in the base to a Pose."""
    x, y, z, i, j, k, w = pin.SE3ToXYZQUAT(placement).tolist()
    return Pose(Vector3(x, y, z), Quaternion(w, i, j, k), Frame.BASE)
