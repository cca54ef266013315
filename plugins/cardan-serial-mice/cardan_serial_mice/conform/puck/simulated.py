"""A simulated serial device and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan_serial_mice.peer.core import simulated_serial_puck
from cardan_serial_mice.protocol import serial_model_by_key

LONGEST_S = 300.0
"""Limit of a simulated run; a script whose wait is never fulfilled ends before."""
_RIGHT, _CLOCKWISE = (0.0, -0.5, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
_REST = (0.0,) * 6


class PuckSimulation:
    """A simulated device, moved like by a user who follows the scenario's requests."""

    def __init__(
        self, key: str, exchange: Exchange, faults: Mapping[str, float], seed: int
    ) -> None:
        """`key`: that of the device's model."""
        self._exchange = exchange
        model = serial_model_by_key(key)
        self._device = simulated_serial_puck(model, faults=faults, jitter_lsb=1, seed=seed)
        self._refused_s = faults.get("refuse", 0.0)
        self._open = False
        self._now_s = 0.0

    def run(self) -> None:
        """Run until the scenario is over."""
        exchange, device = self._exchange, self._device
        while not exchange.over and self._now_s < LONGEST_S:
            # First, because a hand that moves now has not moved since the device was last read.
            for data in device.reports(self._now_s):
                if self._open:
                    self._do(exchange.heard(self._now_s, "", data))
            self._do(exchange.due(self._now_s))
            if self._open and not device.plugged:
                self._open = False
                self._do(exchange.heard(self._now_s, "", kind=Kind.CLOSED))
            if exchange.over:
                break
            self._now_s = max(self._now_s + 1e-6, min(device.next_due_s, exchange.next_s))

    def _do(self, steps: list[Step]) -> None:
        for step in steps:
            if step.kind is Kind.DATA:
                self._device.receive(step.data)
            elif step.kind is Kind.OPENED:
                self._open = self._now_s >= self._refused_s
                if self._open:
                    self._device.power(True)
                kind = Kind.OPENED if self._open else Kind.REFUSED
                self._do(self._exchange.heard(self._now_s, "", kind=kind))
            elif step.kind is Kind.ASKED:
                self._by_hand(step.channel)

    def _by_hand(self, what: str) -> None:
        device = self._device
        if what == "push":
            device.set_axes(_RIGHT)
        elif what == "twist":
            device.set_axes(_CLOCKWISE)
        elif what == "let-go":
            device.set_axes(_REST)
        elif what == "press":
            device.press(device.model.buttons[0])
        elif what == "release":
            device.release(device.model.buttons[0])
        elif what == "unplug":
            device.unplug()
