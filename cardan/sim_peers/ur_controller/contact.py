"""Contact plane of the simulated arm, and its force mode.

The contact is kinematic: a horizontal plane with a stiffness, which the TCP enters; the contact
does not move the arm off its path. Force mode commands a speed along each compliant axis that grows
with the error of the wrench.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from cardan.sim_peers.kinematics import AXES
from cardan.spatial import add, cross, dot, norm, rotate, scale, subtract
from cardan.types import Pose as Frame, Vector3

DAMPING: Final = 0.005
_SETTLES_S: Final = 0.05
"""Time constant of the force on a contact, at a gain scaling of 1."""
_COASTS_S: Final = 0.01
"""Time constant of coasting without force, at a damping of 1."""
_QUICKEST: Final = (5.0,) * 3 + (25.0,) * 3
"""Accelerations of compliant axes, m/s² and rad/s²."""
UP: Final = Vector3(0.0, 0.0, 1.0)
"""Direction of the plane's force."""


class ContactPlane(NamedTuple):
    """Obstacle of the arm: all space below `height_m` in the base frame."""

    height_m: float
    stiffness_n_m: float

    def force(self, tip: Vector3) -> float:
        """Return the upward force on the TCP, N."""
        return max(self.height_m - tip[2], 0.0) * self.stiffness_n_m


class Compliance(NamedTuple):
    """Arguments of `force_mode`."""

    frame: Frame
    free: tuple[bool, ...]
    """Compliant axes."""
    wrench: tuple[float, ...]
    kind: int
    """1 to 3: rotation of `frame`."""
    limits: tuple[float, ...]


class ForceMode:
    """Speed law of the TCP along the compliant axes."""

    def __init__(self) -> None:
        self.damping = DAMPING
        self.gain = 1.0
        self.asked: Compliance | None = None
        self._last: Compliance | None = None
        self._speeds = [0.0] * AXES

    @property
    def moves(self) -> bool:
        """True if the TCP moves along a compliant axis."""
        return any(self._speeds)

    def begin(self, asked: Compliance) -> None:
        """Enter force mode, or change its arguments."""
        self.asked = self._last = asked

    def end(self) -> None:
        """Leave force mode: the compliant axes come to rest."""
        self.asked = None

    def halt(self) -> None:
        """Leave force mode at once."""
        self.asked = self._last = None
        self._speeds = [0.0] * AXES

    def motion(
        self,
        at: Frame,
        change: tuple[Vector3, Vector3],
        contact_force: Vector3,
        touched: tuple[float, Vector3],
        dt_s: float,
    ) -> tuple[Vector3, Vector3]:
        """Return the motion of the TCP in a frame (m, rad): the program's own `change` along rigid
        axes, and that of the force law along compliant ones.

        `contact_force` is the force on the tool, and `touched` the stiffness of the touched object
        (N/m; 0: none) and the direction of its force.
        """
        asked = self._last
        if asked is None:
            return change
        axes = _axes(asked, at, change[0])
        moved = [Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.0)]
        for number in range(AXES):
            part, axis = divmod(number, 3)
            along = axes[axis]
            if asked.free[number]:
                missing = asked.wrench[number] + (0.0 if part else dot(contact_force, along))
                against = 0.0 if part else touched[0] * dot(along, touched[1]) ** 2
                self._speed(number, missing, against, asked.limits[number], dt_s)
                way = self._speeds[number] * dt_s
            else:
                self._speeds[number] = 0.0
                way = dot(change[part], along)
            moved[part] = add(moved[part], scale(along, way))
        return moved[0], moved[1]

    def _speed(
        self, number: int, missing: float, stiffness_n_m: float, most: float, dt_s: float
    ) -> None:
        now = self._speeds[number]
        if self.asked is None:
            wanted = 0.0
        elif stiffness_n_m > 1.0:
            wanted = self.gain * missing / (stiffness_n_m * _SETTLES_S)
        elif abs(missing) > 1e-9:
            wanted = math.copysign(most, missing)
        else:
            wanted = now * math.exp(-dt_s * self.damping / _COASTS_S)
        wanted = min(max(wanted, -most), most)
        change = _QUICKEST[number] * dt_s
        self._speeds[number] = now + min(max(wanted - now, -change), change)


def _axes(asked: Compliance, at: Frame, change: Vector3) -> Sequence[Vector3]:
    """Return the directions of the task frame's axes in the base frame."""
    frame = asked.frame
    x, y, z = (rotate(frame.orientation, Vector3(*each)) for each in _UNITS)
    if asked.kind == 1:
        back = subtract(frame.position, at.position)
        if norm(back) > 1e-9:
            y = scale(back, 1.0 / norm(back))
            aside = cross(y, z)
            if norm(aside) < 1e-6:
                aside = cross(y, x)
            x = scale(aside, 1.0 / norm(aside))
            z = cross(x, y)
    elif asked.kind == 3:
        flat = subtract(change, scale(z, dot(change, z)))
        if norm(flat) > 1e-9:
            x = scale(flat, 1.0 / norm(flat))
            y = cross(z, x)
    return x, y, z


_UNITS: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
