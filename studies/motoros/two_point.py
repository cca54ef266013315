"""Stock MotoROS as its usual driver uses it: a trajectory for each goal, at rest at both ends.

For comparison only: every goal waits until the robot rests (motoman issue 386), and a sent
trajectory is played to its end, whatever the operator does meanwhile.
"""

from __future__ import annotations

import enum
import math
from typing import ClassVar

from cardan.drivers.motoros import Motoros
from cardan.drivers.motoros.diagnosis import reply_in_words
from cardan.drivers.motoros.motion import MotionParts, Trajectory
from cardan.drivers.motoros.motion_control import MotionControl
from cardan.drivers.motoros.options import STATE_PERIOD_S
from cardan.drivers.motoros.requests import Answer
from cardan.drivers.motoros.session import MotorosSession
from cardan.drivers.motoros.trajectory_limiter import JointTrajectoryLimiter
from cardan.protocols.simple_message.codes import MotionCommand, MotionResult
from cardan.protocols.simple_message.messages import JointTrajPtFull, MotionReply
from cardan.types import RobotCapabilities, RobotCommand

ARRIVED_RAD = 0.01
"""Distance to the goal at which a trajectory counts as done (motoman_driver's goal tolerance)."""
SAME_GOAL_RAD = 1e-5
"""Tolerance within which a goal equals the one already reached; a pulse is a few times larger."""
LONGEST_STEP_S = 0.1


def two_point_time_s(start: list[float], goal: list[float], guide: JointTrajectoryLimiter) -> float:
    """Return the shortest time of a cubic from rest to rest within speed and acceleration limits,
    s.

    Its fastest speed is 3/2 of the mean and its largest acceleration 6 Δ/T².
    """
    longest = 0.0
    for a, b, speed, acceleration in zip(
        start, goal, guide.speeds, guide.accelerations, strict=True
    ):
        way = abs(b - a)
        longest = max(longest, 1.5 * way / speed, math.sqrt(6.0 * way / acceleration))
    return longest


class _Phase(enum.Enum):
    RESTING = enum.auto()
    """Waiting until the robot rests for the first time."""
    IDLE = enum.auto()
    CHECKING = enum.auto()
    """Waiting for the answer whether motion is ready."""
    STARTING = enum.auto()
    """Waiting for the answer to point 0."""
    SENDING = enum.auto()
    """Waiting for the answer to point 1."""
    MOVING = enum.auto()


class TwoPointMoves(Trajectory):
    """Motion to the newest goal, started when the previous motion has ended.

    Control instants come with the controller's states, every 25 ms.
    """

    nominal_s = STATE_PERIOD_S
    busy_retry_s = 0.005  # as motoman_driver does

    def __init__(self, parts: MotionParts, now_s: float) -> None:
        super().__init__(parts, now_s)
        self._phase = _Phase.RESTING
        self._seen = parts.feed.statuses
        self._instant_s = now_s
        self._end: list[float] = []
        self._goal: list[float] = []
        self._stopping = False
        self._wait_for_rest("waiting for the robot to rest", now_s)

    def advance(self, now_s: float) -> None:
        phase = self._phase
        if phase is _Phase.RESTING:
            if self._rested(now_s):
                if not self._end:
                    self._guide.reset(self._feed.positions)
                self._end = list(self._feed.positions)
                self.waiting = ""
                self.next_s = math.inf
                self._phase = _Phase.IDLE
        elif phase is _Phase.MOVING:
            if self._arrived():
                self._phase = _Phase.IDLE
        elif phase in (_Phase.STARTING, _Phase.SENDING) and now_s >= self.next_s:
            self.next_s = math.inf
            self._again()
        if self._phase is _Phase.IDLE and not self._stopping and self._has_goal():
            self._phase = _Phase.CHECKING
            self._requests.control(MotionCommand.CHECK_MOTION_READY, self._checked)

    def _has_goal(self) -> bool:
        goal = self._guide.reference
        return any(abs(a - b) > SAME_GOAL_RAD for a, b in zip(goal, self._end, strict=True))

    def _arrived(self) -> bool:
        feed = self._feed
        return feed.at_rest_after(self._rest_since_s) and all(
            abs(a - b) <= ARRIVED_RAD for a, b in zip(feed.positions, self._end, strict=True)
        )

    def due(self, now_s: float) -> float:
        feed = self._feed
        if feed.statuses == self._seen:
            return 0.0
        self._seen = feed.statuses
        if self.waiting:
            self._instant_s = now_s
            return 0.0
        period_s = now_s - self._instant_s
        self._instant_s = now_s
        # States arrive in pairs after a delay; a step must not take zero time.
        self._period_s = min(max(period_s, 1e-3), LONGEST_STEP_S)
        return self._period_s

    def command(self, command: RobotCommand, now_s: float) -> None:
        self._guide.step(command, self._period_s)

    def wind_down(self) -> None:
        self._stopping = True

    def settled(self, now_s: float) -> bool:
        return not self._guide.moving and self._phase in (_Phase.IDLE, _Phase.RESTING)

    # -- replies ----------------------------------------------------------------------------------

    def _checked(self, answer: Answer, now_s: float) -> None:
        if not isinstance(answer, MotionReply) or answer.result != MotionResult.SUCCESS:
            subcode = answer.subcode if isinstance(answer, MotionReply) else 0
            self.ended = reply_in_words(
                MotionCommand.CHECK_MOTION_READY, MotionResult.NOT_READY, subcode
            )
            return
        self._phase = _Phase.STARTING
        self._sequence = self._time_ms = 0
        self._send(self._point(0, 0, self._end), now_s, "start")

    def _accepted(self, point: JointTrajPtFull, now_s: float) -> None:
        if point.sequence == 0:
            self._goal = list(self._guide.reference)
            ipc_ms = self.options.ipc_ms
            time_ms = math.ceil(1e3 * two_point_time_s(self._end, self._goal, self._guide))
            self._time_ms = max(2 * ipc_ms, time_ms)
            self._phase = _Phase.SENDING
            self._send(self._point(1, self._time_ms, self._goal), now_s, "point")
            return
        self._end = self._goal
        # Until then the queue may look empty because the point is still being converted.
        self._rest_since_s = now_s + 1e-3 * self._time_ms
        self._phase = _Phase.MOVING

    def _refused(self, now_s: float) -> None:
        self._phase = _Phase.RESTING
        self._wait_for_rest("the robot is not where it was commanded to be", now_s)


class TwoPointControl(MotionControl):
    """Motion by two-point trajectories."""

    by_points: ClassVar[type[Trajectory]] = TwoPointMoves


class TwoPointSession(MotorosSession):
    """Session of the driver with such motion, for a controller without the velocity mode."""

    kind_of_control: ClassVar[type[MotionControl]] = TwoPointControl

    @property
    def capabilities(self) -> RobotCapabilities:
        able = super().capabilities
        return able if self.control.uses_velocity else able._replace(period_s=STATE_PERIOD_S)


class TwoPointMotoros(Motoros):
    """Driver with that session, for `mode = "stream"`."""

    def _make_session(self) -> MotorosSession:
        return TwoPointSession(self.options)
