"""Conditioning of a sensor's reading for the hand: tare, dead band, axes, scale, low-pass filter.
No I/O; time is part of the readings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.common.options import Options
from cardan.gateway.force.sources import Reading
from cardan.spatial import limit_norm, norm, rotate
from cardan.types import NEVER_S, ZERO3, Frame, Pose, Vector3

TARE_S = 0.5
"""Time over which the readings at rest are averaged for zero: noise of 0.3 N at 250 Hz leaves 0.03
N."""

TARE_READINGS = 10
"""Least number of readings averaged, for slow sensors."""

TARE_SPREAD_N = 5.0
"""Largest difference between readings of a tool at rest: beyond it the tare starts again."""

TARE_REASON = f"its zero is being taken: leave the robot at rest, clutched out, for {TARE_S} s"

FORGET_AFTER_S = 0.1
"""Longest time between two values after which the filter starts again."""

EXTRAPOLATED_S = 0.008
"""Longest time for which a device extrapolates a force by its rate."""


@dataclass(frozen=True, kw_only=True)
class Conditioning(Options):
    """Options for turning a reading into a force for the hand."""

    scale: Annotated[float, bounds.FORCE_SCALE] = 0.02
    """N in the hand for each N at the robot."""
    deadband_n: Annotated[float, bounds.DEADBAND_N] = 0.1
    cutoff_hz: Annotated[float, bounds.FORCE_CUTOFF_HZ] = 40.0
    tare: bool = True


class Tare:
    """Mean of a sensor's readings at rest."""

    def __init__(self, wanted: bool = True) -> None:
        self.value = ZERO3
        """N, along the sensor's axes."""
        self.taken = not wanted
        self._restart()

    def _restart(self) -> None:
        self._count = 0
        self._begun_s = NEVER_S
        self._sum = [0.0, 0.0, 0.0]
        self._low = [math.inf] * 3
        self._high = [-math.inf] * 3

    def add(self, force: Vector3, now_s: float, at_rest: bool) -> None:
        """Add one reading until the tare is complete."""
        if self.taken:
            return
        if not at_rest:
            self._restart()
            return
        if self._count == 0:
            self._begun_s = now_s
        self._count += 1
        for axis in range(3):
            value = force[axis]
            self._sum[axis] += value
            self._low[axis] = min(self._low[axis], value)
            self._high[axis] = max(self._high[axis], value)
            if self._high[axis] - self._low[axis] > TARE_SPREAD_N:
                self._restart()
                return
        if now_s - self._begun_s >= TARE_S and self._count >= TARE_READINGS:
            x, y, z = self._sum
            self.value = Vector3(x / self._count, y / self._count, z / self._count)
            self.taken = True


def without_band(value: float, band: float) -> float:
    """Return `value` less a dead band around zero: continuous, without steps at its edge."""
    if value > band:
        return value - band
    return value + band if value < -band else 0.0


class LowPass:
    """First-order filter for values at irregular times; also gives the rate of its output."""

    def __init__(self, cutoff_hz: float) -> None:
        self._omega = 2.0 * math.pi * cutoff_hz
        self._stamp_s = NEVER_S
        self.value = ZERO3
        self.rate = ZERO3
        """Rate of the filter's output, per s, from its last two values."""

    @property
    def stamp_s(self) -> float:
        """Time of the newest value."""
        return self._stamp_s

    def add(self, new: Vector3, stamp_s: float) -> None:
        """Take a value; a value that is not newer than the last is ignored."""
        dt_s = stamp_s - self._stamp_s
        if dt_s <= 0.0:
            return
        self._stamp_s = stamp_s
        if dt_s > FORGET_AFTER_S:
            self.value, self.rate = new, ZERO3
            return
        share = 1.0 - math.exp(-self._omega * dt_s)
        x, y, z = self.value
        dx, dy, dz = share * (new[0] - x), share * (new[1] - y), share * (new[2] - z)
        self.value = Vector3(x + dx, y + dy, z + dz)
        self.rate = Vector3(dx / dt_s, dy / dt_s, dz / dt_s)


class Conditioner:
    """All steps for one force: `contact` is the force on the tool, `filtered` the rendered one."""

    def __init__(
        self, options: Conditioning, *, rests_at_zero: bool = False, shaped: bool = False
    ) -> None:
        """`rests_at_zero`: no tare is needed; `shaped`: only the filter is applied."""
        self.options = options
        self.tare = Tare(options.tare and not (rests_at_zero or shaped))
        self.filtered = LowPass(options.cutoff_hz)
        """N in the hand, world axes."""
        self.contact: Vector3 = ZERO3
        """N at the tool, along the sensor's axes, without the tare."""
        self._shaped = shaped
        self.reason = ""
        """Reason for rejecting the last reading."""

    @property
    def rate(self) -> Vector3:
        """N/s in the hand, world axes; limited so that the device's extrapolation at most doubles
        the force, or ends it."""
        filtered = self.filtered
        return limit_norm(filtered.rate, norm(filtered.value) / EXTRAPOLATED_S)

    def add(self, reading: Reading, at_rest: bool, tcp: Pose | None) -> bool:
        """Take a reading; return False if it gives no force (`reason` says why)."""
        raw = reading.force
        if not self.tare.taken:
            self.tare.add(raw, reading.stamp_s, at_rest)
            if not self.tare.taken:
                self.reason = TARE_REASON
                return False
        bx, by, bz = self.tare.value
        force = self.contact = Vector3(raw[0] - bx, raw[1] - by, raw[2] - bz)
        if not self._shaped:
            band, factor = self.options.deadband_n, self.options.scale
            force = Vector3(
                without_band(force[0], band) * factor,
                without_band(force[1], band) * factor,
                without_band(force[2], band) * factor,
            )
        if reading.frame is Frame.TOOL:
            if tcp is None:
                self.reason = "it is along the tool's axes, and the robot reports no pose"
                return False
            force = rotate(tcp.orientation, force)
        self.reason = ""
        self.filtered.add(force, reading.stamp_s)
        return True
