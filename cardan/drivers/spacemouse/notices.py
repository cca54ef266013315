"""What a conversation with a device says beside the device's reports."""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.connexion import Model


class Doubt(NamedTuple):
    """What was known of the cap and the buttons counts no more; the device is still there."""

    reason: str
    """Why, in words, and what the operator does about it."""


class Lapse(NamedTuple):
    """The device started anew by itself, and is being given its settings again."""

    reason: str


class Restart(NamedTuple):
    """It has its settings again."""

    model: Model
    period_s: float


Notice = Doubt | Lapse | Restart
