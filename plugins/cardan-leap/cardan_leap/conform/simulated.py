"""Simulated tracking service and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan_leap.conform.scenario import CHANNEL
from cardan_leap.peer import SimulatedLeapService

LONGEST_S = 300.0
"""Limit of a simulated run; a script that waits for an event in vain ends earlier."""
CLIENT, VERSION = 1, 6
RATE_HZ = 50.0
"""Frame rate, Hz, below a tracker's usual 110 because frames are costly to generate."""


class LeapSimulation:
    """Client of the service, and a hand that follows the prompts."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        self._exchange = exchange
        self._service = SimulatedLeapService(rate_hz=RATE_HZ, faults=faults, seed=seed)
        self._refused_s = faults.get("refuse", 0.0)
        self._restarts = 0
        self._open = False
        self._now_s = 0.0

    def run(self) -> None:
        """Run until the scenario's script has ended."""
        exchange, service = self._exchange, self._service
        while not exchange.over and self._now_s < LONGEST_S:
            self._do(exchange.due(self._now_s))
            service.advance(self._now_s)
            if service.restarts != self._restarts:
                self._restarts = service.restarts
                self._closed("the service restarts")
            for _, text in service.outgoing():
                if self._open:
                    self._do(exchange.heard(self._now_s, CHANNEL, text.encode()))
            if exchange.over:
                break
            self._now_s = max(self._now_s + 1e-6, min(service.next_due_s, exchange.next_s))

    def _closed(self, why: str) -> None:
        if self._open:
            self._open = False
            self._do(self._exchange.heard(self._now_s, CHANNEL, kind=Kind.CLOSED, note=why))

    def _do(self, steps: list[Step]) -> None:
        service = self._service
        for step in steps:
            if step.kind is Kind.DATA and self._open:
                service.receive(CLIENT, step.data, self._now_s)
            elif step.kind is Kind.OPENED:
                self._connect()
            elif step.kind is Kind.ASKED:
                if step.channel == "enter":
                    service.enter("right")
                elif step.channel == "leave":
                    service.leave("right")
                elif step.channel == "unplug":
                    service.unplug()

    def _connect(self) -> None:
        if self._now_s < self._refused_s:
            note = "no service"
            self._do(self._exchange.heard(self._now_s, CHANNEL, kind=Kind.REFUSED, note=note))
            return
        self._open = True
        self._do(self._exchange.heard(self._now_s, CHANNEL, kind=Kind.OPENED))
        code = self._service.connect(CLIENT, VERSION)
        if code is not None:
            self._closed(f"closed with {code}")
