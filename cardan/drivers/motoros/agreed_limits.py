"""Limits that hold for a motion: ours, or the controller's if narrower."""

from __future__ import annotations

from cardan.protocols.simple_message.messages import VelocityInfo
from cardan.types import JointLimits

FLOAT32_SHARE = 1.0 - 1e-6
"""Factor on a limit received as float32, so that values sent as float32 do not exceed it."""


def agreed_limits(limits: JointLimits, info: VelocityInfo) -> JointLimits:
    """Narrow `limits` by those that the controller reports for its velocity mode."""
    lower, upper = [], []
    for a, b, low, high in zip(
        limits.lower, limits.upper, info.pos_min, info.pos_max, strict=False
    ):
        known = low < high and max(a, low) < min(b, high)
        lower.append(max(a, low) if known else a)
        upper.append(min(b, high) if known else b)
    return JointLimits(
        tuple(lower),
        tuple(upper),
        _narrower(limits.velocity, info.v_max),
        _narrower(limits.acceleration, info.a_max),
    )


def _narrower(ours: tuple[float, ...], theirs: tuple[float, ...]) -> tuple[float, ...]:
    """Return the lesser of each pair; values of 0 or below are no limits."""
    return tuple(
        min(a, FLOAT32_SHARE * b) if b > 0.0 else a for a, b in zip(ours, theirs, strict=False)
    )
