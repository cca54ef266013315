"""Rotations and rigid motions on the value types of :mod:`cardan.types`.

Plain Python on purpose: a control tick handles a handful of three-vectors, where one numpy call
costs more than the whole product written out.

Rotation vectors are axis times angle in rad. Quaternions are scalar first and active: `rotate(q,
v)` expresses in the outer frame a vector given in the frame that `q` orients.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.types import IDENTITY, ZERO3, Frame, Pose, Quaternion, Vector3

_SMALL_ANGLE = 1e-8
"""Below this angle (rad) sin(x)/x is 1 to the last bit of a double."""

_SKEW = 1e-3
"""Largest deviation of a matrix from orthonormal that counts as rounding: single precision and six
printed digits stay below it."""


def norm(v: Vector3) -> float:
    """Length of `v`."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def dot(a: Vector3, b: Vector3) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def add(a: Vector3, b: Vector3) -> Vector3:
    """Sum."""
    return Vector3(a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector3, b: Vector3) -> Vector3:
    """`a` minus `b`."""
    return Vector3(a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(v: Vector3, factor: float) -> Vector3:
    """`v` times `factor`."""
    return Vector3(v[0] * factor, v[1] * factor, v[2] * factor)


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector product."""
    return Vector3(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def limit_norm(v: Vector3, longest: float) -> Vector3:
    """Shorten `v` to `longest` if it is longer; the direction stays."""
    x, y, z = v
    length = math.sqrt(x * x + y * y + z * z)
    return v if length <= longest else scale(v, longest / length)


def towards(now: Vector3, target: Vector3, most: float) -> Vector3:
    """Return `target`, or the point at most `most` from `now` on the way to it."""
    x, y, z = now
    u, v, w = target
    u, v, w = u - x, v - y, w - z
    squared = u * u + v * v + w * w
    if squared <= most * most:
        return target
    share = most / math.sqrt(squared)
    return tuple.__new__(Vector3, (x + u * share, y + v * share, z + w * share))


def is_finite(values: tuple[float, ...]) -> bool:
    """True when no element is NaN or infinite."""
    return all(map(math.isfinite, values))


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Product of rotations: `b` followed by `a`, both in the outer frame."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return Quaternion(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """The inverse rotation of a unit quaternion."""
    return Quaternion(q[0], -q[1], -q[2], -q[3])


def normalized(q: Quaternion) -> Quaternion:
    """Scale `q` to unit length. Raises ValueError for a length of zero."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if not 1e-12 < length < math.inf:
        raise ValueError(f"quaternion {tuple(q)} has no direction")
    return Quaternion(q[0] / length, q[1] / length, q[2] / length, q[3] / length)


def same_hemisphere(q: Quaternion, reference: Quaternion) -> Quaternion:
    """Return `q` or -q (the same rotation), whichever is nearer to `reference`."""
    if q[0] * reference[0] + q[1] * reference[1] + q[2] * reference[2] + q[3] * reference[3] < 0:
        return Quaternion(-q[0], -q[1], -q[2], -q[3])
    return q


def rotate(q: Quaternion, v: Vector3) -> Vector3:
    """Express in the outer frame a vector `v` of the frame that `q` orients."""
    w, x, y, z = q
    vx, vy, vz = v
    tx = 2.0 * (y * vz - z * vy)
    ty = 2.0 * (z * vx - x * vz)
    tz = 2.0 * (x * vy - y * vx)
    return Vector3(
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def from_rotation_vector(v: Vector3) -> Quaternion:
    """The rotation about `v` by its length in rad (the exponential map)."""
    angle = norm(v)
    if angle < _SMALL_ANGLE:
        return normalized(Quaternion(1.0, 0.5 * v[0], 0.5 * v[1], 0.5 * v[2]))
    factor = math.sin(0.5 * angle) / angle
    return Quaternion(math.cos(0.5 * angle), v[0] * factor, v[1] * factor, v[2] * factor)


def turned_by(q: Quaternion, by: Vector3) -> Quaternion:
    """Rotate the orientation `q` by a rotation vector of the outer frame."""
    # Called in every control cycle: exponential map, product and `normalized` are written out.
    x, y, z = by
    angle = math.sqrt(x * x + y * y + z * z)
    factor = 0.5 if angle < _SMALL_ANGLE else math.sin(0.5 * angle) / angle
    a, b, c, d = math.cos(0.5 * angle), x * factor, y * factor, z * factor
    w, x, y, z = q
    u, i = a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y
    j, k = a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w
    length = math.sqrt(u * u + i * i + j * j + k * k)
    if not 1e-12 < length < math.inf:
        raise ValueError(f"quaternion {(u, i, j, k)} has no direction")
    return tuple.__new__(Quaternion, (u / length, i / length, j / length, k / length))


def moved(pose: Pose, linear: Vector3, angular: Vector3, dt_s: float) -> Pose:
    """Return `pose`, in the base frame, after `dt_s` at a velocity in base axes, m/s and rad/s."""
    (x, y, z), orientation, _ = pose
    u, v, w = linear
    if angular != ZERO3:
        rx, ry, rz = angular
        turn = tuple.__new__(Vector3, (rx * dt_s, ry * dt_s, rz * dt_s))
        orientation = turned_by(orientation, turn)
    position = tuple.__new__(Vector3, (x + u * dt_s, y + v * dt_s, z + w * dt_s))
    return tuple.__new__(Pose, (position, orientation, Frame.BASE))


def to_rotation_vector(q: Quaternion) -> Vector3:
    """The shortest rotation vector of a unit quaternion, rad (the logarithm); |v| <= pi."""
    w, x, y, z = q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])
    sine = math.sqrt(x * x + y * y + z * z)
    if sine < _SMALL_ANGLE:
        return Vector3(2.0 * x, 2.0 * y, 2.0 * z)
    factor = 2.0 * math.atan2(sine, w) / sine
    return Vector3(x * factor, y * factor, z * factor)


def to_rows(q: Quaternion) -> tuple[tuple[float, float, float], ...]:
    """The three rows of the rotation's matrix. Raises ValueError for a quaternion of length 0."""
    w, x, y, z = normalized(q)
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def from_rows(rows: Sequence[Sequence[float]]) -> Quaternion:
    """The rotation of a matrix, its scalar not negative. Raises ValueError for one that is skewed,
    scaled or mirrored."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    # Each row is the quaternion times 4 w, 4 x, 4 y or 4 z: the longest has the least error.
    found = max(
        (1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        (zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx),
        (xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy),
        (yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz),
        key=lambda each: math.hypot(*each),
    )
    q = same_hemisphere(normalized(Quaternion(*found)), IDENTITY)
    for row, exact in zip(rows, to_rows(q), strict=True):
        if not all(abs(a - b) <= _SKEW for a, b in zip(row, exact, strict=True)):
            given = [[*each] for each in rows]
            raise ValueError(f"the matrix {given} is not a rotation")
    return q


def from_axes(x: Vector3, y: Vector3) -> Quaternion:
    """Rotation that maps the axes x and y to these perpendicular unit vectors."""
    axis = cross(Vector3(1.0, 0.0, 0.0), x)
    sine = norm(axis)
    if sine < 1e-10:
        axis, sine = Vector3(0.0, 0.0, 1.0), 1.0
    angle = math.atan2(math.hypot(x[1], x[2]), x[0])
    first = from_rotation_vector(scale(axis, angle / sine))
    there = rotate(conjugate(first), y)
    return multiply(first, from_rotation_vector(Vector3(math.atan2(there[2], there[1]), 0.0, 0.0)))


def rotation_between(a: Quaternion, b: Quaternion) -> Vector3:
    """Shortest rotation vector from `a` to `b`, in the outer frame, rad."""
    return to_rotation_vector(multiply(b, conjugate(a)))


def from_euler_zyx(x: float, y: float, z: float) -> Quaternion:
    """R = Rz(z)·Ry(y)·Rx(x), angles in rad (RAPID's EulerZYX, EGM's EgmEuler)."""
    cx, sx = math.cos(0.5 * x), math.sin(0.5 * x)
    cy, sy = math.cos(0.5 * y), math.sin(0.5 * y)
    cz, sz = math.cos(0.5 * z), math.sin(0.5 * z)
    return Quaternion(
        cx * cy * cz + sx * sy * sz,
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz - sx * sy * cz,
    )


def from_rpy_deg(angles: Sequence[float]) -> Quaternion:
    """Convert roll, pitch and yaw in degrees, in the same convention."""
    x, y, z = map(math.radians, angles)
    return from_euler_zyx(x, y, z)


def to_euler_zyx(q: Quaternion) -> Vector3:
    """Angles (x, y, z) in rad of R = Rz(z)·Ry(y)·Rx(x); at y = ±90° the x angle carries z."""
    w, x, y, z = q
    sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    if abs(sine) > 1.0 - 1e-12:
        return Vector3(2.0 * math.atan2(x, w), math.copysign(0.5 * math.pi, sine), 0.0)
    return Vector3(
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(sine),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def transform(pose: Pose, point: Vector3) -> Vector3:
    """Express in the outer frame a `point` of the frame at `pose`."""
    return add(pose.position, rotate(pose.orientation, point))


def compose(outer: Pose, inner: Pose) -> Pose:
    """Express in the frame of `outer` a pose `inner` of the frame at `outer`."""
    orientation = normalized(multiply(outer.orientation, inner.orientation))
    return Pose(transform(outer, inner.position), orientation, outer.frame)


def inverse(pose: Pose) -> Pose:
    """Pose of the outer frame in the frame at `pose`."""
    turned_back = conjugate(pose.orientation)
    return Pose(scale(rotate(turned_back, pose.position), -1.0), turned_back, pose.frame)
