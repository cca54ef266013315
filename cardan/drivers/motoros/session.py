"""The PC's side of a MotoROS controller without sockets and clocks.

Three connections would be three sessions to a controller; here they are one, because what the
state port says decides what the motion port may be asked.
"""

from __future__ import annotations

import enum
import math
from collections import Counter, deque
from typing import Literal

from cardan.drivers.motoros.connections import CHANNELS, Channel, Connection
from cardan.drivers.motoros.diagnosis import reply_in_words, status_in_words
from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.guide import JointGuide
from cardan.drivers.motoros.motion import Motion, MotionCounters, MotionParts, MotionRecord
from cardan.drivers.motoros.options import STATE_PERIOD_S, MotorosOptions
from cardan.drivers.motoros.requests import Answer, MotionRequests
from cardan.drivers.motoros.streaming import PointStream
from cardan.drivers.motoros.two_point import TwoPointMoves
from cardan.drivers.motoros.velocity import VelocityStream
from cardan.errors import CommandError
from cardan.histogram import LatencyHistogram
from cardan.protocols.simple_message import (
    LONGEST_PREFIX_OF_MOTOROS,
    ByteOrder,
    FrameReader,
    MotionCommand,
    MotionReply,
    MotionResult,
    VelocityInfo,
    VelocityInfoRequest,
    Wire,
    joints10,
    wire,
)
from cardan.types import (
    NEVER_S,
    CommandKind,
    HoldCommand,
    JointCommand,
    JointLimits,
    JointVelocityCommand,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
)

Task = Literal["enable", "disable", "stop", "reset alarm", "servo on", "servo off"]

WAKE_S = 0.09
"""Whoever waits for states gets one at least every 0.1 s, also when the computer is a bit late."""

IDLE_CHECK_S = 1.0
"""While nothing moves the motion connection is asked so often whether it is still there."""

FLOAT32_SHARE = 1.0 - 1e-6
"""Of a limit that came as float32: what goes back as float32 is not above it either."""

STALL_S = 0.1
"""After a pause of this computer longer than this the robot is not where it was left."""
READING_S = 0.005
"""After a pause of this computer what came meanwhile is read within this time."""
BRAKE_CHECK_S = 0.004
"""Whether a braked robot has come to rest is looked at so often."""
STOP_TRIES = 5
STOP_RETRY_S = 0.05
"""A controller refuses to leave trajectory mode while its queue holds something."""


class Phase(enum.Enum):
    """What the motion connection is doing."""

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


_BY_POINTS: dict[str, type[PointStream] | type[TwoPointMoves]] = {
    "auto": PointStream,
    "stream": PointStream,
    "standard": TwoPointMoves,
}


class MotorosSession:
    """One robot on one controller.

    The shell connects what `wants` says, passes on what comes and goes (`connected`, `received`,
    `disconnected`, `connect_failed`), calls `advance` when `next_s` has come, sends what
    `outgoing` gives, one item at a time, and drops what `closing` names. Each state that
    `due_state` gives is answered by one `command`. All times are local monotonic seconds.
    """

    def __init__(self, options: MotorosOptions) -> None:
        self.options = options
        self.limits = options.limits
        self.phase = Phase.DOWN
        self.counters = MotionCounters()
        self.feed = StateFeed(options)
        self.requests = MotionRequests(
            options.group, options.request_timeout_s, options.start_timeout_s
        )
        self.jitter = LatencyHistogram()
        """How far the time between two control instants is off their period."""
        self.losses = 0
        """Times that the controller fell silent."""
        self.record = MotionRecord(options.record, options.joints)
        self.sessions = 0
        """Motion connections and starts of motion; earlier targets are void when it changes."""
        self.end_reason = ""
        """What ended or prevented motion last, in words; empty after a start that worked."""
        self.ends: Counter[str] = Counter()
        """How often motion was ended, by reason."""
        self.velocity_info: VelocityInfo | None = None
        """What the controller says about its velocity mode; None where it has none."""
        self.owes_answer = False
        """True between a state that takes a command and that command."""
        self._velocity: bool | None = None
        """Whether the velocity mode is used; None until the controller was asked."""
        self._links: dict[Channel, Connection] = {name: Connection() for name in CHANNELS}
        self._out: deque[tuple[Channel, bytes]] = deque()
        self._closing: list[Channel] = []
        self._wire: Wire | None = None
        self._reader = FrameReader()
        self._motion: Motion | None = None
        self._after: list[MotionCommand] = []
        """What is asked when the robot has been braked."""
        self._stop_tries = 0
        self._stop_s = math.inf
        self._brake_until_s = math.inf
        self._check_s = math.inf
        self._start_once = options.enable == "at-start"
        self._asked_early = False
        """Enabled while the connection was being set up."""
        self._answer = ""
        """What the last control request was answered, where it failed."""
        self._statuses = 0
        self._checked_statuses = 0
        self._recorded = 0
        self._advanced_s = NEVER_S
        self._reading_until_s = NEVER_S
        self._said_s = NEVER_S
        self._instant_s = NEVER_S
        self._said_link: RobotLink | None = None
        self._period_s = 0.0

    @property
    def capabilities(self) -> RobotCapabilities:
        """What can be commanded. Until a controller was asked "auto" counts as a stream."""
        options = self.options
        if self._uses_velocity:
            period_s = options.command_period_s
        elif options.mode == "standard":
            period_s = STATE_PERIOD_S
        else:
            period_s = 1e-3 * options.spacing_increments * options.ipc_ms
        return RobotCapabilities(
            commands=frozenset({CommandKind.HOLD, CommandKind.JOINT, CommandKind.JOINT_VELOCITY}),
            period_s=period_s,
            joints=options.joints,
            limits=self.limits,
            digital_outputs=0,
            analog_outputs=0,
            lag_s=options.lag_s,
        )

    @property
    def _uses_velocity(self) -> bool:
        mode = self.options.mode
        return mode == "velocity" or (mode == "auto" and bool(self._velocity))

    @property
    def byte_order(self) -> ByteOrder | None:
        """The controller's; None until it was learnt."""
        return self.feed.byte_order

    @property
    def braking_s(self) -> float:
        """How long it takes to come to rest from now, at most; 0 while nothing moves."""
        return 0.0 if self._motion is None else self._motion.braking_s

    @property
    def enabled(self) -> bool:
        """True while commands move the robot, or would if they came."""
        return self.phase is Phase.MOVING

    # -- connections ------------------------------------------------------------------------------

    def wants(self, channel: Channel, now_s: float) -> bool:
        """True when `channel` should be connected now."""
        link = self._links[channel]
        if link.up or now_s < link.retry_s:
            return False
        # Which byte order requests must have, only the state port says.
        return channel == "state" or (self.feed.live(now_s) and self.byte_order is not None)

    def connected(self, channel: Channel, now_s: float) -> None:
        """A connection stands."""
        self._links[channel].opened(now_s)
        if channel == "state":
            self.feed.connected()
            return
        order = self.byte_order or ByteOrder.LITTLE
        self._wire = wire(order)
        self._reader = FrameReader(order, LONGEST_PREFIX_OF_MOTOROS)
        self.requests.reset()
        self.sessions += 1
        self.phase = Phase.GREETING
        # What a connection before this one left in the queue must not be played.
        self.requests.control(MotionCommand.STOP_MOTION, self._stopped)
        self._flush(now_s)

    def connect_failed(self, channel: Channel, reason: str, now_s: float) -> None:
        """No connection could be made."""
        self._links[channel].lost(reason, now_s)

    def disconnected(self, channel: Channel, reason: str, now_s: float) -> None:
        """A connection was closed from the other side, or broke."""
        link = self._links[channel]
        if not link.up:
            return
        link.lost(reason, now_s)
        if channel == "state":
            self.feed.disconnected()
            self._brake(f"the state connection was lost: {reason}", now_s)
            return
        self.requests.reset()
        self._asked_early = False
        self._out = deque(item for item in self._out if item[0] != "motion")
        if self.phase in (Phase.STARTING, Phase.MOVING, Phase.BRAKING, Phase.LEAVING):
            self._over(f"the motion connection was lost: {reason}")
        self.phase = Phase.DOWN

    def _drop(self, channel: Channel, reason: str, now_s: float) -> None:
        """Close a connection that cannot be trusted."""
        if self._links[channel].up:
            self._closing.append(channel)
            self.disconnected(channel, reason, now_s)

    def closing(self) -> list[Channel]:
        """Connections to close now; they count as disconnected already."""
        found, self._closing = self._closing, []
        return found

    def outgoing(self) -> list[tuple[Channel, bytes]]:
        """What to send now, in order; each item is one message and needs a send of its own."""
        found = list(self._out)
        self._out.clear()
        return found

    def received(self, channel: Channel, data: bytes, now_s: float) -> None:
        """Take what TCP delivered."""
        if not self._links[channel].up:
            return
        if channel == "state":
            order = self.byte_order
            feed = self.feed
            feed.received(data, now_s)
            if feed.failure:
                self._drop("state", feed.failure, now_s)
            elif self._links["motion"].up and order is not feed.byte_order:
                self._drop("motion", "the controller has changed its byte order", now_s)
            self._look(now_s)
        elif self._wire is not None:
            overdue = self.requests.overdue(now_s)
            if overdue:
                self._drop("motion", overdue, now_s)
                return
            reader = self._reader
            reader.feed(data)
            while self._links["motion"].up and (frame := reader.take()) is not None:
                wrong = self.requests.received(self._wire.decode(frame), now_s)
                if wrong:
                    self._drop("motion", wrong, now_s)
                else:
                    self._proceed(now_s)
            if reader.failure:
                self._drop("motion", reader.failure, now_s)
        self._flush(now_s)

    def _look(self, now_s: float) -> None:
        """Act on what the state port has said."""
        feed = self.feed
        if feed.feedbacks != self._recorded:
            self._recorded = feed.feedbacks
            if self.record.path:
                count = self.counters.queue_count
                self.record.add(now_s, "feedback", (), feed.positions, count)
        if feed.statuses == self._checked_statuses:
            return
        self._checked_statuses = feed.statuses
        motion = self._motion
        if motion is None:
            return
        if motion.ends_by_status():
            status = feed.status
            words = "" if status is None else status_in_words(status)
            self._over(words or "the controller does not allow motion any more")
            if status is None or not status_in_words(status._replace(motion_possible=1)):
                # The status alone does not tell HOLD from a stopped job or a collaborative stop.
                self.requests.control(MotionCommand.CHECK_MOTION_READY, self._learnt)
            return
        motion.advance(now_s)
        self._proceed(now_s)

    # -- time -------------------------------------------------------------------------------------

    @property
    def next_s(self) -> float:
        """When `advance` and `due_state` are to be called at the latest."""
        found = min(self.requests.deadline_s, self._said_s + WAKE_S, self._stop_s)
        motion = self._motion
        if motion is not None:
            found = min(found, motion.next_s)
            if self.phase is Phase.BRAKING:
                found = min(found, self._advanced_s + BRAKE_CHECK_S)
        elif self.phase is Phase.IDLE:
            found = min(found, self._check_s)
        if self._said_link is RobotLink.LIVE:
            found = min(found, self.feed.stale_s)
        for link in self._links.values():
            if not link.up and link.retry_s > self._advanced_s:
                found = min(found, link.retry_s)
        return found

    def advance(self, now_s: float) -> None:
        """Do what time demands: time-outs, polls, points that are due, ramps."""
        paused_s = now_s - self._advanced_s
        if paused_s > STATE_PERIOD_S and self.feed.live(self._advanced_s):
            self._reading_until_s = now_s + READING_S
        self._advanced_s = now_s
        if self.phase is Phase.MOVING and paused_s > STALL_S:
            self._over(f"this computer stood still for {paused_s:.2f} s")
        overdue = self.requests.overdue(now_s)
        if overdue:
            self._drop("motion", overdue, now_s)
        motion = self._motion
        if motion is not None:
            if self.phase is Phase.MOVING and not self._live(now_s):
                self._brake("no state was heard of the controller", now_s)
            motion.advance(now_s)
            if self.phase is Phase.BRAKING or motion.waiting:
                self._hold(motion, now_s)
            self._proceed(now_s)
        if self.phase is Phase.IDLE and now_s >= self._check_s:
            self._check_s = math.inf
            self.requests.control(MotionCommand.CHECK_MOTION_READY, self._checked)
        if now_s >= self._stop_s:
            self._leave(now_s)
        self._flush(now_s)

    def _live(self, now_s: float) -> bool:
        """True while states come; those that came in a pause of this computer count."""
        return self.feed.live(now_s) or now_s < self._reading_until_s

    def _hold(self, motion: Motion, now_s: float) -> None:
        """Answer control instants that are nobody else's."""
        period_s = motion.due(now_s)
        # A stream that rests is left to run out.
        over = self.phase is Phase.BRAKING and motion.at_rest and not motion.feeds_at_rest
        if period_s and not over:
            motion.command(HoldCommand(), period_s, now_s)

    def _proceed(self, now_s: float) -> None:
        """Go on where something has ended."""
        motion = self._motion
        if motion is None:
            return
        if motion.ended:
            self._over(motion.ended)
            if motion.unexplained:
                self.requests.control(MotionCommand.CHECK_MOTION_READY, self._learnt)
        elif self.phase is Phase.BRAKING and (
            motion.settled(now_s) or now_s >= self._brake_until_s
        ):
            # The last command, of zero speed, goes before what leaves the mode.
            self._send_topics()
            self._motion = None
            self.owes_answer = False
            self.requests.drop()
            self.phase = Phase.LEAVING
            self._stop_tries = 0
            self._leave(now_s)

    def _flush(self, now_s: float) -> None:
        """Move what is to be sent into the outbox."""
        if not self._links["motion"].up or self._wire is None:
            return
        self._send_topics()
        request = self.requests.take(now_s)
        if request is not None:
            self._out.append(("motion", self._wire.encode(request)))

    def _send_topics(self) -> None:
        motion = self._motion
        if motion is None or self._wire is None or not self._links["motion"].up:
            return
        for message in motion.topics:
            self._out.append(("motion", self._wire.encode(message)))
        motion.topics.clear()

    # -- the start of a connection ----------------------------------------------------------------

    def _stopped(self, answer: Answer, now_s: float) -> None:
        failed = self._failure(answer)
        if failed:
            self._drop("motion", failed, now_s)
        elif self.options.mode in ("auto", "velocity"):
            self.requests.ask(VelocityInfoRequest(self.options.group), self._probed)
        else:
            self._velocity = False
            self.requests.control(MotionCommand.CHECK_MOTION_READY, self._checked)

    def _probed(self, answer: Answer, now_s: float) -> None:
        """A controller without the velocity mode does not know the message."""
        self._velocity = isinstance(answer, VelocityInfo)
        self.velocity_info = answer if isinstance(answer, VelocityInfo) else None
        self.requests.control(MotionCommand.CHECK_MOTION_READY, self._checked)

    def _checked(self, answer: Answer, now_s: float) -> None:
        """The connection works; whether motion is ready the status says all the time."""
        self._check_s = now_s + IDLE_CHECK_S
        if self.phase is Phase.GREETING:
            self.phase = Phase.IDLE
            if self._start_once or self._asked_early:
                self._start_once = self._asked_early = False
                self.enable(now_s)

    def _failure(self, answer: Answer) -> str:
        """Why a request failed, in words; "" when it did not."""
        if not isinstance(answer, MotionReply):
            return "the controller answered with something else than a motion reply"
        if answer.result == MotionResult.SUCCESS:
            return ""
        return reply_in_words(answer.command, answer.result, answer.subcode)

    # -- what a person asks for -------------------------------------------------------------------

    def ask(self, task: Task, now_s: float) -> None:
        """Do one of the things that only a person may ask for."""
        if task == "enable":
            self.enable(now_s)
        elif task == "disable":
            self.disable(now_s)
        elif task == "stop":
            self.stop(now_s)
        else:
            command = _CONTROLS[task]
            if self.phase is Phase.IDLE:
                self._control(command, now_s)
            elif self.phase in (Phase.DOWN, Phase.GREETING):
                self._answer = f"{task}: {self.phase.value}"
            elif command is MotionCommand.STOP_SERVOS:
                if self.phase is Phase.STARTING:
                    self.disable(now_s)
                if self.phase is Phase.LEAVING:
                    self._after.append(command)
                else:
                    self._brake("the servos were switched off", now_s, (command,))
            # Alarms and servos that are off would have ended the motion.
        self._flush(now_s)

    def enable(self, now_s: float) -> None:
        """Start motion. A controller that is not connected is not asked later instead."""
        phase = self.phase
        if phase is Phase.GREETING:
            self._asked_early = True
        elif phase is Phase.DOWN:
            self.end_reason = "motion could not be enabled while there was no connection"
        elif phase is Phase.IDLE:
            if self._lacking():
                return
            self.end_reason = self._answer = ""
            self.phase = Phase.STARTING
            self._check_s = math.inf
            if self._uses_velocity:
                data = joints10((float(self.options.watchdog_ms), 1.0))
                self.requests.control(MotionCommand.START_VEL_MODE, self._started, data)
            else:
                self.requests.control(MotionCommand.START_TRAJ_MODE, self._started)
        self._flush(now_s)

    def _lacking(self) -> str:
        """What makes a start useless, in words."""
        if self.options.mode == "velocity" and not self._velocity:
            return "the controller has no velocity mode; set mode to stream or auto"
        if self.feed.other_axis:
            return (
                f"axis {self.feed.other_axis} of group {self.options.group} is not at zero: the "
                f"controller has more axes than {self.options.robot}'s {self.options.joints}"
            )
        info = self.velocity_info
        if self._uses_velocity and info is not None and info.axes != self.options.joints:
            return (
                f"group {self.options.group} of the controller has {info.axes} axes, "
                f"{self.options.robot} has {self.options.joints}"
            )
        return ""

    def _started(self, answer: Answer, now_s: float) -> None:
        failed = self._failure(answer)
        if self.phase is not Phase.STARTING:
            return
        if not failed and not self.feed.live(now_s):
            failed = "no state was heard of the controller"
        self.phase = Phase.IDLE
        self._check_s = now_s + IDLE_CHECK_S
        if failed:
            self.end_reason = failed
            return
        self.sessions += 1
        self._instant_s = NEVER_S
        self.phase = Phase.MOVING
        self._check_s = math.inf
        limits = self._agreed_limits()
        guide = JointGuide(limits.lower, limits.upper, limits.velocity, limits.acceleration)
        parts = MotionParts(
            self.options, self.requests, self.feed, guide, self.counters, self.record
        )
        kind = VelocityStream if self._uses_velocity else _BY_POINTS[self.options.mode]
        self._motion = kind(parts, now_s)
        self._motion.advance(now_s)
        self._hold(self._motion, now_s)

    def _agreed_limits(self) -> JointLimits:
        """Ours, and the controller's own where it tells them and they are narrower."""
        limits, info = self.limits, self.velocity_info
        if info is None or not self._uses_velocity:
            return limits
        lower, upper = [], []
        for a, b, low, high in zip(
            limits.lower, limits.upper, info.pos_min, info.pos_max, strict=False
        ):
            known = low < high and max(a, low) < min(b, high)
            lower.append(max(a, low) if known else a)
            upper.append(min(b, high) if known else b)
        return JointLimits(
            tuple(lower),
            tuple(upper),
            _narrower(limits.velocity, info.v_max),
            _narrower(limits.acceleration, info.a_max),
        )

    def disable(self, now_s: float) -> None:
        """Brake along a ramp, then leave the controller's mode."""
        self._start_once = self._asked_early = False
        if self.phase is Phase.STARTING:
            self.phase = Phase.LEAVING
            self._stop_tries = 0
            self._after = list(self._stop_commands)
            self.requests.drop()
            self._leave(now_s)
        else:
            self._brake("motion was disabled", now_s, self._stop_commands)
        self._flush(now_s)

    def stop(self, now_s: float) -> None:
        """STOP_MOTION at once: a trajectory's command stops dead, velocity mode ramps down at the
        controller's own acceleration. A reply that is awaited comes first."""
        self._start_once = self._asked_early = False
        if self.phase in (Phase.DOWN, Phase.GREETING):
            return
        self._over("motion was stopped", stop=True)
        self._flush(now_s)

    def leave(self, now_s: float) -> None:
        """Brake and leave the controller's mode, for there is nobody left to command."""
        if self.phase in (Phase.GREETING, Phase.STARTING, Phase.MOVING):
            self.disable(now_s)

    @property
    def left(self) -> bool:
        """True when nothing is left to be said to the controller."""
        phase = self.phase
        return phase in (Phase.DOWN, Phase.GREETING) or (phase is Phase.IDLE and self.requests.idle)

    @property
    def _stop_commands(self) -> tuple[MotionCommand, ...]:
        """What leaves the modes; trajectory mode stays behind when velocity mode is left."""
        trajectory = MotionCommand.STOP_TRAJ_MODE
        if self._uses_velocity:
            return MotionCommand.STOP_VEL_MODE, trajectory
        return (trajectory,)

    def _control(self, command: MotionCommand, now_s: float) -> None:
        def told(answer: Answer, now_s: float) -> None:
            self._answer = self._failure(answer)

        self.requests.control(command, told)

    # -- the end of motion ------------------------------------------------------------------------

    def _brake(self, reason: str, now_s: float, after: tuple[MotionCommand, ...] = ()) -> None:
        """Bring the robot to rest along a ramp; motion needs to be enabled again afterwards."""
        motion = self._motion
        if motion is None:
            return
        if self.phase is Phase.MOVING:
            self._note_end(reason)
            self.phase = Phase.BRAKING
            self._brake_until_s = now_s + motion.braking_s
            self.owes_answer = False
            motion.wind_down()
            # Velocity mode is left in any case, for its watchdog would call the silence a fault. A
            # trajectory's queue has run empty by then; if it has not, it is emptied.
            velocity = self._uses_velocity
            stop = MotionCommand.STOP_VEL_MODE if velocity else MotionCommand.STOP_MOTION
            self._after = [stop]
        self._after += [command for command in after if command not in self._after]
        self._hold(motion, now_s)
        self._proceed(now_s)

    def _over(self, reason: str, stop: bool = False) -> None:
        """Motion is over at once: the controller has ended it, or does not do what it is told."""
        if self.phase is Phase.MOVING or not self.end_reason:
            self._note_end(reason)
        moving = self._motion is not None
        self._motion = None
        self.owes_answer = False
        self._after = []
        self._stop_s = math.inf
        self.requests.drop()
        self.phase = Phase.IDLE
        self._check_s = self._said_s + IDLE_CHECK_S
        if self._links["motion"].up and (moving or stop):
            # Nothing that is still queued may be played when the cause has gone.
            self.requests.control(MotionCommand.STOP_MOTION, _ignore)

    def _learnt(self, answer: Answer, now_s: float) -> None:
        """Why the controller ended the motion, in its own words."""
        if self.phase is not Phase.IDLE or not isinstance(answer, MotionReply):
            return
        # Old firmware gives no reason, and says 0.
        if answer.result != MotionResult.SUCCESS and answer.subcode:
            self.ends -= Counter({self.end_reason: 1})
            self._note_end(reply_in_words(answer.command, answer.result, answer.subcode))

    def _note_end(self, reason: str) -> None:
        self.end_reason = reason
        self.ends[reason] += 1

    def _leave(self, now_s: float) -> None:
        """Ask for what is to be done after the braking, one after the other."""
        self._stop_s = math.inf
        if not self._after:
            self.phase = Phase.IDLE
            self._check_s = now_s + IDLE_CHECK_S
            return
        self.requests.control(self._after[0], self._left)

    def _left(self, answer: Answer, now_s: float) -> None:
        if self.phase is not Phase.LEAVING or not self._after:
            return
        failed = self._failure(answer)
        if failed and self._stop_tries < STOP_TRIES:
            self._stop_tries += 1
            self._stop_s = now_s + STOP_RETRY_S
            return
        self._answer = failed
        self._stop_tries = 0
        del self._after[0]
        self._leave(now_s)

    # -- the control loop -------------------------------------------------------------------------

    def due_state(self, now_s: float) -> RobotState | None:
        """The state to report now; None while no control instant has come and nothing is new."""
        feed = self.feed
        if not self._live(now_s):
            if self._said_link is not RobotLink.LIVE and now_s - self._said_s < WAKE_S:
                return None
            self.owes_answer = False
            self._instant_s = NEVER_S
            self.losses += self._said_link is RobotLink.LIVE
            link = RobotLink.LOST if feed.heard else RobotLink.WAITING
            return self._state(now_s, link, 0.0, self._silence(now_s))
        motion = self._motion
        if motion is not None and self.phase is Phase.MOVING and not motion.waiting:
            period_s = motion.due(now_s)
            if period_s:
                self._period_s = period_s
                self.owes_answer = True
                if self._instant_s > NEVER_S:
                    self.jitter.add(abs(now_s - self._instant_s - period_s))
                self._instant_s = now_s
                return self._state(now_s, RobotLink.LIVE, period_s, "")
            if now_s - self._said_s < WAKE_S:
                return None
            waiting = "waiting for the controller"
            return self._state(now_s, RobotLink.LIVE, now_s - self._said_s, waiting)
        if feed.statuses == self._statuses and now_s - self._said_s < WAKE_S:
            return None
        period_s = min(now_s - self._said_s, WAKE_S)
        return self._state(now_s, RobotLink.LIVE, period_s, self.hold_reason)

    def _state(
        self, now_s: float, link: RobotLink, period_s: float, hold_reason: str
    ) -> RobotState:
        feed = self.feed
        self._said_s = now_s
        self._said_link = link
        self._statuses = feed.statuses
        return RobotState(
            stamp_s=now_s,
            link=link,
            session=self.sessions,
            sequence=feed.feedbacks,
            period_s=period_s,
            joints=feed.positions,
            external_axes=(),
            pose=None,
            hold_reason=hold_reason,
            velocities=feed.velocities,
        )

    def command(self, command: RobotCommand, now_s: float) -> None:
        """Answer the state last given; without effect where that takes no command.

        Raises CommandError for a kind or shape that the robot cannot take; nothing is sent then.
        """
        self.check(command)
        motion = self._motion
        if not self.owes_answer or motion is None:
            return
        motion.command(command, self._period_s, now_s)
        self.owes_answer = False
        self._proceed(now_s)
        self._flush(now_s)

    def check(self, command: RobotCommand) -> None:
        """Raise CommandError for a command of a wrong kind, length or of no numbers.

        Limits are met by what is sent, not by refusal.
        """
        if isinstance(command, HoldCommand):
            return
        if isinstance(command, JointCommand):
            if command.external_axes:
                raise CommandError("external_axes: the driver moves one control group only")
            self._numbers("positions", command.positions)
            if command.velocities is not None:
                self._numbers("velocities", command.velocities)
        elif isinstance(command, JointVelocityCommand):
            self._numbers("velocities", command.velocities)
        else:
            raise CommandError(
                f"MotoROS takes no {command.kind.value}; it takes hold, joint, joint velocity"
            )

    def _numbers(self, name: str, values: tuple[float, ...]) -> None:
        joints = self.feed.joints
        if len(values) != joints:
            raise CommandError(f"{name}: {len(values)} values for {joints} joints")
        if not all(map(math.isfinite, values)):
            raise CommandError(f"{name}: {values!r} are not all finite")

    # -- words ------------------------------------------------------------------------------------

    @property
    def hold_reason(self) -> str:
        """Why commands would not act now, in words; empty when they do."""
        phase = self.phase
        motion = self._motion
        if phase is Phase.MOVING and motion is not None:
            return motion.waiting
        if phase is Phase.DOWN:
            return self._why_down()
        if phase is Phase.IDLE:
            lacking = self._lacking()
            if lacking:
                return lacking
            # A reply may have ended motion first; what the status says by now is more exact.
            found = self._stopped_by() or self.end_reason
            return f"{found} (enable motion again)" if found else "motion is not enabled"
        if phase in (Phase.BRAKING, Phase.LEAVING):
            return self.end_reason or str(phase.value)
        return str(phase.value)

    def _stopped_by(self) -> str:
        """What a person has to change at the robot before motion can be enabled, in words."""
        status = self.feed.status
        if status is None or status.motion_possible == 1:
            return ""
        # A controller that nobody has started yet is no reason to look for a cause.
        return status_in_words(status._replace(motion_possible=1, drives_powered=1))

    def _why_down(self) -> str:
        link = self._links["motion"]
        end = f"{self.end_reason}; " if self.end_reason else ""
        port = self.options.motion_port
        return f"{end}no connection to port {port}" + (f": {link.reason}" if link.reason else "")

    def _silence(self, now_s: float) -> str:
        link = self._links["state"]
        if link.reason:
            return f"no connection to port {self.options.state_port}: {link.reason}"
        if not link.up:
            return f"connecting to {self.options.host}:{self.options.state_port}"
        heard_s = max(min(self.feed.status_s, self.feed.feedback_s), link.since_s)
        # Where the status comes and the feedback does not, the controller lacks the group.
        missing = "state"
        if self.feed.status_s > self.feed.feedback_s:
            missing = f"feedback of group {self.options.group}"
        return f"no {missing} for {now_s - heard_s:.1f} s"

    def metrics(self, now_s: float) -> dict[str, float]:
        """Live figures."""
        counters, latency = self.counters, self.requests.latency
        return {
            "feedback_age_s": max(0.0, now_s - self.feed.feedback_s)
            if self.feed.feedback_s > NEVER_S
            else math.inf,
            "period_s": self.capabilities.period_s,
            "period_jitter_p99_s": self.jitter.percentile(99.0),
            "lost": float(self.losses),
            "sessions": float(self.sessions),
            "request_p50_s": latency.percentile(50.0),
            "request_p99_s": latency.percentile(99.0),
            "request_max_s": latency.max,
            "queue_count": float(counters.queue_count),
            "commands": float(counters.commands),
            "underruns": float(counters.underruns),
            "busy_replies": float(counters.busy_replies),
            "resent_points": float(counters.resent_points),
            "restarts": float(counters.restarts),
            "replaced": float(counters.replaced),
            "skipped_instants": float(counters.skipped_instants),
            "speed_limited": float(counters.speed_limited),
            "acceleration_limited": float(counters.acceleration_limited),
            "range_limited": float(counters.range_limited),
            "overwritten": float(counters.overwritten),
            "command_age_s": counters.command_age_s,
            "reconnects": float(sum(max(0, link.count - 1) for link in self._links.values())),
            "ignored": float(sum(self.feed.ignored.values())),
            "ends": float(sum(self.ends.values())),
            "velocity_mode": float(self._uses_velocity),
            "enabled": float(self.enabled),
        }

    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        """What stands in the way or deserves attention, worst first."""
        found: list[str] = []
        if not self.feed.live(now_s):
            found.append(self._silence(now_s))
        else:
            status = self.feed.status
            if self.hold_reason:
                found.append(self.hold_reason)
            words = "" if status is None or self.enabled else status_in_words(status)
            if words and words not in found:
                found.append(words)
        if self._answer:
            found.append(self._answer)
        underruns = self.counters.underruns
        if underruns:
            found.append(
                f"the controller's queue ran empty in motion {underruns} times: this computer is "
                "late; raise queue_low"
            )
        found += [
            f"{count} messages ignored: {why}" for why, count in self.feed.ignored.most_common(5)
        ]
        found += [f"motion ended {n} times: {why}" for why, n in self.ends.most_common(3) if n > 1]
        return tuple(found)


def _ignore(answer: Answer, now_s: float) -> None:
    """Takes a reply that changes nothing."""


def _narrower(ours: tuple[float, ...], theirs: tuple[float, ...]) -> tuple[float, ...]:
    """The lesser of each pair; values that are no limits do not count."""
    return tuple(
        min(a, FLOAT32_SHARE * b) if 0.0 < b < math.inf else a
        for a, b in zip(ours, theirs, strict=False)
    )
