"""A simulated gamepad or keyboard: the hardware, the kernel's side of it, and a scripted hand."""

from cardan.sim_peers.evdev.core import SimulatedInput
from cardan.sim_peers.evdev.faults import FAULTS
from cardan.sim_peers.evdev.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand, play
from cardan.sim_peers.evdev.models import MODELS, Model
from cardan.sim_peers.evdev.peer import EvdevPeer, EvdevPeerOptions

__all__ = [
    "FAULTS",
    "MODELS",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "EvdevPeer",
    "EvdevPeerOptions",
    "Model",
    "ScriptedHand",
    "SimulatedInput",
    "play",
]
