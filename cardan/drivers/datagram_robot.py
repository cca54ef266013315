"""Drivers of controllers that send their state as a datagram in each of their cycles.

:class:`DatagramSession` implements the protocol without I/O, :class:`DatagramRobot` the loop around
it, and :class:`DatagramTransport` the socket. :class:`AnsweringSession` and :class:`AnswerMixin`
are their parts that do not depend on the numbering of datagrams.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

from cardan.common.bounds import LONGEST_BLIND_S
from cardan.common.sockets import opened, waiting
from cardan.drivers.base import RobotDriver
from cardan.drivers.missed_cycles import AgreedTime
from cardan.drivers.robot_core import WAKE_S, LoopMixin, implausible, jump
from cardan.protocols.joint_stream.codec import is_newer
from cardan.types import (
    NEVER_S,
    HoldCommand,
    JointLimits,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
)

FLOOD_DATAGRAMS: Final = 50
"""Excess of refused over accepted datagrams that counts as a flood, in which motion is unsafe.
Garbage in a tenth of all cycles never reaches it, a flood does within a cycle or two."""

BRAKE_WITHIN_S: Final = 1.0
"""Longest wait for a braking ramp, s: no joint takes longer from its full speed."""

_IMPLAUSIBLE: Final = "implausible"

_LATE: Final = "late or double"
_EARLIER: Final = "an earlier session"
_OUT_OF_ORDER: Final = (_LATE, _EARLIER)
"""Reason of implausible states."""


class Numbered(Protocol):
    """A controller's datagram, decoded. Both numbers rise, and wrap at 2^32."""

    @property
    def session(self) -> int:
        """Number that changes when the controller restarts."""

    @property
    def sequence(self) -> int:
        """Number of the datagram in its session."""


MessageT = TypeVar("MessageT", bound=Numbered)


def _continues(message: Numbered, before: Numbered) -> bool:
    return message.session == before.session and is_newer(message.sequence, before.sequence)


class AnsweringSession(ABC):
    """Session with one answer to each state of the controller; sans I/O.

    Each received message gives a state or nothing; `tick` gives the state of a silent link. Times
    are local monotonic.
    """

    capabilities: RobotCapabilities

    def __init__(self, lost_after_s: float) -> None:
        """`lost_after_s`: time without a valid datagram after which the link counts as lost."""
        self.state: RobotState | None = None
        """Newest state."""
        self.reply_pending = False
        """True while the newest state has no answer."""
        self.sessions = 0
        """Number of the controller's sessions heard so far, also in each state."""
        self._lost_after_s = lost_after_s
        self._flood = 0
        """Refused datagrams, less one for each that was accepted."""

    @property
    def moving(self) -> bool:
        """True if the last command moves the robot, which then needs a braking ramp."""
        return False

    @abstractmethod
    def check(self, command: RobotCommand) -> None:
        """Raise CommandError for a command that the robot cannot take."""

    def keepalive(self, now_s: float) -> bytes | None:
        """Message that makes a silent controller report; None: nothing to send."""
        return None

    @abstractmethod
    def hold(self, now_s: float) -> bytes | None:
        """Return the answer to `state` if the application gave none: brake, or stay."""

    @abstractmethod
    def final_command(self, now_s: float) -> bytes | None:
        """Last message to a controller at rest; None: nothing to send."""

    @abstractmethod
    def tick(self, now_s: float) -> RobotState | None:
        """Return the state of a silent controller; None while it is not silent. Call it when
        nothing was received for a while."""

    @abstractmethod
    def silence_s(self, now_s: float) -> float:
        """Time since the newest state, s."""

    def lost(self, now_s: float) -> bool:
        """True if there is no state, or the newest is too old."""
        return self.silence_s(now_s) > self._lost_after_s

    def link(self, now_s: float) -> RobotLink:
        """Link to the controller by the age of the newest state."""
        if self.state is None:
            return RobotLink.WAITING
        return RobotLink.LOST if self.lost(now_s) else RobotLink.LIVE

    def _note_refused(self) -> None:
        """Count a datagram that is none of the controller's states."""
        self._flood = min(self._flood + 1, 2 * FLOOD_DATAGRAMS)

    @abstractmethod
    def metrics(self) -> dict[str, float]:
        """Return live figures."""

    @abstractmethod
    def protocol_errors(self) -> dict[str, int]:
        """Return counts of unusable datagrams, by kind."""

    @abstractmethod
    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        """Return problems, worst first."""


class DatagramSession(AnsweringSession, Generic[MessageT]):
    """Connection to a controller, sans I/O: datagrams to states, commands to datagrams.

    A newer session of the controller voids earlier commands. An older one, or a lower sequence
    number in the same, is ignored, unless the link is lost: then it begins a new session, too. A
    position jump by any sender is implausible: the arm is held for that reason while such states
    come, and the next reachable state begins a new session. Times are local monotonic.
    """

    controller: ClassVar[str]
    """Noun phrase for messages, e.g. "the controller"."""
    advice: str = ""
    """Advice for a controller that has never been heard."""

    def __init__(
        self,
        capabilities: RobotCapabilities,
        lost_after_s: float,
        clock: AgreedTime | None = None,
    ) -> None:
        """Initialize as AnsweringSession. `clock`: a ClockWatch with other options."""
        super().__init__(lost_after_s)
        self.capabilities = capabilities
        self.ignored: Counter[str] = Counter()
        """Datagrams without effect, by reason."""
        self.last_implausible = ""
        """Implausible value that caused the last state to be ignored."""
        self.accepted = 0
        self.message: MessageT | None = None
        """Message from which `state` was made."""
        self._heard_s = NEVER_S
        self._skipped = 0
        self._jumped_s = NEVER_S
        """Time of the last message with a position jump, s."""
        lower, upper, self._fastest, _ = capabilities.limits or JointLimits((), (), (), ())
        self._continuous = [
            low == -math.inf and high == math.inf for low, high in zip(lower, upper, strict=True)
        ]
        self.clock = AgreedTime(capabilities.period_s) if clock is None else clock
        """Time between states by the controller's clock, if they have its time, and ours."""

    # -- defined by the protocol ----------------------------------------------------------------

    @abstractmethod
    def _decode(self, data: Any, now_s: float) -> MessageT | str | None:
        """Decode `data` (bytes, or the transport's value) received at `now_s` to the controller's
        message; return a reason if it is invalid, None if it is a foreign message, which is no
        error."""

    @abstractmethod
    def _state_of(self, message: MessageT, before: MessageT | None, now_s: float) -> RobotState:
        """Make the state, stamped `now_s`, of session `sessions`; `before` is the previous message
        of the same session. Must not change anything: implausible states are ignored. Its
        `period_s` is by the controller's clock, and is later checked against ours."""

    def _joint_name(self, index: int) -> str:
        """Name of a joint for messages."""
        return f"joint {index + 1}"

    def _time_s(self, message: MessageT) -> float | None:
        """Time at which the controller sent `message`, by its clock, s; None if it has none."""
        return None

    @abstractmethod
    def _begin(self, message: MessageT) -> None:
        """Discard earlier commands: a session begins with `message`, or the controller takes no
        commands now (`hold_reason`)."""

    @abstractmethod
    def command(self, command: RobotCommand, now_s: float) -> bytes | None:
        """Return the answer to `state`; None before any. Raises CommandError as `check` does."""

    def hold(self, now_s: float) -> bytes | None:
        return self.command(HoldCommand(), now_s)

    def final_command(self, now_s: float) -> bytes | None:
        """Message that brings the robot to rest when none follows it."""
        return self.hold(now_s)

    # -- states ---------------------------------------------------------------------------------

    def receive(self, data: Any, now_s: float) -> RobotState | None:
        """Return the state in `data`, stamped `now_s`; None if it is invalid, late or double."""
        message = self._decode(data, now_s)
        if message is None:
            return None
        if isinstance(message, str):
            self._ignore(message)
            return None
        before = self.message
        if before is not None and not self.lost(now_s):
            if message.session == before.session:
                if not is_newer(message.sequence, before.sequence):
                    self.ignored[_LATE] += 1
                    return None
            elif not is_newer(message.session, before.session):
                self.ignored[_EARLIER] += 1
                return None
        if before is not None and (
            self._jumped_s > self._heard_s or not _continues(message, before)
        ):
            before = None
        begins = before is None
        self.sessions += begins
        state = self._state_of(message, before, now_s)
        if wrong := implausible(state):
            self.sessions -= begins
            self.last_implausible = wrong
            self._ignore(_IMPLAUSIBLE)
            return None
        if wrong := self._jump(state, message):
            self.sessions -= begins
            self.last_implausible = wrong
            self._ignore(_IMPLAUSIBLE)
            return self._held(wrong, now_s)
        state = self._agreed(state, message, before)
        if begins or state.hold_reason:
            self._begin(message)
        if before is not None:
            self._skipped += (message.sequence - before.sequence - 1) & 0xFFFFFFFF
        self.message, self._heard_s = message, now_s
        self.accepted += 1
        self._flood = max(self._flood - 1, 0)
        if self._flood >= FLOOD_DATAGRAMS:
            state = state._replace(alarm="the port is flooded with other datagrams")
        self.state = state
        self.reply_pending = True
        return state

    def _jump(self, state: RobotState, message: MessageT) -> str:
        """Explain a position jump since the last measurement; empty if the step is possible.

        A repeated implausible position stays implausible: time counts from the last such state,
        unless the controller has restarted since.
        """
        before = self.state
        if before is None or self.message is None:
            return ""
        since_s = self._heard_s
        if message.session == self.message.session:
            since_s = max(since_s, self._jumped_s)
        # By our clock or the controller's, the longer: queued messages were measured earlier.
        time_s = max(state.stamp_s - since_s, min(state.period_s, self._lost_after_s))
        found = jump(state.joints, before.joints, self._fastest, self._continuous, time_s)
        if found is None:
            return ""
        worst, away = found
        return (
            f"{self._joint_name(worst)} jumped from {before.joints[worst]:.4g} to "
            f"{state.joints[worst]:.4g}, by {away:.4g}, and its limit is "
            f"{self._fastest[worst]:.4g} per s: check that {self.controller} measures this arm and "
            "that nothing else sends its states; if the position is right, restart the session"
        )

    def _held(self, why: str, now_s: float) -> RobotState | None:
        """Return the newest state again, held for `why`."""
        if self.state is None or self.message is None:
            return None
        if self._jumped_s <= self._heard_s:
            self._begin(self.message)
        self._jumped_s = now_s
        self.state = self.state._replace(
            stamp_s=now_s, link=self.link(now_s), period_s=0.0, hold_reason=why
        )
        self.reply_pending = True
        return self.state

    def _agreed(self, state: RobotState, message: MessageT, before: MessageT | None) -> RobotState:
        """Return `state` with the period that both clocks agree on; held if they have diverged."""
        clock, clock_s = self.clock, self._time_s(message)
        if before is None:
            clock.begin(math.nan if clock_s is None else clock_s, state.stamp_s)
            return state
        states = (message.sequence - before.sequence) & 0xFFFFFFFF
        if clock_s is None:
            passed_s = clock.counted(state.stamp_s, states)
        else:
            passed_s = clock.passed(clock_s, state.stamp_s, states)
        period_s = min(passed_s, state.period_s)
        fault = clock.fault
        return state._replace(period_s=period_s, hold_reason=state.hold_reason or fault)

    def _ignore(self, reason: str) -> None:
        self.ignored[reason] += 1
        self._note_refused()

    def silence_s(self, now_s: float) -> float:
        return now_s - self._heard_s

    def late(self, now_s: float) -> bool:
        """True if a newer state than the newest is due."""
        return now_s - self._heard_s > self.capabilities.period_s

    def tick(self, now_s: float) -> RobotState | None:
        return self.silence(now_s) if self.lost(now_s) else None

    def silence(self, now_s: float) -> RobotState:
        """Return the state to report while no datagram arrives."""
        last = self.state
        return RobotState(
            stamp_s=now_s,
            link=self.link(now_s),
            session=self.sessions,
            sequence=0 if last is None else last.sequence,
            period_s=0.0,
            joints=() if last is None else last.joints,
            external_axes=(),
            pose=None,
            hold_reason=f"{self.controller} is silent",
        )

    # -- diagnosis ------------------------------------------------------------------------------

    def metrics(self) -> dict[str, float]:
        return {
            "states": float(self.accepted),
            "lost": float(self._skipped),
            "ignored": float(sum(self.ignored.values())),
            "sessions": float(self.sessions),
        }

    def protocol_errors(self) -> dict[str, int]:
        ignored = self.ignored
        found = {"order": sum(ignored[why] for why in _OUT_OF_ORDER)}
        found["implausible"] = ignored[_IMPLAUSIBLE]
        found["malformed"] = sum(ignored.values()) - sum(found.values())
        return found

    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        found = []
        if self.state is None:
            advice = f"; {self.advice}" if self.advice else ""
            found.append(f"nothing was received from {self.controller}{advice}")
        elif self.lost(now_s):
            found.append(f"{self.controller} is silent for {self.silence_s(now_s):.1f} s")
        elif self.state.hold_reason:
            found.append(self.state.hold_reason)
        for why, count in self.ignored.most_common():
            last = f" ({self.last_implausible})" if why == _IMPLAUSIBLE else ""
            found.append(f"{count} datagrams ignored: {why}{last}")
        return tuple(found)


class DatagramTransport(Protocol):
    """A driver's connection to its controller."""

    def now(self) -> float:
        """Return the time of the stamps, s."""

    def send(self, data: bytes) -> None:
        """Send a message. Never raises."""

    def wait(self) -> Sequence[Any]:
        """Return messages up to the next control instant, oldest first; empty at least every
        WAKE_S."""

    def waiting(self) -> Sequence[Any]:
        """Return messages received already, oldest first."""

    def close(self) -> None: ...


class UdpTransport:
    """UDP socket to a controller that listens; other senders are ignored."""

    def __init__(self, host: str, port: int, problem: str, largest: int) -> None:
        """Open the socket for datagrams of up to `largest` bytes. Raises an AddressError that
        begins with `problem`."""
        self._socket = opened(host, port, socket.SOCK_DGRAM, socket.socket.connect, problem)
        self._largest = largest

    def now(self) -> float:
        return time.monotonic()

    def send(self, data: bytes) -> None:
        # Refused if no program listens there; the driver then reports silence.
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def wait(self) -> list[bytes]:
        found: list[bytes] = []
        deadline_s = self.now() + WAKE_S
        while not found and (left_s := deadline_s - self.now()) > 0.0:
            try:
                ready = select.select([self._socket], [], [], left_s)[0]
            except (OSError, ValueError):  # closed by another thread
                break
            if not ready:
                break
            found = self.waiting()
        return found

    def waiting(self) -> list[bytes]:
        # One byte more than the largest, so that an oversized datagram is recognized.
        return [data for data, _ in waiting(self._socket, self._largest + 1)]

    def close(self) -> None:
        self._socket.close()


AnsweringSessionT = TypeVar("AnsweringSessionT", bound=AnsweringSession)
DatagramSessionT = TypeVar("DatagramSessionT", bound=DatagramSession[Any])


class AnswerMixin(LoopMixin[AnsweringSessionT]):
    """Loop with one answer to each state of the controller.

    Of several waiting states it yields the newest; a state that the application does not answer is
    answered with a hold. However the loop ends, it brakes the robot while the session reports
    motion, and sends the final command last.
    """

    brakes_within_s: ClassVar[float] = 0.0
    """Longest duration of braking after the loop, s."""
    no_final_command_after_s: ClassVar[float] = LONGEST_BLIND_S
    """Silence after which a controller gets no final command, s: it has stopped by itself, and its
    next run must not receive one."""

    @abstractmethod
    def _connection(self) -> object:
        """Connection of the driver; None while it is closed."""

    @abstractmethod
    def _waiting(self) -> Iterable[Any]:
        """Return messages received and not yet read, oldest first. Never blocks."""

    @abstractmethod
    def _take(self, came: Any, now_s: float) -> RobotState | None:
        """Return the state in a message received at `now_s`; None if it is invalid."""

    @abstractmethod
    def _hear(self) -> RobotState | None:
        """Wait until the next control instant for the newest state, or the state of a silence just
        noticed; None if neither. Returns at least every WAKE_S."""

    @abstractmethod
    def _say(self, data: bytes | None) -> bool:
        """Send `data`, if any; return True if it was sent. Never raises."""

    def _drain(self) -> RobotState | None:
        """Process all waiting messages; return the newest state, if any."""
        newest = None
        for came in self._waiting():
            newest = self._take(came, self._now_s()) or newest
        return newest

    def _leave_within_s(self) -> float:
        return WAKE_S + self.brakes_within_s

    def _states(self, loop: int) -> Generator[RobotState, None, None]:
        session, connection = self._session, self._connection()
        if connection is None or self._loop != loop:
            return
        said_s = self._now_s()
        self._say(session.keepalive(said_s))
        with self._looping(loop):
            while self._loop == loop:
                state = self._hear()
                if self._loop != loop:
                    return
                if state is None:
                    now_s = self._now_s()
                    if now_s - said_s < WAKE_S or (state := session.tick(now_s)) is None:
                        continue
                    self._say(session.keepalive(now_s))
                said_s = state.stamp_s
                yield state
                if session.reply_pending and self._connection() is connection:
                    self._hold()

    @abstractmethod
    def _hold(self) -> None:
        """Answer a state for which the application gave no command."""

    def _answer_with_hold(self) -> None:
        """Answer the newest state so that the robot brakes, or stays."""
        self._say(self._session.hold(self._now_s()))
        self._session.reply_pending = False

    def _brake(self) -> None:
        """Answer states with holds until the robot is at rest, or they cease."""
        until_s = self._now_s() + self.brakes_within_s
        while self._session.moving and self._now_s() < until_s and self._hear_while_braking():
            self._answer_with_hold()

    def _hear_while_braking(self) -> bool:
        """Process the next messages; return False once the controller is silent."""
        return self._hear() is not None

    def _leave(self) -> None:
        try:
            self._brake()
        finally:
            session, now_s = self._session, self._now_s()
            if session.silence_s(now_s) <= self.no_final_command_after_s:
                self._say(session.final_command(now_s))
            session.reply_pending = False

    @property
    def link(self) -> RobotLink:
        """Link to the controller at this time."""
        if self._connection() is None:
            return RobotLink.WAITING
        return self._session.link(self._now_s())

    def metrics(self) -> dict[str, float]:
        return self._session.metrics()

    def protocol_errors(self) -> dict[str, int]:
        return self._session.protocol_errors()


class DatagramRobot(AnswerMixin[DatagramSessionT], RobotDriver):
    """Driver with a :class:`DatagramTransport`; a subclass defines `_make_session` and `_join`."""

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._session = self._make_session()
        self._transport: DatagramTransport | None = None
        self._parents: DatagramTransport | None = None
        """Kept in a forked child, because closing a bus there would wait for its threads."""

    @abstractmethod
    def _make_session(self) -> DatagramSessionT:
        """Make a new session from `self.options`."""

    @abstractmethod
    def _join(self) -> DatagramTransport:
        """Open the transport. Raises a DriverError."""

    def _acquire(self) -> None:
        self._session = self._make_session()
        self._transport = self._join()

    def _release(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def _forget(self) -> None:
        self._parents, self._transport = self._transport, None
        if isinstance(self._parents, UdpTransport):
            self._parents.close()

    def _connection(self) -> DatagramTransport | None:
        return self._transport

    def _joined(self) -> DatagramTransport:
        if self._transport is None:
            raise self._not_open()
        return self._transport

    def _now_s(self) -> float:
        return self._joined().now()

    def _waiting(self) -> Sequence[Any]:
        return self._joined().waiting()

    def _take(self, came: Any, now_s: float) -> RobotState | None:
        if (callback := self.raw_packet_callback) is not None:
            callback(came, False, "")
        return self._session.receive(came, now_s)

    def _hear(self) -> RobotState | None:
        transport, newest = self._transport, None
        if transport is None:  # closed by another thread
            return None
        for came in transport.wait():
            newest = self._take(came, transport.now()) or newest
        return newest

    def _say(self, data: bytes | None) -> bool:
        if data is None:
            return False
        self._joined().send(data)
        if (callback := self.raw_packet_callback) is not None:
            callback(data, True, "")
        return True

    def _hold(self) -> None:
        self.send(HoldCommand())

    def send(self, command: RobotCommand) -> None:
        """Command the robot; the last of several calls for one state counts."""
        session, now_s = self._session, self._now_s()
        if not session.reply_pending and session.lost(now_s):
            session.check(command)
            return
        if session.late(now_s):
            # The robot has moved since the state that this command was computed from.
            self._drain()
        answer = session.command(command, self._now_s())
        session.reply_pending = False
        self._say(answer)
