"""Control of motion by a MotoROS controller: start, braking, and reasons of its end."""

from __future__ import annotations

import enum
import math
from collections import Counter
from typing import ClassVar, Literal

from cardan.drivers.motoros.agreed_limits import agreed_limits
from cardan.drivers.motoros.diagnosis import reply_in_words, status_in_words
from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.motion import (
    MotionCounters,
    MotionParts,
    MotionRecord,
    MotorosMotion,
    Trajectory,
)
from cardan.drivers.motoros.options import STATE_PERIOD_S, MotorosOptions
from cardan.drivers.motoros.requests import Answer, MotionRequests
from cardan.drivers.motoros.streaming import PointStream
from cardan.drivers.motoros.trajectory_limiter import JointTrajectoryLimiter
from cardan.drivers.motoros.velocity import VelocityStream
from cardan.protocols.simple_message.codes import MotionCommand, MotionResult
from cardan.protocols.simple_message.messages import (
    Message,
    MotionReply,
    VelocityInfo,
    VelocityInfoRequest,
    joints10,
)
from cardan.types import NEVER_S, HoldCommand, JointLimits

Task = Literal["enable", "disable", "stop", "reset alarm", "servo on", "servo off"]

IDLE_CHECK_S = 1.0
"""Period of the requests that check an idle motion connection."""
STALL_S = 0.1
"""Longest pause of this computer after which the robot is still where it was last commanded."""
READING_S = 0.005
"""Time to read messages that came during a pause of this computer."""
BRAKE_CHECK_S = 0.004
"""Period of checking whether a braked robot has come to rest."""
STOP_TRIES = 5
STOP_RETRY_S = 0.05
"""A controller refuses to leave trajectory mode while its queue is not empty."""


class MotionPhase(enum.Enum):
    """Phase of the motion connection."""

    DOWN = "not connected"
    GREETING = "the motion connection is being set up"
    IDLE = "motion is not enabled"
    STARTING = "motion is being started"
    MOVING = "motion is enabled"
    BRAKING = "the robot is being braked"
    LEAVING = "motion is being left"


_CONTROLS: dict[str, MotionCommand] = {
    "reset alarm": MotionCommand.RESET_ALARM,
    "servo on": MotionCommand.START_SERVOS,
    "servo off": MotionCommand.STOP_SERVOS,
}


class MotionControl:
    """Phases of motion of one control group, from opening the motion connection to its end.

    Requests go through `requests`; messages without a reply come from `topics`. While the phase is
    MOVING, `motion` answers control instants.
    """

    by_points: ClassVar[type[Trajectory]] = PointStream
    """Motion for a controller without the velocity mode."""

    def __init__(self, options: MotorosOptions, requests: MotionRequests, feed: StateFeed) -> None:
        self.options = options
        self.requests = requests
        self.feed = feed
        self.counters = MotionCounters()
        self.record = MotionRecord(options.record, options.joints)
        self.phase = MotionPhase.DOWN
        self.motion: MotorosMotion | None = None
        """Current motion, from the reply to START_*_MODE to its end."""
        self.sessions = 0
        """Count of motion connections and motion starts; earlier targets are void when it
        changes."""
        self.end_reason = ""
        """Reason that last ended or prevented motion; empty after a successful start."""
        self.ends: Counter[str] = Counter()
        """Counts of ends of motion, by reason."""
        self.velocity_info: VelocityInfo | None = None
        """Controller's description of its velocity mode; None if it has none."""
        self.failure = ""
        """Reason why the motion connection cannot be used; empty while it can."""
        self.answer = ""
        """Failed answer to the last control request."""
        self._topics: list[Message] = []
        self._velocity: bool | None = None
        """True if velocity mode is used; None until the controller has answered."""
        self._after: list[MotionCommand] = []
        """Requests to send after braking."""
        self._stop_tries = 0
        self._stop_s = math.inf
        self._brake_until_s = math.inf
        self._check_s = math.inf
        self._advanced_s = NEVER_S
        self._reading_until_s = NEVER_S
        self._start_once = options.enable == "at-start"
        self._asked_early = False
        """True if motion was enabled while the connection was being set up."""

    @property
    def uses_velocity(self) -> bool:
        """True if velocity mode is used, as far as known."""
        mode = self.options.mode
        return mode == "velocity" or (mode == "auto" and bool(self._velocity))

    @property
    def braking_s(self) -> float:
        """Longest time until the robot rests, s; 0 while nothing moves."""
        return 0.0 if self.motion is None else self.motion.braking_s

    @property
    def enabled(self) -> bool:
        """True while commands move the robot, or would if they came."""
        return self.phase is MotionPhase.MOVING

    @property
    def next_s(self) -> float:
        """Latest time of the next call of `advance`."""
        found = min(self.requests.deadline_s, self._stop_s)
        motion = self.motion
        if motion is not None:
            found = min(found, motion.next_s)
            if self.phase is MotionPhase.BRAKING:
                found = min(found, self._advanced_s + BRAKE_CHECK_S)
        elif self.phase is MotionPhase.IDLE:
            found = min(found, self._check_s)
        return found

    def topics(self) -> list[Message]:
        """Return messages to send at once, in order, before any request."""
        found, self._topics = self._topics, []
        if self.motion is not None:
            found += self.motion.topics
            self.motion.topics.clear()
        return found

    # -- the motion connection --------------------------------------------------------------------

    def connected(self) -> None:
        """Start after the motion connection was opened."""
        self.requests.reset()
        self.failure = ""
        self.sessions += 1
        self.phase = MotionPhase.GREETING
        # Points that a previous connection left in the queue must not be executed.
        self.requests.control(MotionCommand.STOP_MOTION, self._stopped)

    def disconnected(self, reason: str, now_s: float) -> None:
        """Stop after the motion connection was lost."""
        self.requests.reset()
        self._topics.clear()
        self._asked_early = False
        if self.phase in (
            MotionPhase.STARTING,
            MotionPhase.MOVING,
            MotionPhase.BRAKING,
            MotionPhase.LEAVING,
        ):
            self._finish(f"the motion connection was lost: {reason}", now_s)
        self.phase = MotionPhase.DOWN

    def _stopped(self, answer: Answer, now_s: float) -> None:
        failed = self._failure(answer)
        if failed:
            self.failure = failed
        elif self.options.mode in ("auto", "velocity"):
            self.requests.ask(VelocityInfoRequest(self.options.group), self._probed)
        else:
            self._velocity = False
            self.requests.control(MotionCommand.CHECK_MOTION_READY, self._checked)

    def _probed(self, answer: Answer, now_s: float) -> None:
        """Use velocity mode if the controller knows the message."""
        self._velocity = isinstance(answer, VelocityInfo)
        self.velocity_info = answer if isinstance(answer, VelocityInfo) else None
        self.requests.control(MotionCommand.CHECK_MOTION_READY, self._checked)

    def _checked(self, answer: Answer, now_s: float) -> None:
        """Record that the connection works; every status tells whether motion is ready."""
        self._check_s = now_s + IDLE_CHECK_S
        if self.phase is MotionPhase.GREETING:
            self.phase = MotionPhase.IDLE
            if self._start_once or self._asked_early:
                self._start_once = self._asked_early = False
                self.enable(now_s)

    def _failure(self, answer: Answer) -> str:
        """Return why a request failed; "" if it succeeded."""
        if not isinstance(answer, MotionReply):
            return "the controller answered with something else than a motion reply"
        if answer.result == MotionResult.SUCCESS:
            return ""
        return reply_in_words(answer.command, answer.result, answer.subcode)

    # -- time and states --------------------------------------------------------------------------

    def live(self, now_s: float) -> bool:
        """True while states come; those that came during a pause of this computer count."""
        return self.feed.live(now_s) or now_s < self._reading_until_s

    def advance(self, now_s: float) -> None:
        """Do what is due; `failure` then tells whether a reply is overdue."""
        paused_s = now_s - self._advanced_s
        if paused_s > STATE_PERIOD_S and self.feed.live(self._advanced_s):
            self._reading_until_s = now_s + READING_S
        self._advanced_s = now_s
        if self.phase is MotionPhase.MOVING and paused_s > STALL_S:
            self.over(f"this computer stalled for {paused_s:.2f} s", now_s)
        self.failure = self.requests.overdue(now_s)
        if self.failure:
            return
        motion = self.motion
        if motion is not None:
            if self.phase is MotionPhase.MOVING and not self.live(now_s):
                self.brake("no state was received from the controller", now_s)
            motion.advance(now_s)
            if self.phase is MotionPhase.BRAKING or motion.waiting:
                self._hold(motion, now_s)
            self.proceed(now_s)
        if self.phase is MotionPhase.IDLE and now_s >= self._check_s:
            self._check_s = math.inf
            self.requests.control(MotionCommand.CHECK_MOTION_READY, self._checked)
        if now_s >= self._stop_s:
            self._leave(now_s)

    def status_received(self, now_s: float) -> None:
        """React to a new status."""
        motion = self.motion
        if motion is None:
            return
        if motion.ends_by_status():
            status = self.feed.status
            words = "" if status is None else status_in_words(status)
            self.over(words or "the controller does not allow motion any more", now_s)
            if status is None or not status_in_words(status._replace(motion_possible=1)):
                # The status alone does not distinguish HOLD from a stopped job or a collaborative
                # stop.
                self.requests.control(MotionCommand.CHECK_MOTION_READY, self._learned)

    def _hold(self, motion: MotorosMotion, now_s: float) -> None:
        """Command zero speed at a control instant without a command from the application."""
        period_s = motion.due(now_s)
        # A stream at rest may run out.
        over = self.phase is MotionPhase.BRAKING and motion.at_rest and not motion.feeds_at_rest
        if period_s and not over:
            motion.command(HoldCommand(), now_s)

    def proceed(self, now_s: float) -> None:
        """React to a motion that has ended or come to rest."""
        motion = self.motion
        if motion is None:
            return
        if motion.ended:
            self.over(motion.ended, now_s)
            if motion.unexplained:
                self.requests.control(MotionCommand.CHECK_MOTION_READY, self._learned)
        elif self.phase is MotionPhase.BRAKING and (
            motion.settled(now_s) or now_s >= self._brake_until_s
        ):
            # The last command, of zero speed, is sent before the mode is left.
            self._topics += motion.topics
            self.motion = None
            self._begin_to_leave(now_s)

    # -- requests of the application --------------------------------------------------------------

    def ask(self, task: Task, now_s: float) -> None:
        """Execute a task that only the application may request."""
        if task == "enable":
            self.enable(now_s)
        elif task == "disable":
            self.disable(now_s)
        elif task == "stop":
            self.stop(now_s)
        else:
            command = _CONTROLS[task]
            if self.phase is MotionPhase.IDLE:
                self._control(command, now_s)
            elif self.phase in (MotionPhase.DOWN, MotionPhase.GREETING):
                self.answer = f"{task}: {self.phase.value}"
            elif command is MotionCommand.STOP_SERVOS:
                if self.phase is MotionPhase.STARTING:
                    self.disable(now_s)
                if self.phase is MotionPhase.LEAVING:
                    self._after.append(command)
                else:
                    self.brake("the servos were switched off", now_s, (command,))
            # Alarms, or servos switched off, would have ended the motion.

    def enable(self, now_s: float) -> None:
        """Start motion. Without a connection the request is refused, not deferred."""
        phase = self.phase
        if phase is MotionPhase.GREETING:
            self._asked_early = True
        elif phase is MotionPhase.DOWN:
            self.end_reason = "motion could not be enabled while there was no connection"
        elif phase is MotionPhase.IDLE:
            if self._lacking():
                return
            self.end_reason = self.answer = ""
            self.phase = MotionPhase.STARTING
            if self.uses_velocity:
                data = joints10((float(self.options.watchdog_ms), 1.0))
                self.requests.control(MotionCommand.START_VEL_MODE, self._started, data)
            else:
                self.requests.control(MotionCommand.START_TRAJ_MODE, self._started)

    def _lacking(self) -> str:
        """Return why a start would fail; empty if no reason is known."""
        if self.options.mode == "velocity" and not self._velocity:
            return "the controller has no velocity mode; set mode to stream or auto"
        if self.feed.other_axis:
            return (
                f"axis {self.feed.other_axis} of group {self.options.group} is not at zero: the "
                f"controller has more axes than {self.options.robot}'s {self.options.joints}"
            )
        info = self.velocity_info
        if self.uses_velocity and info is not None and info.axes != self.options.joints:
            return (
                f"group {self.options.group} of the controller has {info.axes} axes, "
                f"{self.options.robot} has {self.options.joints}"
            )
        return ""

    def _started(self, answer: Answer, now_s: float) -> None:
        failed = self._failure(answer)
        if self.phase is not MotionPhase.STARTING:
            return
        if not failed and not self.feed.live(now_s):
            failed = "no state was received from the controller"
        if failed:
            self._idle(now_s)
            self.end_reason = failed
            return
        self.sessions += 1
        self.phase = MotionPhase.MOVING
        limits = self._limits()
        guide = JointTrajectoryLimiter(
            limits.lower, limits.upper, limits.velocity, limits.acceleration
        )
        parts = MotionParts(
            self.options, self.requests, self.feed, guide, self.counters, self.record
        )
        kind = VelocityStream if self.uses_velocity else self.by_points
        self.motion = kind(parts, now_s)
        self.motion.advance(now_s)
        self._hold(self.motion, now_s)

    def _limits(self) -> JointLimits:
        if self.velocity_info is None or not self.uses_velocity:
            return self.options.limits
        return agreed_limits(self.options.limits, self.velocity_info)

    def disable(self, now_s: float) -> None:
        self._start_once = self._asked_early = False
        if self.phase is MotionPhase.STARTING:
            self._after = list(self._stop_commands)
            self._begin_to_leave(now_s)
        else:
            self.brake("motion was disabled", now_s, self._stop_commands)

    def stop(self, now_s: float) -> None:
        """STOP_MOTION at once: a trajectory's command stops dead, velocity mode ramps down at the
        controller's own acceleration. A pending reply comes first."""
        self._start_once = self._asked_early = False
        if self.phase in (MotionPhase.DOWN, MotionPhase.GREETING):
            return
        self.over("motion was stopped", now_s, stop=True)

    def leave(self, now_s: float) -> None:
        """Brake and leave the controller's mode, because the application ended its loop."""
        if self.phase in (MotionPhase.GREETING, MotionPhase.STARTING, MotionPhase.MOVING):
            self.disable(now_s)

    @property
    def left(self) -> bool:
        """True when nothing remains to be sent to the controller."""
        phase = self.phase
        return phase in (MotionPhase.DOWN, MotionPhase.GREETING) or (
            phase is MotionPhase.IDLE and self.requests.idle
        )

    @property
    def _stop_commands(self) -> tuple[MotionCommand, ...]:
        """Return commands that leave the modes; leaving velocity mode does not leave trajectory
        mode."""
        trajectory = MotionCommand.STOP_TRAJ_MODE
        if self.uses_velocity:
            return MotionCommand.STOP_VEL_MODE, trajectory
        return (trajectory,)

    def _control(self, command: MotionCommand, now_s: float) -> None:
        def answered(answer: Answer, now_s: float) -> None:
            self.answer = self._failure(answer)

        self.requests.control(command, answered)

    # -- the end of motion ------------------------------------------------------------------------

    def brake(self, reason: str, now_s: float, after: tuple[MotionCommand, ...] = ()) -> None:
        """Bring the robot to rest along a ramp; motion must then be enabled again."""
        motion = self.motion
        if motion is None:
            return
        if self.phase is MotionPhase.MOVING:
            self._note_end(reason)
            self.phase = MotionPhase.BRAKING
            self._brake_until_s = now_s + motion.braking_s
            motion.reply_pending = False
            motion.wind_down()
            # Velocity mode is left in any case, because its watchdog would report the silence as a
            # fault. A trajectory's queue has run empty by then; if not, it is emptied.
            velocity = self.uses_velocity
            stop = MotionCommand.STOP_VEL_MODE if velocity else MotionCommand.STOP_MOTION
            self._after = [stop]
        self._after += [command for command in after if command not in self._after]
        self._hold(motion, now_s)
        self.proceed(now_s)

    def over(self, reason: str, now_s: float, stop: bool = False) -> None:
        """End motion at once: the controller has ended it, or does not follow."""
        moving = self.motion is not None
        self._finish(reason, now_s)
        if moving or stop:
            # Queued points must not be executed once the cause has gone.
            self.requests.control(MotionCommand.STOP_MOTION, _ignore)

    def _finish(self, reason: str, now_s: float) -> None:
        if self.phase is MotionPhase.MOVING or not self.end_reason:
            self._note_end(reason)
        self.motion = None
        self._stop_s = math.inf
        self.requests.drop()
        self._idle(now_s)

    def _idle(self, now_s: float) -> None:
        self.phase = MotionPhase.IDLE
        self._check_s = now_s + IDLE_CHECK_S

    def _learned(self, answer: Answer, now_s: float) -> None:
        """Replace the reason for the end of motion by the controller's own."""
        if self.phase is not MotionPhase.IDLE or not isinstance(answer, MotionReply):
            return
        # Old firmware gives no reason, and says 0.
        if answer.result != MotionResult.SUCCESS and answer.subcode:
            self.ends -= Counter({self.end_reason: 1})
            self._note_end(reply_in_words(answer.command, answer.result, answer.subcode))

    def _note_end(self, reason: str) -> None:
        self.end_reason = reason
        self.ends[reason] += 1

    def _begin_to_leave(self, now_s: float) -> None:
        self.requests.drop()
        self.phase = MotionPhase.LEAVING
        self._stop_tries = 0
        self._leave(now_s)

    def _leave(self, now_s: float) -> None:
        """Queue the requests that follow the braking, one after the other."""
        self._stop_s = math.inf
        if not self._after:
            self._idle(now_s)
            return
        self.requests.control(self._after[0], self._left)

    def _left(self, answer: Answer, now_s: float) -> None:
        failed = self._failure(answer)
        if failed and self._stop_tries < STOP_TRIES:
            self._stop_tries += 1
            self._stop_s = now_s + STOP_RETRY_S
            return
        self.answer = failed
        self._stop_tries = 0
        del self._after[0]
        self._leave(now_s)

    @property
    def hold_reason(self) -> str:
        """Reason why commands would not act now; empty when they do."""
        phase = self.phase
        motion = self.motion
        if phase is MotionPhase.MOVING and motion is not None:
            return motion.waiting
        if phase is MotionPhase.IDLE:
            lacking = self._lacking()
            if lacking:
                return lacking
            # A reply may have ended motion first; the present status is more exact.
            found = self._stopped_by() or self.end_reason
            return f"{found} (enable motion again)" if found else "motion is not enabled"
        if phase in (MotionPhase.BRAKING, MotionPhase.LEAVING):
            return self.end_reason or str(phase.value)
        return str(phase.value)

    def _stopped_by(self) -> str:
        """Return what must be changed at the robot before motion can be enabled."""
        status = self.feed.status
        if status is None or status.motion_possible == 1:
            return ""
        # Drives without power are normal before motion is enabled for the first time.
        return status_in_words(status._replace(motion_possible=1, drives_powered=1))


def _ignore(answer: Answer, now_s: float) -> None:
    """Accept a reply that changes nothing."""
