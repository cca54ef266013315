"""A simulated lever at a pseudo-terminal, moved by a script: ``cardan sim lever``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cardan.sim_peers.backends.pseudo_terminal import PseudoTerminal
from cardan.sim_peers.base import FaultSwitch, ScriptStep, load_script
from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.device_peer import DevicePeer, DevicePeerOptions
from cardan.sim_peers.motion_profile import VectorMotion, VectorRamp
from cardan.sim_peers.periodic import PERIODIC_FAULTS, PeriodicDevice
from cardan.sim_peers.scripted import Action, MotionScript, StepWords, moving, setting

from cardan_lever.protocol import PERIOD_S, Report, encode

FAULTS = (
    *PERIODIC_FAULTS,
    FaultSwitch("cut", "every VALUE-th line ends halfway", 10.0, 1.0),
)
VERBS = {
    "push": "push FORWARD LEFT TWIST [over SECONDS]",
    "swing": "swing FORWARD LEFT TWIST over SECONDS [times N] [phase DEGREES]",
    "pull": "pull",
    "release": "release",
    "loop": "loop",
}
SCRIPTS = {
    "demo": """
        # with the trigger pulled to and fro, to both sides, a twist, for ever
        0.5  pull
        0.6  swing 0.6 0 0 over 2
        2.6  swing 0 0.6 0 over 2
        4.6  swing 0 0 0.5 over 2
        6.8  release
        7.0  loop
    """,
    "rest": """
        # nobody touches it
        1.0  loop
    """,
}
_DEFLECTIONS = ("FORWARD", "LEFT", "TWIST")


class SimulatedLever(PeriodicDevice[bytes]):
    """Sends its line every `PERIOD_S`."""

    def __init__(self, faults: Mapping[str, float]) -> None:
        super().__init__(PERIOD_S, faults, FAULTS)
        self.deflections = (0.0, 0.0, 0.0)
        """Forward, left, twist; the lever stops at -1 and 1."""
        self.trigger = False
        self._lines = 0
        self._cut_every = int(faults.get("cut", 0.0))

    def report(self) -> bytes:
        """Return the line for the present state."""
        forward, left, twist = (max(-1.0, min(1.0, each)) for each in self.deflections)
        line = encode(Report(forward, left, twist, self.trigger))
        self._lines += 1
        cut = self._cut_every and self._lines % self._cut_every == 0
        return line[: len(line) // 2] if cut else line


class ScriptedLever(MotionScript[SimulatedLever]):
    """Moves the lever by a script."""

    def __init__(self, steps: Sequence[ScriptStep]) -> None:
        self._motion = VectorMotion((0.0, 0.0, 0.0), PERIOD_S)
        super().__init__(steps, VERBS, [self._motion])

    def _read(self, words: StepWords) -> Action[SimulatedLever]:
        if words.verb == "push":
            return moving(
                self._motion, VectorRamp(words.numbers(_DEFLECTIONS, -1.0, 1.0), words.over())
            )
        if words.verb == "swing":
            amplitude = words.numbers(_DEFLECTIONS, -1.0, 1.0)
            return moving(self._motion, words.swing(amplitude, PERIOD_S))
        return setting("trigger", words.verb == "pull")

    def _hold(self, device: SimulatedLever, now_s: float) -> None:
        device.deflections = self._motion.advance(now_s)


@dataclass(frozen=True, kw_only=True)
class LeverPeerOptions(DevicePeerOptions):
    """Options of :class:`LeverPeer`, in addition to script, faults and seed."""

    path: str = option("lever.port", "The serial port to create.", metavar="LINK")


class LeverPeer(DevicePeer[SimulatedLever, bytes]):
    """A simulated lever at a serial port. Raises ScriptError for a script or a fault."""

    def __init__(self, options: LeverPeerOptions) -> None:
        device = SimulatedLever(options.faults)
        motion = ScriptedLever(load_script(options.script, SCRIPTS, VERBS))
        super().__init__(device, motion, PseudoTerminal(options.path), options)


class LeverCommand(PeerCommand[LeverPeerOptions]):
    """A three-axis lever with a trigger at a serial port."""

    Options, Peer = LeverPeerOptions, LeverPeer
    page, speaks = "https://lever.example/cardan", "lines of text, a pseudo-terminal"
    epilog = "Prints READY and the port's path once it can be opened."
    faults, scripts, verbs = FAULTS, SCRIPTS, VERBS
