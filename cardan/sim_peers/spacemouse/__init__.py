"""A simulated 3Dconnexion device: the puck, the hands that move it, and a socket to open it by."""

from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.faults import FAULTS
from cardan.sim_peers.spacemouse.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand, play
from cardan.sim_peers.spacemouse.keyboard import KeyboardHand
from cardan.sim_peers.spacemouse.socket import SpaceMousePeer, SpaceMousePeerOptions

__all__ = [
    "FAULTS",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "KeyboardHand",
    "ScriptedHand",
    "SimulatedSpaceMouse",
    "SpaceMousePeer",
    "SpaceMousePeerOptions",
    "play",
]
