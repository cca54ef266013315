"""Limits and options of an arm that are exchanged between two of its ticks, all together."""

from __future__ import annotations

from dataclasses import dataclass

from cardan.gateway.arm.authority import AuthorityOptions
from cardan.gateway.arm.body import ServoTuning
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.hand.source import HandTuning
from cardan.gateway.motion.reference import ReferenceLimits


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """What an :class:`~cardan.gateway.arm.controller.ArmController` takes by its `tune`."""

    limits: ReferenceLimits
    watchdogs: Watchdogs
    authority: AuthorityOptions
    hand: HandTuning | None
    servo: ServoTuning | None
    ends: str = ""
    """Why motions of programs that are under way end: they were planned by other limits. Empty:
    they go on."""
    disarms: bool = False
    """Whether the arm is disarmed for it: only while it is `unclaimed`."""
