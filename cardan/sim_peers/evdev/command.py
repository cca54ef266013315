"""Pad and keyboard as ``cardan sim gamepad`` and ``cardan sim keyboard`` have them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.evdev.faults import FAULTS
from cardan.sim_peers.evdev.hand import GAMEPAD_SCRIPTS, KEYBOARD_SCRIPTS, SCRIPT_VERBS
from cardan.sim_peers.evdev.models import MODELS
from cardan.sim_peers.evdev.peer import EvdevPeer, EvdevPeerOptions

READY = "Prints READY and where it is once it can be opened."
SPEAKS = (
    "[input events](protocols/evdev.md), a frame per packet of a Unix socket, or the "
    "kernel's own by uinput"
)


@dataclass(frozen=True, kw_only=True)
class GamepadOptions(EvdevPeerOptions):
    """A pad of one of several models."""

    model: str = option(
        "",
        "Which pad; see --list-models.",
        metavar="NAME",
        listed=[(model.key, model.name) for model in MODELS if model.is_gamepad],
    )


class Gamepad(PeerCommand[GamepadOptions]):
    """An Xbox or PlayStation gamepad, as Linux gives its events to programs."""

    Options, Peer = GamepadOptions, EvdevPeer
    page, speaks = "simulated-devices.md", SPEAKS
    epilog = READY
    faults, scripts, verbs = FAULTS, GAMEPAD_SCRIPTS, SCRIPT_VERBS


@dataclass(frozen=True, kw_only=True)
class KeyboardOptions(EvdevPeerOptions):
    """The one keyboard."""

    kind: Literal["gamepad", "keyboard"] = "keyboard"


class Keyboard(PeerCommand[KeyboardOptions]):
    """A keyboard, as Linux gives its events to programs."""

    Options, Peer = KeyboardOptions, EvdevPeer
    page, speaks = "simulated-devices.md", SPEAKS
    epilog = READY
    faults, scripts, verbs = FAULTS, KEYBOARD_SCRIPTS, SCRIPT_VERBS
