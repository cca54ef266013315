"""Torques of an arm's motion by the recursive Newton-Euler algorithm, in bodies' own frames.

It needs no library: a simulated controller gives the same values on every computer, and loads
nothing in its real-time loop. The tests compare it with Pinocchio. Bodies are rigid, and joints
without friction. SI units; vectors are plain tuples, all joints turn about their z axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from cardan.robots import ArmModel
from cardan.spatial import rotate
from cardan.types import Vector3

Triple = tuple[float, float, float]
Rows = tuple[Triple, Triple, Triple]


ROTORS_KG_M2 = (0.5,) * 3 + (0.1,) * 3
"""Inertia of the motors' rotors behind their gears, for motion driven by torques (chosen)."""


class RigidBody(NamedTuple):
    """A rigid body in the frame of the last joint."""

    mass: float
    center: Sequence[float]
    inertia: Sequence[float]
    """About its center: xx, yy, zz, xy, xz, yz."""


class Effort(NamedTuple):
    """Inverse dynamics of a motion."""

    torques: tuple[float, ...]
    """Torques of the joints, N·m."""
    momentum: float
    """Norm of the linear momentum, kg·m/s."""
    load_wrench: tuple[float, ...]
    """Wrench of the flange on the load: force, then torque about the flange; flange axes."""
    base_wrench: tuple[float, ...]
    """Wrench of the base on the arm, in the base of the model."""
    acceleration: Triple
    """Proper acceleration of the flange, as measured by an accelerometer; flange axes."""
    turning: Triple
    """Angular acceleration of the flange, in its axes."""
    carried: Rows
    """Matrix from a position to the acceleration that rotation adds there."""

    def at(self, place: Sequence[float]) -> Triple:
        """Return the proper acceleration of a point fixed to the flange; flange axes."""
        x, y, z = place
        fx, fy, fz = self.acceleration
        (kxx, kxy, kxz), (kyx, kyy, kyz), (kzx, kzy, kzz) = self.carried
        return (
            fx + kxx * x + kxy * y + kxz * z,
            fy + kyx * x + kyy * y + kyz * z,
            fz + kzx * x + kzy * y + kzz * z,
        )


class _Body(NamedTuple):
    x: Triple
    y: Triple
    z: Triple
    """Axes of the joint at 0, in the previous body."""
    place: Triple
    load: RigidBody


class Dynamics:
    """Dynamics of one arm."""

    def __init__(self, arm: ArmModel) -> None:
        """Raises ValueError for an arm with a joint that does not turn about z."""
        if any(joint.axis != (0.0, 0.0, 1.0) for joint in arm.joints):
            raise ValueError(f"{arm.name}: a joint that does not turn about its z axis")
        self._bodies: list[_Body] = []
        for joint, inertia in zip(arm.joints, arm.inertias, strict=True):
            turn = joint.placement.orientation
            x, y, z = (rotate(turn, axis) for axis in _AXES)
            xx, xy, xz, yy, yz, zz = inertia.moments
            load = RigidBody(inertia.mass_kg, inertia.center_m, (xx, yy, zz, xy, xz, yz))
            self._bodies.append(_Body(x, y, z, joint.placement.position, load))

    def mass_matrix(self, q: Sequence[float], load: RigidBody) -> list[tuple[float, ...]]:
        """Return the joints' inertia with a load on the flange, kg·m²: torques for an acceleration
        of 1 rad/s² of one joint."""
        rest = (0.0,) * len(q)
        return [
            self.effort(q, rest, [float(i == j) for i in range(len(q))], load, _NOTHING).torques
            for j in range(len(q))
        ]

    def coriolis(
        self, q: Sequence[float], qd: Sequence[float], load: RigidBody
    ) -> tuple[float, ...]:
        """Return the joints' torques of a motion without gravity and acceleration, N·m."""
        return self.effort(q, qd, (0.0,) * len(q), load, _NOTHING).torques

    def acceleration(
        self, q: Sequence[float], qd: Sequence[float], torques: Sequence[float], load: RigidBody
    ) -> list[float]:
        """Return the joint accelerations by torques beyond gravity compensation (N·m), rad/s²."""
        taken = self.coriolis(q, qd, load)
        left = [torque - each for torque, each in zip(torques, taken, strict=True)]
        masses = [list(row) for row in self.mass_matrix(q, load)]
        for row, inertia in enumerate(ROTORS_KG_M2):
            masses[row][row] += inertia
        return _solved(masses, left)

    def effort(
        self,
        q: Sequence[float],
        qd: Sequence[float],
        qdd: Sequence[float],
        load: RigidBody,
        gravity: Triple,
    ) -> Effort:
        """Return the effort of a motion with a load on the flange. `gravity` is the acceleration of
        the base with the same effect: up."""
        # Out along the arm: w is angular velocity, a angular acceleration, v and f the joint's
        # velocity and acceleration, each in the body's own axes; "carried" maps a position in the
        # body to the acceleration that rotation adds there.
        wx = wy = wz = ax = ay = az = vx = vy = vz = 0.0
        fx, fy, fz = gravity
        carried = _STILL
        passed = []
        for body, angle, speed, change in zip(self._bodies, q, qd, qdd, strict=True):
            c, s = math.cos(angle), math.sin(angle)
            (ox, oy, oz), (px, py, pz), (zx, zy, zz), (x, y, z), own = body
            xx, xy, xz = c * ox + s * px, c * oy + s * py, c * oz + s * pz
            yx, yy, yz = c * px - s * ox, c * py - s * oy, c * pz - s * oz
            (kxx, kxy, kxz), (kyx, kyy, kyz), (kzx, kzy, kzz) = carried
            fx, fy, fz = (
                fx + kxx * x + kxy * y + kxz * z,
                fy + kyx * x + kyy * y + kyz * z,
                fz + kzx * x + kzy * y + kzz * z,
            )
            fx, fy, fz = (
                xx * fx + xy * fy + xz * fz,
                yx * fx + yy * fy + yz * fz,
                zx * fx + zy * fy + zz * fz,
            )
            vx, vy, vz = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
            vx, vy, vz = (
                xx * vx + xy * vy + xz * vz,
                yx * vx + yy * vy + yz * vz,
                zx * vx + zy * vy + zz * vz,
            )
            ax, ay, az = (
                xx * ax + xy * ay + xz * az,
                yx * ax + yy * ay + yz * az,
                zx * ax + zy * ay + zz * az + change,
            )
            wx, wy, wz = (
                xx * wx + xy * wy + xz * wz,
                yx * wx + yy * wy + yz * wz,
                zx * wx + zy * wy + zz * wz + speed,
            )
            ax, ay = ax + wy * speed, ay - wx * speed
            carried = (
                (-wy * wy - wz * wz, wx * wy - az, wx * wz + ay),
                (wx * wy + az, -wx * wx - wz * wz, wy * wz - ax),
                (wx * wz - ay, wy * wz + ax, -wx * wx - wy * wy),
            )
            now = ((wx, wy, wz), (ax, ay, az), (vx, vy, vz), (fx, fy, fz), carried)
            passed.append(
                ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz), (x, y, z), _inertial(own, *now))
            )
        force, torque, momentum = _inertial(load, *now)
        load_wrench = (*force, *torque)
        # Backward: the forces of the previous bodies.
        (fx, fy, fz), (nx, ny, nz), (mx, my, mz) = force, torque, momentum
        torques = []
        for (xx, xy, xz), (yx, yy, yz), (zx, zy, zz), (x, y, z), taken in reversed(passed):
            (bx, by, bz), (tx, ty, tz), (px, py, pz) = taken
            bx, by, bz = fx + bx, fy + by, fz + bz
            tx, ty, tz = nx + tx, ny + ty, nz + tz
            px, py, pz = mx + px, my + py, mz + pz
            torques.append(tz)
            fx = xx * bx + yx * by + zx * bz
            fy = xy * bx + yy * by + zy * bz
            fz = xz * bx + yz * by + zz * bz
            nx = xx * tx + yx * ty + zx * tz + y * fz - z * fy
            ny = xy * tx + yy * ty + zy * tz + z * fx - x * fz
            nz = xz * tx + yz * ty + zz * tz + x * fy - y * fx
            mx = xx * px + yx * py + zx * pz
            my = xy * px + yy * py + zy * pz
            mz = xz * px + yz * py + zz * pz
        _, turning, _, acceleration, _ = now
        return Effort(
            tuple(reversed(torques)),
            math.hypot(mx, my, mz),
            load_wrench,
            (fx, fy, fz, nx, ny, nz),
            acceleration,
            turning,
            carried,
        )


def _solved(matrix: Sequence[Sequence[float]], right: Sequence[float]) -> list[float]:
    """Solve `matrix x = right` by Cholesky's decomposition; `matrix` is symmetric and positive
    definite."""
    lower: list[list[float]] = []
    half: list[float] = []
    for row, value in zip(matrix, right, strict=True):
        made: list[float] = []
        for other in lower:
            known = sum(a * b for a, b in zip(made, other, strict=False))
            made.append((row[len(made)] - known) / other[-1])
        half.append(value - sum(a * b for a, b in zip(made, half, strict=True)))
        made.append(math.sqrt(row[len(made)] - sum(a * a for a in made)))
        half[-1] /= made[-1]
        lower.append(made)
    found = [0.0] * len(half)
    for at in reversed(range(len(half))):
        known = sum(lower[n][at] * found[n] for n in range(at + 1, len(half)))
        found[at] = (half[at] - known) / lower[at][at]
    return found


_AXES = (Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0))
_NOTHING: Triple = (0.0, 0.0, 0.0)
_STILL: Rows = (_NOTHING, _NOTHING, _NOTHING)


def _inertial(
    load: RigidBody, w: Triple, a: Triple, v: Triple, f: Triple, carried: Rows
) -> tuple[Triple, Triple, Triple]:
    """Return force, torque about the joint, and momentum of a moving body."""
    mass, (x, y, z), (xx, yy, zz, xy, xz, yz) = load
    if not mass:
        return _STILL
    (kxx, kxy, kxz), (kyx, kyy, kyz), (kzx, kzy, kzz) = carried
    wx, wy, wz = w
    ax, ay, az = a
    fx = mass * (f[0] + kxx * x + kxy * y + kxz * z)
    fy = mass * (f[1] + kyx * x + kyy * y + kyz * z)
    fz = mass * (f[2] + kzx * x + kzy * y + kzz * z)
    lx, ly, lz = (
        xx * wx + xy * wy + xz * wz,
        xy * wx + yy * wy + yz * wz,
        xz * wx + yz * wy + zz * wz,
    )
    return (
        (fx, fy, fz),
        (
            xx * ax + xy * ay + xz * az + wy * lz - wz * ly + y * fz - z * fy,
            xy * ax + yy * ay + yz * az + wz * lx - wx * lz + z * fx - x * fz,
            xz * ax + yz * ay + zz * az + wx * ly - wy * lx + x * fy - y * fx,
        ),
        (
            mass * (v[0] + wy * z - wz * y),
            mass * (v[1] + wz * x - wx * z),
            mass * (v[2] + wx * y - wy * x),
        ),
    )
