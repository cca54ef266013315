"""Forward and inverse kinematics of a UR arm with a tool, in closed form."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from cardan.sim_peers.kinematics import AXES, DhTransform, forward, jacobian
from cardan.sim_peers.ur_controller.values import UrPose
from cardan.spatial import compose, from_rotation_vector, inverse, rotate, to_rotation_vector
from cardan.types import IDENTITY_POSE, Pose as Frame, Vector3

_TURN: Final = 2.0 * math.pi
_SINGULAR: Final = 1e-9
"""Sine of the second wrist joint below which the first and the third turn about one axis."""
_ROUNDING: Final = 1e-12
_MOMENT_S: Final = 1e-5
_X, _Y, _Z = Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0)


def frame_of(pose: Sequence[float]) -> Frame:
    """Convert six numbers of a URScript pose to a frame."""
    x, y, z, rx, ry, rz = pose
    return Frame(Vector3(x, y, z), from_rotation_vector(Vector3(rx, ry, rz)))


def pose_of(frame: Frame) -> UrPose:
    """Convert a frame to a pose of URScript."""
    return UrPose((*frame.position, *to_rotation_vector(frame.orientation)))


class UrKinematics:
    """Kinematics of an arm, its joints within `low` and `high`, rad."""

    def __init__(
        self, links: Sequence[DhTransform], low: Sequence[float], high: Sequence[float]
    ) -> None:
        self.links, self._low, self._high = links, low, high

    def forward(self, q: Sequence[float], tcp: Frame = IDENTITY_POSE) -> Frame:
        """Return the pose of the TCP; `tcp` is given in the flange's frame."""
        return compose(forward(q, self.links).pose, tcp)

    def jacobian(self, q: Sequence[float], tcp: Frame) -> list[tuple[float, ...]]:
        """Return the TCP's Jacobian in the base frame, a column a joint: m over rad."""
        frames = forward(q, self.links)
        return jacobian(frames._replace(pose=compose(frames.pose, tcp)))

    def jacobian_rate(
        self, q: Sequence[float], qd: Sequence[float], tcp: Frame
    ) -> list[tuple[float, ...]]:
        """Return the Jacobian's time derivative at the speeds `qd`, by a central difference."""
        before, after = (
            self.jacobian([at + side * v for at, v in zip(q, qd, strict=True)], tcp)
            for side in (-_MOMENT_S, _MOMENT_S)
        )
        return [
            tuple(0.5 * (b - a) / _MOMENT_S for a, b in zip(one, other, strict=True))
            for one, other in zip(before, after, strict=True)
        ]

    def speed(self, q: Sequence[float], qd: Sequence[float], tcp: Frame) -> tuple[float, ...]:
        """Return the TCP's speed in the base frame, m/s over rad/s."""
        columns = self.jacobian(q, tcp)
        return tuple(
            math.fsum(column[row] * v for column, v in zip(columns, qd, strict=True))
            for row in range(AXES)
        )

    def inverse(
        self, goal: Frame, near: Sequence[float], tcp: Frame = IDENTITY_POSE
    ) -> list[float] | None:
        """Return the joints nearest to `near` that place the TCP at `goal`; None: no solution."""
        best, least = None, math.inf
        for solution in self._solutions(compose(goal, inverse(tcp)), near[5]):
            q, distance = [], 0.0
            for angle, at, low, high in zip(solution, near, self._low, self._high, strict=True):
                turned = angle + _TURN * round((at - angle) / _TURN)
                if not low <= turned <= high:
                    turned += _TURN if turned < low else -_TURN
                    if not low <= turned <= high:
                        break
                distance += abs(turned - at)
                if distance >= least:
                    break
                q.append(turned)
            else:
                best, least = q, distance
        return best

    def _solutions(self, flange: Frame, last_q: float) -> Iterator[tuple[float, ...]]:
        """Yield all solutions, up to whole turns: two shoulders, two wrists, two elbows.

        Joints 2, 3 and 4 turn about one direction, which joint 1 alone sets: the flange's
        components along it give joints 1, 5 and 6, and the rest is a triangle in a plane.
        """
        (_, d1, *_), (_, _, a2, *_), (_, _, a3, *_), (_, d4, *_), (_, d5, *_), (_, d6, *_) = (
            self.links
        )
        px, py, pz = flange.position
        nx, ny, nz = rotate(flange.orientation, _X)
        ox, oy, oz = rotate(flange.orientation, _Y)
        ax, ay, az = rotate(flange.orientation, _Z)
        wx, wy = px - d6 * ax, py - d6 * ay
        reach = math.hypot(wx, wy)
        if not reach >= abs(d4):
            return
        towards, aside = math.atan2(wy, wx), math.asin(d4 / reach)
        sin, cos, atan2 = math.sin, math.cos, math.atan2
        for q1 in (towards + aside, towards + math.pi - aside):
            s1, c1 = sin(q1), cos(q1)
            n, o, a = nx * s1 - ny * c1, ox * s1 - oy * c1, ax * s1 - ay * c1
            s5 = math.hypot(n, o)
            for sign in (1.0, -1.0):
                q5 = atan2(sign * s5, a)
                q6 = last_q if s5 < _SINGULAR else atan2(-sign * o, sign * n)
                s6, c6 = sin(q6), cos(q6)
                # The direction of joint 5, and the center of the wrist, in the plane.
                ux, uy, uz = -s6 * nx - c6 * ox, -s6 * ny - c6 * oy, -s6 * nz - c6 * oz
                across = c1 * ux + s1 * uy
                x = c1 * (wx - d5 * ux) + s1 * (wy - d5 * uy)
                y = pz - d6 * az - d5 * uz - d1
                q234 = atan2(across, -uz)
                c3 = (x * x + y * y - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
                if not abs(c3) <= 1.0 + _ROUNDING:
                    continue
                elbow = math.acos(min(max(c3, -1.0), 1.0))
                for q3 in (elbow, -elbow):
                    q2 = atan2(y, x) - atan2(a3 * sin(q3), a2 + a3 * cos(q3))
                    yield q1, q2, q3, q234 - q2 - q3, q5, q6
