"""Angular rates of a MotionPlus, with the bias measured again while it lies or is held still."""

from __future__ import annotations

import math

from cardan.types import NEVER_S

Vector = tuple[float, float, float]

STILL_S = 1.0
"""Time of stillness from which the bias is measured."""

STILL_SAMPLES = 20

STILL_RAD_S = math.radians(3.0)
"""Largest difference of rates that counts as still."""

STEADY_TURN_RAD_S = math.radians(10.0)
"""Rate above which steady readings count as a rotation, not as a changed bias."""

LARGEST_BIAS_RAD_S = math.radians(3.0)
"""Largest change of the bias that is accepted. A slower steady rotation looks like a change, and
becomes the opposite rotation once the remote stops."""


class Gyro:
    """Rates in rad/s about the operator's axes. Times are monotonic, s.

    `largest_bias_rad_s`: largest accepted change of the bias, up to `LARGEST_BIAS_RAD_S`. With a
    dead zone of that size a wrong bias causes no motion.
    """

    def __init__(self, largest_bias_rad_s: float = LARGEST_BIAS_RAD_S) -> None:
        self._largest_bias_rad_s = min(largest_bias_rad_s, LARGEST_BIAS_RAD_S)
        self.reset()

    def reset(self) -> None:
        """Reset to an unknown MotionPlus."""
        self.bias_rad_s: Vector = (0.0, 0.0, 0.0)
        self.updates = 0
        """Number of measurements of the bias."""
        self._forget()

    def _forget(self) -> None:
        self._since_s = NEVER_S
        self._count = 0
        self._sum = [0.0, 0.0, 0.0]
        self._low = [math.inf] * 3
        self._high = [-math.inf] * 3

    def update(self, rates_rad_s: Vector, now_s: float, at_rest: bool) -> Vector:
        """Return the rates less the bias. `at_rest`: no clutch is held, thus the rates command
        nothing."""
        if at_rest:
            self._watch(rates_rad_s, now_s)
        elif self._count:
            self._forget()
        x, y, z = rates_rad_s
        u, v, w = self.bias_rad_s
        return (x - u, y - v, z - w)

    def _watch(self, rates_rad_s: Vector, now_s: float) -> None:
        if not self._count:
            self._since_s = now_s
        self._count += 1
        still = True
        for i, rate in enumerate(rates_rad_s):
            self._sum[i] += rate
            self._low[i] = min(self._low[i], rate)
            self._high[i] = max(self._high[i], rate)
            still = (
                still
                and self._high[i] - self._low[i] < STILL_RAD_S
                and abs(rate) < STEADY_TURN_RAD_S
            )
        if not still:
            self._forget()
        elif now_s - self._since_s >= STILL_S and self._count >= STILL_SAMPLES:
            largest = self._largest_bias_rad_s
            x, y, z = (min(largest, max(-largest, total / self._count)) for total in self._sum)
            self.bias_rad_s = (x, y, z)
            self.updates += 1
            self._forget()
