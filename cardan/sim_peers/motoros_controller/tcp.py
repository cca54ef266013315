"""The simulated controller on three real TCP ports."""

from __future__ import annotations

import csv
import logging
from typing import TextIO

from cardan.common.files import create_file
from cardan.errors import ConfigurationError
from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.motoros_controller.controller import MotorosController
from cardan.sim_peers.motoros_controller.faults import FAULTS
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.servers import PORT_KINDS, MotorosServers, PortKind
from cardan.sim_peers.tcp_peer import TcpPeer

log = logging.getLogger(__name__)


class MotorosControllerPeer(TcpPeer[PortKind]):
    """Serves a `MotorosController` on MotoROS's ports for motion, state and I/O clients.

    The interpolation clock and the state cycle keep an absolute schedule. With `options.log` every
    interpolation cycle becomes a row of a CSV file; with base port 0 any free ports are taken.
    """

    servers: MotorosServers

    def __init__(self, options: MotorosControllerOptions | None = None) -> None:
        self.options = options = MotorosControllerOptions() if options is None else options
        self.controller = MotorosController(options)
        super().__init__(options.host, MotorosServers(self.controller, options))
        self._log_file: TextIO | None = None

    @property
    def motion_port(self) -> int:
        """Address of the motion server."""
        return self.port("motion")

    @property
    def state_port(self) -> int:
        """Address of the state server."""
        return self.port("state")

    @property
    def io_port(self) -> int:
        """Address of the I/O server."""
        return self.port("io")

    def _port_of(self, kind: PortKind) -> int:
        base = self.options.base_port
        return base + PORT_KINDS.index(kind) if base else 0

    def _opened(self) -> None:
        if self.options.log:
            # Opened last: a peer that fails to start must not empty another one's log.
            self._log_file = _created(self.options.log)
            self.controller.log.insert(0, self.controller.log_columns)

    def close(self) -> None:
        super().close()
        self._served()
        self._end_log()

    def _served(self) -> None:
        """Write the rows since the last call; the controller keeps none of them. After a write
        error only the file is closed."""
        rows = self.controller.log
        if self._log_file is not None and rows:
            try:
                csv.writer(self._log_file).writerows(rows)
            except OSError as error:
                self._end_log(error)
        rows.clear()

    def _end_log(self, error: OSError | None = None) -> None:
        file, self._log_file = self._log_file, None
        if file is None:
            return
        try:
            file.close()
        except OSError as closing:
            error = error or closing
        if error is not None:
            log.error("%s ends here, it cannot be written: %s", self.options.log, error.strerror)


def _created(path: str) -> TextIO:
    try:
        return create_file(path)
    except OSError as error:
        raise ConfigurationError("log", f"{path!r} cannot be written: {error.strerror}") from None


class MotorosControllerCommand(PeerCommand[MotorosControllerOptions]):
    """A Yaskawa Motoman GP8 that runs MotoROS (simple message on three TCP ports)."""

    Options, Peer = MotorosControllerOptions, MotorosControllerPeer
    page = "simulated-peers.md"
    example = "--plant paper --fault estop=8"
    speaks = (
        "[simple message](protocols/simple-message.md) on three TCP ports, with [velocity "
        "mode](protocols/simple-message.md#velocity-mode)"
    )
    epilog = "Prints READY and the address of motion once it serves."
    faults = FAULTS
