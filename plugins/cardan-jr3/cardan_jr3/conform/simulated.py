"""Simulated board and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Exchange, Step
from cardan.conform.timeline import Kind
from cardan_jr3.conform.frames import pack, unpack
from cardan_jr3.peer import SimulatedJr3
from cardan_jr3.protocol import TEO_SENSORS

LONGEST_S = 300.0
"""Limit of a simulated run; a script that waits for an event in vain ends before."""
_LOAD = (5.0, 0.0, -8.0, 0.0, 0.2, 0.0)
_OFFSET = (4.2, -3.1, -8.6, 0.21, -0.13, 0.05)


class Jr3Simulation:
    """Bus with two nodes."""

    def __init__(
        self, exchange: Exchange, node_id: int, faults: Mapping[str, float], seed: int
    ) -> None:
        self._exchange = exchange
        self._board = SimulatedJr3(
            node_id,
            TEO_SENSORS["right-hand"],
            offset=_OFFSET,
            noise_n=0.05,
            noise_nm=0.002,
            faults=faults,
            seed=seed,
        )
        self._now_s = 0.0

    def run(self) -> None:
        """Run until the scenario's script has ended."""
        exchange, board = self._exchange, self._board
        while not exchange.over and self._now_s < LONGEST_S:
            self._do(exchange.due(self._now_s))
            for frame in board.reports(self._now_s):
                self._do(exchange.heard(self._now_s, "", pack(frame)))
            if exchange.over:
                break
            self._now_s = max(self._now_s + 1e-6, min(board.next_due_s, exchange.next_s))

    def _do(self, steps: list[Step]) -> None:
        for step in steps:
            if step.kind is Kind.DATA:
                frame = unpack(step.data)
                assert frame is not None
                self._board.receive(*frame, self._now_s)
            elif step.kind is Kind.OPENED:
                self._do(self._exchange.heard(self._now_s, "", kind=Kind.OPENED))
            elif step.channel == "load":
                self._board.set_wrench(_LOAD)
