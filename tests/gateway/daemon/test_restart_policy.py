"""Times and number of a process's restarts, in virtual time."""

import pytest

from cardan.gateway.daemon.restart_policy import (
    FIRST_PAUSE_S,
    LASTED_S,
    LONGEST_PAUSE_S,
    Ended,
    Unit,
    UnitState,
)

LIMIT = 8


class Bench:
    """A unit whose processes end when the test decides."""

    def __init__(self):
        self.now_s = 1000.0
        self.unit = Unit("gofa", LIMIT)

    def start(self):
        self.unit.start(self.now_s)
        return self

    def begin(self):
        """Wait until a process is due, and start it; return the wait."""
        pause_s = max(0.0, self.unit.due_s - self.now_s)
        assert pause_s == 0.0 or not self.unit.due(self.now_s)
        self.now_s += pause_s
        assert self.unit.due(self.now_s)
        self.unit.begun(self.now_s)
        assert self.unit.state is UnitState.RUNNING
        return pause_s

    def end(self, how, after_s=0.1, reason="boom"):
        self.now_s += after_s
        self.unit.ended(how, reason, self.now_s)


@pytest.fixture
def bench():
    return Bench().start()


def test_it_starts_at_once(bench):
    assert bench.begin() == 0.0


def test_one_that_dies_comes_back_with_growing_pauses(bench):
    pauses = [bench.begin()]
    for _ in range(LIMIT - 1):
        bench.end(Ended.DIED)
        assert bench.unit.reason == "boom"
        pauses.append(bench.begin())
    assert pauses == pytest.approx([0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0])
    assert bench.unit.restarts == LIMIT - 1


def test_after_the_limit_it_is_given_up_until_somebody_starts_it(bench):
    for _ in range(LIMIT):
        bench.begin()
        bench.end(Ended.DIED)
    assert bench.unit.state is UnitState.FAILED
    assert bench.unit.due_s is None
    assert bench.unit.reason == f"given up after {LIMIT} starts in a row: boom"
    bench.start()
    assert bench.begin() == 0.0
    bench.end(Ended.DIED)
    assert bench.begin() == pytest.approx(FIRST_PAUSE_S)


def test_one_that_lasted_begins_to_count_anew(bench):
    for _ in range(LIMIT - 1):
        bench.begin()
        bench.end(Ended.DIED)
    bench.begin()
    bench.end(Ended.DIED, LASTED_S + 1.0)
    assert bench.begin() == pytest.approx(FIRST_PAUSE_S)


def test_what_is_not_there_is_waited_for_without_a_limit(bench):
    bench.begin()
    for _ in range(5 * LIMIT):
        bench.end(Ended.UNABLE, reason="the port is in use")
        assert bench.begin() <= LONGEST_PAUSE_S


def test_a_wrong_configuration_is_not_tried_again(bench):
    bench.begin()
    bench.end(Ended.MISCONFIGURED, reason="robot.port: 0")
    assert bench.unit.state is UnitState.FAILED
    assert bench.unit.reason == "robot.port: 0"
    assert bench.unit.due_s is None


def test_one_that_ends_as_it_was_asked_to_stays_so(bench):
    bench.begin()
    bench.unit.stop(bench.now_s)
    assert bench.unit.is_ending
    bench.end(Ended.DIED)
    assert bench.unit.state is UnitState.STOPPED
    assert bench.unit.reason == "stopped by hand"
    assert bench.unit.due_s is None


def test_one_whose_time_is_over_stays_so(bench):
    bench.begin()
    bench.end(Ended.AS_ASKED, reason="")
    assert bench.unit.state is UnitState.STOPPED


def test_a_restart_ends_it_first(bench):
    bench.begin()
    bench.unit.restart(bench.now_s)
    assert bench.unit.is_ending
    assert bench.unit.due_s is None
    bench.end(Ended.AS_ASKED)
    assert bench.begin() == 0.0


def test_a_start_while_it_ends_is_not_lost(bench):
    bench.begin()
    bench.unit.stop(bench.now_s)
    bench.unit.start(bench.now_s)
    bench.end(Ended.AS_ASKED)
    assert bench.begin() == 0.0


def test_it_is_wanted_also_while_it_ends_to_begin_anew(bench):
    assert bench.unit.wanted
    bench.begin()
    bench.unit.restart(bench.now_s)
    assert bench.unit.wanted
    bench.unit.stop(bench.now_s)
    assert not bench.unit.wanted
    bench.end(Ended.AS_ASKED)
    assert not bench.unit.wanted


def test_a_stop_takes_a_restart_back(bench):
    bench.begin()
    bench.unit.restart(bench.now_s)
    bench.unit.stop(bench.now_s)
    bench.end(Ended.AS_ASKED)
    assert bench.unit.state is UnitState.STOPPED


@pytest.mark.parametrize("order", [Unit.stop, Unit.restart])
def test_orders_while_it_waits(bench, order):
    bench.begin()
    bench.end(Ended.DIED)
    order(bench.unit, bench.now_s)
    if order is Unit.stop:
        assert bench.unit.state is UnitState.STOPPED
    else:
        assert bench.unit.due(bench.now_s)


def test_a_start_of_one_that_runs_changes_nothing(bench):
    bench.begin()
    bench.unit.start(bench.now_s)
    assert bench.unit.state is UnitState.RUNNING
    assert bench.unit.due_s is None
