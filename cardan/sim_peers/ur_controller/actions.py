"""Actions of a program that take time."""

from __future__ import annotations

from typing import NamedTuple

from cardan.sim_peers.ur_controller.language import Action as Action, Sleep as Sleep
from cardan.types import Pose as Frame


class MoveJ(NamedTuple):
    """Move to joints (rad) that all arrive together."""

    q: tuple[float, ...]
    a: float
    """Acceleration of the joint with the longest way, rad/s²."""
    v: float
    """Speed of the joint with the longest way, rad/s."""
    t: float
    """Duration, which overrides `a` and `v`; 0: they determine it."""
    r: float
    """Distance from the goal at which the next move begins, m."""


class MoveL(NamedTuple):
    """Move the TCP on a line to a pose."""

    goal: Frame
    a: float
    v: float
    t: float
    r: float


class MoveC(NamedTuple):
    """Move the TCP on a circle through a point to a pose."""

    via: Frame
    goal: Frame
    a: float
    v: float
    r: float
    fixed: bool
    """The tool turns with the circle's tangent; the orientation of `goal` is ignored."""


class ServoJ(NamedTuple):
    """Servo to joints (rad) for a time."""

    q: tuple[float, ...]
    left_s: float
    lookahead_s: float


class SpeedJ(NamedTuple):
    """Reach joint speeds (rad/s) at an acceleration, for a time; 0: until they are reached."""

    qd: tuple[float, ...]
    acceleration: float
    left_s: float


class SpeedL(NamedTuple):
    """Reach a TCP speed (m/s over rad/s, base frame), for a time; 0: until it is reached."""

    xd: tuple[float, ...]
    a: float
    a_rot: float
    left_s: float


class DirectTorque(NamedTuple):
    """Drive the joints by torques (N·m) for a frame, in addition to gravity compensation."""

    torques: tuple[float, ...]


class StopJ(NamedTuple):
    """Slow the joints down to rest."""

    deceleration: float


class StopL(NamedTuple):
    """Slow the TCP down to rest, on its line."""

    a: float
    a_rot: float


Move = MoveJ | MoveL | MoveC
