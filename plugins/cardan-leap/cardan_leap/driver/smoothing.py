"""A low-pass filter on a hand's pose whose cut-off rises with speed, and a limit on that speed.

Noise is visible at rest, the filter's lag in motion; hence the rising cut-off (the 1 Euro filter:
Casiez, Roussel and Vogel, CHI 2012). Both depend on elapsed time, not on the frame rate.
"""

from __future__ import annotations

import math

from cardan.spatial import (
    add,
    from_rotation_vector,
    limit_norm,
    multiply,
    norm,
    normalized,
    rotation_between,
    same_hemisphere,
    scale,
    subtract,
)
from cardan.types import ZERO3, Pose, Vector3

SPEED_CUTOFF_HZ = 1.0
"""Cut-off of the low-pass filter on the speed, which determines the pose's cut-off, Hz."""

HAND_LENGTH_M = 0.1
"""Lever that converts rad/s to the m/s of the fingertips, so that one gain serves both filters."""

SHORTEST_STEP_S = 1e-5
"""Shortest time between two poses that gives a speed; a pose that comes sooner is skipped."""

MAX_TURN_RAD_S = 12.0
"""Fastest plausible rotation of a hand."""


class PoseFilter:
    """Filter for the poses of one hand; `reset` for another one."""

    def __init__(self, cutoff_hz: float, cutoff_rise_1_m: float, max_speed_m_s: float) -> None:
        self._cutoff_hz = cutoff_hz
        self._rise = cutoff_rise_1_m
        self._max_speed_m_s = max_speed_m_s
        self.reset()

    def reset(self) -> None:
        """Discard the hand's history."""
        self._raw: Pose | None = None
        self._smooth: Pose | None = None
        self._velocity = ZERO3
        self._turn = ZERO3

    def __call__(self, raw: Pose, dt_s: float) -> Pose:
        """Filter a pose `raw`, measured `dt_s` after the previous one; the first passes
        unchanged."""
        last_raw, smooth = self._raw, self._smooth
        if last_raw is None or smooth is None:
            self._raw = self._smooth = raw
            return raw
        if dt_s < SHORTEST_STEP_S:
            return smooth
        self._raw = raw
        blend = _share(SPEED_CUTOFF_HZ, dt_s)
        self._velocity = _towards(
            self._velocity,
            scale(subtract(raw.position, last_raw.position), 1.0 / dt_s),
            blend,
        )
        self._turn = _towards(
            self._turn,
            scale(rotation_between(last_raw.orientation, raw.orientation), 1.0 / dt_s),
            blend,
        )
        step = scale(
            subtract(raw.position, smooth.position), self._gain(norm(self._velocity), dt_s)
        )
        turn = scale(
            rotation_between(smooth.orientation, raw.orientation),
            self._gain(norm(self._turn) * HAND_LENGTH_M, dt_s),
        )
        turned = multiply(
            from_rotation_vector(limit_norm(turn, MAX_TURN_RAD_S * dt_s)), smooth.orientation
        )
        self._smooth = Pose(
            add(smooth.position, limit_norm(step, self._max_speed_m_s * dt_s)),
            same_hemisphere(normalized(turned), smooth.orientation),
        )
        return self._smooth

    def _gain(self, speed_m_s: float, dt_s: float) -> float:
        if self._cutoff_hz == 0.0:
            return 1.0
        return _share(self._cutoff_hz + self._rise * speed_m_s, dt_s)


def _share(cutoff_hz: float, dt_s: float) -> float:
    """Return the step response of a first-order filter after `dt_s`, 0 to 1."""
    return -math.expm1(-math.tau * cutoff_hz * dt_s)


def _towards(a: Vector3, b: Vector3, share: float) -> Vector3:
    return add(a, scale(subtract(b, a), share))
