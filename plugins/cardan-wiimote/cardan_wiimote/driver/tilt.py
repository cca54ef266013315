"""Tilt of the remote from its accelerometer, valid while this measures gravity alone."""

from __future__ import annotations

import math

from cardan.types import NEVER_S

Vector = tuple[float, float, float]

TRUSTED_G = (0.8, 1.2)
"""Outside this range the hand accelerates the remote, and gravity cannot be separated."""

UNCALIBRATED_G = (0.6, 1.4)
"""The same for a remote whose zero is unknown: it may be 0.2 g off."""

FREEZE_S = 0.25
"""Time after which an unmeasurable tilt counts as zero."""

SETTLED = 4.0
"""Time constants of the filter after which earlier input has no effect."""

SAMPLE_S = (0.002, 0.05)
"""Shortest and longest time of one sample: reports arrive in bursts."""

STILL_S, STILL_COSINE = 0.15, math.cos(math.radians(3.0))
"""Time, and angle, within which gravity must keep its direction to be taken as neutral: a hand that
waves sideways can keep 1 g within the trusted range."""

_UP: Vector = (0.0, 0.0, 1.0)
_TURNED = -1.0 + 1e-9
"""Cosine beyond which a remote is upside down, and all rotations to upright are equally short."""


class Tilt:
    """Low-passed direction of gravity, relative to level or to a captured attitude.

    Vectors are specific forces in g in the operator's axes: x forward, y left, z up. Times are
    monotonic, s.
    """

    def __init__(self, cut_off_hz: float, full_tilt_deg: float) -> None:
        self._rate = 2.0 * math.pi * cut_off_hz
        self._gain = 1.0 / math.sin(math.radians(full_tilt_deg))
        self.reset()

    def reset(self) -> None:
        """Discard all measurements; level is neutral."""
        self._up: Vector | None = None
        self._neutral = _UP
        self._capturing = False
        self._still: Vector | None = None
        self._still_s = NEVER_S
        self._sampled_s = self._trusted_s = self._doubted_s = NEVER_S

    def update(self, force_g: Vector, now_s: float, calibrated: bool = True) -> None:
        """Process a sample. `calibrated`: zero and 1 g of this accelerometer are known."""
        x, y, z = force_g
        low, high = TRUSTED_G if calibrated else UNCALIBRATED_G
        since_s, self._sampled_s = now_s - self._sampled_s, now_s
        if not low * low <= x * x + y * y + z * z <= high * high:
            self._doubted_s = now_s
            self._still = None
            return
        gone_s = FREEZE_S
        if self._capturing and now_s - self._doubted_s < SETTLED / self._rate:
            gone_s = 0.0  # The filter still holds the attitude before the hand moved.
        if self._up is None or now_s - self._trusted_s > gone_s:
            self._up = force_g
        else:
            shortest, longest = SAMPLE_S
            share = 1.0 - math.exp(-self._rate * min(max(since_s, shortest), longest))
            u, v, w = self._up
            self._up = (u + share * (x - u), v + share * (y - v), w + share * (z - w))
        self._trusted_s = now_s
        self._watch_stillness(self._up, now_s)

    def _watch_stillness(self, up: Vector, now_s: float) -> None:
        length = math.hypot(*up)
        x, y, z = here = (up[0] / length, up[1] / length, up[2] / length) if length else _UP
        still = self._still
        if still is None or x * still[0] + y * still[1] + z * still[2] < STILL_COSINE:
            self._still, self._still_s = here, now_s
        elif self._capturing and now_s - self._still_s >= STILL_S:
            self._capturing = False
            self._neutral = here

    def capture(self) -> None:
        """Take the attitude that is held still as neutral; until there is one, the tilt is zero."""
        self._capturing = True

    def trusted(self, now_s: float) -> bool:
        """Return True if the tilt is known at `now_s`."""
        return now_s - self._trusted_s <= FREEZE_S

    def rolled_and_dipped(self, now_s: float) -> tuple[float, float]:
        """Return tilt to the right and nose down, each in -1..1: its sine relative to that of the
        full tilt.

        Each fades as the other approaches 90 degrees. (0, 0) if unknown.
        """
        if self._up is None or self._capturing or not self.trusted(now_s):
            return 0.0, 0.0
        x, y, _ = self._up if self._neutral is _UP else _turned(self._up, self._neutral)
        return _clamped(self._gain * y), _clamped(-self._gain * x)


def _turned(vector: Vector, neutral: Vector) -> Vector:
    """Return `vector` rotated by the shortest rotation from the unit vector `neutral` to +z."""
    x, y, z = vector
    a, b, c = neutral
    if c < _TURNED:
        return (x, -y, -z)
    # Rodrigues' formula for the axis (b, -a, 0), whose length is the sine of the angle.
    along = (b * x - a * y) / (1.0 + c)
    return (c * x - a * z + along * b, c * y - b * z - along * a, a * x + b * y + c * z)


def _clamped(value: float) -> float:
    return min(1.0, max(-1.0, value))
