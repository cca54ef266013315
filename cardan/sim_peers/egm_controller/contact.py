"""Horizontal surface that the TCP of the simulated arm can touch, as a pen meets a sheet.

The arm is position-controlled and rigid; the compliance of the pen in its holder and of the sheet
on its board is the surface's stiffness. Forces are in N, base axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

from cardan.common import bounds
from cardan.sim_peers.kinematics import AXES, Frames
from cardan.types import ZERO3, Vector3

STICK_SPEED_M_S = 0.001
"""Friction is proportional to the speed along the surface below this, and Coulomb's above it."""


_Size = Annotated[float, bounds.NOT_NEGATIVE]


class ContactSurface(NamedTuple):
    """A horizontal plane, solid below `height_m` of the base frame (the work object's)."""

    height_m: float
    stiffness_n_m: _Size = 500.0
    """Stiffness of a pen in a spring-loaded holder; a rigid tool on a table: 10 kN/m or more."""
    damping_n_s_m: _Size = 5.0
    """Damping of motion into and out of the surface; it never pulls."""
    friction: _Size = 0.2
    """Coulomb's coefficient along the surface."""

    @classmethod
    def read(cls, text: str) -> ContactSurface:
        """Parse ``HEIGHT[:STIFFNESS[:DAMPING[:FRICTION]]]``, SI units. Raises ValueError."""
        try:
            height_m, *others = [float(word) for word in text.split(":")]
            return cls(height_m, *others)
        except (ValueError, TypeError):
            raise ValueError(
                f"{text!r} is not HEIGHT[:STIFFNESS[:DAMPING[:FRICTION]]], as 0.28:500"
            ) from None


def touch(surface: ContactSurface, position: Vector3, velocity: Vector3) -> Vector3:
    """Return the force that the TCP exerts on `surface`; zero without contact, never upwards."""
    depth_m = surface.height_m - position.z
    if depth_m <= 0.0:
        return ZERO3
    pressed_n = surface.stiffness_n_m * depth_m - surface.damping_n_s_m * velocity.z
    if pressed_n <= 0.0:
        return ZERO3
    slip_m_s = math.hypot(velocity.x, velocity.y)
    drag = surface.friction * pressed_n / max(slip_m_s, STICK_SPEED_M_S)
    return Vector3(drag * velocity.x, drag * velocity.y, -pressed_n)


def tcp_velocity(frames: Frames, speeds_rad_s: Sequence[float]) -> Vector3:
    """Return the TCP velocity in the base frame, m/s, for joint speeds `speeds_rad_s`."""
    tx, ty, tz = frames.pose.position
    x = y = z = 0.0
    for n in range(AXES):
        ax, ay, az = frames.axes[n]
        px, py, pz = frames.origins[n]
        dx, dy, dz = tx - px, ty - py, tz - pz
        speed = speeds_rad_s[n]
        x += speed * (ay * dz - az * dy)
        y += speed * (az * dx - ax * dz)
        z += speed * (ax * dy - ay * dx)
    return Vector3(x, y, z)
