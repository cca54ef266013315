"""The velocity mode: joint speeds at absolute deadlines, the newest wins.

Source: docs/protocols/motoros-velocity-mode.md.
"""

from __future__ import annotations

import math

from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.guide import JointGuide
from cardan.drivers.motoros.motion import Motion, MotionCounters, MotionRecord
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.requests import SEQUENCES, Answer, MotionRequests
from cardan.protocols.simple_message import (
    ZEROS,
    JointVelocity,
    MotionResult,
    ValidFields,
    joints10,
    topic,
)
from cardan.types import RobotCommand

FIELDS = ValidFields.TIME | ValidFields.VELOCITY

LONGEST_STEP_S = 0.1
"""After a pause of this computer the command goes on; it does not leap."""

REST_S = 0.3
"""The servos have followed after so long at rest."""
REPLACE_RAD = 2e-4
"""Feedback as near as this to the commanded position agrees with it."""

ZEROS_BEFORE_END = 4
"""The controller has come to rest by itself when so many commands have said zero."""

SETTLE_S = 1.0
"""The arm may be told to move that long after the start, though it does not quite rest: an arm
that sags in its servos never does."""


class VelocityStream(Motion):
    """Commands in velocity mode.

    The guide integrates what is sent, the controller what it used; in motion the two part by
    fractions of a period. So whenever the robot rests, the guide is set to what is measured: that
    changes no command, because its speed is zero, and the next one corrects the difference.
    """

    feeds_at_rest = True

    def __init__(
        self,
        options: MotorosOptions,
        requests: MotionRequests,
        feed: StateFeed,
        guide: JointGuide,
        counters: MotionCounters,
        record: MotionRecord,
        now_s: float,
    ) -> None:
        super().__init__(options, requests, feed, guide, counters, record)
        self.nominal_s = options.command_period_s
        self._started_s = self._deadline_s = now_s
        self._sequence = 0
        self._asked = False
        self._since_asked = 0
        self._rest_since_s = now_s
        self._overwritten = 0
        self.waiting = "velocity mode is being entered"
        guide.place(feed.positions)
        self.next_s = now_s

    def advance(self, now_s: float) -> None:
        """Until the controller says so nobody may move: its status is older than its reply."""
        feed = self._feed
        if not self.waiting:
            return
        waited_s = now_s - self._started_s
        status = feed.status
        possible = (
            status is not None
            and status.motion_possible == 1
            and min(feed.status_s, feed.feedback_s) > self._started_s
        )
        if possible and (feed.at_rest_after(self._started_s) or waited_s >= SETTLE_S):
            self._guide.place(feed.positions)
            self._rest_since_s = now_s
            self.waiting = ""
        elif waited_s >= SETTLE_S and not possible:
            self.ended = "velocity mode was started, but the controller does not allow motion"

    def due(self, now_s: float) -> float:
        late_s = now_s - self._deadline_s
        if late_s < 0.0:
            return 0.0
        missed = int(late_s / self.nominal_s)
        self._counters.skipped_instants += missed
        self._deadline_s += (missed + 1) * self.nominal_s
        self.next_s = self._deadline_s
        return min((missed + 1) * self.nominal_s, LONGEST_STEP_S)

    def command(self, command: RobotCommand, period_s: float, now_s: float) -> None:
        guide = self._guide
        if self._resting():
            self._agree(now_s)
        guide.step(command, period_s)
        if not self._resting():
            self._rest_since_s = now_s
        body = JointVelocity(
            self.options.group,
            self._sequence,
            FIELDS,
            now_s - self._started_s,
            ZEROS,
            joints10(guide.velocities),
            ZEROS,
        )
        self._sequence = self._sequence + 1 if self._sequence + 1 < SEQUENCES else 1
        self._counters.commands += 1
        self._since_asked += 1
        self._note(now_s, "velocity")
        # The first one arms the stream, so whether it was taken is asked at once.
        wanted = body.sequence == 0 or self._since_asked >= self.options.reply_every
        if wanted and self._requests.idle:
            self._since_asked = 0
            self._requests.ask(body, self._told)
            return
        self.topics.append(topic(body))

    def _agree(self, now_s: float) -> None:
        """Set the guide to what is measured, where both have been at rest for long enough."""
        feed = self._feed
        guide = self._guide
        if now_s - max(self._rest_since_s, feed.still_since_s) < REST_S:
            return
        if any(
            abs(a - b) > REPLACE_RAD for a, b in zip(guide.positions, feed.positions, strict=True)
        ):
            guide.place(feed.positions)
            self._rest_since_s = now_s
            self._counters.replaced += 1

    def settled(self, now_s: float) -> bool:
        return self.at_rest and now_s - self._rest_since_s >= ZEROS_BEFORE_END * self.nominal_s

    def _told(self, answer: Answer, now_s: float) -> None:
        reply = self._result(answer)
        if reply is None:
            return
        if reply.result != MotionResult.SUCCESS:
            self.ended = "the controller was busy, which it never is in velocity mode"
            return
        counters = self._counters
        speed, acceleration, end, age_ms, overwritten = reply.data[:5]
        counters.speed_limited += speed != 0.0
        counters.acceleration_limited += acceleration != 0.0
        counters.range_limited += end != 0.0
        if math.isfinite(age_ms) and math.isfinite(overwritten):
            counters.command_age_s = 1e-3 * age_ms
            counters.overwritten += int(overwritten)
