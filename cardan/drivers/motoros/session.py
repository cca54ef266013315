"""Client side of the connections to a MotoROS controller, without sockets and clocks.

State and motion connection form one session, because the state port tells which requests the motion
port accepts.
"""

from __future__ import annotations

import math
from typing import ClassVar

from cardan.common.histogram import LatencyHistogram
from cardan.drivers.motoros.connections import CHANNELS, Channel
from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.motion_control import MotionControl, MotionPhase, Task
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.requests import MotionRequests
from cardan.drivers.motoros.status_text import findings, no_motion_connection, silence
from cardan.drivers.motoros.trajectory_limiter import KINDS
from cardan.drivers.robot_core import check_joints, counts
from cardan.drivers.tcp_robot import TcpSession
from cardan.protocols.simple_message.codec import WireFormat, wire
from cardan.protocols.simple_message.framing import (
    LONGEST_PREFIX_OF_MOTOROS,
    ByteOrder,
    FrameReader,
)
from cardan.types import (
    NEVER_S,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
)

WAKE_S = 0.09
"""Longest gap between states of cycles(): 0.1 s, with a margin for a late computer."""


class MotorosSession(TcpSession[Channel, Task]):
    """Protocol session with one robot on one controller."""

    kind_of_control: ClassVar[type[MotionControl]] = MotionControl

    def __init__(self, options: MotorosOptions) -> None:
        super().__init__(CHANNELS)
        self.options = options
        self.limits = options.limits
        self.feed = StateFeed(options)
        self.requests = MotionRequests(
            options.group, options.request_timeout_s, options.start_timeout_s
        )
        self.control = self.kind_of_control(options, self.requests, self.feed)
        """Control of motion, and its results."""
        self.jitter = LatencyHistogram()
        """Deviation of the time between two control instants from their period."""
        self._wire: WireFormat | None = None
        self._reader = FrameReader()
        self._statuses = 0
        self._checked_statuses = 0
        self._recorded = 0
        self._instant_s = NEVER_S
        self._instant_session = 0

    @property
    def capabilities(self) -> RobotCapabilities:
        """Supported commands. Until the controller has answered, "auto" counts as a stream."""
        options = self.options
        if self.control.uses_velocity:
            period_s = options.command_period_s
        else:
            period_s = 1e-3 * options.spacing_increments * options.ipc_ms
        return RobotCapabilities(
            commands=KINDS,
            period_s=period_s,
            joints=options.joints,
            limits=self.limits,
            lag_s=options.lag_s,
            robot=options.robot,
        )

    @property
    def reply_pending(self) -> bool:
        return self.control.reply_pending

    @property
    def left(self) -> bool:
        return self.control.left

    @property
    def braking_s(self) -> float:
        return self.control.braking_s

    @property
    def phase(self) -> MotionPhase:
        """Phase of the motion connection."""
        return self.control.phase

    @property
    def sessions(self) -> int:
        """Count of motion connections and motion starts; earlier targets are void when it
        changes."""
        return self.control.sessions

    # -- connections ------------------------------------------------------------------------------

    def wants(self, channel: Channel, now_s: float) -> bool:
        link = self._links[channel]
        if link.up or now_s < link.retry_s:
            return False
        # The state port reveals the byte order of requests.
        return channel == "state" or (self.feed.live(now_s) and self.feed.byte_order is not None)

    def connected(self, channel: Channel, now_s: float) -> None:
        self._links[channel].opened(now_s)
        if channel == "state":
            self.feed.connected()
            return
        order = self.feed.byte_order or ByteOrder.LITTLE
        self._wire = wire(order)
        self._reader = FrameReader(order, LONGEST_PREFIX_OF_MOTOROS)
        self.control.connected()
        self._flush(now_s)

    def _lost(self, channel: Channel, reason: str, now_s: float) -> None:
        self._links[channel].lost(reason, now_s)
        if channel == "motion":
            self.control.disconnected(reason, now_s)
            return
        self.feed.disconnected()
        self.control.brake(f"the state connection was lost: {reason}", now_s)

    def received(self, channel: Channel, data: bytes, now_s: float) -> None:
        if not self._links[channel].up:
            return
        if channel == "state":
            order = self.feed.byte_order
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
                wrong = wrong or self.control.failure
                if wrong:
                    self._drop("motion", wrong, now_s)
                else:
                    self.control.proceed(now_s)
            if reader.failure:
                self._drop("motion", reader.failure, now_s)
        self._flush(now_s)

    def _look(self, now_s: float) -> None:
        """React to the state port's messages."""
        feed = self.feed
        if feed.feedbacks != self._recorded:
            self._recorded = feed.feedbacks
            if self.control.record.path:
                count = self.control.counters.queue_count
                self.control.record.add(now_s, "feedback", (), feed.positions, count)
        if feed.statuses == self._checked_statuses:
            return
        self._checked_statuses = feed.statuses
        self.control.status_received(now_s)

    # -- time -------------------------------------------------------------------------------------

    @property
    def next_s(self) -> float:
        found = min(self.control.next_s, self._said_s + WAKE_S)
        return min(found, self.feed.stale_s) if self._said_link is RobotLink.LIVE else found

    def advance(self, now_s: float) -> None:
        """Do what is due: timeouts, polls, points, ramps."""
        self.control.advance(now_s)
        if self.control.failure:
            self._drop("motion", self.control.failure, now_s)
        self._flush(now_s)

    def _flush(self, now_s: float) -> None:
        """Move messages to send to the outbox."""
        self._send_topics()
        if not self._links["motion"].up or self._wire is None:
            return
        request = self.requests.take(now_s)
        if request is not None:
            self._out.append(("motion", self._wire.encode(request)))

    def _send_topics(self) -> None:
        if not self._links["motion"].up or self._wire is None:
            return
        for message in self.control.topics():
            self._out.append(("motion", self._wire.encode(message)))

    # -- requests of the application --------------------------------------------------------------

    def ask(self, task: Task, now_s: float) -> None:
        self.control.ask(task, now_s)
        self._flush(now_s)

    def enable(self, now_s: float) -> None:
        """Start motion. Without a connection the request is refused, not deferred."""
        self.control.enable(now_s)
        self._flush(now_s)

    def disable(self, now_s: float) -> None:
        self.control.disable(now_s)
        self._flush(now_s)

    def stop(self, now_s: float) -> None:
        """STOP_MOTION at once: a trajectory's command stops dead, velocity mode ramps down at the
        controller's own acceleration. A pending reply comes first."""
        self.control.stop(now_s)
        self._flush(now_s)

    def leave(self, now_s: float) -> None:
        self.control.leave(now_s)
        self._flush(now_s)

    # -- the control loop -------------------------------------------------------------------------

    def due_state(self, now_s: float) -> RobotState | None:
        """Return the state to report now; None if no control instant has come and nothing is
        new."""
        feed = self.feed
        if not self.control.live(now_s):
            if self._said_link is not RobotLink.LIVE and now_s - self._said_s < WAKE_S:
                return None
            self.control.reply_pending = False
            self._instant_s = NEVER_S
            self.losses += self._said_link is RobotLink.LIVE
            link = RobotLink.LOST if feed.heard else RobotLink.WAITING
            return self._state(
                now_s, link, 0.0, silence(self.options, feed, self._links["state"], now_s)
            )
        motion = self.control.motion
        if motion is not None and self.phase is MotionPhase.MOVING and not motion.waiting:
            period_s = motion.due(now_s)
            if period_s:
                self.control.reply_pending = True
                if self._instant_session != self.sessions:
                    self._instant_session = self.sessions
                    self._instant_s = NEVER_S
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
        self.check(command)
        motion = self.control.motion
        if not self.control.reply_pending or motion is None:
            return
        motion.command(command, now_s)
        self.control.reply_pending = False
        self.control.proceed(now_s)
        self._flush(now_s)

    def check(self, command: RobotCommand) -> None:
        """Raise CommandError for a command of a wrong kind or length, or with implausible numbers.

        Commands beyond the limits are limited, not refused.
        """
        check_joints("MotoROS", command, KINDS, self.feed.joints)

    # -- diagnosis --------------------------------------------------------------------------------

    @property
    def hold_reason(self) -> str:
        """Reason why commands would not act now; empty when they do."""
        control = self.control
        if control.phase is MotionPhase.DOWN:
            return no_motion_connection(self.options, self._links["motion"], control.end_reason)
        return control.hold_reason

    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        feed = self.feed
        quiet = ""
        if not feed.live(now_s):
            quiet = silence(self.options, feed, self._links["state"], now_s)
        return findings(self.control, quiet, self.hold_reason)

    def protocol_errors(self) -> dict[str, int]:
        """Messages of the state port that could not be used, by kind."""
        return {"malformed": sum(self.feed.ignored.values())}

    def metrics(self, now_s: float) -> dict[str, float]:
        counters, latency = self.control.counters, self.requests.latency
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
            **counts(counters),
            "reconnects": float(sum(max(0, link.count - 1) for link in self._links.values())),
            "ignored": float(sum(self.feed.ignored.values())),
            "ends": float(sum(self.control.ends.values())),
            "velocity_mode": float(self.control.uses_velocity),
            "enabled": float(self.control.enabled),
        }
