"""Velocity mode: joint speeds sent at absolute deadlines; the newest wins.

Source: docs/protocols/simple-message.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.drivers.missed_cycles import SlipCompensation
from cardan.drivers.motoros.motion import MotionParts, MotorosMotion
from cardan.drivers.motoros.requests import SEQUENCES, Answer
from cardan.drivers.motoros.tracking_monitor import TrackingMonitor
from cardan.protocols.simple_message.codes import MotionResult, ValidFields
from cardan.protocols.simple_message.messages import ZEROS, JointVelocity, joints10, topic
from cardan.types import JointCommand, RobotCommand

FIELDS = ValidFields.TIME | ValidFields.VELOCITY | ValidFields.ACCELERATION

REST_RAD_S = 1e-5
"""Smallest speed that is not sent as zero: the controller counts any other speed as motion."""

AGREES_RAD = 0.004
"""Largest distance of the arm from the ends of its commanded path that is not corrected: the arm
sags, and the two clocks differ."""
FOUND_RAD_S = 0.05
"""Speed of correcting the commanded position to the measured one, besides its own speed; one wrong
feedback changes next to nothing."""
CLOSING_RAD_S = 0.2
"""Fastest motion back to the command after a correction, which no operator commands."""
LOST_RAD = 0.15
LOST_S = 0.5
"""Distance LOST_RAD for LOST_S after which the arm does not obey, or is measured wrongly."""

JUMP_RAD, JUMP_RAD_S = 0.05, 15.0
"""Farthest motion of a joint between two feedback messages: the first, plus the second per second.
A measurement beyond is implausible, and corrects nothing."""

ZEROS_BEFORE_END = 4
"""Commands of zero speed after which the controller has come to rest by itself."""

SETTLE_S = 1.0
"""Time after the start from which on an arm that is not quite at rest may be moved: an arm that
sags in its servos never is."""


class VelocityStream(MotorosMotion):
    """Commands in velocity mode.

    The limiter integrates the sent velocities, the controller the used ones, and the arm follows as
    it can. If the three differ, the limiter is slowly corrected to the measured position, which
    commands nothing. The next commanded position then makes up for the difference, also slowly.
    """

    feeds_at_rest = True

    def __init__(self, parts: MotionParts, now_s: float) -> None:
        super().__init__(parts)
        options, feed, guide = parts.options, parts.feed, parts.guide
        self.nominal_s = options.command_period_s
        self._started_s = self._deadline_s = now_s
        self._sequence = 0
        self._since_asked = 0
        self._accelerations = joints10(guide.accelerations)
        self._missed_s = 0.0
        """Missed time that no state has reported yet."""
        self._lost = SlipCompensation(options.joints)
        self._asked: JointCommand | None = None
        """Previous command, if it was one of positions."""
        self._zeros = 0
        """Consecutive commands of zero speed."""
        self.waiting = "velocity mode is being entered"
        guide.closing_rad_s = CLOSING_RAD_S
        guide.reset(feed.positions)
        self._watch = TrackingMonitor(options.lag_s, feed.positions, now_s)
        self._watched = feed.feedbacks
        self._watched_s = now_s
        self._lost_since_s = math.inf
        self._measured: Sequence[float] = feed.positions
        self._jumped = False
        """True if the arm is measured at a place that it cannot have reached."""
        self.next_s = now_s

    def advance(self, now_s: float) -> None:
        """Wait until the controller reports that motion is possible, since its status is older than
        its reply; then check the arm's position."""
        feed = self._feed
        if not self.waiting:
            self._coast(now_s)
            if feed.feedbacks != self._watched:
                self._look(now_s)
            return
        waited_s = now_s - self._started_s
        status = feed.status
        possible = (
            status is not None
            and status.motion_possible == 1
            and min(feed.status_s, feed.feedback_s) > self._started_s
        )
        if possible and (feed.at_rest_after(self._started_s) or waited_s >= SETTLE_S):
            self._guide.reset(feed.positions)
            self._watch.begin(feed.positions, now_s)
            self._watched, self._watched_s = feed.feedbacks, now_s
            self._acting_s = now_s
            self.waiting = ""
        elif waited_s >= SETTLE_S and not possible:
            self.ended = "velocity mode was started, but the controller does not allow motion"

    def _look(self, now_s: float) -> None:
        """Set the limiter to the arm's position, if it is not where it should be."""
        feed, guide = self._feed, self._guide
        passed_s = min(now_s - self._watched_s, self.options.state_timeout_s)
        self._watched, self._watched_s = feed.feedbacks, now_s
        before, self._measured = self._measured, feed.positions
        farthest = JUMP_RAD + JUMP_RAD_S * passed_s
        if any(abs(a - b) > farthest for a, b in zip(feed.positions, before, strict=True)):
            self._jumped = True
        away = self._watch.away(feed.positions, guide.reference)
        if self._jumped and away is None:
            away = [a - b for a, b in zip(feed.positions, guide.reference, strict=True)]
        if away is None:
            self._lost_since_s = math.inf
            return
        worst = max(range(self._joints), key=lambda i: abs(away[i]))
        size = abs(away[worst])
        if size <= LOST_RAD:
            self._lost_since_s = math.inf
            self._jumped = False
        else:
            self._lost_since_s = min(self._lost_since_s, now_s)
            if now_s - self._lost_since_s >= LOST_S:
                self.ended = (
                    f"joint {worst + 1} is {size:.2f} rad from where its commands should have "
                    "brought it: something holds it, a speed limit acts, or it is measured wrongly"
                )
                return
        if size <= AGREES_RAD or self._jumped:
            return
        most = passed_s * (FOUND_RAD_S + max(map(abs, guide.velocity)))
        share = min(1.0 - AGREES_RAD / size, most / size)
        by = [share * each for each in away]
        guide.relocate([q + way for q, way in zip(guide.reference, by, strict=True)])
        self._watch.shift(by)
        self._counters.replaced += 1

    def _coast(self, now_s: float) -> None:
        """Continue at the last speeds through missed control instants, as the controller did.

        This comes before the arm's position is looked at: an arm that is ahead of its last command
        by that much is where it should be.
        """
        missed = int((now_s - self._deadline_s) / self.nominal_s)
        if missed > 0:
            missed_s = missed * self.nominal_s
            self._counters.skipped_instants += missed
            self._deadline_s += missed_s
            self._missed_s += missed_s
            self._guide.coast(missed_s)
            self._lost.passed(missed_s)

    def due(self, now_s: float) -> float:
        self._coast(now_s)
        if now_s < self._deadline_s:
            return 0.0
        period_s = self._missed_s + self.nominal_s
        self._missed_s = 0.0
        self._deadline_s += self.nominal_s
        self.next_s = self._deadline_s
        return period_s

    def command(self, command: RobotCommand, now_s: float) -> None:
        guide = self._guide
        guide.step(self._going_on(command), self.nominal_s)
        self._zeros = self._zeros + 1 if self.at_rest else 0
        self._watch.record(guide.reference, now_s)
        body = JointVelocity(
            self.options.group,
            self._sequence,
            FIELDS,
            now_s - self._started_s,
            ZEROS,
            joints10(v if abs(v) >= REST_RAD_S else 0.0 for v in guide.velocity),
            self._accelerations,
        )
        self._sequence = self._sequence + 1 if self._sequence + 1 < SEQUENCES else 1
        self._counters.commands += 1
        self._since_asked += 1
        self._note(now_s, "velocity")
        # The first command arms the stream, so its acceptance is queried at once.
        wanted = body.sequence == 0 or self._since_asked >= self.options.reply_every
        if wanted and self._requests.idle:
            self._since_asked = 0
            self._requests.ask(body, self._answered)
            return
        self.topics.append(topic(body))

    def _going_on(self, command: RobotCommand) -> RobotCommand:
        """Return `command`, adjusted not to make up for missed time."""
        asked, self._asked = self._asked, command if isinstance(command, JointCommand) else None
        if self._asked is None or not self._lost.working:
            return command
        before = None if asked is None else asked[:2]
        return JointCommand(*self._lost.follow(before, *self._asked[:2], self.nominal_s))

    def settled(self, now_s: float) -> bool:
        return self._zeros >= ZEROS_BEFORE_END

    def _answered(self, answer: Answer, now_s: float) -> None:
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
