"""A simulated Leap Motion tracking service: hands, tracker, and the WebSocket they are told by."""

from cardan.sim_peers.leap.anatomy import Anatomy, HandPosture
from cardan.sim_peers.leap.core import SimulatedHand, SimulatedLeapService, rotation_rows
from cardan.sim_peers.leap.faults import FAULTS
from cardan.sim_peers.leap.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHands, play
from cardan.sim_peers.leap.service import LeapPeer, LeapPeerOptions

__all__ = [
    "FAULTS",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "Anatomy",
    "HandPosture",
    "LeapPeer",
    "LeapPeerOptions",
    "ScriptedHands",
    "SimulatedHand",
    "SimulatedLeapService",
    "play",
    "rotation_rows",
]
