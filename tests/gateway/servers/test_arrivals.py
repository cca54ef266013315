"""Greatest age of a client's message, in virtual time."""

from types import SimpleNamespace

import pytest

from cardan.gateway.arm.backlog import STALE_S
from cardan.gateway.servers import web
from cardan.gateway.servers.web import ARRIVALS_PERIOD_S, MAX_ARRIVALS, Arrivals


def test_a_frame_is_as_old_as_the_last_look_that_did_not_find_its_end():
    arrivals = Arrivals(0.0)
    arrivals.record(0, 1.0)
    # The loop was paused for 0.6 s; two whole frames arrived meanwhile, and part of a third.
    arrivals.read(200)
    arrivals.end_frame()
    arrivals.end_frame()
    arrivals.record(50, 1.6)
    assert arrivals.take_frame() == arrivals.take_frame() == 1.0
    arrivals.read(100)
    arrivals.end_frame()
    assert arrivals.take_frame() == 1.0  # 50 bytes of the third frame had arrived then.
    arrivals.record(0, 1.7)
    arrivals.read(10)
    arrivals.end_frame()
    assert arrivals.take_frame() == 1.7


def test_a_fast_sender_of_large_frames_of_whom_something_always_waits_is_not_late():
    arrivals, now_s, oldest_s = Arrivals(0.0), 0.0, 0.0
    for _ in range(1000):  # 1 MB in four portions, each 5 ms, and always 100 kB waiting.
        for _ in range(4):
            now_s += 0.005
            arrivals.read(250_000)
            arrivals.record(100_000, now_s)
        arrivals.end_frame()
        oldest_s = max(oldest_s, now_s - arrivals.take_frame())
    assert oldest_s < 0.05


def test_frames_get_older_while_there_is_no_room_or_more_comes_than_is_taken():
    arrivals, age_s = Arrivals(0.0), []
    for cycle in range(200):
        now_s = 0.01 * cycle
        arrivals.read(1000)
        arrivals.end_frame()
        if cycle < 10:  # Afterwards the buffer is full, and arrivals are no longer recorded.
            arrivals.record(0, now_s)
        age_s.append(now_s - arrivals.take_frame())
    assert max(age_s[:10]) <= 3 * ARRIVALS_PERIOD_S
    assert age_s[-1] == pytest.approx(1.9, abs=0.05)
    arrivals, waiting = Arrivals(0.0), 0
    for cycle in range(100):
        now_s = 0.01 * cycle
        arrivals.read(1000)
        waiting += 1000  # as many bytes stay unread
        arrivals.record(waiting, now_s)
        arrivals.end_frame()
        age_s.append(now_s - arrivals.take_frame())
    assert age_s[-1] > STALE_S


def test_what_is_kept_in_mind_is_bounded_and_nothing_seems_younger_for_it():
    arrivals = Arrivals(0.0)
    for look in range(10 * MAX_ARRIVALS):
        arrivals.record(1000 + look, 2 * ARRIVALS_PERIOD_S * (look + 1))
    assert len(arrivals._seen) == MAX_ARRIVALS
    arrivals.read(10)
    arrivals.end_frame()
    assert arrivals.take_frame() == 0.0


def test_what_arrived_while_the_server_stood_still_in_the_midst_of_a_look_is_old(monkeypatch):
    clock = SimpleNamespace(now_s=1.0)

    def looks(_socket):
        clock.now_s += 1.0  # a pause
        return 100

    monkeypatch.setattr(web, "has_room", lambda _: True)
    monkeypatch.setattr(web, "waiting_bytes", looks)
    connection = SimpleNamespace(
        loop=SimpleNamespace(time=lambda: clock.now_s), arrivals=Arrivals(0.0), _socket=object()
    )
    web.ListenerConnection.note_backlog(connection)
    connection.arrivals.read(100)
    connection.arrivals.end_frame()
    web.ListenerConnection.note_backlog(connection)
    connection.arrivals.read(100)
    connection.arrivals.end_frame()
    assert [connection.arrivals.take_frame() for _ in range(2)] == [0.0, 1.0]
