"""Client side of the connections to a Universal Robots controller, without sockets and clocks.

RTDE carries states and commands; the dashboard server switches power on; the primary interface
takes the program. The last two are connected only while needed.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from operator import sub
from typing import Final, Literal

from cardan.common.histogram import LatencyHistogram
from cardan.drivers.robot_core import (
    WAKE_S as REPORT_S,
    check_joints,
)
from cardan.drivers.tcp_robot import TcpSession
from cardan.drivers.ur_rtde.feed import IMPLAUSIBLE, Package, RtdeFeed
from cardan.drivers.ur_rtde.motion import UrMotion
from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.drivers.ur_rtde.power_on import Starting
from cardan.drivers.ur_rtde.status_text import (
    ENDS,
    NOT_ENABLED,
    REDUCED,
    again,
    mode_words,
    other_arm,
    safety_words,
)
from cardan.protocols.ur.dashboard import UNLOCK_PROTECTIVE_STOP, DashboardReader, refusal, request
from cardan.protocols.ur.primary import MessageKind, PackageReader, RobotMessage, read_message
from cardan.protocols.ur.program import JOINTS, ProgramStatus, nobody, program
from cardan.protocols.ur.states import MOVES_IN, RobotMode, RuntimeState, SafetyMode
from cardan.types import (
    NEVER_S,
    CommandKind,
    HoldCommand,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
)

Channel = Literal["rtde", "dashboard", "primary"]
CHANNELS: tuple[Channel, ...] = ("rtde", "dashboard", "primary")
Task = Literal["enable", "disable", "unlock"]
SessionPhase = Literal["down", "idle", "starting", "moving", "braking"]
"""Phase of the driver: no states come; idle; motion is starting; the program runs, and commands
act; a ramp, and then the program's end."""

KINDS: Final = frozenset({CommandKind.HOLD, CommandKind.JOINT, CommandKind.JOINT_VELOCITY})

WAKE_S: Final = 0.9 * REPORT_S
"""Longest gap between states: the contract's, with a margin for a late computer."""
SLOWEST_SHARE: Final = 0.01
"""Lowest position of the speed slider at which commands act."""
ANSWER_S: Final = 0.3
"""Time without an obeyed command after which the program counts as gone."""
FOLLOWING_S: Final = 0.25
"""Time for which a joint may be farther from its target than `following_error_rad`: a hard start
takes less."""
MUTE: Final = 3
"""Connections without any answer after which the server may speak another protocol: a controller
that boots closes one or two."""
_JITTERED: Final = 10
"""Longest pause, in periods, that the network causes."""


_MOVES_IN = frozenset(map(int, MOVES_IN))
_RUNNING, _PLAYING = int(RobotMode.RUNNING), int(RuntimeState.PLAYING)
_FOLLOWS = int(ProgramStatus.FOLLOWS)
"""Enum values as plain numbers, which are compared in every cycle."""
_LIVE = RobotLink.LIVE
_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor."""


def _drawn_token() -> int:
    return random.SystemRandom().randrange(1, 1 << 31)


class UrSession(TcpSession[Channel, Task]):
    """Protocol session with one robot on one controller."""

    reply_pending = False

    def __init__(self, options: UrRtdeOptions, draw: Callable[[], int] = _drawn_token) -> None:
        """Set `draw`, which returns a new token for each run of the program."""
        super().__init__(CHANNELS)
        self.options = options
        self.limits = options.limits
        self.feed = RtdeFeed(options)
        self.phase: SessionPhase = "down"
        self.sessions = 0
        """Count of starts of motion and connections; earlier targets are void when it changes."""
        self.end_reason = ""
        """Reason that last ended or prevented motion; empty after a successful start."""
        self.superseded = self.commands = self.starts = self.ends = 0
        self._jitter, self._command_latency = LatencyHistogram(), LatencyHistogram()
        self._unaccounted: tuple[float, float, int] | None = None
        """Arrival of the newest state, time since the previous one (inf: several came), and its
        beat; None: it is in the histograms."""
        self._draw = draw
        self._blind_s, self._astray_rad = options.state_timeout_s, options.following_error_rad
        self._starting: Starting | None = None
        self._motion: UrMotion | None = None
        self._token = self._beat = 0
        self._sent: deque[tuple[int, float]] = deque(maxlen=256)
        self._lines = DashboardReader()
        self._packages = PackageReader()
        self._model = ""
        """Model of the arm as the controller reports it, if a start has requested it."""
        self._unlocks = self._ended = False
        self._at_start = options.enable == "at-start"
        self._reported_packages = 0
        self._before_s: float | None = None
        """Agreed time of the last returned state."""
        self._answered = (0, 0.0)
        """Last beat that the program obeyed, and its agreed time."""
        self._effective = False
        """True if commands acted in the last returned state."""
        self._braked_by_s = math.inf
        self._followed_s = NEVER_S
        """Last time that the arm was near its target."""
        self._mute = 0
        """Consecutive connections that ended before any RTDE message came."""

    # -- capabilities and state of the robot ----------------------------------------------------

    @property
    def capabilities(self) -> RobotCapabilities:
        """Supported commands; the period is the controller's once it is known."""
        return RobotCapabilities(
            commands=KINDS,
            period_s=self.feed.period_s,
            joints=JOINTS,
            limits=self.limits,
            lag_s=self.options.lag_s,
            robot=self.options.robot,
        )

    @property
    def enabled(self) -> bool:
        """True while commands move the robot, or would if they came."""
        return self.phase == "moving"

    @property
    def left(self) -> bool:
        return self.phase not in ("moving", "braking")

    @property
    def braking_s(self) -> float:
        return max(
            v / a for v, a in zip(self.limits.velocity, self.limits.acceleration, strict=True)
        )

    @property
    def hold_reason(self) -> str:
        """Reason why commands would not act now; empty when they do."""
        if self.phase == "down":
            return self._silence()
        values = self.feed.values
        if values.safety_mode not in _MOVES_IN:
            return safety_words(values.safety_mode)
        if fault := self.feed.clock.fault:
            return again(fault)
        if self.phase == "moving":
            if self.feed.slider < SLOWEST_SHARE:
                return "the speed slider is at 0: move it up at the pendant"
            return ""
        if self.phase == "starting" and self._starting is not None:
            return f"starting: {self._starting.wish}"
        if self.phase == "braking":
            return "the arm is brought to rest"
        if self.end_reason:
            return self.end_reason
        if values.robot_mode != RobotMode.RUNNING:
            return f"{mode_words(values.robot_mode)}; {NOT_ENABLED}"
        if values.safety_mode == SafetyMode.REDUCED:
            return f"{NOT_ENABLED}; {REDUCED}"
        return NOT_ENABLED

    # -- connections ------------------------------------------------------------------------------

    def wants(self, channel: Channel, now_s: float) -> bool:
        if channel == "dashboard":
            return (self._unlocks or self.phase == "starting") and not self._links[channel].up
        if channel == "primary" and self.phase != "starting":
            return False
        link = self._links[channel]
        return now_s >= link.retry_s and not link.up

    def connected(self, channel: Channel, now_s: float) -> None:
        self._links[channel].opened(now_s)
        if channel == "rtde":
            self._model = ""
            self.feed.connected(now_s)
        elif channel == "dashboard":
            self._lines = DashboardReader()
            if self._unlocks:
                self._out.append(("dashboard", request(UNLOCK_PROTECTIVE_STOP)))
        else:
            self._packages = PackageReader()

    def connect_failed(self, channel: Channel, reason: str, now_s: float) -> None:
        super().connect_failed(channel, reason, now_s)
        if channel == "rtde":
            return
        where = "dashboard server" if channel == "dashboard" else "primary interface"
        port = getattr(self.options, f"{channel}_port")
        why = f"no connection to the {where}, port {port}: {reason}"
        if self._unlocks and self.phase == "idle":
            self.end_reason = why
        self._unlocks = False
        self._fail(why)

    def _lost(self, channel: Channel, reason: str, now_s: float) -> None:
        link = self._links[channel]
        if channel == "rtde":
            reason = self._refused_rtde(reason)
        link.lost(reason, now_s)
        if channel == "rtde":
            if self.feed.foreign:
                link.retry_s = math.inf
            moved = self.phase in ("moving", "braking")
            self.feed.disconnected()
            self._end(again(f"the RTDE connection was lost in motion: {reason}") if moved else "")
            self.phase = "down"
        elif self.phase == "starting" and channel == "dashboard":
            self._fail(f"the dashboard server closed its connection: {reason}")
        elif channel == "dashboard":
            self._unlocks = False

    def _refused_rtde(self, reason: str) -> str:
        """Explain why the RTDE connection ended with `reason`, in case the server is another."""
        self._mute = 0 if self.feed.answered else self._mute + 1
        if self.feed.foreign:
            return f"{self.feed.foreign}; not tried again before motion is enabled"
        if self._mute < MUTE:
            return reason
        return (
            f"{reason}, {self._mute} times without an answer: it does not seem to speak RTDE; is "
            "rtde_port the controller's?"
        )

    def outgoing(self) -> list[tuple[Channel, bytes]]:
        states = self.feed.out
        if not (states or self._out):
            return []
        found, self._out = self._out, []
        for data in states:
            found.append(("rtde", data))
        states.clear()
        return found

    def received(self, channel: Channel, data: bytes, now_s: float) -> None:
        if not self._links[channel].up:
            return
        if channel == "dashboard":
            self._received_lines(data, now_s)
            return
        if channel == "primary":
            self._received_packages(data, now_s)
            return
        feed = self.feed
        before, before_s = feed.packages, feed.heard_s
        feed.received(data, now_s)
        fresh = feed.packages - before
        if fresh:
            self.superseded += fresh - 1
            if self._unaccounted is not None:
                self.account()
            waited_s = now_s - before_s if fresh == 1 else math.inf
            obeyed, motion = feed.values.beat, self._motion
            self._unaccounted = (now_s, waited_s, obeyed)
            obeys = feed.obeys and self.phase == "moving"
            if motion is None or not obeys or self._stuck(obeyed, motion):
                self._look(now_s)
            else:
                self._followed_s = now_s
        if feed.failure:
            self._drop("rtde", feed.failure, now_s)

    def account(self) -> None:
        """Count the newest state in the histograms, which its answer need not wait for."""
        unaccounted, self._unaccounted = self._unaccounted, None
        if unaccounted is None:
            return
        now_s, waited_s, obeyed = unaccounted
        sent, period_s = self._sent, self.feed.period_s
        if waited_s < _JITTERED * period_s:
            self._jitter.add(abs(waited_s - period_s))
        while sent and sent[0][0] <= obeyed:
            beat, sent_s = sent.popleft()
            if beat == obeyed:
                self._command_latency.add(now_s - sent_s)

    @property
    def jitter(self) -> LatencyHistogram:
        """Deviation of the time between two states from their period."""
        self.account()
        return self._jitter

    @property
    def command_latency(self) -> LatencyHistogram:
        """Time from a command to the state that shows that the program obeyed it."""
        self.account()
        return self._command_latency

    def _received_lines(self, data: bytes, now_s: float) -> None:
        self._lines.feed(data)
        while (line := self._lines.take()) is not None:
            if self._starting is not None:
                self._starting.replied(line)
                self._model = self._starting.model
            elif self._unlocks and not line.startswith("Connected"):
                self.end_reason = refusal(UNLOCK_PROTECTIVE_STOP, line)
                self._drop("dashboard", "not needed", now_s)
                return
        if self._lines.failure:
            self._drop("dashboard", self._lines.failure, now_s)

    def _received_packages(self, data: bytes, now_s: float) -> None:
        self._packages.feed(data)
        while (package := self._packages.take()) is not None:
            message = read_message(package)
            if message is not None:
                self._take_message(message)
        if self._packages.failure:
            self._drop("primary", self._packages.failure, now_s)

    def _take_message(self, message: RobotMessage) -> None:
        # Any program or URCap may send text by `textmsg`: it does not show that ours was not
        # started.
        if message.kind == MessageKind.RUNTIME_EXCEPTION and self._starting is not None:
            self._starting.report_failure(f"line {message.line}: {message.text}")

    # -- evaluation of states -------------------------------------------------------------------

    def _look(self, now_s: float) -> None:
        """React to the newest state."""
        if self.feed.clock.fault and self.phase not in ("down", "idle"):
            self._end(again(self.feed.clock.fault))
        if self._motion is not None:
            self._watch(self.feed.values, self._motion, now_s)
        elif self.phase == "down":
            self.phase = "idle"
            self.sessions += 1
            # Values of an earlier run in the registers are void.
            self._beat += 1
            self.feed.write(nobody(self._beat))
            if self._at_start:
                self._at_start = False
                self._enable(now_s)

    def _watch(self, values: Package, motion: UrMotion, now_s: float) -> None:
        """Check whether the program still runs and obeys."""
        if values.safety_mode not in _MOVES_IN:
            why = safety_words(values.safety_mode)
        elif values.robot_mode != _RUNNING:
            why = f"{mode_words(values.robot_mode)}: motion has ended"
        elif values.token != self._token:
            why = "another program uses the registers"
        elif values.report != _FOLLOWS:
            why = ENDS.get(values.report, "the program at the controller has ended")
        elif values.runtime_state != _PLAYING:
            if values.runtime_state in (RuntimeState.PAUSING, RuntimeState.PAUSED):
                why = "the program was paused at the controller: stop it there"
            else:
                why = "the program was stopped at the controller"
        elif self._stuck(values.beat, motion):
            why = "the program at the controller does not answer: another has taken its place"
        else:
            why = self._astray(values, now_s)
        if why:
            self._end("" if self.phase == "braking" and self._ended else again(why))
        elif self.phase == "braking":
            self._brake(motion, now_s)

    def _astray(self, values: Package, now_s: float) -> str:
        """Describe a joint that was too far from its target for too long; empty if there is
        none."""
        most = self._astray_rad
        # No single joint is farther off than all of them together.
        if math.dist(values.actual_q, values.target_q) <= most:
            self._followed_s = now_s
            return ""
        errors = [*map(abs, map(sub, values.actual_q, values.target_q))]
        farthest = max(errors)
        if farthest <= most:
            self._followed_s = now_s
            return ""
        if now_s - self._followed_s <= FOLLOWING_S:
            return ""
        return (
            f"joint {errors.index(farthest) + 1} is {farthest:.2f} rad from its target: something "
            "holds it, or it is measured wrongly"
        )

    def _stuck(self, obeyed: int, motion: UrMotion) -> bool:
        """True if commands were sent and none was obeyed for a while."""
        beat, at_s = self._answered
        time_s = self.feed.clock.time_s
        if (
            obeyed != beat
            or obeyed == motion.beat
            or (slider := self.feed.slider) < SLOWEST_SHARE
            or time_s < at_s
        ):
            self._answered = (obeyed, time_s)
            return False
        return time_s - at_s > ANSWER_S / min(slider, 1.0)

    def _brake(self, motion: UrMotion, now_s: float) -> None:
        """Brake for one period of the ramp that ends motion; then command the program to end."""
        if motion.moving and now_s < self._braked_by_s:
            self._send(HoldCommand(), motion, now_s)
        else:
            self._ended = True
            self.feed.write(motion.end())
            self._beat = motion.beat

    def _end(self, reason: str) -> None:
        """Record the end of motion, or of its start."""
        self.account()
        if self.phase in ("moving", "braking"):
            self.ends += 1
            if self._motion is not None:
                # A program that is only paused ends as soon as it continues.
                self.feed.write(self._motion.end())
                self._beat = self._motion.beat
        if self.phase != "down":
            self.phase = "idle"
        self.end_reason = reason
        self._motion = self._starting = None
        self.reply_pending = False
        self._sent.clear()
        for channel in ("dashboard", "primary"):
            if self._links[channel].up:
                self._links[channel].lost("not needed", NEVER_S)
                self._closing.append(channel)
        self._out.clear()

    def _fail(self, reason: str) -> None:
        if self.phase == "starting":
            self._end(reason)

    # -- starting ---------------------------------------------------------------------------------

    def ask(self, task: Task, now_s: float) -> None:
        if task == "enable":
            self._links["rtde"].retry_s = min(self._links["rtde"].retry_s, now_s)
            self._enable(now_s)
        elif task == "disable":
            self.leave(now_s)
        elif self.phase == "idle":
            self._unlocks = True

    def _enable(self, now_s: float) -> None:
        """Start motion. Without a connection the request is refused, not deferred."""
        if self.phase != "idle":
            return
        if self.feed.clock.fault:
            self.end_reason = again(self.feed.clock.fault)
            return
        self.end_reason = ""
        self._token = self._draw()
        self._starting = Starting(self.options, self._token, now_s)
        self.phase = "starting"
        self.feed.write(nobody(self._beat))

    def _go_on(self, now_s: float) -> None:
        """Execute the next step of a start."""
        starting, values = self._starting, self.feed.values
        if starting is None or self.phase != "starting":
            return
        if starting.uploaded and values.token == starting.token:
            self._started(values, now_s)
            return
        asked = ""
        modes = values.robot_mode, values.safety_mode, values.runtime_state
        if self._links["dashboard"].up:
            asked = starting.asks(*modes, now_s)
        elif now_s >= starting.deadline_s:
            starting.failure = starting.wish
        if starting.failure:
            self._fail(starting.failure)
        elif asked:
            self._out.append(("dashboard", request(asked)))
        elif starting.uploads and self._links["primary"].up:
            starting.uploads, starting.uploaded = False, True
            text = program(self.options.servoing, starting.token, 1.0 / self.feed.control_rate_hz)
            self._out.append(("primary", text.encode()))

    def _started(self, values: Package, now_s: float) -> None:
        if values.report != ProgramStatus.FOLLOWS:
            return
        self.starts += 1
        self.sessions += 1
        self._motion = UrMotion(self.options, self._token, self._beat, self.feed.command_head)
        self.feed.follow(self._token)
        self._motion.begin(values.target_q)
        self._answered = (values.beat, self.feed.clock.time_s)
        self._starting = None
        self._followed_s = now_s
        self.phase = "moving"
        self._effective = True
        self._ended = False
        self._drop("dashboard", "not needed", now_s)
        self._drop("primary", "not needed", now_s)

    def leave(self, now_s: float) -> None:
        if self.phase == "moving":
            self.phase = "braking"
            self._braked_by_s = now_s + self.braking_s + 0.5
            self.end_reason = ""
        elif self.phase == "starting":
            self._end("")

    # -- time -------------------------------------------------------------------------------------

    @property
    def next_s(self) -> float:
        feed = self.feed
        found = self._said_s + WAKE_S
        if feed.next_s < found:
            found = feed.next_s
        if self._said_link is _LIVE and feed.heard_s + self._blind_s < found:
            found = feed.heard_s + self._blind_s
        if self._starting is not None:
            found = min(found, self._starting.deadline_s)
        return found

    def advance(self, now_s: float) -> None:
        feed = self.feed
        if now_s >= feed.next_s and self._links["rtde"].up:
            feed.advance(now_s)
            if feed.failure:
                self._drop("rtde", feed.failure, now_s)
        if self._motion is not None:
            if not self._live(now_s):
                self._end(again(self._silence()))
        elif self.phase == "starting":
            self._go_on(now_s)

    # -- the control loop -------------------------------------------------------------------------

    def _live(self, now_s: float) -> bool:
        return self.feed.streaming and now_s - self.feed.heard_s <= self._blind_s

    def late(self, now_s: float) -> bool:
        """True when a newer state than the newest is due."""
        return (now_s - self.feed.heard_s) * self.feed.rate_hz > 1.0

    def due_state(self, now_s: float) -> RobotState | None:
        feed = self.feed
        if not self._live(now_s) or self.phase == "down":
            if self._said_link is not _LIVE and now_s - self._said_s < WAKE_S:
                return None
            self.reply_pending = False
            self.losses += self._said_link is _LIVE
            link = RobotLink.LOST if feed.packages else RobotLink.WAITING
            self._before_s = None
            return self._state(now_s, link, 0.0, self._silence())
        if feed.packages == self._reported_packages:
            if now_s - self._said_s < WAKE_S:
                return None
            # States are late and not lost yet: nothing is reported or answered.
            return self._state(now_s, _LIVE, 0.0, "waiting for the controller")
        self._reported_packages = feed.packages
        time_s = feed.clock.time_s
        before_s, self._before_s = self._before_s, time_s
        moves = feed.obeys and self.phase == "moving" and feed.slider >= SLOWEST_SHARE
        hold_reason = "" if moves else self.hold_reason
        period_s = feed.period_s if before_s is None else time_s - before_s
        state = self._state(now_s, _LIVE, period_s, hold_reason)
        if self.phase == "moving" and self._motion is not None:
            self.reply_pending = True
            if not self._effective or hold_reason:
                # Targets from the time without motion are void.
                self._motion.begin(feed.values.target_q)
            if not self._effective and not hold_reason:
                self.sessions += 1
                state = state._replace(session=self.sessions)
            self._effective = not hold_reason
        return state

    def _state(
        self, now_s: float, link: RobotLink, period_s: float, hold_reason: str
    ) -> RobotState:
        values = self.feed.values
        self._said_s, self._said_link = now_s, link
        joints, speeds = values.actual_q, values.actual_qd
        number, packages = self.sessions, self.feed.packages
        # Field by field in their order; by name it takes three times as long.
        return _new(
            RobotState,
            (
                now_s,
                link,
                number,
                packages,
                period_s,
                joints,
                (),
                None,
                hold_reason,
                None,
                None,
                None,
                "",
                speeds,
                (),
            ),
        )

    def command(self, command: RobotCommand, now_s: float) -> None:
        motion, feed = self._motion, self.feed
        if (
            motion is not None
            and self.reply_pending
            and self._effective
            and feed.slider == 1.0
            and feed.streaming
            and self.phase == "moving"
            and (package := motion.usual(command, feed.clock.time_s, feed.period_s)) is not None
        ):
            self.reply_pending = False
            self._reported_packages, self._said_s = feed.packages, now_s
            self._beat = beat = motion.beat
            self.commands += 1
            self._sent.append((beat, now_s))
            feed.out.append(package)
            return
        self.check(command)
        if not self.reply_pending or motion is None or self.phase != "moving":
            return
        self.reply_pending = False
        if not self._effective:
            command = HoldCommand()
        # Packages received since the state was returned count as answered and heard.
        self._reported_packages, self._said_s = self.feed.packages, now_s
        self._send(command, motion, now_s)

    def _send(self, command: RobotCommand, motion: UrMotion, now_s: float) -> None:
        feed = self.feed
        scale = feed.slider
        if not SLOWEST_SHARE <= scale <= 1.0:
            scale = max(min(scale, 1.0), SLOWEST_SHARE)
        values = motion.command(command, feed.clock.time_s, feed.period_s, scale)
        if values is not None:
            self._beat = beat = motion.beat
            self.commands += 1
            self._sent.append((beat, now_s))
            feed.write(values)

    def check(self, command: RobotCommand) -> None:
        """Raise CommandError for a command of a wrong kind or length, or with implausible numbers.

        Commands beyond the limits are limited, not refused.
        """
        check_joints("the UR driver", command, KINDS, JOINTS)

    # -- diagnosis --------------------------------------------------------------------------------

    def _silence(self) -> str:
        link, options = self._links["rtde"], self.options
        where = f"{options.host}:{options.rtde_port}"
        if not link.up:
            why = link.reason or "not connected yet"
            end = f"; {self.end_reason}" if self.end_reason and why not in self.end_reason else ""
            return f"no RTDE connection to {where}: {why}{end}"
        if not self.feed.streaming:
            return f"RTDE of {where} is being set up"
        return f"no state from {where} for {options.state_timeout_s:g} s"

    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        found = []
        if not self._live(now_s):
            found.append(self._silence())
        elif self.hold_reason:
            found.append(self.hold_reason)
        elif self.feed.slider < 1.0:
            found.append(
                f"the speed slider is at {100.0 * self.feed.slider:.0f} %: the arm's highest "
                "speeds are so much lower, and it lags behind so much more"
            )
        if self._live(now_s) and self.feed.values.safety_mode == SafetyMode.REDUCED:
            found.append(REDUCED)
        version = self.feed.version
        if version is not None and (
            wrong := other_arm(self.options.robot, version.major, self._model)
        ):
            found.append(wrong)
        for why, count in self.feed.ignored.most_common():
            last = f" ({self.feed.last_implausible})" if why == IMPLAUSIBLE else ""
            found.append(f"{count} packets ignored: {why}{last}")
        if self.feed.said:
            found.append(f"the controller said: {self.feed.said}")
        return tuple(found)

    def protocol_errors(self) -> dict[str, int]:
        """RTDE packets that could not be used, by kind."""
        ignored = self.feed.ignored
        wrong = ignored[IMPLAUSIBLE]
        return {"implausible": wrong, "malformed": sum(ignored.values()) - wrong}

    def metrics(self) -> dict[str, float]:
        latency = self.command_latency
        return {
            "period_s": self.feed.period_s,
            "period_jitter_p99_s": self.jitter.percentile(99.0),
            "lost": float(self.feed.skipped),
            "sessions": float(self.sessions),
            "states": float(self.feed.packages),
            "superseded": float(self.superseded),
            "commands": float(self.commands),
            "losses": float(self.losses),
            "starts": float(self.starts),
            "ends": float(self.ends),
            "reconnects": float(max(0, self._links["rtde"].count - 1)),
            "ignored": float(sum(self.feed.ignored.values())),
            "command_latency_median_s": latency.percentile(50.0),
            "command_latency_p99_s": latency.percentile(99.0),
            "command_latency_max_s": latency.max,
            "enabled": float(self.enabled),
        }
