"""Simulated JR3 on a real bus: by python-can, or on a bus of its own that it serves by
socketcand."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Annotated, Any

from cardan.common import bounds
from cardan.common.options import require_each
from cardan.sim_peers.base import check_faults, load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.device_peer import DevicePeer, DevicePeerOptions
from cardan_jr3.bounds import CAN_NAME, CAN_PORTS
from cardan_jr3.peer.can import CanBackend, PythonCanBus
from cardan_jr3.peer.core import SimulatedJr3
from cardan_jr3.peer.faults import FAULTS
from cardan_jr3.peer.motion_script import SCRIPT_VERBS, SCRIPTS, ScriptedJr3
from cardan_jr3.peer.socketcand import SocketcandHub
from cardan_jr3.protocol import MAX_NODE_ID, TEO_NODE_IDS, TEO_SENSORS, CanFrame, Six

UDP_MULTICAST_GROUP = "239.74.163.2"
NODE_ID = bounds.Range(0, MAX_NODE_ID, "", "a CANopen bus has no other numbers", zero="its own")

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Jr3PeerOptions(DevicePeerOptions):
    """Options of the simulated board and its bus. Times of the script and of faults count from the
    board's first command to acquire."""

    interface: Annotated[str, CAN_NAME] = option(
        "udp_multicast", "Interface of the bus, by python-can's name.", metavar="NAME"
    )
    channel: Annotated[str, CAN_NAME] = option(
        UDP_MULTICAST_GROUP,
        "The bus; for udp_multicast the multicast group.",
        metavar="NAME",
    )
    serve_socketcand: bool = option(False, "Serve a bus of its own, by socketcand's protocol.")
    """Serve a bus at `host` and `port` instead of joining one; needs no python-can."""
    host: Annotated[str, bounds.LISTEN_HOST] = option(
        "127.0.0.1", "Address of socketcand, served or joined.", metavar="HOST"
    )
    port: Annotated[int, bounds.ANY_PORT] | None = option(
        None, "Port of udp_multicast or socketcand; default: the usual one.", metavar="PORT"
    )
    """Port of the interface; default 43113 for udp_multicast, 29536 for socketcand; for a served
    bus 0 is any free port."""
    hop_limit: Annotated[int, bounds.HOP_LIMIT] = 0
    """Hop limit of udp_multicast; 0: frames stay on this computer."""
    bitrate: int = 1_000_000
    """Bit rate of a bus by hardware other than socketcan."""
    sensor: str = option(
        "right-hand",
        "Sensor, with its full scales; see --list-sensors.",
        metavar="NAME",
        listed=[(name, f"node {TEO_NODE_IDS[name]}") for name in TEO_SENSORS],
    )
    """Sensor model: one of TEO's four sensors."""
    node_id: Annotated[int, NODE_ID] = option(
        0, "Node id; 0: that of the sensor on TEO.", name="node", metavar="ID"
    )
    boot_s: Annotated[float, bounds.NOT_NEGATIVE] = option(
        2.0, "Time from power-on to its first message."
    )
    """Time from power-on to BOOTUP, the board's first message."""
    offset: Six = (4.2, -3.1, -8.6, 0.21, -0.13, 0.05)
    """Reading before the sensor is zeroed: its own offset and the load mounted on it."""
    noise_n: Annotated[float, bounds.NOT_NEGATIVE] = 0.05
    """Standard deviation of the unfiltered forces."""
    noise_nm: Annotated[float, bounds.NOT_NEGATIVE] = 0.002
    """Standard deviation of the unfiltered moments."""

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed = f"one of {', '.join(TEO_SENSORS)}"
        require_each(self, ("sensor", self.sensor in TEO_SENSORS, allowed))
        check_faults(self.faults, FAULTS)


class Jr3Peer(DevicePeer[SimulatedJr3, CanFrame]):
    """Simulated board on a bus; its power is on from `open`. Raises ScriptError or
    ConfigurationError for invalid options.
    """

    def __init__(self, options: Jr3PeerOptions | None = None) -> None:
        options = Jr3PeerOptions() if options is None else options
        board = SimulatedJr3(
            options.node_id or TEO_NODE_IDS[options.sensor],
            TEO_SENSORS[options.sensor],
            boot_s=options.boot_s,
            offset=options.offset,
            noise_n=options.noise_n,
            noise_nm=options.noise_nm,
            faults=options.faults,
            seed=options.seed,
        )
        backend: CanBackend
        if options.serve_socketcand:
            port = CAN_PORTS["socketcand"] if options.port is None else options.port
            backend = SocketcandHub(board, options.host, port)
        else:
            extra = _extra(options)
            backend = PythonCanBus(board, options.interface, options.channel, extra)
        motion = ScriptedJr3(load_script(options.script, SCRIPTS, SCRIPT_VERBS))
        board.on_first_start = motion.start
        super().__init__(board, motion, backend, options)
        self._starts = 0

    def _follow(self, now_s: float) -> None:
        """Log the host's settings of the board."""
        super()._follow(now_s)
        if self.device.starts != self._starts:
            self._starts = self.device.starts
            _log.info("told to acquire")


def _extra(options: Jr3PeerOptions) -> dict[str, Any]:
    """Return an interface's options besides its channel."""
    if options.interface == "udp_multicast":
        port = CAN_PORTS["udp_multicast"] if options.port is None else options.port
        return {"port": port, "hop_limit": options.hop_limit}
    if options.interface == "socketcand":
        port = CAN_PORTS["socketcand"] if options.port is None else options.port
        return {"host": options.host, "port": port, "tcp_tune": True}
    return {} if options.interface in ("socketcan", "virtual") else {"bitrate": options.bitrate}
