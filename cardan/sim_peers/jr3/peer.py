"""The simulated JR3 on a real bus: by python-can, or on a bus of its own that socketcand serves."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

from cardan import bounds
from cardan.options import check_options, require_each
from cardan.protocols.jr3_can import MAX_NODE_ID, TEO_NODE_IDS, TEO_SENSORS, CanFrame, Six
from cardan.sim_peers.base import SimulatedPeer, check_faults, load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.jr3.can_bus import PythonCanBus
from cardan.sim_peers.jr3.core import SimulatedJr3
from cardan.sim_peers.jr3.faults import FAULTS
from cardan.sim_peers.jr3.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand, play
from cardan.sim_peers.jr3.socketcand import SocketcandHub

UDP_MULTICAST_GROUP = "239.74.163.2"
NODE_ID = bounds.Range(0, MAX_NODE_ID, "", "a CANopen bus has no other numbers", zero="its own")
STALL_S = 0.02
"""Samples older than this when the peer comes to run are left out: a late peer makes no burst."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Jr3PeerOptions:
    """What to simulate and on which bus."""

    interface: Annotated[str, bounds.CAN_NAME] = option(
        "udp_multicast", "The way to the bus, as python-can calls it.", metavar="NAME"
    )
    channel: Annotated[str, bounds.CAN_NAME] = option(
        UDP_MULTICAST_GROUP,
        "The bus; that of udp_multicast is its group.",
        metavar="NAME",
    )
    serve_socketcand: bool = option(False, "Serve a bus of its own, by socketcand's protocol.")
    """Instead of joining one: at `host` and `port`; needs no python-can."""
    host: Annotated[str, bounds.HOST] = option(
        "127.0.0.1", "Of socketcand, served or joined.", metavar="HOST"
    )
    port: Annotated[int, bounds.ANY_PORT] | None = option(
        None, "Of udp_multicast or socketcand; default: theirs.", metavar="PORT"
    )
    """Theirs are 43113 and 29536; for socketcand that is served 0 is any."""
    hop_limit: Annotated[int, bounds.HOP_LIMIT] = 0
    """Of udp_multicast; 0: frames stay on this computer."""
    bitrate: int = 1_000_000
    """Of a bus by hardware other than socketcan."""
    sensor: str = option(
        "right-hand",
        "Whose full scales; see --list-sensors.",
        metavar="NAME",
        listed=[(name, f"node {TEO_NODE_IDS[name]}") for name in TEO_SENSORS],
    )
    """One of TEO's four sensors."""
    node_id: Annotated[int, NODE_ID] = option(
        0, "Node id; 0: that of the sensor on TEO.", name="node", metavar="ID"
    )
    script: str = "demo"
    """A built-in script or a file."""
    boot_s: Annotated[float, bounds.NOT_NEGATIVE] = option(2.0, "From power to its first message.")
    """That message is BOOTUP."""
    offset: Six = (4.2, -3.1, -8.6, 0.21, -0.13, 0.05)
    """What the sensor shows before it is zeroed: its own zero and what is mounted on it."""
    noise_n: Annotated[float, bounds.NOT_NEGATIVE] = 0.05
    """Standard deviation of the unfiltered forces."""
    noise_nm: Annotated[float, bounds.NOT_NEGATIVE] = 0.002
    """The same of the moments."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of `FAULTS`; times count from when the board is told to acquire."""
    seed: int = 0
    """Of the noise and of the faults' choices."""

    def __post_init__(self) -> None:
        check_options(self)
        allowed = f"one of {', '.join(TEO_SENSORS)}"
        require_each(self, ("sensor", self.sensor in TEO_SENSORS, allowed))
        check_faults(self.faults, FAULTS)


class _Bus(Protocol):
    @property
    def endpoint(self) -> str: ...

    def open(self) -> None: ...

    def close(self) -> None: ...

    def receive(self, timeout_s: float) -> list[CanFrame]: ...

    def send(self, frame: CanFrame) -> None: ...


class Jr3Peer(SimulatedPeer):
    """Serves a `SimulatedJr3` (`board`). Raises ScriptError or ConfigurationError for nonsense."""

    def __init__(self, options: Jr3PeerOptions | None = None) -> None:
        self.options = options = Jr3PeerOptions() if options is None else options
        self.board = SimulatedJr3(
            options.node_id or TEO_NODE_IDS[options.sensor],
            TEO_SENSORS[options.sensor],
            boot_s=options.boot_s,
            offset=options.offset,
            noise_n=options.noise_n,
            noise_nm=options.noise_nm,
            faults=options.faults,
            seed=options.seed,
        )
        self._hand = ScriptedHand(load_script(options.script, SCRIPTS, SCRIPT_VERBS))
        self._bus: _Bus
        if options.serve_socketcand:
            port = bounds.CAN_PORTS["socketcand"] if options.port is None else options.port
            self._bus = SocketcandHub(options.host, port)
        else:
            self._bus = PythonCanBus(options.interface, options.channel, _extra(options))
        self._start_s = math.inf
        self._played_s = 0.0
        self._starts = 0
        self._ready = False

    @property
    def endpoint(self) -> str:
        """The address served, or the bus joined, and the node."""
        if isinstance(self._bus, SocketcandHub):
            return self._bus.endpoint
        return f"{self._bus.endpoint} node {self.board.node_id}"

    def open(self) -> None:
        """Join the bus, or serve it; the board's power is on from here. AddressError."""
        if self._ready:
            return
        self._bus.open()
        self._ready = True
        self._start_s = time.monotonic()

    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`."""
        while self._ready:
            now_s = time.monotonic()
            self._play(now_s)
            if now_s >= until_s:
                return
            due_s = self._start_s + min(self.board.next_due_s, self._hand.next_due_s)
            for frame in self._bus.receive(max(0.0, min(due_s, until_s) - now_s)):
                self.board.receive(*frame, time.monotonic() - self._start_s)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()
        self._ready = False

    def _play(self, now_s: float) -> None:
        board_s = now_s - self._start_s
        if board_s - self._played_s > STALL_S:
            self.board.skip_to(board_s - STALL_S)
        self._played_s = board_s
        for frame in play(self.board, self._hand, board_s):
            self._bus.send(frame)
        if self.board.starts != self._starts:
            self._starts = self.board.starts
            _log.info("told to acquire")


def _extra(options: Jr3PeerOptions) -> dict[str, Any]:
    """What an interface wants to be told beside its channel."""
    if options.interface == "udp_multicast":
        port = bounds.CAN_PORTS["udp_multicast"] if options.port is None else options.port
        return {"port": port, "hop_limit": options.hop_limit}
    if options.interface == "socketcand":
        port = bounds.CAN_PORTS["socketcand"] if options.port is None else options.port
        return {"host": options.host, "port": port, "tcp_tune": True}
    return {} if options.interface in ("socketcan", "virtual") else {"bitrate": options.bitrate}
