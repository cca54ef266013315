"""Serves a simulated gamepad or keyboard, on a socket or as a uinput device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from cardan.common import bounds
from cardan.errors import ConfigurationError, OptionError
from cardan.sim_peers.backends.base import DeviceBackend
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.device_peer import DeviceNodeOptions, DevicePeer
from cardan.sim_peers.evdev.backends import EventSocket, UinputBackend
from cardan.sim_peers.evdev.core import InputEvents, SimulatedInput
from cardan.sim_peers.evdev.faults import FAULTS
from cardan.sim_peers.evdev.models import MODELS, InputDeviceModel
from cardan.sim_peers.evdev.motion_script import (
    GAMEPAD_SCRIPTS,
    KEYBOARD_SCRIPTS,
    SCRIPT_VERBS,
    SCRIPTS,
    ScriptedInput,
)


@dataclass(frozen=True, kw_only=True)
class EvdevPeerOptions(DeviceNodeOptions):
    """Options of a simulated input device."""

    kind: Literal["gamepad", "keyboard"] = "gamepad"
    path: str = option(
        "",
        "Unix seqpacket socket: packets of struct input_event.",
        name="events",
        metavar="PATH",
    )
    """Created when the peer opens."""
    uinput: bool = option(False, "An input device of this machine's kernel (/dev/uinput).")
    """Use uinput instead of a socket."""
    model: str = ""
    """Key of the model; empty: the first of its kind."""
    jitter_lsb: Annotated[int, bounds.NOISE_COUNTS] = 0
    """Noise of the sticks while they are deflected, counts."""


class EvdevPeer(DevicePeer[SimulatedInput, InputEvents]):
    """Simulated input device, for up to 8 programs on its socket.

    Raises OptionError for an unknown model, ScriptError for an unknown or unsuitable script or
    fault.
    """

    def __init__(self, options: EvdevPeerOptions) -> None:
        model = _model(options)
        if options.uinput == bool(options.path):
            raise ConfigurationError(
                "path, uinput", "give either the path of a socket or uinput, one of the two"
            )
        device = SimulatedInput(
            model,
            faults=options.faults,
            jitter_lsb=options.jitter_lsb,
            seed=options.seed,
            uinput=options.uinput,
        )
        steps = load_script(options.script, SCRIPTS[options.kind], SCRIPT_VERBS)
        backend: DeviceBackend[InputEvents]
        if options.uinput:
            backend = UinputBackend(device)
        else:
            backend = EventSocket(options.path, device, options.faults, options.seed, options.mode)
        super().__init__(device, ScriptedInput(steps, device), backend, options)


def _model(options: EvdevPeerOptions) -> InputDeviceModel:
    models = [model for model in MODELS if model.is_gamepad == (options.kind == "gamepad")]
    for model in models:
        if options.model in ("", model.key):
            return model
    raise OptionError("model", options.model, f"one of {', '.join(each.key for each in models)}")


@dataclass(frozen=True, kw_only=True)
class GamepadPeerOptions(EvdevPeerOptions):
    """Options of a simulated gamepad."""

    model: str = option(
        "",
        "Gamepad model; see --list-models.",
        metavar="NAME",
        listed=[(model.key, model.name) for model in MODELS if model.is_gamepad],
    )


class GamepadCommand(PeerCommand[EvdevPeerOptions]):
    """An Xbox or PlayStation gamepad, as Linux gives its events to programs."""

    Options: ClassVar[type[EvdevPeerOptions]] = GamepadPeerOptions
    Peer = EvdevPeer
    page = "simulated-peers.md"
    example = "--events gamepad.sock"
    speaks = (
        "[input events](gamepad.md#input-events-byte-for-byte), a frame per packet of a Unix "
        "socket, or the kernel's own by uinput"
    )
    epilog = "Prints READY and where it is once it can be opened."
    faults, scripts, verbs = FAULTS, GAMEPAD_SCRIPTS, SCRIPT_VERBS


@dataclass(frozen=True, kw_only=True)
class KeyboardPeerOptions(EvdevPeerOptions):
    """Options of the simulated keyboard."""

    kind: Literal["gamepad", "keyboard"] = "keyboard"


class KeyboardCommand(GamepadCommand):
    """A keyboard, as Linux gives its events to programs."""

    Options, scripts = KeyboardPeerOptions, KEYBOARD_SCRIPTS
    example = "--events keyboard.sock"
