"""Waits of an inbox end, for any behavior of its lock."""

import itertools
import re
import threading
import time
from pathlib import Path

import pytest

from cardan.common.inbox import Inbox, InboxEmptyError


class StandIn:
    """Stand-in for a lock that wakes without cause, `early_s` before the time or after it. It never
    blocks, and refuses a wait without limit."""

    def __init__(self, early_s):
        self.now_s, self.asked = 0.0, []
        self._early_s = early_s

    def acquire(self, blocking=True, timeout=None):
        if timeout is not None:
            assert 0.0 < timeout <= threading.TIMEOUT_MAX
            self.asked.append(timeout)
            self.now_s += max(timeout - next(self._early_s), 0.01)
        return False

    def release(self):
        raise RuntimeError

    def clock(self):
        return self.now_s


@pytest.mark.parametrize("early_s", [0.0, 0.3, -0.3, 5.0])
@pytest.mark.parametrize("timeout_s", [0.0, -1.0, 0.001, 1.0, 1e9 * threading.TIMEOUT_MAX])
def test_a_wait_ends_by_the_clock_and_never_asks_for_no_end(early_s, timeout_s):
    lock = StandIn(itertools.chain([early_s] * 5, itertools.repeat(0.0)))
    if timeout_s > 1.0:
        lock._early_s = itertools.repeat(-timeout_s)
    inbox = Inbox(wake=lock, clock=lock.clock)
    with pytest.raises(InboxEmptyError):
        inbox.get(timeout_s)
    assert lock.now_s >= timeout_s
    assert bool(lock.asked) == (timeout_s > 0.0)


def test_items_come_in_their_order_and_wait_for_none():
    inbox = Inbox()
    for item in range(5):
        inbox.put(item)
    assert len(inbox) == 5
    assert [inbox.get(0.0) for _ in range(5)] == list(range(5))
    with pytest.raises(InboxEmptyError):
        inbox.get(0.0)


def test_of_too_many_the_newest_are_kept():
    inbox = Inbox(2)
    for item in range(5):
        inbox.put(item)
    assert [inbox.get(0.0), inbox.get()] == [3, 4]


def test_a_wait_is_woken_by_each_of_several_threads():
    inbox, each = Inbox(), 500
    threads = [
        threading.Thread(target=lambda: [inbox.put(n) for n in range(each)]) for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    found = [inbox.get(10.0) for _ in range(3 * each)]
    assert sorted(found) == sorted([*range(each)] * 3)
    for thread in threads:
        thread.join()


def test_a_wait_without_a_limit_is_woken():
    inbox = Inbox()
    threading.Timer(0.02, inbox.put, ["a"]).start()
    assert inbox.get() == "a"
    began_s = time.monotonic()
    with pytest.raises(InboxEmptyError):
        inbox.get(0.02)
    assert time.monotonic() - began_s >= 0.02


def test_no_other_queue_is_waited_for_with_a_time_out():
    root = Path(__file__).parents[1]
    waits = [
        f"{file.relative_to(root)}: {line.strip()}"
        for folder in ("cardan", "plugins", "studies", "bench", "examples", "tools")
        for file in (root / folder).rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if re.search(r"\.get\((block=|True|timeout=)", line)
    ]
    assert waits == []
