"""Conversions between the tracker's axes and the operator's: positions, directions, and the
attitude of a hand.

Tracker: x right, y up, z towards the operator, mm. Operator (and robot): x forward, y left, z up,
m; an attitude is the identity when the palm is down and the fingers point forward.
"""

from __future__ import annotations

import math

from cardan.types import Quaternion, Vector3

M_PER_MM = 0.001
_PARALLEL = 1e-3
"""Sine of the angle between direction and normal below which they do not define a hand's
attitude."""


def vector_from_leap(v: Vector3) -> Vector3:
    """Convert a vector from the tracker's axes to the operator's: forward -z, left -x, up y."""
    # Subtracting from 0.0 instead of negating keeps rest free of negative zeros.
    return Vector3(0.0 - v[2], 0.0 - v[0], v[1])


def vector_to_leap(v: Vector3) -> Vector3:
    """Convert a vector back, the inverse of `vector_from_leap`."""
    return Vector3(0.0 - v[1], v[2], 0.0 - v[0])


def position_from_leap(position_mm: Vector3) -> Vector3:
    """Convert a position from the tracker's axes, mm, to the operator's, m."""
    x, y, z = position_mm
    return Vector3(0.0 - z * M_PER_MM, 0.0 - x * M_PER_MM, y * M_PER_MM)


def position_to_leap(position_m: Vector3) -> Vector3:
    """Convert a position back, the inverse of `position_from_leap`."""
    x, y, z = position_m
    return Vector3(0.0 - y / M_PER_MM, z / M_PER_MM, 0.0 - x / M_PER_MM)


def hand_orientation(direction: Vector3, palm_normal: Vector3) -> Quaternion | None:
    """Return the attitude of a hand in the operator's axes, from two vectors in the tracker's:
    `direction`, and the part of `palm_normal` perpendicular to it. None: they are too short, or
    parallel.
    """
    fx, fy, fz = vector_from_leap(direction)
    nx, ny, nz = vector_from_leap(palm_normal)
    length = math.sqrt(fx * fx + fy * fy + fz * fz)
    normal_length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if not (0.1 < length < 10.0 and 0.1 < normal_length < 10.0):
        return None
    fx, fy, fz = fx / length, fy / length, fz / length
    along = fx * nx + fy * ny + fz * nz
    ux, uy, uz = along * fx - nx, along * fy - ny, along * fz - nz
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    if length < _PARALLEL * normal_length:
        return None
    ux, uy, uz = ux / length, uy / length, uz / length
    left_x, left_y, left_z = uy * fz - uz * fy, uz * fx - ux * fz, ux * fy - uy * fx
    return _from_columns(fx, fy, fz, left_x, left_y, left_z, ux, uy, uz)


def direction_and_normal(orientation: Quaternion) -> tuple[Vector3, Vector3]:
    """Return `direction` and `palmNormal` of a hand of this attitude, in the tracker's axes."""
    w, x, y, z = orientation
    forward = Vector3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
    down = Vector3(-2.0 * (x * z + w * y), 2.0 * (w * x - y * z), 2.0 * (x * x + y * y) - 1.0)
    return vector_to_leap(forward), vector_to_leap(down)


def pitch_yaw_roll(direction: Vector3, palm_normal: Vector3) -> tuple[float, float, float]:
    """Return the vendor's three angles of a hand, rad: fingers up, fingers to the right, left edge
    down.

    They degenerate when the fingers point up or back; an attitude does not.
    """
    return (
        math.atan2(direction[1], -direction[2]),
        math.atan2(direction[0], -direction[2]),
        math.atan2(palm_normal[0], -palm_normal[1]),
    )


def _from_columns(
    xx: float, xy: float, xz: float,
    yx: float, yy: float, yz: float,
    zx: float, zy: float, zz: float,
) -> Quaternion:  # fmt: skip
    """Return the unit quaternion of the rotation with these columns, scalar not negative."""
    # Each component is first found as a square; dividing by the largest preserves precision.
    squares = (1.0 + xx + yy + zz, 1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz)
    largest = squares.index(max(squares))
    double = 2.0 * math.sqrt(squares[largest])
    if largest == 0:
        q = (double / 4.0, (yz - zy) / double, (zx - xz) / double, (xy - yx) / double)
    elif largest == 1:
        q = ((yz - zy) / double, double / 4.0, (yx + xy) / double, (zx + xz) / double)
    elif largest == 2:
        q = ((zx - xz) / double, (yx + xy) / double, double / 4.0, (zy + yz) / double)
    else:
        q = ((xy - yx) / double, (zx + xz) / double, (zy + yz) / double, double / 4.0)
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    return Quaternion(w, x, y, z)
