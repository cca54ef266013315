"""A simulated 3Dconnexion device: the puck, the hands that move it, and the ways to open it."""

from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.faults import FAULTS
from cardan.sim_peers.spacemouse.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand, play
from cardan.sim_peers.spacemouse.keyboard import KeyboardHand
from cardan.sim_peers.spacemouse.serial import SerialSpaceMousePeer, SerialSpaceMousePeerOptions
from cardan.sim_peers.spacemouse.serial_core import SimulatedSerialPuck, simulated_serial_puck
from cardan.sim_peers.spacemouse.serial_line import SERIAL_FAULTS
from cardan.sim_peers.spacemouse.socket import SpaceMousePeer, SpaceMousePeerOptions
from cardan.sim_peers.spacemouse.uhid import UhidSpaceMousePeer, UhidSpaceMousePeerOptions
from cardan.sim_peers.spacemouse.usbip import UsbipSpaceMousePeer, UsbipSpaceMousePeerOptions

__all__ = [
    "FAULTS",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "SERIAL_FAULTS",
    "KeyboardHand",
    "ScriptedHand",
    "SerialSpaceMousePeer",
    "SerialSpaceMousePeerOptions",
    "SimulatedSerialPuck",
    "SimulatedSpaceMouse",
    "SpaceMousePeer",
    "SpaceMousePeerOptions",
    "UhidSpaceMousePeer",
    "UhidSpaceMousePeerOptions",
    "UsbipSpaceMousePeer",
    "UsbipSpaceMousePeerOptions",
    "play",
    "simulated_serial_puck",
]
