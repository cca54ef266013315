"""Detection of pauses of this computer."""

import pytest

from cardan.demos import pauses
from cardan.demos.pauses import LOOKED_EVERY_S, Pauses


class Clock:
    """Virtual clock whose sleeps overrun by the given times; after the last one the watch ends."""

    def __init__(self, late_s):
        self.now_s = 100.0
        self.late_s = list(late_s)
        self.watch = None

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds + self.late_s.pop(0)
        if not self.late_s:
            self.watch._ended.set()


def watched(monkeypatch, late_s):
    """Return the longest pause detected on one processor whose sleeps overrun by `late_s`."""
    clock = Clock(late_s)
    monkeypatch.setattr(pauses, "time", clock)
    monkeypatch.setattr(pauses, "_processors", lambda: [set()])
    clock.watch = Pauses()
    with clock.watch as watch:
        watch._threads[0].join()
    return watch.longest_s


def test_the_longest_pause_is_what_counts(monkeypatch):
    assert watched(monkeypatch, [0.0, 0.13, 0.02]) == pytest.approx(0.13)


def test_a_computer_that_keeps_up_has_none(monkeypatch):
    assert watched(monkeypatch, [0.0] * 5) == pytest.approx(0.0)


def test_each_processor_of_this_process_is_looked_at(monkeypatch):
    monkeypatch.setattr(pauses.os, "sched_getaffinity", lambda _pid: {2, 5}, raising=False)
    assert len(Pauses()._threads) == 2
    monkeypatch.delattr(pauses.os, "sched_getaffinity")
    assert len(Pauses()._threads) == 1


def test_the_block_ends_with_what_looked():
    with Pauses() as watch:
        assert all(thread.is_alive() for thread in watch._threads)
    assert not any(thread.is_alive() for thread in watch._threads)
    assert LOOKED_EVERY_S < 0.01
