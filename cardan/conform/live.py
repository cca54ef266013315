"""Runner of a scenario against a real target, in real time."""

from __future__ import annotations

import select
import time
from collections.abc import Callable

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan.conform.transports import TargetWire, Wires
from cardan.errors import DriverError


class Live:
    """A scenario and the wires of its target. `instruct` gets the instructions to the operator."""

    def __init__(self, exchange: Exchange, wires: Wires, instruct: Callable[[str], None]) -> None:
        self._exchange, self._wires, self._instruct = exchange, wires, instruct
        self._open: dict[str, TargetWire] = {}
        self._any = False
        self._start_s = time.monotonic()

    def _now(self) -> float:
        return time.monotonic() - self._start_s

    def run(self) -> None:
        """Run until the scenario is over.

        Raises AddressError or DeviceAccessError if the first wire cannot be opened; a failure of
        a later wire is an event.
        """
        exchange = self._exchange
        try:
            while not exchange.over:
                self._do(exchange.due(self._now()))
                if exchange.over:
                    break
                timeout_s = max(0.0, exchange.next_s - self._now())
                wires = {each.fileno(): name for name, each in self._open.items()}
                due_s = self._now() + timeout_s
                ready, _, _ = select.select(list(wires), [], [], timeout_s)
                exchange.timeline.record_lateness(self._now() - due_s)
                for descriptor in ready:
                    self._take(wires[descriptor])
        finally:
            for each in self._open.values():
                each.close()
            self._wires.close()

    def _take(self, channel: str) -> None:
        wire = self._open.get(channel)
        if wire is None:
            return
        for name, client in wire.arrivals():
            self._open[name] = client
            self._do(self._exchange.heard(self._now(), name, kind=Kind.OPENED))
        for data, source in wire.read():
            now_s, late_s = self._now(), wire.late_s
            self._do(self._exchange.heard(now_s, channel, data, note=source, late_s=late_s))
            self._exchange.timeline.record_lateness(self._now() - now_s)
        if wire.ended and self._open.pop(channel, None) is not None:
            wire.close()
            self._do(self._exchange.heard(self._now(), channel, kind=Kind.CLOSED))

    def _do(self, steps: list[Step]) -> None:
        for step in steps:
            if step.kind is Kind.DATA:
                wire = self._open.get(step.channel)
                if wire is not None:
                    wire.write(step.data)
            elif step.kind is Kind.OPENED:
                self._do(self._opened(step.channel))
            elif step.kind is Kind.CLOSED:
                found = self._open.pop(step.channel, None)
                if found is not None:
                    found.close()
            elif step.kind is Kind.ASKED:
                self._instruct(step.note)

    def _opened(self, channel: str) -> list[Step]:
        try:
            wire = self._wires.open(channel)
        except DriverError as error:
            if not self._any:
                raise
            now_s = self._now()
            return self._exchange.heard(now_s, channel, kind=Kind.REFUSED, note=str(error))
        self._any = True
        self._open[channel] = wire
        steps = self._exchange.heard(self._now(), channel, kind=Kind.OPENED, note=wire.identity)
        self._do(steps)
        # Data that arrived with the opening do not wake `select`.
        self._take(channel)
        return []
