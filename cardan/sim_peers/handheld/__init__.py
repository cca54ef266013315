"""Pages with a phone or a headset's controllers in a simulated hand."""

from cardan.sim_peers.handheld.core import (
    FAULTS as FAULTS,
    SimulatedHandheld as SimulatedHandheld,
)
from cardan.sim_peers.handheld.peer import (
    PagePeer as PagePeer,
    PagePeerOptions as PagePeerOptions,
    XrPeerOptions as XrPeerOptions,
)
