"""Base of the three ways to move a robot through MotoROS."""

from __future__ import annotations

import csv
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from cardan.common.files import create_file
from cardan.drivers.motoros.diagnosis import reply_in_words
from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.requests import Answer, MotionRequests
from cardan.drivers.motoros.trajectory_limiter import JointTrajectoryLimiter
from cardan.errors import CardanError
from cardan.protocols.simple_message.codes import (
    ControllerMode,
    InvalidSubcode,
    MessageType,
    MotionResult,
    ValidFields,
)
from cardan.protocols.simple_message.messages import JointTrajPtFull, Message, MotionReply, joints10
from cardan.types import NEVER_S, RobotCommand

POINT_FIELDS = ValidFields.TIME | ValidFields.POSITION | ValidFields.VELOCITY
"""Values that MotoROS requires; it ignores accelerations."""

REST_TIMEOUT_S = 5.0
"""Longest time to come to rest: servos lag by less than half a second."""

REST_RAD_S = 1e-6
"""Speed that counts as rest: rounding keeps a limiter that follows positions from exact zero."""

BRAKE_MARGIN_S = 1.0
"""Time besides the ramp itself, for queued points and replies."""

WAKING_S = 0.06
"""Time after the first point in which statuses may still be older: two of their cycles."""

READY_S = 0.1
"""Lag of the status behind the reply to START_TRAJ_MODE: inputs are polled every 10 ms, and the
state is sent every 25 ms."""

START_TRIES = 3
"""Attempts for point 0, made from feedback: a sagging arm's differs from the commanded position."""


@dataclass(slots=True)
class MotionCounters:
    """Counts of command outcomes since the driver was opened."""

    commands: int = 0
    """Points or velocities sent."""
    underruns: int = 0
    """Times that the controller's queue ran empty during a motion."""
    busy_replies: int = 0
    resent_points: int = 0
    queue_count: int = 0
    """Increments in the controller's queue at the last query."""
    restarts: int = 0
    """Trajectories restarted at standstill because their times had become too large."""
    replaced: int = 0
    """Feedback messages in velocity mode that moved the commanded position towards the arm's."""
    skipped_instants: int = 0
    """Command periods that this computer missed."""
    speed_limited: int = 0
    """Replies that report that the controller limited a speed."""
    acceleration_limited: int = 0
    range_limited: int = 0
    overwritten: int = 0
    """Velocity commands replaced by a newer one before the controller used them."""
    command_age_s: float = 0.0
    """Age of the newest queried command when the controller first used it."""


class MotionRecord:
    """Rows of commands and feedback, kept in memory and written at the end."""

    HEADER = ("monotonic_s", "kind")

    def __init__(self, path: str, joints: int) -> None:
        self.path = path
        self.rows: list[tuple[float, str, tuple[float, ...], tuple[float, ...], int]] = []
        self._joints = joints

    def add(
        self,
        time_s: float,
        kind: str,
        commanded: tuple[float, ...],
        measured: tuple[float, ...],
        queue_count: int,
    ) -> None:
        """Add a row; without a path nothing is kept."""
        if self.path:
            self.rows.append((time_s, kind, commanded, measured, queue_count))

    def write(self) -> None:
        """Write the file, if a path was given. Raises CardanError if that fails."""
        if not self.path:
            return
        numbers = range(1, self._joints + 1)
        header = [
            *self.HEADER,
            *(f"commanded_{n}_rad" for n in numbers),
            *(f"measured_{n}_rad" for n in numbers),
            "queue_count",
        ]
        empty = ("",) * self._joints
        try:
            with create_file(self.path) as file:
                rows = csv.writer(file)
                rows.writerow(header)
                for time_s, kind, commanded, measured, count in self.rows:
                    sent, seen = commanded or empty, measured or empty
                    rows.writerow([f"{time_s:.6f}", kind, *sent, *seen, count])
        except OSError as error:
            raise CardanError(f"record: {self.path}: {error.strerror or error}") from None


class MotionParts(NamedTuple):
    """Parts of the session that a motion uses."""

    options: MotorosOptions
    requests: MotionRequests
    feed: StateFeed
    guide: JointTrajectoryLimiter
    """Limiter with the limits of this motion."""
    counters: MotionCounters
    record: MotionRecord


class MotorosMotion(ABC):
    """A period of motion in one of the controller's modes.

    The session calls `advance` at `next_s`, answers each control instant that `due` reports with
    `command`, and checks `ended`. Replies come through the requests' callbacks.
    """

    nominal_s: float
    """Time between two control instants, s."""
    feeds_at_rest = False
    """True if the controller needs commands even at standstill."""

    def __init__(self, parts: MotionParts) -> None:
        self.options = parts.options
        self.ended = ""
        """Reason why motion ended; empty before."""
        self.unexplained = False
        """True if the controller can give more details about `ended`."""
        self.waiting = ""
        """Reason why commands do not act yet; empty when they do."""
        self.next_s = math.inf
        """Time of the next call of `advance`."""
        self.reply_pending = False
        """True between a state that takes a command and that command."""
        self.instant_s = NEVER_S
        """Time of the last control instant that the application was asked about."""
        self._acting_s = math.inf
        """Time from which on a status must report that the drives have power, s."""
        self.topics: list[Message] = []
        """Messages to send at once, in order."""
        self._requests, self._feed, self._guide = parts.requests, parts.feed, parts.guide
        self._counters, self._record = parts.counters, parts.record
        self._joints = parts.options.joints

    @property
    def at_rest(self) -> bool:
        """True while standstill is commanded."""
        return not self._guide.moving

    @abstractmethod
    def advance(self, now_s: float) -> None:
        """Do what is due."""

    @abstractmethod
    def due(self, now_s: float) -> float:
        """Return the time since the previous control instant when one has come, else 0."""

    @abstractmethod
    def command(self, command: RobotCommand, now_s: float) -> None:
        """Answer the control instant. Raises CommandError for an invalid command; nothing is sent
        then."""

    def wind_down(self) -> None:  # noqa: B027 - most have nothing to do
        """Command only holds from now on."""

    @abstractmethod
    def settled(self, now_s: float) -> bool:
        """True when all commanded motion has been executed and ends at rest."""

    def ends_by_status(self) -> bool:
        """True when the newest status shows that commands do not act."""
        status = self._feed.status
        return (
            status is None
            or status.e_stopped != 0
            or status.in_error != 0
            or status.mode != ControllerMode.AUTO
            or (status.motion_possible != 1 and not self.waiting)
            # Energy saving: motion is possible, but only a first point wakes the drives.
            or (status.drives_powered == 0 and self._feed.status_s > self._acting_s)
        )

    @property
    def braking_s(self) -> float:
        """Duration of the ramp to rest and of the points queued before it, s."""
        guide = self._guide
        ramp_s = max(
            abs(speed) / acceleration
            for speed, acceleration in zip(guide.velocity, guide.accelerations, strict=True)
        )
        return ramp_s + BRAKE_MARGIN_S

    def _resting(self) -> bool:
        return all(abs(speed) < REST_RAD_S for speed in self._guide.velocity)

    def _note(self, now_s: float, kind: str) -> None:
        record = self._record
        if record.path:
            record.add(
                now_s,
                kind,
                tuple(self._guide.reference),
                self._feed.positions,
                self._counters.queue_count,
            )

    def _point(
        self,
        sequence: int,
        time_ms: int,
        positions: Iterable[float],
        velocities: Iterable[float] = (),
    ) -> JointTrajPtFull:
        """Make a point of a trajectory; one without velocities is at rest."""
        return JointTrajPtFull(
            self.options.group,
            sequence,
            POINT_FIELDS,
            # The controller truncates float32 seconds to whole ms; from the middle of a ms none is
            # lost.
            (time_ms + 0.5) * 1e-3,
            joints10(positions),
            joints10(velocities),
            joints10(()),
        )

    def _result(self, answer: Answer) -> MotionReply | None:
        """Return the MotionReply in `answer` if it is success or busy; any other ends the
        motion."""
        if not isinstance(answer, MotionReply):
            self.ended = "the controller answered with something else than a motion reply"
            return None
        if answer.result in (MotionResult.SUCCESS, MotionResult.BUSY):
            return answer
        self.ended = reply_in_words(answer.command, answer.result, answer.subcode)
        return None


class Trajectory(MotorosMotion):
    """Motion by points: begins a trajectory at the robot's position, and sends point after
    point."""

    busy_retry_s: float
    """Time after which a point is sent again if the controller was too busy for it."""

    def __init__(self, parts: MotionParts, now_s: float) -> None:
        super().__init__(parts)
        self._sequence = 0
        self._time_ms = 0
        self._resend: JointTrajPtFull | None = None
        """Point that the controller was too busy for."""
        self._placed = False
        """True if the limiter is at the controller's last commanded position."""
        self._tries = 0
        self._rest_since_s = now_s
        """Time from which on a status may report that the robot rests, s."""
        self._give_up_s = now_s + REST_TIMEOUT_S

    def _wait_for_rest(self, words: str, since_s: float) -> None:
        self.waiting = words
        self._rest_since_s = since_s
        self._give_up_s = since_s + REST_TIMEOUT_S
        self.next_s = self._give_up_s

    def _rested(self, now_s: float) -> bool:
        """True when a trajectory can begin; gives up when that takes too long."""
        feed = self._feed
        status = feed.status
        possible = status is not None and status.motion_possible == 1
        if possible and feed.at_rest_after(self._rest_since_s):
            return True
        late_s = READY_S if self._acting_s == math.inf else 0.0
        if not possible and feed.status_s > self._rest_since_s + late_s:
            self.ended = "the controller does not allow motion"
            self.unexplained = True
            return False
        if now_s >= self._give_up_s:
            self.ended = "the robot did not come to rest, so no trajectory could be started"
            self.unexplained = True
        return False

    def _begin(self, now_s: float) -> None:
        """Send point 0 at the controller's last commanded position, or at the measured one."""
        if not self._placed:
            self._guide.reset(self._feed.positions)
            self._placed = True
        self._sequence = self._time_ms = 0
        guide = self._guide
        self._send(self._point(0, 0, guide.reference, guide.velocity), now_s, "start")

    def _send(self, point: JointTrajPtFull, now_s: float, kind: str) -> None:
        self._resend = point
        self.next_s = math.inf
        self._counters.commands += 1
        self._note(now_s, kind)
        self._requests.ask(point, self._replied)

    def _again(self) -> None:
        """Send the point again that the controller was too busy for."""
        if self._resend is not None:
            self._counters.resent_points += 1
            self._requests.ask(self._resend, self._replied)

    def _replied(self, answer: Answer, now_s: float) -> None:
        point = self._resend
        if (
            point is not None
            and point.sequence == 0
            and self._tries < START_TRIES
            and isinstance(answer, MotionReply)
            and answer.command == MessageType.JOINT_TRAJ_PT_FULL
            and answer.result == MotionResult.INVALID
            and answer.subcode == InvalidSubcode.DATA_START_POS
        ):
            self._tries += 1
            self._placed = False
            self._resend = None
            self._refused(now_s)
            return
        reply = self._result(answer)
        if reply is None or point is None:
            return
        if reply.result == MotionResult.BUSY:
            self._counters.busy_replies += 1
            self.next_s = now_s + self.busy_retry_s
            return
        self._resend = None
        if point.sequence == 0:
            self._tries = 0
            self._acting_s = now_s + WAKING_S
        self._accepted(point, now_s)

    @abstractmethod
    def _refused(self, now_s: float) -> None:
        """React to a refused point 0: the controller is elsewhere."""

    @abstractmethod
    def _accepted(self, point: JointTrajPtFull, now_s: float) -> None:
        """Record that the controller has accepted `point`."""
