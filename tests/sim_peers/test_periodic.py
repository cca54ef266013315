"""A simulated device that reports continuously, in virtual time."""

import pytest

from cardan.errors import ScriptError
from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.periodic import PERIODIC_FAULTS, PeriodicDevice

PERIOD_S = 0.25  # exact in binary, so that sums have no remainder


class Counter(PeriodicDevice[int]):
    """Counts its reports."""

    count = 0

    def report(self):
        self.count += 1
        return self.count


def test_a_report_each_period():
    device = Counter(PERIOD_S, {})
    assert device.reports(0.0) == [1]
    assert device.next_due_s == PERIOD_S
    assert device.reports(0.2) == []
    assert device.reports(1.0) == [2, 3, 4, 5]


def test_what_nobody_simulated_is_not_sent():
    device = Counter(PERIOD_S, {})
    device.skip_to(0.6)
    assert device.next_due_s == 0.75
    device.skip_to(0.5)
    assert device.next_due_s == 0.75
    device.skip_to(0.75)
    assert device.reports(1.0) == [1, 2]


def test_it_vanishes_and_is_back():
    device = Counter(PERIOD_S, {"unplug": 0.5, "replug": 1.0})
    assert device.reports(0.75) == [1, 2]
    assert not device.plugged
    assert device.reports(1.0) == [3]
    assert device.plugged


def test_it_falls_silent_and_stays():
    device = Counter(PERIOD_S, {"silence": 0.5})
    assert device.reports(5.0) == [1, 2]
    assert device.plugged


def test_it_has_the_faults_that_it_says():
    own = FaultSwitch.flag("cut", "it is cut")
    assert Counter(PERIOD_S, {"cut": 1.0}, (*PERIODIC_FAULTS, own)).plugged
    for faults, words in (
        ({"cut": 1.0}, "there is no fault 'cut'; there are: refuse, replug, silence, unplug"),
        ({"replug": 1.0}, "replug: needs the fault unplug"),
    ):
        with pytest.raises(ScriptError, match=words):
            Counter(PERIOD_S, faults)
