"""A simulated Leap Motion tracking service: hands, tracker, and its WebSocket."""

from cardan.sim_peers.leap.anatomy import (
    Anatomy as Anatomy,
    HandPosture as HandPosture,
)
from cardan.sim_peers.leap.core import (
    SimulatedHand as SimulatedHand,
    SimulatedLeapService as SimulatedLeapService,
    rotation_rows as rotation_rows,
)
from cardan.sim_peers.leap.faults import (
    FAULTS as FAULTS,
)
from cardan.sim_peers.leap.hand import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedHands as ScriptedHands,
)
from cardan.sim_peers.leap.service import (
    LeapPeer as LeapPeer,
    LeapPeerOptions as LeapPeerOptions,
)
