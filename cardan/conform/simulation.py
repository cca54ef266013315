"""Base classes that connect a scenario to a simulated target in virtual time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, Generic, TypeVar

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan.sim_peers.base import FaultSwitch, check_faults
from cardan.sim_peers.link import FaultyLink
from cardan.sim_peers.tcp_servers import KindT, TcpServers

LONGEST_S = 300.0
"""Longest simulated run; a script whose wait is never fulfilled ends before."""
LOOK_S = 0.01
"""Longest period at which a driver's core is polled."""
NETWORK_S = 1e-4
"""Transmission time of a piece."""

SentT = TypeVar("SentT")


class Simulation(ABC):
    """Carries data between the simulated side and the scenario, and acts as the operator."""

    step_s: ClassVar[float] = 1e-6
    """Smallest time step."""

    def __init__(self, exchange: Exchange) -> None:
        self._exchange = exchange
        self._now_s = 0.0
        self._flight: deque[tuple[float, Callable[[], None]]] = deque()

    def run(self) -> None:
        """Run until the scenario is over."""
        exchange, flight = self._exchange, self._flight
        while not exchange.over and self._now_s < LONGEST_S:
            self._do(exchange.due(self._now_s))
            while flight and flight[0][0] <= self._now_s:
                flight.popleft()[1]()
            self._turn()
            if exchange.over:
                break
            times = [exchange.next_s, self._next_s()]
            if flight:
                times.append(flight[0][0])
            self._now_s = max(self._now_s + self.step_s, min(times))
            self._time_passed()

    def _later(self, seconds: float, action: Callable[[], None]) -> None:
        """Schedule `action` in `seconds`; actions run in the order of these calls."""
        self._flight.append((self._now_s + seconds, action))

    def _hear(
        self, channel: str, data: bytes = b"", kind: Kind = Kind.DATA, note: str = ""
    ) -> None:
        """Deliver an event of the simulated side to the scenario."""
        self._do(self._exchange.heard(self._now_s, channel, data, kind=kind, note=note))

    def _do(self, steps: list[Step]) -> None:
        for step in steps:
            if step.kind is Kind.DATA:
                self._take(step.data, step.channel)
            elif step.kind is Kind.OPENED:
                self._open(step.channel)
            elif step.kind is Kind.CLOSED:
                self._closed(step.channel)
            elif step.kind is Kind.ASKED:
                self._by_hand(step.channel)

    @abstractmethod
    def _take(self, data: bytes, channel: str) -> None:
        """Accept `data` from the scenario."""

    @abstractmethod
    def _by_hand(self, what: str) -> None:
        """Do `what` as the operator would."""

    @abstractmethod
    def _turn(self) -> None:
        """Advance the simulated side to now."""

    @abstractmethod
    def _next_s(self) -> float:
        """Time of the next call of `_turn`."""

    def _open(self, channel: str) -> None:
        """Open `channel` for the scenario."""
        self._hear(channel, kind=Kind.OPENED)

    def _closed(self, channel: str) -> None:  # noqa: B027 - datagrams need none
        """Close `channel` for the scenario."""

    def _time_passed(self) -> None:  # noqa: B027 - most only have turns
        """Follow the clock after it has advanced."""


class DriverSimulation(Simulation):
    """A driver's core and a scenario as its controller, with transmission times."""

    def __init__(
        self, exchange: Exchange, faults: Mapping[str, float], switches: Iterable[FaultSwitch]
    ) -> None:
        check_faults(faults, switches)
        super().__init__(exchange)
        self._faults = faults

    def _turn(self) -> None:
        """Do nothing: a core that only answers has no time of its own."""

    def _next_s(self) -> float:
        return self._now_s + LOOK_S


class CyclicSimulation(Simulation, Generic[SentT]):
    """A simulated controller that sends in each of its cycles, with a network both ways."""

    step_s = 0.0

    def __init__(
        self,
        exchange: Exchange,
        period_s: float,
        faults: Mapping[str, float],
        seed: int,
        garbage: bool = False,
    ) -> None:
        """`faults`: those of the network; `garbage`: insert junk into the sent data."""
        super().__init__(exchange)
        self._period_s = period_s
        self._cycles = 0
        self._out: FaultyLink[SentT] = FaultyLink(faults, seed + 2, garbage)
        self._in: FaultyLink[bytes] = FaultyLink(faults, seed + 3)

    @abstractmethod
    def _receive(self, data: bytes) -> None:
        """Deliver data of the scenario to the controller."""

    @abstractmethod
    def _cycle(self, due_s: float) -> Iterable[SentT]:
        """Return the data that the controller sends in the cycle of `due_s`."""

    @abstractmethod
    def _tell(self, sent: SentT) -> None:
        """Deliver data of the controller to the scenario."""

    def _take(self, data: bytes, channel: str) -> None:
        self._in.push(self._now_s, data)

    def _turn(self) -> None:
        for data in self._in.pop(self._now_s):
            self._receive(data)
        due_s = self._cycles * self._period_s
        if self._now_s >= due_s:
            self._cycles += 1
            for sent in self._cycle(due_s):
                self._out.push(self._now_s, sent)
        for sent in self._out.pop(self._now_s):
            self._tell(sent)

    def _next_s(self) -> float:
        times = (self._cycles * self._period_s, self._out.next_s(), self._in.next_s())
        return min(each for each in times if each is not None)


class TcpSimulation(Simulation, Generic[KindT]):
    """A simulated controller's TCP servers and a scenario that is their client."""

    def __init__(self, exchange: Exchange, servers: TcpServers[KindT, Any]) -> None:
        super().__init__(exchange)
        self._servers = servers
        self._numbers: dict[str, int] = {}

    def run(self) -> None:
        """Run until the scenario is over."""
        self._servers.advance(0.0)
        super().run()

    def _turn(self) -> None:
        self._servers.advance(self._now_s)
        self._carry()

    def _next_s(self) -> float:
        return self._servers.next_s

    def _take(self, data: bytes, channel: str) -> None:
        self._later(NETWORK_S, lambda: self._deliver(channel, data))

    def _deliver(self, channel: str, data: bytes) -> None:
        """Deliver our data to the controller."""
        if channel in self._numbers:
            self._servers.data(self._numbers[channel], data, self._now_s)
            self._carry()

    def _carry(self) -> None:
        for number, data in self._servers.outgoing():
            self._bring(self._numbers, number, data)
        for number in (*self._servers.closing(), *self._servers.aborting()):
            self._bring(self._numbers, number)

    def _bring(self, numbers: dict[str, int], number: int, data: bytes | None = None) -> None:
        """Deliver data, or the end of a connection; `numbers` has those of the open channels."""
        channel = next((name for name, each in numbers.items() if each == number), None)
        if channel is not None and data is not None:
            self._hear(channel, data)
        elif channel is not None:
            del numbers[channel]
            self._hear(channel, kind=Kind.CLOSED)

    def _closed(self, channel: str) -> None:
        if channel in self._numbers:
            self._servers.eof(self._numbers.pop(channel), self._now_s)

    def _open(self, channel: str) -> None:
        number = None
        if not self._servers.silent:
            # A channel's name begins with its port's name.
            kind = next(each for each in self._servers.kinds if channel.startswith(each))
            number = self._servers.accepted(kind, self._now_s)
        if number is not None:
            self._numbers[channel] = number
        self._hear(channel, kind=Kind.REFUSED if number is None else Kind.OPENED)
