"""Motion to goals that arrive a few dozen times a second, from the arm's commanded pose. The first
goal, and any distant one, is approached slowly: however wrong it is, the arm does not jump. After
that each goal is passed on unchanged; the arm's own limits apply in any case."""

from __future__ import annotations

from cardan.gateway.operator.mapping import MappingOptions
from cardan.spatial import (
    add,
    limit_norm,
    norm,
    rotation_between,
    subtract,
    turned_by,
)
from cardan.types import Frame, Pose

ARRIVED_M, ARRIVED_RAD = 0.002, 0.01
"""Distance to its goal at which the arm has arrived."""

LONGEST_STEP_S = 0.1
"""Longest time step; a longer pause is not made up for."""


class Approach:
    """The arm's reference on its way to a goal. Time is an argument."""

    def __init__(self, options: MappingOptions) -> None:
        """`options`: their approach speeds, and the distance from which a goal is approached."""
        self._options = options
        self._at: Pose | None = None
        self.arrived = False
        """True if goals are passed on unchanged."""

    @property
    def engaged(self) -> bool:
        """True between `engage` and `release`."""
        return self._at is not None

    def engage(self, tcp: Pose) -> None:
        """Begin at the commanded pose of the TCP."""
        self._at, self.arrived = tcp, False

    def release(self) -> None:
        """Forget the pose; the next `engage` begins with an approach."""
        self._at, self.arrived = None, False

    def step(self, goal: Pose, tcp: Pose, dt_s: float) -> Pose:
        """Return the next pose to command; `tcp`: the pose commanded at present."""
        assert self._at is not None
        options, dt_s = self._options, min(max(dt_s, 0.0), LONGEST_STEP_S)
        if farther_apart_than(tcp, goal, options.slip_m, options.slip_rad):
            if self.arrived:
                self._at = tcp
            self.arrived = False
        at = self._at
        if not self.arrived:
            way = limit_norm(
                subtract(goal.position, at.position), options.approach_speed_m_s * dt_s
            )
            turn = limit_norm(
                rotation_between(at.orientation, goal.orientation),
                options.approach_speed_rad_s * dt_s,
            )
            ahead = Pose(
                add(at.position, way),
                turned_by(at.orientation, turn),
                Frame.BASE,
            )
            if not farther_apart_than(tcp, ahead, options.slip_m, options.slip_rad):
                at = ahead  # Wait for an arm that does not follow.
            self.arrived = not farther_apart_than(at, goal, ARRIVED_M, ARRIVED_RAD)
        self._at = goal if self.arrived else at
        return self._at


def farther_apart_than(a: Pose, b: Pose, most_m: float, most_rad: float) -> bool:
    """Return True if two poses are farther apart than either of these distances."""
    return (
        norm(subtract(b.position, a.position)) > most_m
        or norm(rotation_between(a.orientation, b.orientation)) > most_rad
    )
