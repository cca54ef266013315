"""How the simulated arm follows what a program asks of it.

UR publishes neither servoj's law nor the arm's. Here `servoj` moves the target towards the joints
asked for with `lookahead_time` as its time constant, whatever the gain, which is what a ramp is
behind by; and the arm follows its target with 8 ms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from cardan.sim_peers.ur_controller.language import Action

_ARM_LAG_S: Final = 0.008
_STOP_RAD_S2: Final = 15.0
"""Of a stop that is not the program's."""
_AT_REST: Final = 1e-9
_TOO_FAST: Final = 1.05
"""Of a joint's highest speed: here the safety system stops the arm."""


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


class StopJ(NamedTuple):
    """Slow down to rest."""

    deceleration: float


class Servo:
    """The joints, commanded (`target_q`) and measured (`actual_q`), rad and rad/s."""

    def __init__(
        self,
        start: Sequence[float],
        speed: Sequence[float],
        low: Sequence[float],
        high: Sequence[float],
    ) -> None:
        self.target_q = list(start)
        self.target_qd = [0.0] * len(start)
        self.actual_q = list(start)
        self.actual_qd = [0.0] * len(start)
        self._speed, self._low, self._high = speed, low, high

    @property
    def moving(self) -> bool:
        """Whether the target moves."""
        return any(abs(v) > _AT_REST for v in self.target_qd)

    def at_speed(self, speeds: Sequence[float], scale: float) -> bool:
        """Whether the target moves at `scale` times these speeds."""
        return all(
            abs(v - scale * aim) <= _AT_REST for v, aim in zip(self.target_qd, speeds, strict=True)
        )

    def left_of(self, action: Action, dt_s: float, scale: float) -> Action | None:
        """What of an action is left after a frame."""
        if isinstance(action, StopJ):
            return action if self.moving else None
        if isinstance(action, SpeedJ) and action.left_s == 0.0:
            return None if self.at_speed(action.qd, scale) else action
        assert isinstance(action, (ServoJ, SpeedJ))
        left_s = action.left_s - dt_s * scale
        return None if left_s <= 1e-9 else action._replace(left_s=left_s)

    def step(self, action: Action | None, dt_s: float, scale: float) -> str:
        """One frame of `dt_s`, with the program's time running `scale` times as fast as real time.

        None brakes. Gives why the safety system has to stop the arm; empty: it has not.
        """
        if isinstance(action, ServoJ):
            share = -math.expm1(-dt_s * scale / action.lookahead_s)
            asked = [
                (goal - q) * share / dt_s for goal, q in zip(action.q, self.target_q, strict=True)
            ]
            for number, (v, most) in enumerate(zip(asked, self._speed, strict=True)):
                if abs(v) > _TOO_FAST * most:
                    return f"joint {number + 1} was asked for {v:.2f} rad/s, beyond {most:.2f}"
            self.target_qd = asked
        elif isinstance(action, SpeedJ):
            self._approach([scale * v for v in action.qd], action.acceleration * scale * dt_s)
        elif isinstance(action, StopJ):
            self._approach([0.0] * len(self.target_q), action.deceleration * dt_s)
        else:
            self._approach([0.0] * len(self.target_q), _STOP_RAD_S2 * dt_s)
        for joint, v in enumerate(self.target_qd):
            self.target_q[joint] += v * dt_s
            if not self._low[joint] <= self.target_q[joint] <= self._high[joint]:
                self.target_q[joint] -= v * dt_s
                self.target_qd[joint] = 0.0
                return f"joint {joint + 1} is at the end of its range"
        self._follow(dt_s)
        return ""

    def _approach(self, speeds: Sequence[float], change: float) -> None:
        """Change the speeds by at most `change`, all in the same share of time."""
        apart = [aim - v for aim, v in zip(speeds, self.target_qd, strict=True)]
        largest = max(map(abs, apart))
        share = 1.0 if largest <= change else change / largest
        self.target_qd = [v + share * each for v, each in zip(self.target_qd, apart, strict=True)]

    def _follow(self, dt_s: float) -> None:
        share = dt_s / (_ARM_LAG_S + dt_s)
        for joint, goal in enumerate(self.target_q):
            change = share * (goal - self.actual_q[joint])
            self.actual_q[joint] += change
            self.actual_qd[joint] = change / dt_s
