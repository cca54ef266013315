"""Paths of the simulated controller's moves, and their time law.

The parameter of a path is its length: for a joint move that of the joint with the longest way
(rad), for a move in tool space that of the TCP (m), or of the tool's rotation if that is longer: a
radian counts as `TURNING_M` meters (chosen; UR publishes no such law).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final

from cardan.sim_peers.ur_controller.kinematics import UrKinematics
from cardan.spatial import (
    add,
    cross,
    dot,
    from_rotation_vector,
    multiply,
    norm,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import Pose as Frame

TURNING_M: Final = 0.1
_STRAIGHT: Final = 1e-6
"""Sine of the angle between the ways to two points below which they are on one line."""


class MovejPath:
    """Path from joints to joints."""

    def __init__(self, start: Sequence[float], goal: Sequence[float]) -> None:
        self._start, self.goal = list(start), list(goal)
        self.change = [b - a for a, b in zip(start, goal, strict=True)]
        self.length = max(map(abs, self.change))

    def at(self, s: float) -> list[float]:
        """Return the joints after the length `s`."""
        if s >= self.length:
            return self.goal
        share = s / self.length
        return [q + share * change for q, change in zip(self._start, self.change, strict=True)]


class MovelPath:
    """Path of the TCP on a line, with rotation of the tool about one axis."""

    radius = math.inf

    def __init__(self, start: Frame, goal: Frame) -> None:
        self.start, self.goal = start, goal
        self._way = subtract(goal.position, start.position)
        self._turn = rotation_between(start.orientation, goal.orientation)
        self.length = max(norm(self._way), TURNING_M * norm(self._turn))

    def at(self, s: float) -> Frame:
        """Return the TCP after the length `s`."""
        if s >= self.length:
            return self.goal
        share = s / self.length
        return Frame(
            add(self.start.position, scale(self._way, share)),
            multiply(from_rotation_vector(scale(self._turn, share)), self.start.orientation),
        )


class ArcPath:
    """Path of the TCP, on the circle through three points."""

    def __init__(self, start: Frame, via: Frame, goal: Frame, fixed: bool) -> None:
        to_via = subtract(via.position, start.position)
        to_goal = subtract(goal.position, start.position)
        normal = cross(to_via, to_goal)
        square = dot(normal, normal)
        offset = scale(
            cross(
                subtract(scale(to_goal, dot(to_via, to_via)), scale(to_via, dot(to_goal, to_goal))),
                normal,
            ),
            0.5 / square,
        )
        self.start = start
        self.radius = norm(offset)
        self._center = add(start.position, offset)
        self._normal = scale(normal, 1.0 / math.sqrt(square))
        self._out = scale(offset, -1.0)
        self._along = cross(self._normal, self._out)
        reached = subtract(goal.position, self._center)
        self._angle = math.atan2(dot(reached, self._along), dot(reached, self._out)) % math.tau
        if fixed:
            turned = from_rotation_vector(scale(self._normal, self._angle))
            goal = goal._replace(orientation=multiply(turned, start.orientation))
            self._turn = scale(self._normal, self._angle)
        else:
            self._turn = rotation_between(start.orientation, goal.orientation)
        self.goal = goal
        self.length = max(self.radius * self._angle, TURNING_M * norm(self._turn))

    def at(self, s: float) -> Frame:
        """Return the TCP after the length `s`."""
        if s >= self.length:
            return self.goal
        share = s / self.length
        angle = self._angle * share
        out = add(scale(self._out, math.cos(angle)), scale(self._along, math.sin(angle)))
        return Frame(
            add(self._center, out),
            multiply(from_rotation_vector(scale(self._turn, share)), self.start.orientation),
        )


ToolPath = MovelPath | ArcPath


def arc_or_line(start: Frame, via: Frame, goal: Frame, fixed: bool) -> ToolPath:
    """Return the arc of a circle, or a line if the three points are on one."""
    to_via = subtract(via.position, start.position)
    to_goal = subtract(goal.position, start.position)
    area = norm(cross(to_via, to_goal))
    if area <= _STRAIGHT * norm(to_via) * norm(to_goal):
        return MovelPath(start, goal._replace(orientation=start.orientation) if fixed else goal)
    return ArcPath(start, via, goal, fixed)


class Course:
    """Length along a path as a function of time: pieces of constant acceleration."""

    def __init__(self, s: float, v: float, end: float, pieces: Iterable[tuple[float, float]]):
        self.s, self.v, self.end = s, v, end
        self._pieces = deque(pieces)

    @property
    def done(self) -> bool:
        """True at rest at the end."""
        return not self._pieces

    def advance(self, dt_s: float) -> None:
        """Advance the time."""
        pieces = self._pieces
        while pieces and dt_s > 0.0:
            left_s, a = pieces[0]
            part_s = min(dt_s, left_s)
            self.s += (self.v + 0.5 * a * part_s) * part_s
            self.v += a * part_s
            if left_s - part_s > 1e-12:
                pieces[0] = (left_s - part_s, a)
            else:
                pieces.popleft()
            dt_s -= part_s
        if not pieces:
            self.s, self.v = self.end, 0.0


def ramp(
    length: float, v0: float, v1: float, most: float, a: float
) -> tuple[list[tuple[float, float]], float]:
    """Return the fastest motion over a length, from `v0` to a speed of at most `v1`: pieces (time,
    acceleration), and the final speed."""
    if length <= 0.0:
        return [], v0
    v1 = min(v1, math.sqrt(v0 * v0 + 2.0 * a * length))
    top = max(min(most, math.sqrt(a * length + 0.5 * (v0 * v0 + v1 * v1))), v0, v1)
    up, down = (top * top - v0 * v0) / (2.0 * a), (top * top - v1 * v1) / (2.0 * a)
    even = max(length - up - down, 0.0)
    pieces = [((top - v0) / a, a), (even / top, 0.0), ((top - v1) / a, -a)]
    return [piece for piece in pieces if piece[0] > 0.0], v1


def joints_on(
    kinematics: UrKinematics,
    path: MovejPath | ToolPath,
    s: float,
    near: Sequence[float],
    tcp: Frame,
) -> list[float] | None:
    """Return the joints after the length `s`; None if the arm does not reach there."""
    if isinstance(path, MovejPath):
        return path.at(s)
    return kinematics.inverse(path.at(s), near, tcp)


def tcp_on(kinematics: UrKinematics, path: MovejPath | ToolPath, s: float, tcp: Frame) -> Frame:
    """Return the TCP after the length `s`."""
    if isinstance(path, MovejPath):
        return kinematics.forward(path.at(s), tcp)
    return path.at(s)


def length_within(
    kinematics: UrKinematics, path: MovejPath | ToolPath, radius: float, tcp: Frame
) -> float:
    """Return the length of a path's end within `radius` of its goal, at most half of the path."""
    goal = tcp_on(kinematics, path, path.length, tcp).position
    near, far = 0.0, 0.5 * path.length
    for _ in range(40):
        middle = 0.5 * (near + far)
        here = tcp_on(kinematics, path, path.length - middle, tcp).position
        if norm(subtract(here, goal)) <= radius:
            near = middle
        else:
            far = middle
    return near
