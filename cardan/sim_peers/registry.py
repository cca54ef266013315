"""Finds simulated peers by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from typing import Any

from cardan.common.plugins import Finder, entry_points
from cardan.sim_peers.command import PeerCommand

ENTRY_POINT_GROUP = "cardan.sim_peers"

BUILT_IN = {
    "abb-gofa": "cardan.sim_peers.egm_controller.udp:EgmControllerCommand",
    "arm": "cardan.sim_peers.arm.command:SimulatedArmCommand",
    "gamepad": "cardan.sim_peers.evdev.peer:GamepadCommand",
    "keyboard": "cardan.sim_peers.evdev.peer:KeyboardCommand",
    "motoman-gp8": "cardan.sim_peers.motoros_controller.tcp:MotorosControllerCommand",
    "network": "cardan.sim_peers.network:SimulatedNetworkCommand",
    "phone": "cardan.sim_peers.handheld.peer:PhonePageCommand",
    "ros2-arm": "cardan.sim_peers.ros2_arm.peer:Ros2ArmCommand",
    "ros2-device": "cardan.sim_peers.ros2_device.peer:Ros2DeviceCommand",
    "spacemouse": "cardan.sim_peers.spacemouse.peer:SpaceMouseCommand",
    "ur": "cardan.sim_peers.ur_controller.tcp:UrControllerCommand",
    "xr": "cardan.sim_peers.handheld.peer:XrPageCommand",
}
"""Built-in peers. Other packages add theirs by an entry point of the same form."""


FINDER: Finder[PeerCommand[Any]] = Finder(
    PeerCommand,
    "simulated peer",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, load, load_all, using = FINDER.names, FINDER.load, FINDER.load_all, FINDER.using
