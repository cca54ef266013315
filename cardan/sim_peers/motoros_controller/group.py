"""A control group: from points of a trajectory to the pulses commanded in each IPC.

Follows MotoROS 1.9.12 (MotionServer.c): a point becomes increments of one IPC each in a queue, and
each IPC takes one. It keeps no clock; `fill` and `take` are called once an IPC.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from cardan.protocols.simple_message.codes import InvalidSubcode

START_PULSES = 30
"""Largest distance of point 0 from the commanded position; also the threshold of motion."""

_REFUSED_SPEED = 1.1
"""Share of an axis's highest speed above which the controller refuses increments."""

_LONGEST_MS = 2**31 - 1
_NO_INTEGER = -(2**31)
"""Result of C's conversion of a number too large for an integer on x86; other processors differ."""
_SINGLE = struct.Struct("<f")


def milliseconds(time_s: float) -> int:
    """Return the whole ms of a time on the wire: the product in single precision, truncated.

    0.6 to 1 % of the times on a grid of 1 ms become 1 ms low, as on the controller. Times out of
    range, and NaN, become the longest time.
    """
    if not abs(time_s) < _LONGEST_MS / 1000:
        return int(math.copysign(_LONGEST_MS, time_s))
    single = _SINGLE.unpack(_SINGLE.pack(time_s))[0]
    return int(_SINGLE.unpack(_SINGLE.pack(single * 1000.0))[0])


def _finite(time_s: float, joints_rad: list[float], speeds_rad_s: list[float]) -> bool:
    """Return True if all are finite. MotoROS does not check; see 3010 in
    docs/simulated-peers.md."""
    return math.isfinite(time_s) and all(map(math.isfinite, (*joints_rad, *speeds_rad_s)))


def _too_fast(speed_rad_s: float, highest_rad_s: float) -> bool:
    """Return True if too fast by the C code, which truncates the speed first."""
    return abs(int(speed_rad_s)) > highest_rad_s


class _Start(NamedTuple):
    """Start of the next segment."""

    time_ms: int
    position: list[float]
    speed: list[float]
    previous: list[int]
    """Pulses that the first increment is counted from."""


class _Segment:
    """Segment between two points, with its conversion so far."""

    __slots__ = ("cubics", "end_ms", "first_ms", "now_ms", "step_ms")

    def __init__(self, cubics: list[tuple[float, float, float, float]], end_ms: int) -> None:
        self.cubics = cubics
        self.end_ms = end_ms
        self.first_ms = self.now_ms = self.step_ms = 0


class ControlGroup:
    """Axes that move together. Positions are in pulses, those of points in rad (m).

    `lower` and `upper` are the limits of the controller's own check of increments.
    """

    def __init__(
        self,
        pulses_per_rad: Sequence[float],
        speeds_rad_s: Sequence[float],
        lower_rad: Sequence[float],
        upper_rad: Sequence[float],
        start_rad: Sequence[float],
        ipc_s: float,
        queue_increments: int,
    ) -> None:
        self.axes = len(pulses_per_rad)
        self.pulses_per_rad = tuple(pulses_per_rad)
        self.command = self.pulses(start_rad)
        """The present command."""
        self.tool = 0
        self.speeds_rad_s = tuple(speeds_rad_s)
        self.largest_increments = tuple(
            speed * each * ipc_s for speed, each in zip(speeds_rad_s, pulses_per_rad, strict=True)
        )
        self._refused = [_REFUSED_SPEED * each + 1.0 for each in self.largest_increments]
        self._lower = [
            q * each - START_PULSES for q, each in zip(lower_rad, pulses_per_rad, strict=True)
        ]
        self._upper = [
            q * each + START_PULSES for q, each in zip(upper_rad, pulses_per_rad, strict=True)
        ]
        self._ipc_ms = round(ipc_s * 1000.0)
        self._room = queue_increments
        self.queue: deque[tuple[int, list[int]]] = deque()
        """Trajectory time in ms, and the pulses to go."""
        self.has_data = False
        """True while a point is converted; the next one is answered BUSY."""
        self._time_ms = 0
        self._position = list(start_rad)
        self._speed = [0.0] * self.axes
        self._todo: tuple[int, list[float], list[float]] = (0, [], [])
        self._segment: _Segment | None = None
        self._overwritten: _Start | None = None
        """Point 0 that arrived while the filler waited inside a segment."""
        self._left_ms = 0
        self._previous = list(self.command)
        self._queue_time_ms = 0
        self._zeros = [0] * self.axes
        self.owed = [0] * self.axes
        """Pulses that a speed limit has held back."""
        self._cap = [0] * self.axes
        self.owes = False
        """True while `owed` is not all zero."""

    # -- points -----------------------------------------------------------------------------------

    def pulses(self, joints_rad: Sequence[float]) -> list[int]:
        """Convert joints to pulses, truncated toward zero. A NaN, or a value too large for an
        integer of the controller, becomes one to which it executes no increments."""
        return [
            int(pulses) if -_LONGEST_MS <= (pulses := q * each) <= _LONGEST_MS else _NO_INTEGER
            for q, each in zip(joints_rad, self.pulses_per_rad, strict=False)
        ]

    def begin(
        self, time_s: float, joints_rad: Sequence[float], speeds_rad_s: Sequence[float]
    ) -> int:
        """Begin with point 0. Return 0, or the InvalidSubcode of a refusal.

        As in MotionServer.c the point is stored before any check, even if it is refused: later
        points continue from it, with the whole distance from the command in their first increment.
        If the filler waits for room in the queue, its next sample undoes that. The axes are checked
        one after the other, the position of each before its speed.
        """
        axes = self.axes
        joints, speeds = list(joints_rad[:axes]), list(speeds_rad_s[:axes])
        self._queue_time_ms = milliseconds(time_s)
        self._left_ms = 0
        start = _Start(self._queue_time_ms, joints, speeds, list(self.command))
        if self._segment is None:
            self._begin_at(start)
        else:
            self._overwritten = start
        if not _finite(time_s, joints, speeds):
            return InvalidSubcode.DATA
        for wanted, now, speed, highest in zip(
            self.pulses(joints), self.command, speeds, self.speeds_rad_s, strict=True
        ):
            if abs(wanted - now) > START_PULSES:
                return InvalidSubcode.DATA_START_POS
            if _too_fast(speed, highest):
                return InvalidSubcode.DATA_SPEED
        return 0

    def _begin_at(self, start: _Start) -> None:
        self._time_ms, self._position, self._speed, self._previous = start

    def add(self, time_s: float, joints_rad: Sequence[float], speeds_rad_s: Sequence[float]) -> int:
        """Add a further point, while `has_data` is False. Return 0, or the InvalidSubcode of a
        refusal, which changes nothing."""
        axes = self.axes
        joints, speeds = list(joints_rad[:axes]), list(speeds_rad_s[:axes])
        if not _finite(time_s, joints, speeds):
            return InvalidSubcode.DATA
        if any(map(_too_fast, speeds, self.speeds_rad_s)):
            return InvalidSubcode.DATA_SPEED
        self._todo = (milliseconds(time_s), joints, speeds)
        self._segment = None
        self.has_data = True
        return 0

    # -- the filler -------------------------------------------------------------------------------

    def fill(self, ready: bool) -> None:
        """Convert as much of the point as fits in the queue; drop it unless `ready`."""
        if not self.has_data:
            return
        if not ready:
            self._drop_point()
            return
        end_ms, end_position, end_speed = self._todo
        segment = self._segment
        if segment is None:
            if end_ms <= self._time_ms:
                self.has_data = False
                return
            segment = self._segment = self._planned(end_ms, end_position, end_speed)
        queue, ipc_ms = self.queue, self._ipc_ms
        while len(queue) < self._room:
            now_ms = segment.now_ms + segment.step_ms
            if now_ms < end_ms:
                segment.now_ms = now_ms
                segment.step_ms = ipc_ms
                tau = (now_ms - segment.first_ms) * 0.001
                position = [
                    ((c3 * tau + c2) * tau + c1) * tau + c0 for c0, c1, c2, c3 in segment.cubics
                ]
                self._time_ms = now_ms
                self._position = position
            else:
                self._left_ms = now_ms - end_ms
                self._time_ms, self._position, self._speed = end_ms, end_position, end_speed
                position = end_position
            pulses = self.pulses(position)
            queue.append(
                (
                    self._time_ms,
                    [new - old for new, old in zip(pulses, self._previous, strict=True)],
                )
            )
            self._previous = pulses
            self._overwritten = None
            if now_ms >= end_ms:
                self._segment = None
                self.has_data = False
                return

    def _planned(self, end_ms: int, end_position: list[float], end_speed: list[float]) -> _Segment:
        t = (end_ms - self._time_ms) * 0.001
        cubics = []
        for p0, p1, v0, v1 in zip(
            self._position, end_position, self._speed, end_speed, strict=True
        ):
            a1 = 6.0 * (p1 - p0) / (t * t) - 2.0 * (v1 + 2.0 * v0) / t
            a2 = -12.0 * (p1 - p0) / (t * t * t) + 6.0 * (v1 + v0) / (t * t)
            cubics.append((p0, v0, a1 / 2.0, a2 / 6.0))
        segment = _Segment(cubics, end_ms)
        segment.first_ms = segment.now_ms = self._time_ms
        segment.step_ms = self._left_ms or self._ipc_ms
        self._left_ms = 0
        return segment

    def _drop_point(self) -> None:
        """Drop the point and its speed in place, since no next point continues from it."""
        segment = self._segment
        if segment is not None:
            tau = (segment.now_ms - segment.first_ms) * 0.001
            self._speed = [
                (3.0 * c3 * tau + 2.0 * c2) * tau + c1 for _, c1, c2, c3 in segment.cubics
            ]
        self._segment = None
        self.has_data = False
        if self._overwritten is not None:
            self._begin_at(self._overwritten)
            self._overwritten = None

    # -- the increment task -----------------------------------------------------------------------

    @property
    def holding_data(self) -> bool:
        """True if the queue holds increments, or pulses are owed."""
        return bool(self.queue) or self.owes

    def take(self, resend: bool) -> list[int]:
        """Take the increments of this IPC, pulses: one entry, and those of the same IPC.

        With `resend` pulses that a speed limit held back come first, no faster than the segment
        that they belong to.
        """
        if resend and self.owes:
            owed, cap = self.owed, self._cap
            if self.queue and not any(
                abs(due) >= most > 0 for due, most in zip(owed, cap, strict=True)
            ):
                for axis, pulses in enumerate(self._take_entry()):
                    owed[axis] += pulses
                    cap[axis] = max(cap[axis], abs(pulses))
            return [max(-most, min(most, due)) for due, most in zip(owed, cap, strict=True)]
        if not self.queue:
            return self._zeros
        increments = self._take_entry()
        if resend:
            self._cap = [abs(pulses) for pulses in increments]
            self.owed = list(increments)
        return increments

    def _take_entry(self) -> list[int]:
        queue, start_ms = self.queue, self._queue_time_ms
        time_ms, increments = queue.popleft()
        while queue and start_ms <= queue[0][0] <= start_ms + self._ipc_ms:
            time_ms, more = queue.popleft()
            increments = [a + b for a, b in zip(increments, more, strict=True)]
        self._queue_time_ms = time_ms
        return increments

    def refuses(self, increments: Sequence[int]) -> bool:
        """Return True if the controller would refuse these: too fast, or out of an axis's range."""
        if increments is self._zeros:
            return False
        for pulses, most, now, lower, upper in zip(
            increments, self._refused, self.command, self._lower, self._upper, strict=True
        ):
            if not -most <= pulses <= most:
                return True
            if (pulses > 0 and now + pulses > upper) or (pulses < 0 and now + pulses < lower):
                return True
        return False

    def limited(self, increments: Sequence[int], share: float) -> Sequence[int]:
        """Scale `increments` down to `share` of the highest speeds.

        All axes are slowed alike.
        """
        scale = 1.0
        for pulses, most in zip(increments, self.largest_increments, strict=True):
            if abs(pulses) * scale > most * share:
                scale = most * share / abs(pulses)
        if scale >= 1.0:
            return increments
        return [int(pulses * scale) for pulses in increments]

    def execute(self, increments: Sequence[int], resend: bool) -> None:
        """Add the increments to the command. With `resend`, missing pulses of `take` stay owed."""
        command = self.command
        for axis, pulses in enumerate(increments):
            command[axis] += pulses
        if resend and increments is not self._zeros:
            owed = self.owed
            for axis, pulses in enumerate(increments):
                owed[axis] -= pulses
            self.owes = any(owed)

    def clear(self) -> None:
        """Empty the queue and discard the point and owed pulses."""
        self.queue.clear()
        if self.has_data:
            self._drop_point()
        self.forget_owed()

    def forget_owed(self) -> None:
        """Drop owed pulses: the stopped increment task starts again from the arm's position."""
        if self.owes:
            self.owed = [0] * self.axes
            self.owes = False

    def restart(self) -> None:
        """Restart as START_TRAJ_MODE does: no increments; the next ones count from the command."""
        self.clear()
        self._previous = list(self.command)
