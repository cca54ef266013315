"""The simulated controller on real TCP ports."""

from __future__ import annotations

from collections.abc import Sequence

from cardan.sim_peers.tcp_peer import TcpPeer
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.options import UrControllerOptions
from cardan.sim_peers.ur_controller.servers import PORT_KINDS, PortKind, UrServers


class UrControllerPeer(TcpPeer[PortKind]):
    """Serves a `UrController`: RTDE, the primary interface and the dashboard."""

    kinds = PORT_KINDS

    def __init__(self, options: UrControllerOptions | None = None) -> None:
        self.options = options = UrControllerOptions() if options is None else options
        self.controller = UrController(options)
        self.servers = UrServers(self.controller, options)
        super().__init__(options.host, self.servers)

    def _port_of(self, kind: PortKind) -> int:
        return self.options.ports[kind]

    def _events(self) -> Sequence[Sequence[tuple[float, str]]]:
        return (self.controller.events, self.servers.events)
