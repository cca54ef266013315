"""What the carriers of a simulated 3Dconnexion device share: its hand, and time."""

from __future__ import annotations

import logging
import math
import selectors
import sys
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from cardan import bounds
from cardan.errors import OptionError, ScriptError
from cardan.options import check_options
from cardan.protocols.connexion import MODELS, model_by_key
from cardan.sim_peers.base import load_script
from cardan.sim_peers.command import option
from cardan.sim_peers.hand_peer import HandPeer
from cardan.sim_peers.spacemouse.core import ONE_PERIOD_S, SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.hand import (
    SCRIPT_VERBS,
    SCRIPTS,
    Hand,
    Puck,
    ScriptedHand,
    play,
)
from cardan.sim_peers.spacemouse.keyboard import (
    KEYBOARD_HELP,
    KeyboardHand,
    Terminal,
    status_line,
)

STALL_S = ONE_PERIOD_S
"""Motion older than this when the peer comes to run is left out: a late peer makes no burst."""
STATUS_PERIOD_S = 0.1
"""How often the line for the person at the keyboard is drawn."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PuckOptions:
    """What to simulate, and who moves it."""

    model: str = "spacenavigator"
    """Key of the model."""
    script: str = "demo"
    """A built-in script or a file."""
    keyboard: bool = option(False, "Move it with this terminal's keys.")
    """Instead of the script."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Values by the names of `FAULTS`; times count from the start of the script."""
    jitter_lsb: Annotated[int, bounds.NOISE_COUNTS] = 1
    """Noise on every axis while deflected, counts."""
    seed: int = 0
    """Of the noise and of the faults' choices."""
    start_on_connect: bool = True
    """The script starts when the first program opens the device, not when the peer opens."""

    def __post_init__(self) -> None:
        check_options(self)


class HeldPuckPeer(HandPeer):
    """A simulated puck that a hand moves in real time; subclasses carry what it sends.

    Raises ScriptError for a script that does not exist or does not fit.
    """

    def __init__(
        self,
        device: Puck,
        *,
        script: str,
        keyboard: bool,
        faults: Mapping[str, float],
        start_on_connect: bool,
    ) -> None:
        super().__init__()
        self.device = device
        self._faults = faults
        self._start_on_connect = start_on_connect
        self._keys: KeyboardHand | None = None
        self._terminal: Terminal | None = None
        self._hand: Hand
        if keyboard:
            self._hand = self._keys = KeyboardHand()
            self._terminal = Terminal()
        else:
            self._hand = ScriptedHand(load_script(script, SCRIPTS, SCRIPT_VERBS), device.model)
        self._opened_s = 0.0
        self._led = device.led
        self._status = ""
        self._status_due_s = math.inf

    # -- what a carrier does -------------------------------------------------------------------

    @property
    @abstractmethod
    def _there(self) -> bool:
        """Whether the host can see the device."""

    @abstractmethod
    def _appear(self) -> None:
        """Plug the device in. Raises a CardanError that says what to do."""

    @abstractmethod
    def _vanish(self) -> None:
        """Unplug the device. Never raises; twice is fine."""

    @abstractmethod
    def _deliver(self, reports: Sequence[bytes]) -> None:
        """Pass input reports on to whoever has the device open."""

    # -- the peer ------------------------------------------------------------------------------

    def open(self) -> None:
        """Plug the device in; take the terminal over. Raises a CardanError."""
        if self._selector is not None:
            return
        self._opened_s = time.monotonic()
        self._selector = selectors.DefaultSelector()
        try:
            self._appear()
            if self._terminal is not None:
                self._terminal.open()
                self._selector.register(self._terminal.fd, selectors.EVENT_READ, self._read_keys)
                print(KEYBOARD_HELP)
                self._status_due_s = self._opened_s
        except BaseException:
            self.close()
            raise
        if self._terminal is not None or not self._start_on_connect:
            self._start_s = self._opened_s

    def close(self) -> None:
        """Unplug the device for good, give the terminal back."""
        if self._selector is None:
            return
        self._vanish()
        if self._terminal is not None:
            self._terminal.close()
        self._selector.close()
        self._selector = None
        self._start_s = None

    # -- time ----------------------------------------------------------------------------------

    @property
    def _hand_due_s(self) -> float:
        return min(self.device.next_due_s, self._hand.next_due_s)

    def _next_due_s(self) -> float:
        return min(super()._next_due_s(), self._status_due_s)

    def _play(self, now_s: float) -> None:
        if self._start_s is None:
            return
        device_s = now_s - self._start_s
        if device_s - self._played_s > STALL_S:
            resumed_s = device_s - STALL_S
            self._hand.advance(resumed_s, self.device)
            self.device.skip_to(resumed_s)
        self._played_s = device_s
        reports = play(self.device, self._hand, device_s)
        if reports:
            self._deliver(reports)
        if self.device.plugged != self._there:
            if self.device.plugged:
                self._appear()
            else:
                self._vanish()
        if self.device.led != self._led:
            self._led = self.device.led
            _log.info("LED %s", "on" if self._led else "off")

    # -- the keyboard --------------------------------------------------------------------------

    def _read_keys(self) -> None:
        assert self._selector is not None
        assert self._terminal is not None
        assert self._keys is not None
        text = self._terminal.read()
        if text:
            now_s = time.monotonic()
            self._play(now_s)
            self._keys.feed(text, self._device_s(now_s))
        else:
            self._selector.unregister(self._terminal.fd)

    def _follow(self, now_s: float) -> None:
        """Draw the line for the person at the keyboard."""
        if now_s < self._status_due_s:
            return
        self._status_due_s = now_s + STATUS_PERIOD_S
        status = status_line(self.device)
        if status != self._status:
            self._status = status
            sys.stdout.write(f"\r{status}\x1b[K")
            sys.stdout.flush()


class PuckPeer(HeldPuckPeer):
    """A simulated HID device.

    Raises OptionError for a model that does not exist, ScriptError for a script or fault that does
    not exist or does not fit.
    """

    device: SimulatedSpaceMouse
    unfit_faults: Mapping[str, str] = {}
    """Faults that this carrier cannot have, and why."""

    def __init__(self, options: PuckOptions) -> None:
        try:
            model = model_by_key(options.model)
        except KeyError:
            allowed = f"one of {', '.join(model.key for model in MODELS)}"
            raise OptionError("model", options.model, allowed) from None
        for name in options.faults:
            if name in self.unfit_faults:
                raise ScriptError(f"fault {name}: {self.unfit_faults[name]}")
        super().__init__(
            SimulatedSpaceMouse(
                model, faults=options.faults, jitter_lsb=options.jitter_lsb, seed=options.seed
            ),
            script=options.script,
            keyboard=options.keyboard,
            faults=options.faults,
            start_on_connect=options.start_on_connect,
        )

    def _take_output(self, report: bytes) -> None:
        """Hand the device an output report of the host's."""
        self.device.output(report, self._device_s())
