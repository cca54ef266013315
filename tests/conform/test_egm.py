"""The EGM controller suite, with phases of any length."""

from __future__ import annotations

import pytest

from cardan.conform import Level, registry
from cardan.conform.run import simulated


@pytest.mark.matrix("1.0", "2.0", "5.0", "7.0", "10.0")
@pytest.mark.parametrize("seconds", [0.5, 1.0, 2.0, 5.0, 7.0, 10.0])
def test_a_faultless_controller_is_not_failed_by_where_its_runs_end(seconds):
    """With some durations the hold phase begins as the listening phase has just ended."""
    report, _ = simulated(registry.load("egm"), Level.BY_HAND, seconds=seconds)
    assert report.failed == ()


def test_a_run_that_begins_anew_though_it_is_held_is_a_failure():
    """The listening phase ends at 1.2 s; the run in the hold phase begins 0.3 s later."""
    suite = registry.load("egm")
    report, _ = simulated(suite, Level.HOLD, {"restart": 2.5}, seconds=2.0)
    assert "EGM-101" in report.failed
