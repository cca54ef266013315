"""What holds for every test."""

import os

import pytest


@pytest.fixture(autouse=True)
def the_scheduling_of_the_tests_is_left_alone():
    """One that made pytest a real-time process would starve whatever the tests after it start."""
    before = os.sched_getscheduler(0)
    yield
    after = os.sched_getscheduler(0)
    if after != before:
        os.sched_setscheduler(0, before, os.sched_param(0))
    assert after == before
