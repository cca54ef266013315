"""The simulated libHD in this process and a scenario in virtual time."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan.types import ZERO3, Vector3
from cardan_omni.conform.calls import HdCalls
from cardan_omni.driver.library import load
from cardan_omni.peer import OmniFault, OmniSettings, SimulatedOmni

LONGEST_S = 60.0
"""Limit of a simulated run; a script that waits for an event in vain ends earlier."""
IDLE_S = 1e-3
"""Time step while the scheduler makes no ticks."""
REACH_M, TURN_RAD_S = 0.04, 2.0 * math.pi
"""Distance and speed of the hand's motion."""


class HdapiSimulation:
    """Program using the library, and a hand that follows the scenario's requests."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        self._exchange = exchange
        wanted = tuple(OmniFault(name, value) for name, value in faults.items())
        self._device = SimulatedOmni(OmniSettings(virtual=True, seed=seed, faults=wanted))
        self._calls = HdCalls(load(str(self._device.path)), lambda: self._now_s)
        self._moved_s: float | None = None
        """Time when the hand began to move; None: it rests."""
        self._now_s = 0.0

    def run(self) -> None:
        """Run until the scenario's script has ended."""
        exchange, device = self._exchange, self._device
        ran_s = device.now_s
        try:
            while not exchange.over and self._now_s < LONGEST_S:
                self._do(exchange.due(self._now_s))
                if exchange.over:
                    break
                self._move()
                before_s = self._now_s
                device.step()
                # The callback has read our clock in the tick, so that tick's time is the library's.
                self._now_s = before_s + max(0.0, device.now_s - ran_s) or before_s
                ran_s = device.now_s
                if self._now_s == before_s:
                    self._now_s = before_s + IDLE_S
                for data in self._calls.ticks():
                    self._do(exchange.heard(self._now_s, "", data))
        finally:
            self._calls.end()

    def _do(self, steps: list[Step]) -> None:
        for step in steps:
            if step.kind is Kind.DATA:
                answer = self._calls.do(step.data)
                self._do(self._exchange.heard(self._now_s, step.channel, answer))
            elif step.kind is Kind.OPENED:
                self._do(self._exchange.heard(self._now_s, step.channel, kind=Kind.OPENED))
                self._do(self._exchange.heard(self._now_s, step.channel, self._calls.began))
            elif step.kind is Kind.ASKED:
                self._by_hand(step.channel)

    def _by_hand(self, what: str) -> None:
        self._moved_s = self._now_s if what == "move" else None
        if what == "unplug":
            self._device.fault("unplug")
        else:
            self._device.hand(ZERO3, buttons=int(what == "press"), docked=what == "dock")

    def _move(self) -> None:
        if self._moved_s is not None:
            turn = TURN_RAD_S * (self._now_s - self._moved_s)
            away = REACH_M * math.sin(turn)
            self._device.hand(Vector3(away, REACH_M * math.sin(0.5 * turn), 0.5 * away))
