"""Simulated controller and scenario in virtual time, with a network between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from cardan.conform.runner import Exchange
from cardan.conform.simulation import CyclicSimulation
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions

_FIRST_PORT = 49_152


class EgmSimulation(CyclicSimulation[bytes]):
    """A controller whose program restarts EGM by itself, as many do, without an operator."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        options = EgmControllerOptions(script="teleop-retry", faults=faults, seed=seed)
        super().__init__(exchange, options.period_s, faults, seed, garbage=True)
        self._core = EgmController(options)

    def _receive(self, data: bytes) -> None:
        self._core.receive(data)

    def _cycle(self, due_s: float) -> Iterable[bytes]:
        sent = self._core.cycle(due_s)
        return () if sent is None else (sent,)

    def _tell(self, sent: bytes) -> None:
        self._hear("", sent, note=f"127.0.0.1:{_FIRST_PORT + self._core.port_changes}")

    def _by_hand(self, what: str) -> None:
        verbs = {"estop": ("estop",), "release": ("motors-on", "program-start")}
        for verb in verbs[what]:
            self._core.do(verb)
