"""A simulated JR3 force-torque sensor: the board, the loads on it, and its place on a CAN bus."""

from cardan.sim_peers.jr3.core import SimulatedJr3
from cardan.sim_peers.jr3.faults import FAULTS
from cardan.sim_peers.jr3.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand, play
from cardan.sim_peers.jr3.peer import Jr3Peer, Jr3PeerOptions

__all__ = [
    "FAULTS",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "Jr3Peer",
    "Jr3PeerOptions",
    "ScriptedHand",
    "SimulatedJr3",
    "play",
]
