"""Raw samples and what they mean: N, N·m and the time between two counters."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from cardan_jr3.protocol.messages import COUNTER_MODULUS, RAW_MAX, RAW_MIN

FULL_SCALE_COUNTS = 16384
"""Raw value of the full scale; the sensor gives more when it is overloaded."""

SAMPLE_PERIOD_S = 128.5e-6
"""Period at which the sensor samples all six components (7782 Hz); the counter counts samples."""

Six = tuple[float, float, float, float, float, float]
"""Fx, Fy, Fz in N, Mx, My, Mz in N·m."""


class FullScales(NamedTuple):
    """Full scales of a sensor, as the board gives them."""

    forces_n: tuple[int, int, int]
    moments_dnm: tuple[int, int, int]
    """0.1 N·m."""

    @property
    def per_count(self) -> Six:
        """N and N·m of one count of each component."""
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
"""The four sensors of uc3m's humanoid TEO."""

TEO_NODE_IDS: Mapping[str, int] = MappingProxyType(
    {"right-foot": 31, "left-foot": 32, "right-hand": 33, "left-hand": 34}
)


def to_counts(values: Six, scales: FullScales) -> tuple[int, int, int, int, int, int]:
    """The raw values nearest to `values`, as far as sixteen bits reach."""
    a, b, c, d, e, f = (
        min(RAW_MAX, max(RAW_MIN, round(value / unit)))
        for value, unit in zip(values, scales.per_count, strict=True)
    )
    return (a, b, c, d, e, f)


def samples_between(newer: int, older: int) -> int:
    """Number of samples by the counter from `older` to `newer`, 0 to 65535."""
    return (newer - older) % COUNTER_MODULUS
