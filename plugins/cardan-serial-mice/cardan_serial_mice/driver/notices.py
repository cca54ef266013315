"""Changes of a serial device's condition, beside its reports."""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.connexion.devices import Model


class Doubt(NamedTuple):
    """The known state of cap and buttons is void; the device is still there."""

    reason: str
    """The reason, and the operator's remedy."""


class Lapse(NamedTuple):
    """The device started anew by itself, and is being given its settings again."""

    reason: str


class Restart(NamedTuple):
    """The device was started again and has its settings."""

    model: Model
    period_s: float


Notice = Doubt | Lapse | Restart
