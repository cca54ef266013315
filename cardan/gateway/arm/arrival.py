"""Arrival check: the measured arm, and not only its command, is at rest at the end of a motion."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.common.options import Options
from cardan.types import RobotState

SLOW_RAD_S = 0.02
"""Mean speed of every joint, rad/s or m/s, below which the arm has come to rest."""

_SPACING_S = 0.01
_CAPACITY = 11
"""Positions kept from the last 0.1 s: within that time a joint may jump by one count of a coarse
encoder, 2 mrad, and still count as slow."""


@dataclass(frozen=True, kw_only=True)
class ArrivalOptions(Options):
    """Tolerances around the goal within which the arm must come to rest at the end of movj, relj,
    movl or a trajectory, and the longest wait for it."""

    arrival_m: Annotated[float, bounds.ARRIVAL_M] = 0.01
    """Largest distance of the TCP from the end of its line."""
    arrival_rad: Annotated[float, bounds.ARRIVAL_RAD] = 0.02
    """Largest angle of the TCP from its orientation at the end of the line."""
    arrival_joint: Annotated[float, bounds.ARRIVAL_JOINT] = 0.01
    """Largest distance of a joint from its goal in motions of joints, rad or m."""
    arrival_timeout_s: Annotated[float, bounds.ARRIVAL_S] = 2.0
    """Longest wait for the arm once the command is at rest, beyond the robot's lag."""


class Arrival:
    """Watches the measured joints of one motion."""

    def __init__(self, options: ArrivalOptions, lag_s: float = 0.0) -> None:
        """`lag_s`: normal delay of the robot behind its command."""
        self.options, self.lag_s = options, lag_s
        self._seen: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=_CAPACITY)

    def observe(self, robot: RobotState) -> None:
        """Measured joints, for every tick of the motion."""
        if not self._seen or robot.stamp_s - self._seen[-1][0] >= _SPACING_S:
            self._seen.append((robot.stamp_s, robot.joints))

    def arrived(self, robot: RobotState, near: bool) -> bool:
        """Return whether the arm has come to rest at its goal. `near` says whether it is there now.
        At rest: no joint has moved noticeably since one of the last positions, and the arm was near
        since then."""
        if not near:
            self._seen.clear()
        return any(
            robot.stamp_s - stamp_s >= _SPACING_S
            and all(
                abs(now - then) <= SLOW_RAD_S * (robot.stamp_s - stamp_s)
                for now, then in zip(robot.joints, joints, strict=True)
            )
            for stamp_s, joints in self._seen
        )
