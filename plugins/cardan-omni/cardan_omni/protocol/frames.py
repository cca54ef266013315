"""HDAPI's axes and the hand's: x right, y up, z to the operator; x forward, y left, z up."""

from __future__ import annotations

from collections.abc import Sequence

from cardan.types import Quaternion, Vector3

HAND_FROM_DEVICE = (
    (0.0, 0.0, -1.0),
    (-1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
)
"""Rotation by rows, determinant +1: v_hand = R · v_device, rotations R · M · Rᵀ, forces back with
Rᵀ."""


def to_hand(v: Sequence[float]) -> Vector3:
    """Convert a vector from HDAPI's axes to the hand's."""
    return Vector3(-v[2], -v[0], v[1])


def to_device(v: Sequence[float]) -> Vector3:
    """Convert a vector from the hand's axes to HDAPI's."""
    return Vector3(-v[1], v[2], -v[0])


def rotation_to_hand(q: Quaternion) -> Quaternion:
    """Convert a rotation from the device frame to the hand frame."""
    return Quaternion(q.w, *to_hand(q[1:]))


def rotation_to_device(q: Quaternion) -> Quaternion:
    """Convert a rotation from the hand frame to the device frame."""
    return Quaternion(q.w, *to_device(q[1:]))
