"""Simulated tracking service on a real TCP port, speaking WebSocket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.device_peer import DevicePeer, DevicePeerOptions
from cardan_leap.peer.core import (
    DEFAULT_JITTER,
    DEFAULT_RATE_HZ,
    Message,
    SimulatedLeapService,
)
from cardan_leap.peer.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHands
from cardan_leap.peer.websocket import LeapWebSocket
from cardan_leap.protocol import PORT

RATE_HZ = Range(1.0, 1000.0, "Hz", "no tracker is faster")
JITTER = Range(0.0, 0.9, "", "a frame comes before the next one")


@dataclass(frozen=True, kw_only=True)
class LeapPeerOptions(DevicePeerOptions):
    """Options of the simulated service. Raises OptionError for a value that is not allowed."""

    host: Annotated[str, bounds.LISTEN_HOST] = option(
        "127.0.0.1", "The address it listens on.", metavar="HOST"
    )
    port: Annotated[int, bounds.ANY_PORT] = option(PORT, "Its port; 0: any.", metavar="PORT")
    rate_hz: Annotated[float, RATE_HZ] = option(DEFAULT_RATE_HZ, "Frames a second.")
    jitter: Annotated[float, JITTER] = DEFAULT_JITTER
    """Largest delay of a frame, as a share of the period."""


class LeapPeer(DevicePeer[SimulatedLeapService, Message]):
    """Server of a `SimulatedLeapService` for at most `MAX_CLIENTS` clients. Raises ScriptError for
    an unknown or invalid script or fault.
    """

    stall_s = 0.0
    """Longest time to catch up after a stall: none, since the service itself skips late frames."""

    def __init__(self, options: LeapPeerOptions | None = None) -> None:
        options = LeapPeerOptions() if options is None else options
        service = SimulatedLeapService(
            rate_hz=options.rate_hz,
            jitter=options.jitter,
            faults=options.faults,
            seed=options.seed,
        )
        hands = ScriptedHands(load_script(options.script, SCRIPTS, SCRIPT_VERBS))
        backend = LeapWebSocket(service, options.host, options.port)
        super().__init__(service, hands, backend, options)
