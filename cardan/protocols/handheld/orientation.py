"""The axes of phones and of WebXR.

A phone's: x right, y to the top edge, z out of the screen, whatever the picture's orientation. The
reference is z up, with an arbitrary heading. Its angles are intrinsic Z-X'-Y'', whose singular pose
is the upright phone: nothing here computes with single angles. Source: W3C, DeviceOrientation Event
Specification, 4.1 and appendix A.

WebXR's: x right, y up, -z forward (W3C, WebXR Device API). Ours: x forward, y left, z up.
"""

from __future__ import annotations

import math

from cardan.spatial import rotate
from cardan.types import Quaternion, Vector3

_SINGULAR = 1.0 - 1e-12

FLAT = 0.5
"""Horizontal share of the top edge's direction below which the phone's back tells the heading: an
upright phone's top edge points to the sky."""


def from_angles(alpha_deg: float, beta_deg: float, gamma_deg: float) -> Quaternion:
    """Orientation of the phone in its reference: Rz(alpha)·Rx(beta)·Ry(gamma)."""
    x, y, z = (math.radians(0.5 * each) for each in (beta_deg, gamma_deg, alpha_deg))
    cx, cy, cz = math.cos(x), math.cos(y), math.cos(z)
    sx, sy, sz = math.sin(x), math.sin(y), math.sin(z)
    return Quaternion(
        cx * cy * cz - sx * sy * sz,
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz + sx * sy * cz,
    )


def to_angles(q: Quaternion) -> tuple[float, float, float]:
    """Return alpha, beta and gamma (degrees) in a browser's ranges: 0 to 360, -180 to 180, -90 to
    90."""
    w, x, y, z = q
    # The last row of the rotation matrix is (-cos beta sin gamma, sin beta, cos beta cos gamma).
    r20, r22 = 2.0 * (x * z - w * y), 1.0 - 2.0 * (x * x + y * y)
    r21 = max(-1.0, min(1.0, 2.0 * (y * z + w * x)))
    r01, r11 = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z)
    if abs(r21) > _SINGULAR:
        beta, gamma = math.copysign(0.5 * math.pi, r21), 0.0
        alpha = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    else:
        side = 1.0 if r22 >= 0.0 else -1.0
        beta = math.atan2(r21, side * math.hypot(r20, r22))
        gamma = math.atan2(-side * r20, side * r22)
        alpha = math.atan2(-side * r01, side * r11)
    degrees = math.degrees(alpha) % 360.0
    return 0.0 if degrees == 360.0 else degrees, math.degrees(beta), math.degrees(gamma)


def heading_rad(q: Quaternion) -> float:
    """Return the phone's heading about the vertical: of its top edge, or its back if upright."""
    top = rotate(q, Vector3(0.0, 1.0, 0.0))
    if math.hypot(top.x, top.y) < FLAT:
        top = rotate(q, Vector3(0.0, 0.0, -1.0))
    return math.atan2(top.y, top.x)


def position_from_xr(p: Vector3) -> Vector3:
    """Convert a position, or any vector, of WebXR to our axes."""
    return Vector3(-p.z, -p.x, p.y)


def position_to_xr(p: Vector3) -> Vector3:
    """The inverse of `position_from_xr`."""
    return Vector3(-p.y, p.z, -p.x)


def orientation_from_xr(q: Quaternion) -> Quaternion:
    """Convert an orientation of WebXR to our axes, in world and body: T·R·Tᵀ."""
    return Quaternion(q.w, *position_from_xr(Vector3(q.x, q.y, q.z)))


def orientation_to_xr(q: Quaternion) -> Quaternion:
    """The inverse of `orientation_from_xr`."""
    return Quaternion(q.w, *position_to_xr(Vector3(q.x, q.y, q.z)))
