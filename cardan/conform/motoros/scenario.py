"""Scenario for MotoROS: listen to states, send single requests, and move one axis a little."""

from __future__ import annotations

import math
from collections.abc import Iterator

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.streams import ChannelReaders
from cardan.conform.timeline import Kind, WireEvent
from cardan.protocols.simple_message import codec, codes, framing, messages as m
from cardan.protocols.simple_message.codes import MessageType as T, MotionCommand as C

STEP_RAD = math.radians(0.2)
"""Step of the last axis, which only turns the flange."""
STEP_S = 0.1
UNKNOWN_TYPE = 3900
"""A type that no known firmware has."""
REPLY_S = 0.6
"""Timeout of a reply."""
START_S = 12.0
"""START_TRAJ_MODE may power the drives and start a job."""
POLL_S = 0.02
WATCHDOG_MS = 100.0
HAND_S = 60.0
VELOCITY_S = 0.01
FIRST_OUTPUT = 10010
_POSITION = codes.ValidFields.TIME | codes.ValidFields.POSITION | codes.ValidFields.VELOCITY


class MotorosScenario(Scenario):
    """A client that has one request open at a time, each in a send of its own."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._seconds = seconds
        self._order = framing.ByteOrder.LITTLE
        self._streams = ChannelReaders(lambda _: framing.FrameReader(), lambda *_: None)
        self._reply: m.Message | None = None
        self._status: m.RobotStatus | None = None
        self._feedback: m.JointFeedback | None = None
        self._sequence = 0
        self._lost: set[str] = set()
        self._axes = 6

    # -- received messages ------------------------------------------------------------------------

    def answer(self, event: WireEvent) -> Iterator[Step]:
        channel = event.channel
        if event.kind is Kind.OPENED:
            self._streams.begin(channel)
            self._lost.discard(channel)
        elif event.kind in (Kind.CLOSED, Kind.REFUSED):
            self._lost.add(channel)
        elif event.kind is Kind.DATA:
            for _, frame in self._streams.whole(0, event):
                self._order = self._streams.reader(channel).byte_order or self._order
                message = codec.wire(self._order).decode(frame)
                if isinstance(message, m.Message):
                    self._take(channel, message)
        return iter(())

    def _take(self, channel: str, message: m.Message) -> None:
        body = message.body
        if channel != "state":
            self._reply = message
        elif isinstance(body, m.RobotStatus):
            self._status = body
        elif isinstance(body, m.JointFeedback) and body.group == 0:
            self._feedback = body

    # -- requests ---------------------------------------------------------------------------------

    def script(self) -> Script:
        yield open_("state")
        yield mark("listen")
        yield Pause(self._seconds / 3.0)
        if self._level < Level.HOLD:
            return
        yield from self._asking()
        yield from self._holding()
        if self._level >= Level.MOVE:
            yield from self._moving()
        if self._level >= Level.BY_HAND:
            yield from self._by_hand()
        yield mark("leave")
        yield from self._ordered(C.STOP_MOTION)
        yield from self._ordered(C.STOP_TRAJ_MODE)

    def _asking(self) -> Script:
        yield open_("motion")
        yield open_("io")
        yield mark("ask")
        yield from self._ordered(C.STOP_MOTION)
        yield from self._asked(m.Empty(), T.PING)
        yield from self._ordered(C.CHECK_MOTION_READY)
        yield from self._ordered(C.CHECK_QUEUE_CNT)
        yield from self._asked(m.VelocityInfoRequest(0), T.MOTO_VELOCITY_INFO)
        if self._reply is not None and isinstance(self._reply.body, m.VelocityInfo):
            self._axes = min(max(self._reply.body.axes, 1), 10)
        yield from self._asked(m.Raw(b""), UNKNOWN_TYPE)
        yield from self._asked(m.Raw(bytes(8)), int(T.MOTO_MOTION_CTRL))
        # Sequence 0 of a group that exists on no controller.
        point = m.JointTrajPtFull(9, 0, _POSITION, 0.0, m.ZEROS, m.ZEROS, m.ZEROS)
        yield from self._asked(point)
        yield from self._asked(m.ReadIo(FIRST_OUTPUT), T.MOTO_READ_IO_BIT, channel="io")
        yield from self._asked(m.ReadIo(9), T.MOTO_READ_IO_BIT, channel="io")
        yield mark("pieces")
        data = codec.wire(self._order).encode(m.request(m.Empty(), T.PING))
        self._reply = None
        yield send(data[:6], "motion")
        yield Pause(0.03)
        yield send(data[6:], "motion")
        yield Pause(REPLY_S, self._answered)

    def _holding(self) -> Script:
        yield mark("start")
        yield from self._ordered(C.START_TRAJ_MODE, START_S)
        yield Pause(0.05)
        yield mark("hold")
        yield from self._point(0, 0.0)
        end_s = self.now_s + self._seconds
        while self.now_s < end_s and "motion" not in self._lost:
            yield from self._ordered(C.CHECK_QUEUE_CNT)
            yield Pause(POLL_S)
            yield from self._ordered(C.CHECK_MOTION_READY)
            yield Pause(POLL_S)
        yield mark("velocity")
        yield from self._start_velocity()
        if self._succeeded():
            yield from self._velocity(0, 0.0)
            # Longer than the watchdog's timeout.
            yield Pause(3.0 * WATCHDOG_MS * 1e-3)
            yield from self._velocity(1, 0.0)
            yield from self._point(0, 0.0)
            yield from self._velocity(0, 0.0)
            yield from self._velocity(2, 0.0)
            yield from self._velocity(2, 0.0)
            yield from self._ordered(C.STOP_VEL_MODE)

    def _moving(self) -> Script:
        yield mark("trajectory")
        yield from self._ordered(C.START_TRAJ_MODE, START_S)
        yield Pause(0.1)
        for name, shift in (("out", STEP_RAD), ("back", -STEP_RAD)):
            yield mark(name)
            yield from self._point(0, 0.0)
            if self._succeeded():
                yield from self._point(1, STEP_S, shift)
                # The queue is filled one interpolation period later.
                end_s = self.now_s + 10.0 * STEP_S
                yield Pause(0.5 * POLL_S)
                while self.now_s < end_s and self._queue_left():
                    yield from self._ordered(C.CHECK_QUEUE_CNT)
                    yield Pause(0.5 * POLL_S)
            yield Pause(0.5)
            yield Pause(3.0, lambda: self._status is None or self._status.in_motion != 1)
        yield mark("stream")
        yield from self._start_velocity()
        if self._succeeded():
            yield from self._velocity(0, 0.0)
            speed, count = STEP_RAD / STEP_S / 2.0, round(STEP_S / VELOCITY_S)
            for sequence in range(1, count + 1):
                body = self._velocity_body(sequence, speed)
                yield send(codec.wire(self._order).encode(m.topic(body)), "motion")
                yield Pause(VELOCITY_S)
            yield mark("deserted")
            yield Pause(5.0 * WATCHDOG_MS * 1e-3)
            yield from self._velocity(count + 1, 0.0)
            yield from self._ordered(C.STOP_VEL_MODE)

    def _by_hand(self) -> Script:
        yield mark("estop")
        yield ask("estop", "Press the emergency stop.")
        yield Pause(HAND_S, lambda: self._status is not None and self._status.e_stopped == 1)
        yield Pause(0.1)
        yield from self._ordered(C.CHECK_MOTION_READY)
        yield mark("released")
        yield ask("release", "Release the emergency stop.")
        yield Pause(HAND_S, lambda: self._status is not None and self._status.e_stopped == 0)
        yield Pause(0.3)

    # -- single requests --------------------------------------------------------------------------

    def _answered(self) -> bool:
        return self._reply is not None or "motion" in self._lost

    def _asked(
        self,
        body: m.Body,
        msg_type: int | None = None,
        *,
        channel: str = "motion",
        s: float = REPLY_S,
    ) -> Script:
        self._reply = None
        yield send(codec.wire(self._order).encode(m.request(body, msg_type)), channel)
        yield Pause(s, self._answered)

    def _ordered(self, command: C, seconds: float = REPLY_S, data: m.Joints = m.ZEROS) -> Script:
        self._sequence += 1
        yield from self._asked(m.MotionCtrl(0, self._sequence, command, data), s=seconds)

    def _start_velocity(self) -> Script:
        yield from self._ordered(C.START_VEL_MODE, START_S, m.joints10((WATCHDOG_MS,)))

    def _point(self, sequence: int, time_s: float, shift: float = 0.0) -> Script:
        at = m.ZEROS if self._feedback is None else self._feedback.pos
        axis = self._axes - 1
        at = (*at[:axis], at[axis] + shift, *at[axis + 1 :])
        # Half a millisecond, because times are truncated to whole milliseconds.
        time_s += 0.0005 if time_s else 0.0
        yield from self._asked(
            m.JointTrajPtFull(0, sequence, _POSITION, time_s, at, m.ZEROS, m.ZEROS)
        )

    def _velocity_body(self, sequence: int, speed: float) -> m.JointVelocity:
        axis = self._axes - 1
        speeds = m.joints10((*m.ZEROS[:axis], speed))
        return m.JointVelocity(
            0, sequence, codes.ValidFields.VELOCITY, 0.0, m.ZEROS, speeds, m.ZEROS
        )

    def _velocity(self, sequence: int, speed: float) -> Script:
        yield from self._asked(self._velocity_body(sequence, speed))

    def _motion_reply(self) -> m.MotionReply | None:
        body = None if self._reply is None else self._reply.body
        return body if isinstance(body, m.MotionReply) else None

    def _succeeded(self) -> bool:
        found = self._motion_reply()
        return found is not None and found.result == codes.MotionResult.SUCCESS

    def _queue_left(self) -> bool:
        found = self._motion_reply()
        return found is None or found.command != C.CHECK_QUEUE_CNT or found.subcode > 0
