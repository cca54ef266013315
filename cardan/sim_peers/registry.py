"""Finds simulated peers by name: the built-in table, then installed packages' entry points."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib.metadata import EntryPoints, entry_points
from typing import Any

from cardan.plugins import Finder, Loaded
from cardan.sim_peers.command import PeerCommand

ENTRY_POINT_GROUP = "cardan.sim_peers"

BUILT_IN = {
    "abb-gofa": "cardan.sim_peers.egm_controller.command:AbbGofa",
    "arm": "cardan.sim_peers.arm.command:Arm",
    "gamepad": "cardan.sim_peers.evdev.command:Gamepad",
    "jr3": "cardan.sim_peers.jr3.command:Jr3",
    "keyboard": "cardan.sim_peers.evdev.command:Keyboard",
    "leap": "cardan.sim_peers.leap.command:Leap",
    "motoman-gp8": "cardan.sim_peers.motoros_controller.command:MotomanGp8",
    "omni": "cardan.sim_peers.omni.command:Omni",
    "phone": "cardan.sim_peers.handheld.command:PhonePage",
    "ros2-arm": "cardan.sim_peers.ros2_arm.command:Ros2Arm",
    "ros2-device": "cardan.sim_peers.ros2_device.command:Ros2Device",
    "spacemouse": "cardan.sim_peers.spacemouse.command:SpaceMouse",
    "ur": "cardan.sim_peers.ur_controller.command:Ur",
    "wiimote": "cardan.sim_peers.wiimote.command:Wiimote",
    "xr": "cardan.sim_peers.handheld.command:XrPage",
}
"""Our own peers. Other packages add theirs by an entry point of the same form."""


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


_FINDER: Finder[PeerCommand[Any]] = Finder(PeerCommand, "simulated peer", BUILT_IN, _installed)


def names() -> tuple[str, ...]:
    """Every name of a simulated peer that can be loaded, sorted."""
    return _FINDER.names()


def load(name: str) -> type[PeerCommand[Any]]:
    """The declaration of the peer called `name`; ConfigurationError names the ones there are."""
    return _FINDER.load(name)


def load_all() -> Loaded[PeerCommand[Any]]:
    """Every peer class, and why others cannot be loaded."""
    return _FINDER.load_all()


def using(name: str, key: str) -> AbstractContextManager[None]:
    """What another package's peer raises inside is a ConfigurationError of `key`."""
    return _FINDER.using(name, key)
