"""What is checked of every command before anything else: length, numbers, rotation, workspace."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.errors import MotionRefusedError
from cardan.spatial import from_rotation_vector, is_finite, normalized, to_rotation_vector
from cardan.types import Frame, Pose, Vector3

Six = tuple[float, float, float, float, float, float]
Target = Pose | Sequence[float]
"""A pose, or its six numbers: position (m) and rotation vector (rad)."""
Workspace = tuple[
    tuple[float, float] | None, tuple[float, float] | None, tuple[float, float] | None
]

LARGEST_NUMBER = 1e4
"""Largest accepted m, rad, m/s, N or N·m: more is a mistake of units, and could overflow."""

UNIT_TOLERANCE = 1e-3
"""Largest deviation of a quaternion's length from 1 that can be rounding."""


def six_numbers(verb: str, values: Sequence[float]) -> Six:
    """`values` as six finite floats. Raises MotionRefusedError that says what is wrong."""
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError, OverflowError):
        raise MotionRefusedError(f"{verb} takes six numbers, not {values!r}") from None
    if len(numbers) != 6:
        raise MotionRefusedError(f"{verb} takes six numbers, not {len(numbers)}")
    for index, number in enumerate(numbers):
        if not math.isfinite(number):
            raise MotionRefusedError(f"{verb}: number {index + 1} of 6 is {number}")
        if abs(number) > LARGEST_NUMBER:
            raise MotionRefusedError(
                f"{verb}: number {index + 1} of 6 is {number:g}; no arm goes beyond "
                f"{LARGEST_NUMBER:g}"
            )
    x, y, z, rx, ry, rz = numbers
    return x, y, z, rx, ry, rz


def checked_pose(verb: str, target: Target) -> Pose:
    """`target` as a pose. Raises MotionRefusedError."""
    if isinstance(target, Pose):
        position, orientation = target.position, target.orientation
        if not is_finite((*position, *orientation)):
            raise MotionRefusedError(f"{verb}: the pose has values that are not numbers: {target}")
        if max(map(abs, position)) > LARGEST_NUMBER:
            raise MotionRefusedError(f"{verb}: no arm reaches the position {tuple(position)}")
        length = math.sqrt(sum(c * c for c in orientation))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise MotionRefusedError(
                f"{verb}: the quaternion {tuple(orientation)} has length {length:.4g}, not 1"
            )
        return Pose(Vector3(*position), normalized(orientation), Frame.BASE)
    x, y, z, rx, ry, rz = six_numbers(verb, target)
    return Pose(Vector3(x, y, z), from_rotation_vector(Vector3(rx, ry, rz)), Frame.BASE)


def six_of(pose: Pose) -> Six:
    """Position (m) and rotation vector (rad, length at most pi) of a pose."""
    rotation = to_rotation_vector(pose.orientation)
    return (*pose.position, *rotation)


def check_workspace(verb: str, position: Sequence[float], workspace: Workspace) -> None:
    """Raises MotionRefusedError for a position (base axes, m) outside of the box."""
    for axis, value, bounds in zip("xyz", position, workspace, strict=True):
        if bounds is not None and not bounds[0] <= value <= bounds[1]:
            raise MotionRefusedError(
                f"{verb}: {axis} = {value:.4f} m is outside of the workspace, "
                f"{bounds[0]:.4f} to {bounds[1]:.4f} m"
            )
