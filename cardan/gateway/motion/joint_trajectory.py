"""Joint trajectories planned by other programs: positions at times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cardan.errors import MotionRefusedError

PATH_TOLERANCE = "path tolerance"
GOAL_TOLERANCE = "goal tolerance"
"""Beginning of the reasons for ending a trajectory at its goal."""

MAX_POINTS = 5000
"""Longest trajectory: MoveIt's have some hundred points."""

LONGEST_S = 3600.0
"""Longest duration, s."""

LARGEST = 1e6
"""Largest plausible position or speed of a joint (rad, m, s)."""

SHORTEST_STEP_S = 1e-4
"""Shortest time between two points."""

AT_REST = 1e-3
"""Largest speed of a joint at the end, rad/s or m/s, that counts as rest."""


@dataclass(frozen=True)
class JointTrajectory:
    """Positions of all joints, in kinematic order, at times. Raises MotionRefusedError."""

    times_s: Sequence[float]
    """Times of the points since the start; growing. The first may be 0."""
    positions: Sequence[Sequence[float]]
    """A row for each point, rad or m."""
    velocities: Sequence[Sequence[float]] | None = None
    """Joint velocities at the points; None: chosen so that no joint overshoots the points."""
    accelerations: Sequence[Sequence[float]] | None = None
    path_tolerance: Sequence[float] | None = None
    """Largest distance of each measured joint from its desired position; 0: any; None: any for
    all."""
    goal_tolerance: Sequence[float | None] | None = None
    """The same at the end; None, for a joint or for all: the tolerance of the arm's other
    motions."""
    goal_time_s: float = 0.0
    """Allowed delay of the end; 0: as long as the arm's limits need, plus the usual wait for
    arrival."""

    def __post_init__(self) -> None:
        times = self.times_s
        count = len(times)
        if not 1 <= count <= MAX_POINTS:
            raise MotionRefusedError(
                f"trajectory: it has {count} points; allowed: 1 to {MAX_POINTS}"
            )
        if len(self.positions) != count:
            raise MotionRefusedError(
                f"trajectory: {len(self.positions)} positions for {count} times"
            )
        joints = len(self.positions[0])
        for name in ("positions", "velocities", "accelerations"):
            rows = getattr(self, name)
            if rows is None:
                continue
            if len(rows) != count or any(len(row) != joints for row in rows):
                raise MotionRefusedError(f"trajectory: {name} are not given for all joints")
            if not all(abs(value) <= LARGEST for row in rows for value in row):
                raise MotionRefusedError(
                    f"trajectory: {name} have numbers that are not finite, or above {LARGEST:g}"
                )
        if not all(0.0 <= time_s <= LONGEST_S for time_s in times):
            raise MotionRefusedError(
                f"trajectory: its times are not all from 0 to {LONGEST_S:g} s after its start"
            )
        for index in range(1, count):
            step_s = times[index] - times[index - 1]
            if step_s < SHORTEST_STEP_S:
                raise MotionRefusedError(
                    f"trajectory: point {index} comes {step_s:g} s after the one before it; "
                    f"at least {SHORTEST_STEP_S:g} s are needed"
                )
        if self.velocities is not None and max(map(abs, self.velocities[-1])) > AT_REST:
            raise MotionRefusedError("trajectory: it does not end at rest")
