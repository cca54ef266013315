"""The servers of a simulated controller, sans I/O: connections, schedules, faults of the network.

Input is bytes with their time, output is pieces to write; a shell (`cardan.sim_peers.tcp_peer`, or
a simulation in virtual time) has the sockets.
"""

from __future__ import annotations

import math
import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Generic, TypeVar

from cardan.sim_peers.base import FaultSwitch, TimedActions

SILENT: Final = FaultSwitch(
    "silent", "from this time on nothing is sent or read, the sockets stay open, s", 5.0
)
RESET: Final = FaultSwitch.at("reset", "every connection is reset")

SPLIT_S: Final = 0.001
"""Delay of the second piece of data that is written in two."""
MAX_EVENTS: Final = 10_000

KindT = TypeVar("KindT", bound=str)

TimedAction = Callable[[], object]
Events = deque[tuple[float, str]]


@dataclass(eq=False)
class ServerConnection(Generic[KindT]):
    """Connection of a client."""

    number: int
    kind: KindT
    late: deque[tuple[float, bytes]] = field(default_factory=deque)
    """Delayed data, each with the time at which it is sent, s."""
    out: deque[bytes] = field(default_factory=deque)
    """Pieces to write."""


ConnectionT = TypeVar("ConnectionT", bound=ServerConnection[Any])


class TcpServers(ABC, Generic[KindT, ConnectionT]):
    """The servers of a controller; connections are small integers.

    Times of faults count from the first time given. The faults "late", "split", "garbage",
    "silent", "cut" and "reset" are implemented here; the protocol defines which data is late, and
    the garbage.
    """

    kinds: tuple[KindT, ...]
    """Ports in the order in which they are opened; the first receives commands."""
    never_read: ClassVar[frozenset[str]] = frozenset()
    """Those of `kinds` whose connections are never read."""
    leaves_out: ClassVar[frozenset[str]] = frozenset()
    """Those of `kinds` that skip messages for a client without room; a client of another port is
    disconnected."""
    state_period_s: float
    """Period of published states."""

    def __init__(self, history: Events, faults: Mapping[str, float], seed: int) -> None:
        """`history`: events of the controller."""
        self.events: Events = deque(maxlen=MAX_EVENTS)
        """The newest events, (time_s, text)."""
        self.histories = (history, self.events)
        self._connections: dict[int, ConnectionT] = {}
        self._count = 0
        self._closing: list[int] = []
        self._aborting: list[int] = []
        self._last_words: list[tuple[int, bytes]] = []
        self._silent = False
        self._start_s = math.nan
        self._now_s = 0.0
        self._next_state_s = math.inf
        self._random = random.Random(seed)
        self._timed: TimedActions[TimedAction] = TimedActions({}, {})
        self.behave(faults)

    def behave(self, faults: Mapping[str, float]) -> None:
        """Activate only these faults from now on; timed faults are planned from the options
        alone."""
        self._late_s = 1e-3 * faults.get("late", 0.0)
        self._split = faults.get("split", 0.0) > 0.0
        self._garbage_share = faults.get("garbage", 0.0)

    # -- made by the controller -----------------------------------------------------------------

    @abstractmethod
    def _plan(self) -> TimedActions[TimedAction]:
        """Return the timed actions, counted from now: those of the network, and others."""

    @abstractmethod
    def _live(self) -> None:
        """Run the controller, and the timed actions, until now."""

    @abstractmethod
    def _due(self) -> Iterator[float]:
        """Yield the times of the next work of the controller or its servers."""

    @abstractmethod
    def _refuses(self, kind: KindT) -> str:
        """Return why another client of this port is refused; empty: it is accepted."""

    @abstractmethod
    def _met(self, kind: KindT, number: int) -> ConnectionT:
        """Return the connection of a new client."""

    @abstractmethod
    def _greet(self, connection: ConnectionT) -> None:
        """Set up the connection of a new client, and send its first messages."""

    @abstractmethod
    def _received(self, connection: ConnectionT, data: bytes) -> None:
        """Handle the data of one read."""

    @abstractmethod
    def _parted(self, connection: ConnectionT) -> None:
        """Handle the end of a connection."""

    # -- called by the shell --------------------------------------------------------------------

    @property
    def silent(self) -> bool:
        """True if all traffic has stopped, as with a disconnected cable."""
        return self._silent

    @property
    def next_s(self) -> float:
        """Time of the next call of `advance`."""
        times = [self._timed.next_s, *self._due()]
        if not self._silent:
            for each in self._connections.values():
                if each.late:
                    times.append(each.late[0][0])
                if each.out:
                    times.append(self._now_s + SPLIT_S)
        return min(times)

    def takes(self, connection: int) -> bool:
        """Return True if the server of this connection is ready to read."""
        return connection in self._connections and not self._silent

    def accepted(self, kind: KindT, now_s: float) -> int | None:
        """Accept a new client; return the number of its connection, or None to close it at once."""
        self._go(now_s)
        if why := self._refuses(kind):
            self._note(f"{kind}: a client is refused, {why}")
            return None
        self._count += 1
        made = self._connections[self._count] = self._met(kind, self._count)
        self._note(f"{kind}: connection {self._count}")
        self._greet(made)
        return made.number

    def data(self, connection: int, data: bytes, now_s: float) -> None:
        """Handle the data of one read; for a port that is never read, the data of a peek."""
        self._go(now_s)
        found = self._connections.get(connection)
        if found is not None and not self._silent:
            self._received(found, data)

    def eof(self, connection: int, now_s: float) -> None:
        """Handle a client that has closed its end."""
        self.lost(connection, now_s, "its client has gone")

    def lost(self, connection: int, now_s: float, reason: str) -> None:
        """Drop a connection that failed in the shell, or whose client does not read."""
        self._go(now_s)
        found = self._connections.get(connection)
        if found is not None:
            self._drop(found, reason)

    def advance(self, now_s: float) -> None:
        """Do all work that is due by `now_s`: robot, faults, states, delayed data."""
        self._go(now_s)

    def outgoing(self) -> list[tuple[int, bytes]]:
        """Return the pieces to write, each with one write, in this order; each is returned once."""
        pieces, self._last_words = self._last_words, []
        for each in self._connections.values():
            out = each.out
            for _ in range(min(1, len(out)) if self._split else len(out)):
                pieces.append((each.number, out.popleft()))
        return [] if self._silent else pieces

    def closing(self) -> list[int]:
        """Return the connections to close after `outgoing` was written; each is returned once."""
        numbers, self._closing = self._closing, []
        return numbers

    def aborting(self) -> list[int]:
        """Return the connections to reset; each is returned once."""
        numbers, self._aborting = self._aborting, []
        return numbers

    # -- time -----------------------------------------------------------------------------------

    def _go(self, now_s: float) -> None:
        self._now_s = now_s
        if math.isnan(self._start_s):
            self._start_s = now_s
            self._next_state_s = now_s + self.state_period_s
            self._timed = self._plan()
        self._live()
        for each in self._connections.values():
            while each.late and each.late[0][0] <= now_s:
                self._send(each, each.late.popleft()[1])

    def _state_due(self) -> bool:
        """Return True if a state is due now; missed ones are skipped."""
        if self._now_s < self._next_state_s:
            return False
        missed = math.floor((self._now_s - self._next_state_s) / self.state_period_s)
        self._next_state_s += (missed + 1) * self.state_period_s
        return True

    def _happens(self, share: float) -> bool:
        """Return True if a fault of this share happens now."""
        return share > 0.0 and self._random.random() < share

    # -- faults of the network ------------------------------------------------------------------

    def _network_actions(self) -> dict[str, TimedAction]:
        return {"silent": self._fall_silent, "cut": self._cut, "reset": self._reset}

    def _fall_silent(self) -> None:
        self._note("fault: silent from now on")
        self._silent = True

    def _cut(self) -> None:
        for each in tuple(self._connections.values()):
            if each.kind == self.kinds[0]:
                self._drop(each, "fault: cut")

    def _reset(self) -> None:
        for each in tuple(self._connections.values()):
            self._drop(each, "fault: reset", self._aborting)

    # -- connections ----------------------------------------------------------------------------

    def _drop(self, connection: ConnectionT, reason: str, into: list[int] | None = None) -> None:
        number = connection.number
        del self._connections[number]
        self._last_words += [(number, piece) for piece in connection.out]
        (self._closing if into is None else into).append(number)
        self._note(f"{connection.kind}: connection {number} is closed: {reason}")
        self._parted(connection)

    def _later(self, connection: ConnectionT, data: bytes) -> None:
        """Send data that the fault "late" may delay."""
        if self._late_s:
            connection.late.append((self._now_s + self._late_s, data))
        else:
            self._send(connection, data)

    def _send(self, connection: ConnectionT, data: bytes) -> None:
        """Send data that is not, or no longer, delayed."""
        self._put(connection, data)

    def _put(self, connection: ConnectionT, data: bytes) -> None:
        """Write, in two pieces with the fault "split"."""
        if self._split and len(data) > 1:
            cut = self._random.randrange(1, len(data))
            connection.out.append(data[:cut])
            connection.out.append(data[cut:])
        else:
            connection.out.append(data)

    def _note(self, text: str) -> None:
        self.events.append((self._now_s, text))
