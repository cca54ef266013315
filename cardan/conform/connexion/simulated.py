"""The simulated 3Dconnexion device and a pilot in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Act, Exchange
from cardan.conform.timeline import Kind
from cardan.protocols.connexion import model_by_key
from cardan.sim_peers.spacemouse import SimulatedSpaceMouse

LONGEST_S = 300.0
"""Of a simulated run; a script that waits for what never comes ends before."""
_MODEL = "spacenavigator"
_WITH_BATTERY = "spacemouse-wireless"
_RIGHT, _CLOCKWISE = (0.0, -0.5, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
_REST = (0.0,) * 6


class ConnexionRig:
    """Has the device moved as a person would who does what is asked."""

    def __init__(self, conduct: Exchange, faults: Mapping[str, float], seed: int) -> None:
        key = _WITH_BATTERY if "low-battery" in faults else _MODEL
        self._conduct = conduct
        self._device = SimulatedSpaceMouse(
            model_by_key(key), faults=faults, jitter_lsb=1, seed=seed
        )
        self._refused_s = faults.get("refuse", 0.0)
        self._open = False
        self._now_s = 0.0

    def run(self) -> None:
        """Until the pilot's script is over."""
        conduct, device = self._conduct, self._device
        while not conduct.over and self._now_s < LONGEST_S:
            self._do(conduct.due(self._now_s))
            for report in device.reports(self._now_s):
                if self._open:
                    self._do(conduct.heard(self._now_s, "", report))
            if self._open and not device.plugged:
                self._open = False
                self._do(conduct.heard(self._now_s, "", kind=Kind.CLOSED))
            if conduct.over:
                break
            self._now_s = max(self._now_s + 1e-6, min(device.next_due_s, conduct.next_s))
            device.skip_to(self._now_s)

    def _do(self, acts: list[Act]) -> None:
        device = self._device
        for act in acts:
            if act.kind is Kind.DATA:
                device.output(act.data, self._now_s)
            elif act.kind is Kind.OPENED:
                self._open = self._now_s >= self._refused_s
                kind = Kind.OPENED if self._open else Kind.REFUSED
                ids = f"{device.model.vendor_id:04x}:{device.model.product_id:04x}"
                note = ids if self._open else "the device cannot be opened"
                self._do(self._conduct.heard(self._now_s, "", kind=kind, note=note))
            elif act.kind is Kind.ASKED:
                self._by_hand(act.channel)

    def _by_hand(self, what: str) -> None:
        device = self._device
        if what == "push":
            device.set_axes(_RIGHT)
        elif what == "twist":
            device.set_axes(_CLOCKWISE)
        elif what == "let-go":
            device.set_axes(_REST)
        elif what == "press":
            device.press(device.model.buttons[0])
        elif what == "release":
            device.release(device.model.buttons[0])
        elif what == "unplug":
            device.set_axes(_RIGHT)
            device.unplug()
