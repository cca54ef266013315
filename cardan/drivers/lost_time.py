"""Time in which a robot got no commands is lost, and never made up for.

While a process stands still, or datagrams are lost, most controllers continue at the last commanded
speed. The next command then differs from the robot's position: it is behind, if the application
continued from its last command, or ahead, if the robot slowed down. Sent at once it would cause a
jerk, and a robot that made up for lost time would be faster than commanded.

So the difference is kept, and added to every command. A robot that is ahead of its
command is slowed a little until it is not; one that is behind stays behind until it rests.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

WORK_OFF_S: Final = 0.5
"""Time constant with which a difference in place dies away: 6 mm, what 60 ms at 100 mm/s leave, at
12 mm/s. The arm has to be still 1.5 s after the operator lets go."""

WORK_OFF_SHARE: Final = 0.5
"""Share of the commanded speed by which it may be slowed for that."""

SPEED_UP_S: Final = 0.25
"""Time constant with which a robot that has slowed down by itself returns to its speed: from rest
to 250 mm/s at no more than 1 m/s²."""

SLOW_DOWN_S: Final = 0.1
"""The same for a robot that is faster than commanded: from 100 mm/s at 1 m/s²."""

_NOTHING = 1e-7
"""Smallest difference that counts: m, rad, and per s."""


class LostTime:
    """The difference in place and speed between a robot and its commands, along some axes.

    Units are those of the axes, rad or m. `offset` and `rate` are added to the commands. For
    orientations a subclass overrides `_displacement` and `_advanced`.
    """

    __slots__ = ("_gap_s", "_interrupted", "_slip", "_went", "offset", "rate", "working")

    def __init__(self, axes: int) -> None:
        self._clear(axes)

    def _clear(self, axes: int) -> None:
        self.offset = [0.0] * axes
        """How far the robot is ahead of its commands."""
        self.rate = [0.0] * axes
        """How much faster it is than its commands, per s."""
        self.working = False
        """False: there is no difference, and `step` need not be called."""
        self._interrupted = False
        self._gap_s = 0.0
        self._went = [0.0] * axes
        """Distance moved in the interruption beyond that of the commanded speed over `_gap_s`."""
        self._slip = [0.0] * axes
        """How much faster it is than commanded before the interruption."""

    def reset(self) -> None:
        """Forget the difference: the robot is where it is commanded to be."""
        if self.working:
            self._clear(len(self.offset))

    def passed(self, gap_s: float, apart: Sequence[float] = (), slip: Sequence[float] = ()) -> None:
        """`gap_s` have passed without a command, beyond the period that a command is for.

        The robot went on at the speed it had. By now it is `apart` from where that would have
        brought it, and by `slip` faster. Empty: neither.
        """
        self.working = self._interrupted = True
        self._gap_s += gap_s
        went, slipped = self._went, self._slip
        for i, each in enumerate(slipped):
            went[i] += each * gap_s
        for i, each in enumerate(apart):
            went[i] += each
        for i, each in enumerate(slip):
            slipped[i] += each

    def follow(
        self,
        asked: tuple[Any, Sequence[float] | None] | None,
        target: Any,
        speeds: Sequence[float] | None,
        dt_s: float,
        seen_s: float = 0.0,
    ) -> tuple[Any, Any]:
        """What to send for one period, while `working`, with a `target` that moves at `speeds`.

        `asked` is the target before with its speeds, None after anything else than a target.
        Where the speeds of either are not known, the difference is forgotten; `seen_s`, if above
        0, is then the time between the two targets, and gives the speeds.
        """
        if asked is None:
            self.reset()
            return target, speeds
        moved = self._displacement(asked[0], target)
        if speeds is None or asked[1] is None:
            self.reset()
            if speeds is None and seen_s > 0.0:
                speeds = [way / seen_s for way in moved]
            return target, speeds
        self.step(moved, asked[1], speeds, dt_s)
        return (
            self._advanced(target, self.offset),
            tuple([v + more for v, more in zip(speeds, self.rate, strict=True)]),
        )

    def _displacement(self, start: Any, end: Any) -> list[float]:
        """Displacement from one position to another, along the axes."""
        return [b - a for a, b in zip(start, end, strict=True)]

    def _advanced(self, place: Any, by: Sequence[float]) -> Any:
        """The position `by` ahead."""
        return tuple([q + way for q, way in zip(place, by, strict=True)])

    def step(
        self,
        moved: Sequence[float],
        before: Sequence[float],
        velocity: Sequence[float],
        dt_s: float,
    ) -> None:
        """One period with a command that moves at `velocity`.

        It is `moved` from the command before it, which moved at `before`, both without what is
        added here.
        """
        if self._interrupted:
            self._resume(moved, before, velocity, dt_s)
            before = velocity
        offset, rate = self.offset, self.rate
        ahead = square = faster = size = 0.0
        for v, each, r in zip(velocity, offset, rate, strict=True):
            ahead += each * v
            square += v * v
            size += each * each
            faster += r * (v + 0.5 * r)
        back = 0.0
        if square < _NOTHING * _NOTHING:
            back = -1.0 / WORK_OFF_S
        elif ahead > 0.0:
            back = -min(1.0 / WORK_OFF_S, WORK_OFF_SHARE * math.sqrt(square / size))
        share = min(dt_s / (SLOW_DOWN_S if faster > 0.0 else SPEED_UP_S), 1.0)
        left = False
        for i, each in enumerate(offset):
            v = velocity[i]
            # The robot's speed moves towards its aim and never away from it: a robot that stands
            # while its command brakes would otherwise be moved back.
            current, aim = before[i] + rate[i], v + back * each
            speed = v + rate[i] + share * (back * each - rate[i])
            low, high = (current, aim) if current < aim else (aim, current)
            rate[i] = r = min(max(speed, low), high) - v
            offset[i] = each = each + r * dt_s
            left = left or abs(each) > _NOTHING or abs(r) > _NOTHING
        if not left:
            self.reset()

    def _resume(
        self,
        moved: Sequence[float],
        before: Sequence[float],
        velocity: Sequence[float],
        dt_s: float,
    ) -> None:
        """Take the interruption into account, less what the command itself has moved."""
        offset, rate, went, slip = self.offset, self.rate, self._went, self._slip
        for i, way in enumerate(moved):
            robot = (before[i] + rate[i]) * self._gap_s + went[i]
            offset[i] += robot - (way - velocity[i] * dt_s)
            rate[i] += slip[i] + before[i] - velocity[i]
            went[i] = slip[i] = 0.0
        self._interrupted, self._gap_s = False, 0.0
