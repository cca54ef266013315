"""Benchmark of the UR driver: all participants answer, and a session takes longer than an echo."""

import pytest

from bench import ur_latency

pytestmark = pytest.mark.matrix


def test_everybody_answers():
    figures = ur_latency.measure(cycles=50, warm_up=5)
    for name in (ur_latency.ECHO, ur_latency.DRIVER, ur_latency.SESSION):
        assert 0.0 < figures.quantile(name, "median") < ur_latency.ANSWER_WITHIN_S
