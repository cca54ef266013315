"""A simulated controller's TCP servers and a pilot in virtual time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Generic

from cardan.conform.runner import Act, Exchange
from cardan.conform.timeline import Kind
from cardan.sim_peers.tcp_servers import KindT, TcpServers

LONGEST_S = 300.0
"""Of a simulated run; a script that waits for what never comes ends before."""
STEP_S = 1e-6
NETWORK_S = 1e-4
"""How long a piece is on its way to the servers."""


class TcpRig(ABC, Generic[KindT]):
    """Carries what servers and pilot write, in order, and does what is asked by hand."""

    def __init__(self, conduct: Exchange, servers: TcpServers[KindT, Any]) -> None:
        self._conduct, self._servers = conduct, servers
        self._numbers: dict[str, int] = {}
        self._now_s = 0.0
        self._to_it: list[tuple[float, str, bytes]] = []

    @abstractmethod
    def _by_hand(self, what: str, now_s: float) -> None:
        """Do what somebody was asked to do."""

    def run(self) -> None:
        """Until the pilot's script is over."""
        conduct, servers = self._conduct, self._servers
        servers.advance(0.0)
        while not conduct.over and self._now_s < LONGEST_S:
            self._do(conduct.due(self._now_s))
            while self._to_it and self._to_it[0][0] <= self._now_s:
                _, channel, data = self._to_it.pop(0)
                self._deliver(channel, data)
            servers.advance(self._now_s)
            self._carry()
            times = [servers.next_s, conduct.next_s]
            if self._to_it:
                times.append(self._to_it[0][0])
            self._now_s = max(self._now_s + STEP_S, min(times))

    def _deliver(self, channel: str, data: bytes) -> None:
        """What we sent has come."""
        if channel in self._numbers:
            self._servers.data(self._numbers[channel], data, self._now_s)
            self._carry()

    def _carry(self) -> None:
        for number, data in self._servers.outgoing():
            channel = self._channel(number)
            if channel is not None:
                self._do(self._conduct.heard(self._now_s, channel, data))
        for number in (*self._servers.closing(), *self._servers.aborting()):
            channel = self._channel(number)
            if channel is not None:
                del self._numbers[channel]
                self._do(self._conduct.heard(self._now_s, channel, kind=Kind.CLOSED))

    def _channel(self, number: int) -> str | None:
        return next((name for name, each in self._numbers.items() if each == number), None)

    def _do(self, acts: list[Act]) -> None:
        for act in acts:
            if act.kind is Kind.DATA:
                self._to_it.append((self._now_s + NETWORK_S, act.channel, act.data))
            elif act.kind is Kind.OPENED:
                self._open(act.channel)
            elif act.kind is Kind.CLOSED:
                self._closed(act.channel)
            elif act.kind is Kind.ASKED:
                self._by_hand(act.channel, self._now_s)

    def _closed(self, channel: str) -> None:
        if channel in self._numbers:
            self._servers.eof(self._numbers.pop(channel), self._now_s)

    def _open(self, channel: str) -> None:
        number = None
        if not self._servers.silent:
            # A channel's name begins with that of its port.
            kind = next(each for each in self._servers.kinds if channel.startswith(each))
            number = self._servers.accepted(kind, self._now_s)
        happened = Kind.REFUSED
        if number is not None:
            self._numbers[channel] = number
            happened = Kind.OPENED
        self._do(self._conduct.heard(self._now_s, channel, kind=happened))
