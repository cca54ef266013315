"""Changes of a serial device's condition, in addition to its reports."""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.connexion.devices import Model


class Doubt(NamedTuple):
    """The known state of cap and buttons is invalid; the device is still present."""

    reason: str
    """Reason, and the operator's remedy."""


class Lapse(NamedTuple):
    """The device restarted by itself, and is getting its settings again."""

    reason: str


class Restart(NamedTuple):
    """The device was restarted and has its settings."""

    model: Model
    period_s: float


Notice = Doubt | Lapse | Restart
