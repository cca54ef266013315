"""The simulated tracking service on a real TCP port, speaking WebSocket."""

from __future__ import annotations

from dataclasses import dataclass

from cardan.errors import ConfigurationError
from cardan.protocols.leap import PORT
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.hand_peer import HandOptions, HandPeer
from cardan.sim_peers.leap.core import (
    DEFAULT_JITTER,
    DEFAULT_RATE_HZ,
    Message,
    SimulatedLeapService,
)
from cardan.sim_peers.leap.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHands
from cardan.sim_peers.leap.websocket import LeapWebSocket


@dataclass(frozen=True, kw_only=True)
class LeapPeerOptions(HandOptions):
    """What to simulate and where. Raises ConfigurationError for a value that is not allowed."""

    host: str = option("127.0.0.1", "The address it listens on.", metavar="HOST")
    port: int = option(PORT, "Its port; 0: any.", metavar="PORT")
    rate_hz: float = option(DEFAULT_RATE_HZ, "Frames a second.")
    jitter: float = DEFAULT_JITTER
    """How late a frame may be, as a share of the period."""

    def __post_init__(self) -> None:
        for key, lowest, highest in (
            ("port", 0, 65535),
            ("rate_hz", 1.0, 1000.0),
            ("jitter", 0.0, 0.9),
        ):
            value = getattr(self, key)
            if not lowest <= value <= highest:
                raise ConfigurationError(key, f"{value!r} is not in {lowest:g} to {highest:g}")


class LeapPeer(HandPeer[SimulatedLeapService, Message]):
    """Serves a `SimulatedLeapService` to any number of clients up to `MAX_CLIENTS`.

    Raises ScriptError for a script or fault that does not exist or makes no sense.
    """

    stall_s = 0.0
    """The service itself knows which of its frames are too late."""

    def __init__(self, options: LeapPeerOptions | None = None) -> None:
        options = LeapPeerOptions() if options is None else options
        service = SimulatedLeapService(
            rate_hz=options.rate_hz,
            jitter=options.jitter,
            faults=options.faults,
            seed=options.seed,
        )
        hands = ScriptedHands(load_script(options.script, SCRIPTS, SCRIPT_VERBS))
        carrier = LeapWebSocket(service, options.host, options.port)
        super().__init__(service, hands, carrier, options)
