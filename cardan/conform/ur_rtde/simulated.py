"""Servers of the simulated controller, and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cardan.conform.runner import Exchange
from cardan.conform.simulation import TcpSimulation
from cardan.conform.timeline import Kind
from cardan.conform.ur_rtde.decoded import REVERSE
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers
from cardan.sim_peers.ur_controller.servers import PortKind

OPTIONS = UrControllerOptions()


class UrSimulation(TcpSimulation[PortKind]):
    """The ports of a controller by its `options`, e-Series by default, and ours for programs."""

    def __init__(
        self,
        exchange: Exchange,
        faults: Mapping[str, float],
        seed: int = 0,
        options: UrControllerOptions = OPTIONS,
    ) -> None:
        options = replace(options, faults=faults, seed=seed)
        self._controller = UrController(options)
        super().__init__(exchange, UrServers(self._controller, options))
        self._listening = False
        self._calls: dict[str, int] = {}
        """Sockets of programs, by their channels."""

    def _by_hand(self, what: str) -> None:
        controller = self._controller
        if what in ("slider-half", "slider-full"):
            controller.slider = 0.5 if what == "slider-half" else 1.0
        elif what in ("local", "remote"):
            controller.remote = what == "remote"
        elif what == "estop":
            controller.emergency_stop()
        else:
            controller.release_emergency_stop()

    def _open(self, channel: str) -> None:
        if channel != REVERSE:
            super()._open(channel)
            return
        self._listening = True
        self._hear(channel, kind=Kind.OPENED)

    def _closed(self, channel: str) -> None:
        if channel == REVERSE:
            self._listening = False
        else:
            super()._closed(channel)

    def _deliver(self, channel: str, data: bytes) -> None:
        if channel in self._calls:
            self._controller.sockets.data(self._calls[channel], data)
        else:
            super()._deliver(channel, data)

    def _carry(self) -> None:
        super()._carry()
        sockets = self._controller.sockets
        for opening in sockets.openings():
            if not self._listening:
                sockets.lost(opening.number, "nobody listens")
                continue
            channel = f"{REVERSE} {opening.number}"
            self._calls[channel] = opening.number
            sockets.opened(opening.number)
            self._hear(channel, kind=Kind.OPENED)
        for number, data in sockets.outgoing():
            self._bring(self._calls, number, data)
        for number in sockets.closings():
            self._bring(self._calls, number)
