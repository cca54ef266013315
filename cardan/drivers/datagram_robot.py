"""Drivers of controllers that send their state as a datagram in each of their cycles.

A :class:`DatagramSession` has the protocol, without sockets, clocks and threads; a
:class:`DatagramRobot` around it has the loop, and a :class:`Transport` the socket.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Generator, Sequence
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

from cardan.common.bounds import LONGEST_BLIND_S
from cardan.common.sockets import opened, waiting
from cardan.drivers.missed_cycles import AgreedTime
from cardan.drivers.robot_core import WAKE_S, LoopingRobot, implausible, leap
from cardan.protocols.joint_stream import is_newer
from cardan.types import (
    NEVER_S,
    HoldCommand,
    JointLimits,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
)

_FLOOD: Final = 50
"""Excess of bad over good datagrams that counts as a flood: motion is not safe then."""

_IMPLAUSIBLE: Final = "implausible"

_LATE: Final = "late or double"
_EARLIER: Final = "an earlier session"
_OUT_OF_ORDER: Final = (_LATE, _EARLIER)
"""The reason of states that no robot measures."""


class Numbered(Protocol):
    """A controller's datagram, decoded. Both numbers go up, and wrap at 2^32."""

    @property
    def session(self) -> int:
        """Changes when the controller restarts."""

    @property
    def sequence(self) -> int:
        """Counts the datagrams of a session."""


MessageT = TypeVar("MessageT", bound=Numbered)


def _continues(message: Numbered, before: Numbered) -> bool:
    return message.session == before.session and is_newer(message.sequence, before.sequence)


class DatagramSession(ABC, Generic[MessageT]):
    """One connection to a controller, sans I/O: datagrams to states, commands to datagrams.

    A newer session of the controller voids earlier commands; an older one, or a lower sequence
    number in the same, is ignored unless the link is lost: then it is a new session, too. A state
    that the arm cannot have come to since the one before, by any sender, is none: the arm is held
    with that reason for as long as it is said to be there, and the next state within its reach
    begins a new session. Times are local monotonic ones.
    """

    controller: ClassVar[str]
    """What messages call it, with its article."""
    advice: str = ""
    """What to look at when nothing was ever heard of it."""

    def __init__(
        self,
        capabilities: RobotCapabilities,
        lost_after_s: float,
        clock: AgreedTime | None = None,
    ) -> None:
        """After `lost_after_s` without a valid datagram the link counts as lost. `clock`: one that
        has options of its own."""
        self.capabilities = capabilities
        self.ignored: Counter[str] = Counter()
        """Datagrams without effect, by reason."""
        self.last_implausible = ""
        """What no robot measures in the last state that was ignored for it."""
        self.accepted = 0
        self.state: RobotState | None = None
        """The newest."""
        self.message: MessageT | None = None
        """Of which `state` was made."""
        self._lost_after_s = lost_after_s
        self._heard_s = NEVER_S
        self.sessions = 0
        """So many sessions of the controller were heard; the number that states have."""
        self._skipped = self._flood = 0
        self._leapt_s = NEVER_S
        """When what came last was out of the arm's reach."""
        lower, upper, self._fastest, _ = capabilities.limits or JointLimits((), (), (), ())
        self._continuous = [
            low == -math.inf and high == math.inf for low, high in zip(lower, upper, strict=True)
        ]
        self.clock = AgreedTime(capabilities.period_s) if clock is None else clock
        """Time between states, by the controller's clock, where they tell it, and ours."""

    # -- what a protocol gives ------------------------------------------------------------------

    @abstractmethod
    def _decode(self, data: Any, now_s: float) -> MessageT | str | None:
        """The controller's message, or why `data` (bytes, or what the transport gives), which came
        `now_s`, is none; None for what is somebody else's, which is no mistake."""

    @abstractmethod
    def _state_of(self, message: MessageT, before: MessageT | None, now_s: float) -> RobotState:
        """The state, stamped `now_s`, its session `sessions`; `before` is the message before it in
        the same session. Changes nothing: a state that no robot measures is ignored. `period_s` is
        what it is by the controller's word, and becomes what our clock agrees with."""

    def _joint_name(self, index: int) -> str:
        """What messages call a joint."""
        return f"joint {index + 1}"

    def _time_s(self, message: MessageT) -> float | None:
        """When the controller sent `message`, by its own clock; None: it does not tell."""
        return None

    @abstractmethod
    def _begin(self, message: MessageT) -> None:
        """A session of the controller begins with `message`, or it takes no commands now
        (`hold_reason`): forget what was commanded."""

    @abstractmethod
    def check(self, command: RobotCommand) -> None:
        """Raise CommandError for a command that the robot cannot take."""

    @abstractmethod
    def command(self, command: RobotCommand, now_s: float) -> bytes | None:
        """The answer to `state`; None before any. Raises CommandError as `check` does."""

    def greeting(self, now_s: float) -> bytes | None:
        """What a silent controller is sent, to make itself heard; None: nothing."""
        return None

    def farewell(self, now_s: float) -> bytes | None:
        """What brings the robot to rest when nothing comes after it. Not asked for where the
        controller has been silent for `LONGEST_BLIND_S`: it has stopped by itself, and its next
        run is not ours to command."""
        return self.command(HoldCommand(), now_s)

    # -- states ---------------------------------------------------------------------------------

    def receive(self, data: Any, now_s: float) -> RobotState | None:
        """The state in `data`, stamped `now_s`; None when it is none, late or double."""
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
            self._leapt_s > self._heard_s or not _continues(message, before)
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
        if wrong := self._leap(state, message):
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
        if self._flood >= _FLOOD:
            state = state._replace(alarm="the port is flooded with other datagrams")
        self.state = state
        return state

    def _leap(self, state: RobotState, message: MessageT) -> str:
        """Why the arm cannot have come here from where it was measured last; empty: it can.

        A place that it cannot have come to becomes no likelier by being told again: time counts
        from the last time that it was, unless the controller has begun anew since.
        """
        before = self.state
        if before is None or self.message is None:
            return ""
        since_s = self._heard_s
        if message.session == self.message.session:
            since_s = max(since_s, self._leapt_s)
        # By our clock or the controller's, the longer: what waited in a queue was measured earlier.
        time_s = max(state.stamp_s - since_s, min(state.period_s, self._lost_after_s))
        found = leap(state.joints, before.joints, self._fastest, self._continuous, time_s)
        if found is None:
            return ""
        worst, away = found
        return (
            f"{self._joint_name(worst)} is measured at {state.joints[worst]:.4g}, {away:.4g} from "
            f"{before.joints[worst]:.4g} where it was before, and goes {self._fastest[worst]:.4g} "
            f"per s at most: see that {self.controller} measures this arm, and that nothing else "
            "sends its states; if it is there indeed, start the session anew"
        )

    def _held(self, why: str, now_s: float) -> RobotState | None:
        """The newest state again, held for `why`."""
        if self.state is None or self.message is None:
            return None
        if self._leapt_s <= self._heard_s:
            self._begin(self.message)
        self._leapt_s = now_s
        self.state = self.state._replace(
            stamp_s=now_s, link=self.link(now_s), period_s=0.0, hold_reason=why
        )
        return self.state

    def _agreed(self, state: RobotState, message: MessageT, before: MessageT | None) -> RobotState:
        """`state` with the period that both clocks agree on; held where they have parted."""
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
        self._flood = min(self._flood + 1, 2 * _FLOOD)

    def silence_s(self, now_s: float) -> float:
        """Time since the newest state, s; infinite before the first."""
        return now_s - self._heard_s

    def lost(self, now_s: float) -> bool:
        """True when the newest state is too old (or there is none)."""
        return self.silence_s(now_s) > self._lost_after_s

    def late(self, now_s: float) -> bool:
        """True when a newer state than the newest should be there."""
        return now_s - self._heard_s > self.capabilities.period_s

    def link(self, now_s: float) -> RobotLink:
        """Whether the controller is heard."""
        if self.state is None:
            return RobotLink.WAITING
        return RobotLink.LOST if self.lost(now_s) else RobotLink.LIVE

    def silence(self, now_s: float) -> RobotState:
        """The state to report while nothing is heard."""
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
        """Counts so far."""
        return {
            "states": float(self.accepted),
            "lost": float(self._skipped),
            "ignored": float(sum(self.ignored.values())),
            "sessions": float(self.sessions),
        }

    def protocol_errors(self) -> dict[str, int]:
        """Datagrams ignored: out of their order, no plausible state, or none of the protocol."""
        ignored = self.ignored
        found = {"order": sum(ignored[why] for why in _OUT_OF_ORDER)}
        found["implausible"] = ignored[_IMPLAUSIBLE]
        found["malformed"] = sum(ignored.values()) - sum(found.values())
        return found

    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        """Problems, worst first."""
        found = []
        if self.state is None:
            advice = f"; {self.advice}" if self.advice else ""
            found.append(f"nothing was heard of {self.controller}{advice}")
        elif self.lost(now_s):
            found.append(f"{self.controller} is silent for {self.silence_s(now_s):.1f} s")
        elif self.state.hold_reason:
            found.append(self.state.hold_reason)
        for why, count in self.ignored.most_common():
            last = f" ({self.last_implausible})" if why == _IMPLAUSIBLE else ""
            found.append(f"{count} datagrams ignored: {why}{last}")
        return tuple(found)


class Transport(Protocol):
    """A driver's connection to its controller."""

    def now(self) -> float:
        """The time of the stamps."""

    def send(self, data: bytes) -> None:
        """Never raises."""

    def wait(self) -> Sequence[Any]:
        """What came in by the next control instant, oldest first; empty at least every WAKE_S."""

    def waiting(self) -> Sequence[Any]:
        """What is there already, oldest first."""

    def close(self) -> None: ...


class UdpTransport:
    """A controller that listens; nobody else is heard."""

    def __init__(self, host: str, port: int, problem: str, largest: int) -> None:
        """Datagrams of up to `largest` bytes mean something. Raises an AddressError that begins
        with `problem`."""
        self._socket = opened(host, port, socket.SOCK_DGRAM, socket.socket.connect, problem)
        self._largest = largest

    def now(self) -> float:
        return time.monotonic()

    def send(self, data: bytes) -> None:
        # Refused while no program listens there; the driver then reports silence.
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
        # One byte more, so that a longer one is seen to be longer.
        return [data for data, _ in waiting(self._socket, self._largest + 1)]

    def close(self) -> None:
        self._socket.close()


DatagramSessionT = TypeVar("DatagramSessionT", bound=DatagramSession[Any])


class DatagramRobot(LoopingRobot[DatagramSessionT]):
    """A driver of a controller that is answered, a datagram for each of its own.

    A driver gives `_make_session` and `_join`. Of several states that came in at once the newest is
    yielded; one that the application does not answer is answered with a hold.
    """

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._session = self._make_session()
        self._transport: Transport | None = None
        self._parents: Transport | None = None
        """In a forked child: kept, as a bus that is let go of there would wait for its threads."""
        self._owes_answer = False

    @abstractmethod
    def _make_session(self) -> DatagramSessionT:
        """A new session, from `self.options`."""

    @abstractmethod
    def _join(self) -> Transport:
        """Open the transport. Raises a DriverError."""

    def _acquire(self) -> None:
        self._session = self._make_session()
        self._transport = self._join()
        self._owes_answer = False

    def _release(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def _forget(self) -> None:
        self._parents, self._transport = self._transport, None
        if isinstance(self._parents, UdpTransport):
            self._parents.close()

    def _joined(self) -> Transport:
        if self._transport is None:
            raise self._not_open()
        return self._transport

    def _now_s(self) -> float:
        return self._joined().now()

    def _leave_within_s(self) -> float:
        return WAKE_S

    def _states(self, loop: int) -> Generator[RobotState, None, None]:
        session, transport = self._session, self._transport
        if transport is None or self._loop != loop:
            return
        said_s = transport.now()
        self._say(transport, session.greeting(said_s))
        with self._looping(loop):
            while self._loop == loop:
                state = None
                for data in transport.wait():
                    if (tap := self.tap) is not None:
                        tap(data, False, "")
                    state = session.receive(data, transport.now()) or state
                if self._loop != loop:
                    return
                now_s = transport.now()
                if state is not None:
                    said_s = now_s
                    self._owes_answer = True
                    yield state
                    if self._loop == loop and self._owes_answer:
                        self.send(HoldCommand())
                elif now_s - said_s >= WAKE_S and session.lost(now_s):
                    said_s = now_s
                    self._say(transport, session.greeting(now_s))
                    yield session.silence(now_s)

    def _leave(self) -> None:
        transport = self._joined()
        self._owes_answer = False
        now_s = transport.now()
        if self._session.silence_s(now_s) <= LONGEST_BLIND_S:
            self._say(transport, self._session.farewell(now_s))

    def send(self, command: RobotCommand) -> None:
        """Command the robot; the last of several calls for one state counts."""
        transport, session = self._joined(), self._session
        if not self._owes_answer and session.lost(transport.now()):
            session.check(command)
            return
        if session.late(transport.now()):
            # The robot has moved on since the state that this command was computed from.
            for data in transport.waiting():
                if (tap := self.tap) is not None:
                    tap(data, False, "")
                session.receive(data, transport.now())
        answer = session.command(command, transport.now())
        self._owes_answer = False
        self._say(transport, answer)

    def _say(self, transport: Transport, data: bytes | None) -> None:
        if data is not None:
            transport.send(data)
            if (tap := self.tap) is not None:
                tap(data, True, "")

    @property
    def link(self) -> RobotLink:
        """Whether the controller is heard now."""
        if self._transport is None:
            return RobotLink.WAITING
        return self._session.link(self._transport.now())

    def metrics(self) -> dict[str, float]:
        return self._session.metrics()

    def protocol_errors(self) -> dict[str, int]:
        return self._session.protocol_errors()
