"""Kinematics of simulated arms, from their makers' Denavit-Hartenberg tables.

Independent of the package's other kinematics on purpose: it checks the gateway's results and the
models of the arms. Lengths in m, angles in rad, rotations as row-major 9-tuples while computing.

Sources, standard (distal) DH parameters; the last frame is tool0: ABB CRB 15000-5/0.95 as published
with its public drivers; UR5 and UR5e from UR's article on DH parameters (nominal values). UR's are
in the controller's base, which is turned by pi about z from `base_link`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import mul
from typing import NamedTuple

from cardan.spatial import rotation_between
from cardan.types import Pose, Quaternion, Vector3

AXES = 6

_DEG = math.pi / 180.0


class DhTransform(NamedTuple):
    """A link, A = Rz(offset + q)·Tz(d)·Tx(a)·Rx(alpha), alpha as its exact cosine and sine."""

    offset: float
    d: float
    a: float
    cos_alpha: float
    sin_alpha: float


class SixAxisArm(NamedTuple):
    """A six-axis arm: geometry and limits of its axes."""

    links: tuple[DhTransform, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    """rad/s."""
    acceleration: tuple[float, ...]
    """rad/s²."""


_TIME_TO_FULL_SPEED_S = 0.1
"""The manufacturer publishes no joint accelerations; full speed in a tenth of a second agrees with
the published 36.9 m/s² at the TCP at full reach."""

_GOFA_SPEED_DEG_S = (125.0, 125.0, 140.0, 200.0, 200.0, 200.0)

GOFA = SixAxisArm(
    links=(
        DhTransform(0.0, 0.265, 0.0, 0.0, -1.0),
        DhTransform(-90.0 * _DEG, 0.0, 0.444, 1.0, 0.0),
        DhTransform(0.0, 0.0, 0.110, 0.0, -1.0),
        DhTransform(0.0, 0.470, 0.0, 0.0, 1.0),
        DhTransform(0.0, 0.0, 0.080, 0.0, -1.0),
        DhTransform(180.0 * _DEG, 0.101, 0.0, 1.0, 0.0),
    ),
    lower=tuple(v * _DEG for v in (-180.0, -180.0, -225.0, -180.0, -180.0, -180.0)),
    upper=tuple(v * _DEG for v in (180.0, 180.0, 85.0, 180.0, 180.0, 180.0)),
    velocity=tuple(v * _DEG for v in _GOFA_SPEED_DEG_S),
    acceleration=tuple(v * _DEG / _TIME_TO_FULL_SPEED_S for v in _GOFA_SPEED_DEG_S),
)
"""CRB 15000-5/0.95."""

UR_LINKS: Mapping[str, tuple[DhTransform, ...]] = {
    "ur5": (
        DhTransform(0.0, 0.089159, 0.0, 0.0, 1.0),
        DhTransform(0.0, 0.0, -0.425, 1.0, 0.0),
        DhTransform(0.0, 0.0, -0.39225, 1.0, 0.0),
        DhTransform(0.0, 0.10915, 0.0, 0.0, 1.0),
        DhTransform(0.0, 0.09465, 0.0, 0.0, -1.0),
        DhTransform(0.0, 0.0823, 0.0, 1.0, 0.0),
    ),
    "ur5e": (
        DhTransform(0.0, 0.1625, 0.0, 0.0, 1.0),
        DhTransform(0.0, 0.0, -0.425, 1.0, 0.0),
        DhTransform(0.0, 0.0, -0.3922, 1.0, 0.0),
        DhTransform(0.0, 0.1333, 0.0, 0.0, 1.0),
        DhTransform(0.0, 0.0997, 0.0, 0.0, -1.0),
        DhTransform(0.0, 0.0996, 0.0, 1.0, 0.0),
    ),
}


class Frames(NamedTuple):
    """Joint axes and TCP in one configuration."""

    pose: Pose
    axes: list[tuple[float, float, float]]
    """Direction of each joint axis, base frame."""
    origins: list[tuple[float, float, float]]
    """A point on each joint axis, base frame, m."""
    approach: Vector3
    """The tool's z axis, base frame."""


def forward(joints: Sequence[float], links: Sequence[DhTransform] = GOFA.links) -> Frames:
    """Return TCP pose and joint axes at `joints` (rad)."""
    xx, xy, xz = 1.0, 0.0, 0.0
    yx, yy, yz = 0.0, 1.0, 0.0
    zx, zy, zz = 0.0, 0.0, 1.0
    px = py = pz = 0.0
    axes: list[tuple[float, float, float]] = []
    origins: list[tuple[float, float, float]] = []
    for angle, (offset, d, a, ca, sa) in zip(joints, links, strict=True):
        axes.append((zx, zy, zz))
        origins.append((px, py, pz))
        c, s = math.cos(angle + offset), math.sin(angle + offset)
        ux, uy, uz = c * yx - s * xx, c * yy - s * xy, c * yz - s * xz
        xx, xy, xz = c * xx + s * yx, c * xy + s * yy, c * xz + s * yz
        px, py, pz = px + d * zx + a * xx, py + d * zy + a * xy, pz + d * zz + a * xz
        yx, yy, yz = ca * ux + sa * zx, ca * uy + sa * zy, ca * uz + sa * zz
        zx, zy, zz = ca * zx - sa * ux, ca * zy - sa * uy, ca * zz - sa * uz
    orientation = _quaternion(xx, yx, zx, xy, yy, zy, xz, yz, zz)
    return Frames(Pose(Vector3(px, py, pz), orientation), axes, origins, Vector3(zx, zy, zz))


def _quaternion(
    r00: float,
    r01: float,
    r02: float,
    r10: float,
    r11: float,
    r12: float,
    r20: float,
    r21: float,
    r22: float,
) -> Quaternion:
    """Return the unit quaternion of a rotation matrix, from its largest component.

    The sign depends on that component, so it can flip along a motion, as a controller's can.
    """
    if r00 + r11 + r22 > 0.0:
        t = 1.0 + r00 + r11 + r22
        f = 0.5 / math.sqrt(t)
        return Quaternion(t * f, (r21 - r12) * f, (r02 - r20) * f, (r10 - r01) * f)
    if r00 >= r11 and r00 >= r22:
        t = 1.0 + r00 - r11 - r22
        f = 0.5 / math.sqrt(t)
        return Quaternion((r21 - r12) * f, t * f, (r01 + r10) * f, (r02 + r20) * f)
    if r11 >= r22:
        t = 1.0 - r00 + r11 - r22
        f = 0.5 / math.sqrt(t)
        return Quaternion((r02 - r20) * f, (r01 + r10) * f, t * f, (r12 + r21) * f)
    t = 1.0 - r00 - r11 + r22
    f = 0.5 / math.sqrt(t)
    return Quaternion((r10 - r01) * f, (r02 + r20) * f, (r12 + r21) * f, t * f)


def jacobian(frames: Frames) -> list[tuple[float, ...]]:
    """Return the TCP's Jacobian in the base frame, a column a joint: v (m/s) over w (rad/s)."""
    tx, ty, tz = frames.pose.position
    columns: list[tuple[float, ...]] = []
    for (zx, zy, zz), (px, py, pz) in zip(frames.axes, frames.origins, strict=True):
        dx, dy, dz = tx - px, ty - py, tz - pz
        columns.append((zy * dz - zz * dy, zz * dx - zx * dz, zx * dy - zy * dx, zx, zy, zz))
    return columns


def _cholesky(gram: Sequence[Sequence[float]], shift: float) -> list[list[float]] | None:
    """Return the lower triangle L with L·Lᵀ = gram + shift·1; None if not positive definite."""
    rows: list[list[float]] = []
    for i, line in enumerate(gram):
        row: list[float] = []
        for j in range(i):
            other = rows[j]
            value = line[j]
            for k in range(j):
                value -= row[k] * other[k]
            row.append(value / other[j])
        square = line[i] + shift
        for value in row:
            square -= value * value
        if square <= 0.0:
            return None
        row.append(math.sqrt(square))
        rows.append(row)
    return rows


class Differential:
    """The inverse of a Jacobian J by damped least squares: Jᵀ·(J·Jᵀ + damping²·1)⁻¹."""

    def __init__(self, frames: Frames, damping: float = 1e-4) -> None:
        self._columns = jacobian(frames)
        rows = list(zip(*self._columns, strict=True))
        self._gram = [
            [sum(map(mul, row, other)) for other in rows[: i + 1]] for i, row in enumerate(rows)
        ]
        lower = _cholesky(self._gram, damping * damping)
        assert lower is not None
        self._lower = lower

    def is_singular(self, threshold: float) -> bool:
        """True if the smallest singular value of J is below `threshold` (m and rad together)."""
        # All singular values are at least t where J·Jᵀ - t²·1 is positive definite.
        return threshold > 0.0 and _cholesky(self._gram, -threshold * threshold) is None

    def joints(self, twist: Sequence[float]) -> list[float]:
        """Return the joint motion for the TCP motion `twist` (v over w)."""
        lower = self._lower
        solved: list[float] = []
        for row, value in zip(lower, twist, strict=True):
            solved.append((value - sum(map(mul, row, solved))) / row[-1])
        for i in range(len(solved) - 1, -1, -1):
            row = lower[i]
            solved[i] = value = solved[i] / row[i]
            for k in range(i):
                solved[k] -= row[k] * value
        return [sum(map(mul, column, solved)) for column in self._columns]


def manipulability(frames: Frames) -> float:
    """Return the square root of det(J·Jᵀ), m and rad together; 0 at a singularity."""
    rows = list(zip(*jacobian(frames), strict=True))
    gram = [[sum(map(mul, row, other)) for other in rows[: i + 1]] for i, row in enumerate(rows)]
    lower = _cholesky(gram, 0.0)
    return 0.0 if lower is None else math.prod(row[-1] for row in lower)


def pose_error(target: Pose, actual: Pose) -> tuple[float, float, float, float, float, float]:
    """Return the error from `actual` to `target`: v (m) over rotation vector (rad), base frame."""
    tx, ty, tz = target.position
    ax, ay, az = actual.position
    rx, ry, rz = rotation_between(actual.orientation, target.orientation)
    return (tx - ax, ty - ay, tz - az, rx, ry, rz)
