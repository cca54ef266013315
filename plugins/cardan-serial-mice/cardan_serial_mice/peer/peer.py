"""Serves a simulated serial device at a pseudo-terminal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.errors import ConfigurationError, OptionError
from cardan.sim_peers.backends.pseudo_terminal import PseudoTerminal
from cardan.sim_peers.command import option
from cardan.sim_peers.spacemouse.motion_script import ScriptedPuck
from cardan.sim_peers.spacemouse.peer import PuckPeer, PuckPeerOptions
from cardan_serial_mice.peer.core import SimulatedSerialPuck, simulated_serial_puck
from cardan_serial_mice.protocol import SERIAL_MODELS, serial_model_by_key

SCRIPT_DELAY_S = 1.0
"""Delay of the script after the host has started the device, to let the host find the cap at
rest."""


@dataclass(frozen=True, kw_only=True)
class SerialPuckPeerOptions(PuckPeerOptions):
    """Options of the simulated device, its script and its port.

    The script starts `SCRIPT_DELAY_S` after a program has first started the device.
    """

    model: str = option(
        "magellan",
        "Device model; see --list-models.",
        metavar="NAME",
        listed=[(model.key, model.name) for model in SERIAL_MODELS],
    )
    port: str = option("", "Its serial port: a link to a pseudo-terminal.", metavar="LINK")
    boot_s: Annotated[float, bounds.NOT_NEGATIVE] | None = None
    """Start-up time: from power, which the open port supplies, to the first command that it
    receives; None: the default of its kind."""


class SerialPuckPeer(PuckPeer[SimulatedSerialPuck]):
    """A simulated serial device, moved by a script or by the keyboard.

    Raises ConfigurationError without a port, OptionError for an unknown model, ScriptError for an
    unknown or unsuitable script or fault.
    """

    def __init__(self, options: SerialPuckPeerOptions) -> None:
        if not options.port:
            raise ConfigurationError("port", "give the path at which its port is to be")
        try:
            model = serial_model_by_key(options.model)
        except KeyError:
            allowed = f"one of {', '.join(model.key for model in SERIAL_MODELS)}"
            raise OptionError("model", options.model, allowed) from None
        device = simulated_serial_puck(
            model,
            faults=options.faults,
            jitter_lsb=options.jitter_lsb,
            seed=options.seed,
            boot_s=options.boot_s,
        )
        waits = options.start_on_connect and not options.keyboard
        super().__init__(
            device,
            PseudoTerminal(options.port, device, options.mode),
            options,
            script_s=math.inf if waits else 0.0,
        )
        self._waits = waits
        """The script waits for a host."""
        if waits:
            device.faults_from_s = math.inf

    def _follow(self, now_s: float) -> None:
        super()._follow(now_s)
        if self._waits and self.device.host_began:
            self._waits = False
            self.device.faults_from_s = self.device_s() + SCRIPT_DELAY_S
            # Replaced in tests by their own motion.
            if isinstance(self.motion, ScriptedPuck):
                self.motion.start(self.device.faults_from_s)
