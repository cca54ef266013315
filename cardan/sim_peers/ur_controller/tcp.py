"""The simulated controller on real TCP ports."""

from __future__ import annotations

from cardan.sim_peers.tcp_peer import TcpPeer
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.options import UrControllerOptions
from cardan.sim_peers.ur_controller.servers import PortKind, UrServers


class UrControllerPeer(TcpPeer[PortKind]):
    """Serves a `UrController`: RTDE, the client interfaces and the dashboard."""

    servers: UrServers

    def __init__(self, options: UrControllerOptions | None = None) -> None:
        self.options = options = UrControllerOptions() if options is None else options
        self.controller = UrController(options)
        super().__init__(options.host, UrServers(self.controller, options))

    def _port_of(self, kind: PortKind) -> int:
        return self.options.ports[kind]
