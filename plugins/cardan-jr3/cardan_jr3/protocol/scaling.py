"""Conversion of raw samples to N and N·m, and of counters to time."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from cardan_jr3.protocol.messages import COUNTER_MODULUS, RAW_MAX, RAW_MIN

FULL_SCALE_COUNTS = 16384
"""Raw value of the full scale; an overloaded sensor reports more."""

SAMPLE_PERIOD_S = 128.5e-6
"""Period at which the sensor samples all six components (7782 Hz); the counter counts samples."""

Six = tuple[float, float, float, float, float, float]
"""Units of the components: Fx, Fy, Fz in N, Mx, My, Mz in N·m."""


class FullScales(NamedTuple):
    """Full scales of a sensor, in the board's units."""

    forces_n: tuple[int, int, int]
    moments_dnm: tuple[int, int, int]
    """Full scales of the moments, 0.1 N·m."""

    @property
    def per_count(self) -> Six:
        """Return N and N·m per count of each component."""
        (fx, fy, fz), (mx, my, mz) = self
        force, moment = 1.0 / FULL_SCALE_COUNTS, 0.1 / FULL_SCALE_COUNTS
        return (fx * force, fy * force, fz * force, mx * moment, my * moment, mz * moment)


TEO_SENSORS: Mapping[str, FullScales] = MappingProxyType(
    {
        "right-hand": FullScales((115, 111, 185), (56, 52, 61)),
        "left-hand": FullScales((114, 106, 184), (55, 52, 60)),
        "right-foot": FullScales((317, 314, 845), (221, 219, 307)),
        "left-foot": FullScales((326, 325, 870), (224, 224, 309)),
    }
)
"""Full scales of the four sensors of uc3m's humanoid TEO."""

TEO_NODE_IDS: Mapping[str, int] = MappingProxyType(
    {"right-foot": 31, "left-foot": 32, "right-hand": 33, "left-hand": 34}
)


def to_counts(values: Six, scales: FullScales) -> tuple[int, int, int, int, int, int]:
    """Return the raw values nearest to `values`, limited to sixteen bits."""
    a, b, c, d, e, f = (
        min(RAW_MAX, max(RAW_MIN, round(value / unit)))
        for value, unit in zip(values, scales.per_count, strict=True)
    )
    return (a, b, c, d, e, f)


def samples_between(newer: int, older: int) -> int:
    """Return the number of samples by the counter from `older` to `newer`, 0 to 65535."""
    return (newer - older) % COUNTER_MODULUS
