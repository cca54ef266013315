"""The simulated controller on a real UDP socket."""

from __future__ import annotations

import contextlib
import logging
import socket
import time
from typing import Any

from cardan.common.sockets import opened
from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.datagrams import DatagramPeer
from cardan.sim_peers.egm_controller.controller import EgmController
from cardan.sim_peers.egm_controller.faults import FAULTS
from cardan.sim_peers.egm_controller.options import EgmControllerOptions
from cardan.sim_peers.egm_controller.scripts import SCRIPT_VERBS, SCRIPTS

log = logging.getLogger(__name__)


class EgmControllerPeer(DatagramPeer):
    """Serves an `EgmController` as a client of the PC, like the real one.

    The socket has an ephemeral local port and is connected to the PC's address, which excludes
    answers from other addresses.
    """

    def __init__(self, options: EgmControllerOptions | None = None) -> None:
        self.options = options = EgmControllerOptions() if options is None else options
        super().__init__(options.period_s, options.faults, options.seed)
        self.core = EgmController(options, wall_start_s=time.time())
        self._port_changes = 0
        self._logged = 0

    @property
    def endpoint(self) -> str:
        return f"{self.options.pc_host}:{self.options.pc_port}"

    @property
    def local_port(self) -> int | None:
        """Ephemeral port that datagrams come from now; None while closed."""
        return None if self._socket is None else int(self._socket.getsockname()[1])

    def _connect(self) -> socket.socket:
        host, port = self.options.pc_host, self.options.pc_port
        problem = f"cannot send to {host}:{port}"
        join, any_family = socket.socket.connect, socket.AF_UNSPEC
        return opened(host, port, socket.SOCK_DGRAM, join, problem, any_family)

    def _cycle(self, now_s: float, scheduled_s: float) -> None:
        data = self.core.cycle(scheduled_s)
        if self.core.port_changes != self._port_changes:
            self._port_changes = self.core.port_changes
            self.close()
            self._socket = self._connect()
        if data is not None:
            self._send(data, now_s)
        for event in self.core.events[self._logged :]:
            log.info("event %s: %s", event.code or "-", event.text)
        self._logged = len(self.core.events)

    def _receive(self, data: bytes, source: Any, now_s: float) -> None:
        self.core.receive(data)

    def _heard(self, answered: bool) -> None:
        if answered:
            self.core.sending_worked()
        else:
            self.core.sending_failed()

    def _transmit(self, data: bytes) -> None:
        if self._socket is None:
            return
        try:
            self._socket.send(data)
        except BlockingIOError:
            return
        except OSError:
            # Linux reports an earlier refusal here and sends nothing; a controller continues to
            # send.
            self.core.sending_failed()
            with contextlib.suppress(OSError):
                self._socket.send(data)


class EgmControllerCommand(PeerCommand[EgmControllerOptions]):
    """An ABB GoFa CRB 15000-5 in Externally Guided Motion (protobuf on UDP, 250 Hz)."""

    Options, Peer = EgmControllerOptions, EgmControllerPeer
    page = "simulated-peers.md"
    example = "--to 127.0.0.1:6510 --mode pose --fault drop=0.05"
    speaks = "[EGM](abb-egm.md#the-protocol-byte-for-byte), protobuf on UDP, 250 Hz"
    epilog = "Prints READY and the PC's address once it sends."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
