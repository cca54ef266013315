"""Servers of the simulated controller, and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Exchange
from cardan.conform.simulation import TcpSimulation
from cardan.sim_peers.motoros_controller import (
    MotorosController,
    MotorosControllerOptions,
    MotorosServers,
)
from cardan.sim_peers.motoros_controller.servers import PortKind


class MotorosSimulation(TcpSimulation[PortKind]):
    """The three ports of a controller with MotoROS."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        options = MotorosControllerOptions(faults=faults, seed=seed)
        self._controller = MotorosController(options)
        super().__init__(exchange, MotorosServers(self._controller, options))

    def _by_hand(self, what: str) -> None:
        doing = {
            "estop": self._controller.emergency_stop,
            "release": self._controller.release_emergency_stop,
        }
        doing[what](self._now_s)
