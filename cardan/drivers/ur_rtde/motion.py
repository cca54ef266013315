"""Reference sent to the program, within the limits whatever is commanded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from cardan.drivers.limiters import JointLimiter
from cardan.drivers.missed_cycles import SlipCompensation
from cardan.drivers.ur_rtde.compiled import compiled_answer
from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.protocols.ur.program import JOINTS, ProgramCommand
from cardan.types import JointCommand, JointVelocityCommand, RobotCommand

_BEATS: Final = 1 << 30
_SAME_CYCLE: Final = 1.5
"""Periods since the previous command from which on a cycle counts as missed."""


class UrMotion:
    """Run of the program, from its first report on. Times are those agreed by both clocks."""

    def __init__(self, options: UrRtdeOptions, token: int, beat: int, head: bytes = b"") -> None:
        """Set `head`, the first bytes of command packages; empty: no package can be made here."""
        self._token = token
        self.beat = beat
        """Beat of the last command."""
        self._limiter = JointLimiter(*options.limits, longest_period_s=options.watchdog_s)
        self._lost = SlipCompensation(JOINTS)
        self._answer = compiled_answer(self._limiter, self._lost, head, token) if head else None
        self._asked: tuple[Sequence[float], Sequence[float] | None] | None = None
        self._answered_s: float | None = None
        """Time of the last answered state."""

    @property
    def moving(self) -> bool:
        """True if the reference has a speed."""
        return self._limiter.moving

    @property
    def reference(self) -> tuple[float, ...]:
        """Commanded joint positions, rad."""
        return tuple(self._limiter.reference)

    def begin(self, place: Sequence[float]) -> None:
        """Continue from `place`, at rest; earlier commands are void."""
        self._limiter.reset(place)
        self._asked = self._answered_s = None

    def usual(self, command: RobotCommand, time_s: float, period_s: float) -> bytes | None:
        """Return the data package that answers the state of `time_s` while the controller's time
        passes as real time; None, and no change, if `command` must be used."""
        before_s = self._answered_s
        if (
            self._answer is None
            or before_s is None
            or not 0.0 < time_s - before_s <= _SAME_CYCLE * period_s
        ):
            return None
        asked = self._asked if self._lost.working else None
        if self._lost.working and (asked is None or self._lost.resumed):
            return None
        beat = (self.beat + 1) % _BEATS
        package = self._answer(command, period_s, beat, asked)
        if package is not None:
            self.beat, self._answered_s = beat, time_s
            self._asked = command[:2]  # type: ignore[assignment]
        return package

    def command(
        self, command: RobotCommand, time_s: float, period_s: float, scale: float
    ) -> list[Any] | bytes | None:
        """Return the register values that answer the state of `time_s`, or their whole data
        package; None if it has been answered.

        `scale` is the rate of the controller's time relative to real time, above 0.
        """
        before_s, self._answered_s = self._answered_s, time_s
        if before_s is not None:
            passed_s = time_s - before_s
            if passed_s <= 0.0:
                self._answered_s = before_s
                return None
            if passed_s > _SAME_CYCLE * period_s:
                # The program has continued at its last commanded speeds.
                gap_s = passed_s - period_s
                self._limiter.coast(gap_s * scale)
                self._lost.passed(gap_s)
        if isinstance(command, JointCommand):
            positions, speeds = command.positions, command.velocities
            asked, self._asked = self._asked, (positions, speeds)
            if self._lost.working:
                positions, speeds = self._lost.follow(asked, positions, speeds, period_s)
            if scale == 1.0:
                if self._answer is not None:
                    beat = (self.beat + 1) % _BEATS
                    followed = JointCommand(positions, speeds)
                    package = self._answer(followed, period_s, beat, None)
                    if package is not None:
                        self.beat = beat
                        return package
            elif speeds is not None:
                speeds = tuple([v / scale for v in speeds])
            self._limiter.track(positions, speeds, period_s * scale)
        else:
            self._asked = None
            self._lost.reset()
            if isinstance(command, JointVelocityCommand):
                driven = [v / scale for v in command.velocities]
                self._limiter.drive(driven, period_s * scale)
            else:
                self._limiter.brake(period_s * scale)
        return self._values(ProgramCommand.FOLLOW)

    def end(self) -> list[Any]:
        """Return the register values that make the program stop the arm and end."""
        return self._values(ProgramCommand.END)

    def _values(self, order: ProgramCommand) -> list[Any]:
        self.beat = (self.beat + 1) % _BEATS
        limiter = self._limiter
        return [self._token, self.beat, order, *limiter.reference, *limiter.velocity]
