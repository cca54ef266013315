"""The simulated remote and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan_wiimote.peer import SimulatedWiimote

LONGEST_S = 300.0
"""Limit of a simulated run; a script whose wait is never fulfilled ends before."""


class WiimoteSimulation:
    """Remote with a Nunchuk, flat on a table."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        self._exchange = exchange
        self._remote = SimulatedWiimote(
            extension="nunchuk", tr="woken-by-1-2" in faults, faults=faults, noise_lsb=1, seed=seed
        )
        self._refused_s = faults.get("refuse", 0.0)
        self._open = False
        self._now_s = 0.0

    def run(self) -> None:
        """Run until the scenario is over."""
        exchange, remote = self._exchange, self._remote
        while not exchange.over and self._now_s < LONGEST_S:
            self._do(exchange.due(self._now_s))
            for report in remote.reports(self._now_s):
                if self._open:
                    self._do(exchange.heard(self._now_s, "", report))
            if self._open and not (remote.control_open and remote.interrupt_open):
                # The system ends both channels when one has ended.
                self._open = False
                self._do(exchange.heard(self._now_s, "", kind=Kind.CLOSED))
            if exchange.over:
                break
            self._now_s = max(self._now_s + 1e-6, min(remote.next_due_s, exchange.next_s))

    def _do(self, steps: list[Step]) -> None:
        remote = self._remote
        for step in steps:
            if step.kind is Kind.DATA and self._open:
                remote.output(step.data, self._now_s)
            elif step.kind is Kind.OPENED:
                self._open = self._now_s >= self._refused_s and remote.connect(self._now_s)
                kind = Kind.OPENED if self._open else Kind.REFUSED
                self._do(self._exchange.heard(self._now_s, "", kind=kind))
            elif step.kind is Kind.ASKED:
                if step.channel == "press":
                    remote.press("a")
                elif step.channel == "release":
                    remote.release("a")
                elif step.channel == "power-off":
                    remote.power_off(self._now_s)
