"""Serves a simulated gamepad or keyboard, on a socket or as a device of the kernel's."""

from __future__ import annotations

import selectors
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from cardan import bounds
from cardan.errors import ConfigurationError, OptionError
from cardan.options import check_options
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.evdev.carriers import Carrier, SocketCarrier, UinputCarrier
from cardan.sim_peers.evdev.core import SimulatedInput
from cardan.sim_peers.evdev.hand import SCRIPT_VERBS, SCRIPTS, ScriptedHand, play
from cardan.sim_peers.evdev.models import MODELS, Model
from cardan.sim_peers.hand_peer import HandPeer

STALL_S = 0.016
"""Motion older than this when the peer comes to run is left out: a late peer makes no burst."""


@dataclass(frozen=True, kw_only=True)
class EvdevPeerOptions:
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
    script: str = "demo"
    """A built-in script or a file."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of `FAULTS`; times count from the start of the script."""
    jitter_lsb: Annotated[int, bounds.NOISE_COUNTS] = 0
    """Noise of the sticks while they are deflected, counts."""
    seed: int = 0
    """Of the noise and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts when the first client connects, not when the peer opens; socket only."""

    def __post_init__(self) -> None:
        check_options(self)


class EvdevPeer(HandPeer):
    """A simulated input device, for any number of programs up to 8 on its socket.

    Raises OptionError for a model that does not exist, ScriptError for a script or fault that does
    not exist or does not fit.
    """

    def __init__(self, options: EvdevPeerOptions) -> None:
        super().__init__()
        model = _model(options)
        if options.uinput == bool(options.path):
            raise ConfigurationError(
                "path, uinput", "give either the path of a socket or uinput, one of the two"
            )
        self.options = options
        self.device = SimulatedInput(
            model,
            faults=options.faults,
            jitter_lsb=options.jitter_lsb,
            seed=options.seed,
            uinput=options.uinput,
        )
        steps = load_script(options.script, SCRIPTS[options.kind], SCRIPT_VERBS)
        self._hand = ScriptedHand(steps, self.device)
        self._carrier: Carrier | None = None

    @property
    def endpoint(self) -> str:
        """The path of the socket or of the node."""
        return self._carrier.endpoint if self._carrier is not None else self.options.path

    @property
    def overruns(self) -> int:
        """How often a client of the socket was too slow, and its events were dropped."""
        return self._carrier.overruns if isinstance(self._carrier, SocketCarrier) else 0

    def open(self) -> None:
        """Create the socket or the node; AddressError when that cannot be."""
        if self._selector is not None:
            return
        options = self.options
        self._selector = selectors.DefaultSelector()
        if options.uinput:
            self._carrier = UinputCarrier(self.device, self._selector, self._device_s)
        else:
            self._carrier = SocketCarrier(
                options.path,
                self.device,
                options.faults,
                options.seed,
                self._selector,
                self._device_s,
                self._begin,
            )
        try:
            self._carrier.appear()
        except BaseException:
            self.close()
            raise
        if options.uinput or not options.start_on_connect:
            self._begin()

    def close(self) -> None:
        """Close every connection, remove the socket or the node."""
        if self._carrier is not None:
            self._carrier.vanish()
        if self._selector is not None:
            self._selector.close()
        self._selector = self._carrier = self._start_s = None

    # -- time ----------------------------------------------------------------------------------

    @property
    def _hand_due_s(self) -> float:
        return min(self.device.next_due_s, self._hand.next_due_s)

    def _play(self, now_s: float) -> None:
        carrier = self._carrier
        if self._start_s is None or carrier is None:
            return
        device_s = now_s - self._start_s
        if device_s - self._played_s > STALL_S and self.device.next_due_s < device_s - STALL_S:
            self._hand.advance(device_s - STALL_S, self.device)
            self.device.skip_to(device_s - STALL_S)
        self._played_s = device_s
        frames = play(self.device, self._hand, device_s)
        if self.device.plugged != carrier.there:
            if self.device.plugged:
                carrier.appear()
            else:
                carrier.vanish()
        if frames and carrier.there:
            carrier.send(frames)


def _model(options: EvdevPeerOptions) -> Model:
    models = [model for model in MODELS if model.is_gamepad == (options.kind == "gamepad")]
    for model in models:
        if options.model in ("", model.key):
            return model
    raise OptionError("model", options.model, f"one of {', '.join(each.key for each in models)}")
