"""Simulated console pages with a phone or a headset's controllers."""

from cardan.sim_peers.handheld.core import (
    FAULTS as FAULTS,
    SimulatedHandheld as SimulatedHandheld,
)
from cardan.sim_peers.handheld.peer import (
    PagePeer as PagePeer,
    PagePeerOptions as PagePeerOptions,
    XrPeerOptions as XrPeerOptions,
)
