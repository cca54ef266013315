"""Simulated Leap Motion tracking service: hands, tracker, and its WebSocket."""

from cardan_leap.peer.core import (
    SimulatedHand as SimulatedHand,
    SimulatedLeapService as SimulatedLeapService,
    rotation_rows as rotation_rows,
)
from cardan_leap.peer.faults import (
    FAULTS as FAULTS,
)
from cardan_leap.peer.hand import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedHands as ScriptedHands,
)
from cardan_leap.peer.hand_model import (
    HandModel as HandModel,
    HandPosture as HandPosture,
)
from cardan_leap.peer.service import (
    LeapPeer as LeapPeer,
    LeapPeerOptions as LeapPeerOptions,
)
