"""Streaming to stock MotoROS: one endless trajectory whose queue is kept shallow.

A controller cannot replace a trajectory by another without a standstill in between, and it accepts
up to 0.8 s of points before it reports busy. Therefore there is one trajectory, and its next point
is computed when the queue has nearly run empty: the robot is the clock. The stream continues with
equal points while nothing moves. Stopping it would be no safer (without points MotoROS stands as
still), and a restart requires a robot at rest, for which its servos need 0.2 to 0.5 s.
"""

from __future__ import annotations

import enum
import math
from collections import deque

from cardan.drivers.motoros.motion import MotionParts, Trajectory
from cardan.drivers.motoros.requests import Answer
from cardan.protocols.simple_message.codes import MotionCommand, MotionResult
from cardan.protocols.simple_message.messages import JointTrajPtFull
from cardan.types import HoldCommand, RobotCommand

STANDS_STILL_S = 0.5
"""Time without a shorter queue after which it counts as not being executed."""
SLOW_REPLY_S = 0.02
"""Longest round trip whose reply still tells how much has been executed."""
RTT_MEMORY = 0.95
"""Share of the longest round trip that is kept at the next one."""
EMPTY_WITHIN_S, EMPTY_TIMES = 10.0, 3
"""Time in which a stream that ran empty EMPTY_TIMES times is given up."""

LAST_TIME_MS = 8_150_000
"""Longest trajectory time: beyond 8192 s float32 does not resolve 2 ms any more."""
RENEW_TIME_MS = 4_000_000
"""Trajectory time from which on a standstill of RENEW_REST_S serves to begin a new trajectory."""
RENEW_REST_S = 2.0


class _Phase(enum.Enum):
    RESTING = enum.auto()
    """Waiting until the robot rests and point 0 can be sent."""
    STARTING = enum.auto()
    """Point 0 was sent."""
    QUEUED = enum.auto()
    """The queue suffices until its next query."""
    ASKING = enum.auto()
    """Waiting for the reply with the queue's length."""
    INSTANT = enum.auto()
    """The next point is to be computed now."""
    SENDING = enum.auto()
    """A point waits to be accepted."""


class PointStream(Trajectory):
    """An endless trajectory. Control instants come when `queue_low` increments are left."""

    busy_retry_s = 0.002

    def __init__(self, parts: MotionParts, now_s: float) -> None:
        super().__init__(parts, now_s)
        options = parts.options
        self._increments = options.spacing_increments
        self._ipc_s = options.ipc_ms * 1e-3
        self._spacing_ms = self._increments * options.ipc_ms
        self.nominal_s = self._spacing_ms * 1e-3
        self._phase = _Phase.RESTING
        self._rest_points = 0
        self._renewing = False
        self._moving_at_send = self._was_moving = False
        """True if the newest point, and the one before, is one in motion."""
        self._empty_s = now_s
        """Time at which the queue will have run empty, unless points are added."""
        self._counted_s = now_s
        """Time at which `queue_count` was reported."""
        self._rtt_s = 0.0
        """Longest recent round trip."""
        self._shorter_s = now_s
        """Last time that the queue had become shorter."""
        self._ran_empty_s: deque[float] = deque(maxlen=EMPTY_TIMES)
        self._played_s = now_s
        """Time at which all accepted increments will have been executed."""
        self._wait_for_rest("waiting for the robot to rest, to begin a trajectory", now_s)

    # -- time -------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        phase = self._phase
        if phase is _Phase.RESTING:
            if now_s > self._rest_since_s and self._rested(now_s):
                self._phase = _Phase.STARTING
                self._begin(now_s)
        elif now_s < self.next_s:
            return
        elif phase is _Phase.QUEUED:
            self._phase = _Phase.ASKING
            self.next_s = math.inf
            self._requests.control(MotionCommand.CHECK_QUEUE_CNT, self._counted)
        elif phase in (_Phase.SENDING, _Phase.STARTING):
            self.next_s = math.inf
            self._again()

    def due(self, now_s: float) -> float:
        return self.nominal_s if self._phase is _Phase.INSTANT else 0.0

    def command(self, command: RobotCommand, now_s: float) -> None:
        if self._phase is not _Phase.INSTANT:
            return
        if self._moving_at_send and now_s > self._empty_s:
            self._ran_empty(now_s)
            return
        guide = self._guide
        guide.step(HoldCommand() if self._renewing else command, self.nominal_s)
        if self._renew_now(now_s):
            return
        self._sequence += 1
        self._time_ms += self._spacing_ms
        self._was_moving = self._moving_at_send
        self._moving_at_send = not self._resting()
        self._phase = _Phase.SENDING
        point = self._point(self._sequence, self._time_ms, guide.reference, guide.velocity)
        self._send(point, now_s, "point")

    def _renew_now(self, now_s: float) -> bool:
        """Leave a trajectory whose times have become large, at standstill."""
        if not self._resting():
            self._rest_points = 0
            self._renewing = self._time_ms >= LAST_TIME_MS
            return False
        self._rest_points += 1
        rested = self._rest_points * self.nominal_s >= RENEW_REST_S
        # The point at rest must have been sent, so the one before must be at rest, too.
        if self._rest_points > 1 and (
            self._renewing or (rested and self._time_ms >= RENEW_TIME_MS)
        ):
            self._counters.restarts += 1
            self._renewing = False
            self._rest_points = 0
            self._phase = _Phase.RESTING
            self._wait_for_rest("a new trajectory is being started", self._played_s)
            return True
        self._renewing = self._time_ms >= LAST_TIME_MS
        return False

    def _ran_empty(self, now_s: float) -> None:
        """Restart after the command has stopped dead: the next segment would begin at the last
        point's speed, so a new trajectory from rest is needed."""
        self._counters.underruns += 1
        self._ran_empty_s.append(now_s)
        if len(self._ran_empty_s) == EMPTY_TIMES and now_s - self._ran_empty_s[0] <= EMPTY_WITHIN_S:
            self.ended = (
                "the controller's queue ran empty again and again: its replies or this computer "
                "are too slow for a stream; set point_spacing_s or queue_low higher"
            )
            return
        self._guide.reset(tuple(self._guide.reference))
        self._phase = _Phase.RESTING
        self._wait_for_rest("the stream ran empty, a new one is being started", now_s)

    def settled(self, now_s: float) -> bool:
        still = not self._guide.moving and self._phase is not _Phase.SENDING
        return still and now_s >= self._played_s

    # -- replies ----------------------------------------------------------------------------------

    def _accepted(self, point: JointTrajPtFull, now_s: float) -> None:
        if point.sequence == 0:
            self.waiting = ""
            self._counters.queue_count = 0
            self._played_s = self._empty_s = self._shorter_s = self._counted_s = now_s
            self._moving_at_send = False
            self._phase = _Phase.INSTANT
            return
        if self._timed(now_s) > SLOW_REPLY_S and self._was_moving:
            self._ran_empty(now_s)
            return
        played = int((now_s - self._counted_s) / self._ipc_s)
        self._counters.queue_count += self._increments
        count = max(self._counters.queue_count - played, 0)
        self._empty_s += self._increments * self._ipc_s
        self._shorter_s = now_s
        # The point is converted within one period and executed from the next one on.
        self._played_s = now_s + (count + 2) * self._ipc_s
        if count <= self._low:
            self._phase = _Phase.INSTANT
            return
        self._phase = _Phase.QUEUED
        self.next_s = now_s + (count - self._low) * self._ipc_s

    def _timed(self, now_s: float) -> float:
        """Return the round trip that ends now, s."""
        took_s = now_s - self._requests.asked_s
        self._rtt_s = max(RTT_MEMORY * self._rtt_s, took_s)
        return took_s

    @property
    def _low(self) -> int:
        """Remaining queue at which the next point is computed: query and transmission take time."""
        return self.options.queue_low + round(2.0 * self._rtt_s / self._ipc_s)

    def _counted(self, answer: Answer, now_s: float) -> None:
        reply = self._result(answer)
        if reply is None:
            return
        if reply.result != MotionResult.SUCCESS or reply.subcode < 0:
            self.ended = "the controller does not say how much its queue holds"
            return
        before = self._counters.queue_count
        self._counters.queue_count = count = reply.subcode
        if count < before:
            self._shorter_s = now_s
        elif count and now_s - self._shorter_s > STANDS_STILL_S:
            self.ended = (
                f"the controller executes nothing of its queue ({count} increments): a speed "
                "limit of "
                "the safety unit, or a stop that its status does not show"
            )
            return
        took_s = self._timed(now_s)
        self._counted_s = now_s
        # The queue held that many at the end of the round trip at the latest.
        self._empty_s = now_s + (count + 2) * self._ipc_s
        low = self._low
        if count > low:
            self._phase = _Phase.QUEUED
            self.next_s = now_s + (count - low) * self._ipc_s
            return
        if self._moving_at_send and (count == 0 or took_s > SLOW_REPLY_S):
            self._ran_empty(now_s)
            return
        self._phase = _Phase.INSTANT

    def _refused(self, now_s: float) -> None:
        self._phase = _Phase.RESTING
        self._wait_for_rest("the robot is not where it was commanded to be", now_s)
