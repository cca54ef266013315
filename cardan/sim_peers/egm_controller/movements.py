"""Movements of the arm without guidance, one after the other."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from cardan.sim_peers.egm_controller.motion import JointMove, RampDown, ServoAxes
from cardan.sim_peers.kinematics import AXES

_STILL = [0.0] * AXES


class Movements:
    """A queue of braking ramps and joint movements; each starts at the end of the previous one."""

    def __init__(self, servo: ServoAxes) -> None:
        self._servo = servo
        self._current: RampDown | JointMove | None = None
        self._next: deque[Callable[[], RampDown | JointMove]] = deque()

    @property
    def busy(self) -> bool:
        """True while a movement is under way or queued."""
        return self._current is not None or bool(self._next)

    def brake(self, ramp_s: float) -> None:
        """Queue a ramp to zero speed; 0 is as fast as the axes can."""
        self._next.append(lambda: RampDown(self._servo, ramp_s))

    def go(self, joints: Sequence[float], at_least_s: float = 0.0) -> None:
        """Queue a movement to `joints`, rad."""
        self._next.append(lambda: JointMove(self._servo, joints, at_least_s))

    def clear(self) -> None:
        """Discard all movements; an arm that still moves brakes."""
        self._current = None
        self._next.clear()

    def tick(self) -> bool:
        """Move for one cycle; return True when all movements are done and the arm stands."""
        if self._current is None and self._next:
            self._current = self._next.popleft()()
        if self._current is None:
            self._servo.drive(_STILL)
        elif self._current.tick():
            self._current = None
        return not self.busy and self._servo.at_rest
