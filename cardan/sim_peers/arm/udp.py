"""The simulated arm on a real UDP socket."""

from __future__ import annotations

import logging
import time
from typing import Any

from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.arm.options import SimulatedArmOptions
from cardan.sim_peers.datagrams import ListeningPeer

log = logging.getLogger(__name__)


class SimulatedArmPeer(ListeningPeer):
    """Serves a `SimulatedArm` on a port, and sends states to the client that commands it.

    Session numbers start from the wall clock and thus increase over restarts of this program.
    """

    def __init__(self, options: SimulatedArmOptions | None = None) -> None:
        self.options = options = SimulatedArmOptions() if options is None else options
        super().__init__(options.host, options.port, options.period_s)
        self.core = SimulatedArm(options, session=int(time.time()) & 0xFFFFFFFF)
        self._reason = ""

    def _receive(self, data: bytes, source: Any, now_s: float) -> None:
        self.core.receive(data, now_s, source)

    def _cycle(self, now_s: float, scheduled_s: float) -> None:
        self._client = self.core.client
        for data in self.core.cycle(now_s):
            self._send(data, now_s)
        if self.core.hold_reason != self._reason:
            self._reason = self.core.hold_reason
            log.info("%s", self._reason or "ready")
