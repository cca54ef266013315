"""Pulse modulation: many strengths of rumble from a motor that is on or off."""

from __future__ import annotations

import math

from cardan.types import NEVER_S

PULSE_S = 0.02
"""Shortest time on or off: the motor follows nothing faster, and this limits it to 50 writes per
second."""

PERIOD_S = 0.08
"""Period of the pulses at medium strength: 12.5 Hz feels like strength and not like knocking."""

LONGEST_PERIOD_S = 0.4
"""Longest period: below one pulse in it the motor is off, above one gap in it on."""

CUT_OFF_S = 0.9
"""Time after which a strength without renewal ends: its program may have died."""


class Rumble:
    """On-off state of the motor by strength and time. Times are monotonic, s."""

    def __init__(self) -> None:
        self.on = False
        """Last commanded state of the motor."""
        self._level = 0.0
        self._renewed_s = NEVER_S
        self._switched_s = NEVER_S

    @property
    def level(self) -> float:
        """Requested strength, 0..1."""
        return self._level

    def set(self, level: float, now_s: float) -> None:
        """Request the strength `level`, 0..1 (else clamped; NaN is off), for up to `CUT_OFF_S`."""
        self._level = min(max(level, 0.0), 1.0) if math.isfinite(level) else 0.0
        self._renewed_s = now_s

    def update(self, now_s: float) -> bool:
        """Return True if the motor has to be switched at `now_s`; `on` is its new state."""
        if self._level and now_s - self._renewed_s > CUT_OFF_S:
            self._level = 0.0
        since_s = now_s - self._switched_s
        on_s, off_s = pulse(self._level)
        if since_s < (on_s if self.on else off_s):
            return False
        if since_s < PULSE_S:
            return False
        wanted = not self.on if on_s and off_s else bool(on_s)
        if wanted is self.on:
            return False
        self.on = wanted
        self._switched_s = now_s
        return True

    def reset(self) -> None:
        """Reset for a new link: motor off, no strength requested."""
        self.on = False
        self._level = 0.0
        self._switched_s = NEVER_S


def pulse(level: float) -> tuple[float, float]:
    """Return time on and time off, s, for `level` (0..1); (0, 0.0) and so on if constant."""
    if level <= PULSE_S / LONGEST_PERIOD_S:
        return 0.0, 0.0
    if level >= 1.0 - PULSE_S / LONGEST_PERIOD_S:
        return math.inf, 0.0
    if level <= 0.5:
        on_s = max(PULSE_S, level * PERIOD_S)
        return on_s, on_s / level - on_s
    off_s = max(PULSE_S, (1.0 - level) * PERIOD_S)
    return off_s / (1.0 - level) - off_s, off_s
