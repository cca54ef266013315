"""Latency histogram compared with exact percentiles."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from cardan.common.histogram import LatencyHistogram


def exact_percentile(values: list[float], p: float) -> float:
    ordered = sorted(values)
    return ordered[max(0, math.ceil(len(ordered) * p / 100.0) - 1)]


def test_empty() -> None:
    histogram = LatencyHistogram()
    assert (histogram.count, histogram.max, histogram.mean) == (0, 0.0, 0.0)
    assert histogram.percentile(99) == 0.0


@given(
    values=st.lists(st.floats(2e-7, 900.0), min_size=1, max_size=200),
    p=st.floats(0.0, 100.0),
)
def test_percentiles_are_within_a_bucket(values: list[float], p: float) -> None:
    histogram = LatencyHistogram()
    for value in values:
        histogram.add(value)
    assert histogram.count == len(values)
    assert histogram.max == max(values)
    assert histogram.mean == pytest.approx(sum(values) / len(values))
    assert histogram.percentile(p) == pytest.approx(exact_percentile(values, p), rel=0.023)


@pytest.mark.parametrize("seconds", [0.0, -1.0, 1e-12, 1e-7, 1e3, 1e9, math.inf])
def test_ends_of_the_range_are_counted(seconds: float) -> None:
    histogram = LatencyHistogram()
    histogram.add(seconds)
    assert histogram.count == 1
    assert histogram.max == max(0.0, seconds)
    assert histogram.percentile(50) == max(0.0, seconds)


@pytest.mark.parametrize("p", [-0.1, 100.1, math.nan])
def test_percentile_outside_0_to_100_is_refused(p: float) -> None:
    with pytest.raises(ValueError, match="0 to 100"):
        LatencyHistogram().percentile(p)


def test_how_many_were_within_bounds():
    histogram = LatencyHistogram()
    for each in (0.0, 1e-4, 9e-4, 2e-3, 3e-2, 1e4):
        histogram.add(each)
    assert histogram.within((2e-4, 1e-3, 4e-3, 0.05, 1e6)) == [2, 3, 4, 5, 6]
    assert histogram.within(()) == []
    assert histogram.sum == pytest.approx(1e4, abs=0.1)
