"""Whether the measured arm, and not only its command, is at rest where a motion ends."""

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
_KEPT = 11
"""Places of the last 0.1 s: that long a joint may be seen to jump by a count of a coarse encoder,
2 mrad, and still count as slow."""


@dataclass(frozen=True, kw_only=True)
class ArrivalOptions(Options):
    """How near its goal the measured arm has to come to rest, that a motion which ends by itself
    (movj, relj, movl, a trajectory) has arrived, and how long that is waited for."""

    arrival_m: Annotated[float, bounds.ARRIVAL_M] = 0.01
    """Farthest that the TCP may be from the end of its line."""
    arrival_rad: Annotated[float, bounds.ARRIVAL_RAD] = 0.02
    """Farthest that it may be turned from there."""
    arrival_joint: Annotated[float, bounds.ARRIVAL_JOINT] = 0.01
    """Farthest that a joint may be from its goal, rad or m, if joints are moved."""
    arrival_timeout_s: Annotated[float, bounds.ARRIVAL_S] = 2.0
    """Longest wait for it once the command is at rest, beyond the robot's lag."""


class Arrival:
    """Watches the measured joints of one motion."""

    def __init__(self, options: ArrivalOptions, lag_s: float = 0.0) -> None:
        """`lag_s`: how far the robot may be behind its command in good order."""
        self.options, self.lag_s = options, lag_s
        self._seen: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=_KEPT)

    def observe(self, robot: RobotState) -> None:
        """Measured joints, for every tick of the motion."""
        if not self._seen or robot.stamp_s - self._seen[-1][0] >= _SPACING_S:
            self._seen.append((robot.stamp_s, robot.joints))

    def arrived(self, robot: RobotState, near: bool) -> bool:
        """Whether the arm, which is `near` its goal or not, has come to rest there: no joint has
        moved to speak of since one of the last places, and it was near since then."""
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
