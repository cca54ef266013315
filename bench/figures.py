"""Latency figures by name: medians, tails and ratios; aims, printed as met or missed."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

BATCH = 200
BATCHES = 101


def median_costs(
    calls: Mapping[str, Callable[[], object]], batch: int = BATCH, batches: int = BATCHES
) -> dict[str, float]:
    """Median cost of one call by name, s; batches of all functions are measured in turns."""
    costs: dict[str, list[float]] = {name: [] for name in calls}
    clock = time.perf_counter
    for _ in range(batches):
        for name, call in calls.items():
            start_s = clock()
            for _ in range(batch):
                call()
            costs[name].append((clock() - start_s) / batch)
    return {name: statistics.median(cost) for name, cost in costs.items()}


class Aim(NamedTuple):
    """Upper limit for `name`: `factor` times `reference` plus `added_s`, or `factor` seconds
    without a reference."""

    name: str
    reference: str | None
    factor: float
    quantile: str
    added_s: float = 0.0


QUANTILES = {"median": 0.5, "p99": 0.99, "p99.9": 0.999}


class Figures:
    """Durations collected in one run."""

    def __init__(self, title: str) -> None:
        self.title = title
        self._samples: dict[str, list[float]] = {}
        self._missed: dict[str, int] = {}

    def add(self, name: str, seconds: float) -> None:
        """Record a duration."""
        self._samples.setdefault(name, []).append(seconds)

    def miss(self, name: str) -> None:
        """Record a missing answer."""
        self._missed[name] = self._missed.get(name, 0) + 1

    def missed(self, name: str) -> int:
        """Number of missing answers."""
        return self._missed.get(name, 0)

    def quantile(self, name: str, quantile: str) -> float:
        """Return the quantile of the durations under `name`, s; NaN without any."""
        samples = sorted(self._samples.get(name, []))
        if not samples:
            return float("nan")
        return samples[min(len(samples) - 1, int(QUANTILES[quantile] * len(samples)))]

    def print(
        self, aims: tuple[Aim, ...] = (), added: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        """Return the table, relative to the first recorded name, then the aims. `added`: limits for
        the excess of medians over that first one, s."""
        names = list(self._samples)
        base = names[0]
        print(f"\n{self.title}\n")
        print(f"{'':18}" + "".join(f"{q:>12}{'':>8}" for q in QUANTILES) + "   unanswered")
        for name in names:
            cells = ""
            for quantile in QUANTILES:
                value = self.quantile(name, quantile)
                ratio = value / self.quantile(base, quantile)
                cells += f"{value * 1e6:9.1f} µs {ratio:6.2f}x "
            print(f"{name:18}{cells}   {self.missed(name)}")
        print(f"\n(x: times {base})")
        for name, most_s in added.items():
            value = self.quantile(name, "median") - self.quantile(base, "median")
            verdict = "met" if value <= most_s else "MISSED"
            print(
                f"aim: {name} median <= {base} + {most_s * 1e6:g} µs: {verdict} "
                f"({value * 1e6:+.1f} µs)"
            )
        for aim in aims:
            value = self.quantile(aim.name, aim.quantile)
            if aim.reference is None:
                bound, words = aim.factor, f"{aim.factor * 1e6:g} µs"
            else:
                bound = aim.factor * self.quantile(aim.reference, aim.quantile) + aim.added_s
                words = f"{aim.factor:g} x {aim.reference}"
                if aim.added_s:
                    words = f"{aim.reference} + {aim.added_s * 1e6:g} µs"
            verdict = "met" if value <= bound else "MISSED"
            print(
                f"aim: {aim.name} {aim.quantile} <= {words}: {verdict} ({value / bound:.2f} of it, "
                f"{value * 1e6:.0f} µs)"
            )
