"""The simulated 3Dconnexion device and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Exchange
from cardan.conform.simulation import Simulation
from cardan.conform.timeline import Kind
from cardan.protocols.connexion.devices import model_by_key
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse

_MODEL = "spacenavigator"
_WITH_BATTERY = "spacemouse-wireless"
_RIGHT, _CLOCKWISE = (0.0, -0.5, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
_AXES = {"push": _RIGHT, "twist": _CLOCKWISE, "let-go": (0.0,) * 6, "unplug": _RIGHT}
"""Deflection by what the operator is asked to do."""


class ConnexionSimulation(Simulation):
    """Moves the simulated device as an operator who follows the instructions."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        super().__init__(exchange)
        key = _WITH_BATTERY if "low-battery" in faults else _MODEL
        self._device = SimulatedSpaceMouse(
            model_by_key(key), faults=faults, jitter_lsb=1, seed=seed
        )
        self._refused_s = faults.get("refuse", 0.0)
        self._listens = False

    def _turn(self) -> None:
        for report in self._device.reports(self._now_s):
            if self._listens:
                self._hear("", report)
        if self._listens and not self._device.plugged:
            self._listens = False
            self._hear("", kind=Kind.CLOSED)

    def _next_s(self) -> float:
        return self._device.next_due_s

    def _time_passed(self) -> None:
        self._device.skip_to(self._now_s)

    def _take(self, data: bytes, channel: str) -> None:
        self._device.output(data, self._now_s)

    def _open(self, channel: str) -> None:
        model = self._device.model
        self._listens = self._now_s >= self._refused_s
        if self._listens:
            ids = f"{model.vendor_id:04x}:{model.product_id:04x}"
            self._hear("", kind=Kind.OPENED, note=ids)
        else:
            self._hear("", kind=Kind.REFUSED, note="the device cannot be opened")

    def _by_hand(self, what: str) -> None:
        device = self._device
        if what in _AXES:
            device.set_axes(_AXES[what])
        if what == "press":
            device.press(device.model.buttons[0])
        elif what == "release":
            device.release(device.model.buttons[0])
        elif what == "unplug":
            device.unplug()
