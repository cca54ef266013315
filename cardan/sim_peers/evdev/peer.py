"""Serves a simulated gamepad or keyboard, on a socket or as a device of the kernel's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.errors import ConfigurationError, OptionError
from cardan.sim_peers.base import load_script
from cardan.sim_peers.carriers.base import Carrier
from cardan.sim_peers.command import option
from cardan.sim_peers.evdev.carriers import EventSocket, UinputCarrier
from cardan.sim_peers.evdev.core import InputEvents, SimulatedInput
from cardan.sim_peers.evdev.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand
from cardan.sim_peers.evdev.models import MODELS, Model
from cardan.sim_peers.hand_peer import HandPeer, NodeOptions


@dataclass(frozen=True, kw_only=True)
class EvdevPeerOptions(NodeOptions):
    """What to simulate and where."""

    kind: Literal["gamepad", "keyboard"] = "gamepad"
    path: str = option(
        "",
        "Unix seqpacket socket: packets of struct input_event.",
        name="events",
        metavar="PATH",
    )
    """Created when the peer opens."""
    uinput: bool = option(False, "An input device of this machine's kernel (/dev/uinput).")
    """Instead of a socket."""
    model: str = ""
    """Key of the model; empty: the first of its kind."""
    jitter_lsb: Annotated[int, bounds.NOISE_COUNTS] = 0
    """Noise of the sticks while they are deflected, counts."""


class EvdevPeer(HandPeer[SimulatedInput, InputEvents]):
    """A simulated input device, for any number of programs up to 8 on its socket.

    Raises OptionError for a model that does not exist, ScriptError for a script or fault that does
    not exist or does not fit.
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
        carrier: Carrier[InputEvents]
        if options.uinput:
            carrier = UinputCarrier(device)
        else:
            carrier = EventSocket(options.path, device, options.faults, options.seed, options.mode)
        super().__init__(device, ScriptedHand(steps, device), carrier, options)


def _model(options: EvdevPeerOptions) -> Model:
    models = [model for model in MODELS if model.is_gamepad == (options.kind == "gamepad")]
    for model in models:
        if options.model in ("", model.key):
            return model
    raise OptionError("model", options.model, f"one of {', '.join(each.key for each in models)}")
