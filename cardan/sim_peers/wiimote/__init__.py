"""A simulated Wii Remote: its memory and sensors, the hand that holds it, and ways to reach it."""

from cardan.sim_peers.wiimote.core import EXTENSIONS, LogEntry, SimulatedWiimote
from cardan.sim_peers.wiimote.faults import FAULTS
from cardan.sim_peers.wiimote.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand, play
from cardan.sim_peers.wiimote.peer import WiimotePeer, WiimotePeerOptions

__all__ = [
    "EXTENSIONS",
    "FAULTS",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "LogEntry",
    "ScriptedHand",
    "SimulatedWiimote",
    "WiimotePeer",
    "WiimotePeerOptions",
    "play",
]
