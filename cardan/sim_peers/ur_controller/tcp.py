"""The simulated controller on real TCP ports."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.tcp_peer import TcpPeer
from cardan.sim_peers.ur_controller.connector import Connector
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.faults import FAULTS
from cardan.sim_peers.ur_controller.options import UrControllerOptions
from cardan.sim_peers.ur_controller.servers import PortKind, UrServers


class UrControllerPeer(TcpPeer[PortKind]):
    """Serves a `UrController`: RTDE, client interfaces and dashboard; opens the sockets of
    programs."""

    servers: UrServers

    def __init__(self, options: UrControllerOptions | None = None) -> None:
        self.options = options = UrControllerOptions() if options is None else options
        self.controller = UrController(options)
        self._connector: Connector | None = None
        super().__init__(options.host, UrServers(self.controller, options))

    def open(self) -> None:
        super().open()
        if self._selector is not None and self._connector is None:
            self._connector = Connector(self.controller.sockets, self._selector)

    def close(self) -> None:
        if self._connector is not None:
            self._connector.close()
            self._connector = None
        super().close()

    def _flush(self) -> None:
        super()._flush()
        if self._connector is not None:
            self._connector.serve()

    def _port_of(self, kind: PortKind) -> int:
        return self.options.ports[kind]


class UrControllerCommand(PeerCommand[UrControllerOptions]):
    """A Universal Robots UR5e or UR5 (RTDE, client interfaces and dashboard on TCP ports)."""

    Options, Peer = UrControllerOptions, UrControllerPeer
    page = "simulated-peers.md"
    example = "--robot ur5e --running"
    speaks = (
        "[RTDE; primary, secondary and real-time interface with URScript; dashboard]"
        "(universal-robots.md#the-protocol-byte-for-byte) on TCP ports"
    )
    epilog = "Prints READY and the address of RTDE once it serves."
    faults = FAULTS
