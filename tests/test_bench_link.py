"""Simulated link between two computers of a benchmark, in virtual time."""

import random

import pytest

from bench.link import LOGGED, Conditions, Way

SENT_S = [100.0 + 0.008 * number for number in range(5000)]
FRAME = b"f" * 1000


def carried(conditions, sent_s=SENT_S):
    """Return the arrival time of each frame by its content, and the counts."""
    way, came = Way(conditions, random.Random(1)), []
    for number, at_s in enumerate((*sent_s, 1e6)):
        while way.next_s <= at_s:
            now_s = way.next_s
            came += [(int(frame[:6]), now_s) for frame in way.arrived(now_s)]
        if at_s < 1e6:
            way.send(b"%06d" % number + FRAME[6:], at_s)
    return came, way.counts


def test_jitter_keeps_the_order_unless_frames_may_overtake():
    jitter = Conditions(0.05, 0.02, stall_s=0.5, stall_every_s=10.0)
    came, _ = carried(jitter)
    assert [number for number, _ in came] == list(range(5000))
    assert min(at_s - SENT_S[number] for number, at_s in came) >= 0.03 - 1e-9
    assert not [at_s for _, at_s in came if at_s % 10.0 < 0.5 - 1e-9]
    overtaken, _ = carried(jitter._replace(in_order=False, stall_s=0.0))
    assert [number for number, _ in overtaken] != sorted(number for number, _ in overtaken)
    assert max(at_s - SENT_S[number] for number, at_s in overtaken) <= 0.07 + 1e-9


def test_frames_are_lost_or_come_twice_as_often_as_said():
    came, counts = carried(Conditions(loss=0.2, twice=0.5))
    assert counts["sent"] == 5000
    assert counts["lost"] / 5000 == pytest.approx(0.2, abs=0.03)
    assert len(came) / (5000 - counts["lost"]) == pytest.approx(1.5, abs=0.03)


def test_a_slow_link_passes_its_rate_and_loses_what_its_queue_does_not_hold():
    at_once = [1.0] * 20
    came, counts = carried(Conditions(0.1, rate_bps=8e5, queue_bytes=5500), at_once)
    assert counts["overflowed"] == 20 - len(came) == 15
    assert [at_s for _, at_s in came] == pytest.approx([1.11 + 0.01 * n for n in range(5)])


def test_a_cut_loses_what_is_on_its_way_and_what_is_sent_until_it_ends():
    way = Way(Conditions(0.1), random.Random(1))
    way.send(b"on its way", 1.0)
    way.conditions = Conditions(0.1, cut=True)
    way.send(b"sent meanwhile", 1.05)
    assert way.arrived(1.1) == []
    way.conditions = Conditions(0.1)
    way.send(b"after", 1.12)
    assert way.arrived(1.21) == []
    assert way.arrived(1.23) == [b"after"]
    assert way.counts == {"sent": 3, "lost": 2}


def transits(way, since_s, until_s):
    """Return the transit times of the frames sent in that interval, s; None: not arrived."""
    return [
        each.came_s and pytest.approx(each.came_s - each.sent_s)
        for each in way.carried(since_s, until_s)
    ]


def carry(way, *sent_s):
    """Send a frame at each of these times, and forward each at its arrival time."""
    for at_s in (*sent_s, 1e6):
        while way.next_s <= at_s:
            way.arrived(way.next_s)
        if at_s < 1e6:
            way.send(FRAME, at_s)


def test_a_way_tells_what_it_took_for_each_frame_since_an_act():
    stalls = Conditions(0.1, stall_s=0.5, stall_every_s=10.0)
    way = Way(stalls, random.Random(1))
    carry(way, 109.7, 109.95, 110.2, 110.45)
    # Both frames that arrive during the stall wait for its end.
    assert transits(way, 109.7, 111.0) == [0.1, 0.55, 0.3, 0.1]
    assert transits(way, 109.8, 110.2) == [0.55, 0.3]
    assert transits(way, 111.0, 112.0) == []
    way.send(FRAME, 113.0)
    assert transits(way, 113.0, 113.0) == [None]


def test_a_frame_behind_a_late_one_takes_as_long_as_it_waits():
    way = Way(Conditions(0.5), random.Random(1))
    way.send(FRAME, 1.0)
    way.conditions = Conditions(0.1)
    way.send(FRAME, 1.1)
    carry(way)
    assert transits(way, 1.0, 2.0) == [0.5, 0.4]


def test_a_lost_frame_never_arrives_and_one_that_comes_twice_counts_as_the_first_of_both():
    way = Way(Conditions(0.1, loss=1.0), random.Random(1))
    way.send(FRAME, 1.0)
    way.conditions = Conditions(0.1)
    way.send(FRAME, 2.0)
    way.conditions = Conditions(0.1, cut=True)
    assert way.arrived(2.1) == []
    way.conditions = Conditions(0.1, 0.09, twice=1.0, in_order=False)
    way.send(FRAME, 3.0)
    first_s = way.next_s
    carry(way)
    assert [transits(way, at_s, at_s) for at_s in (1.0, 2.0)] == [[None], [None]]
    assert way.carried(3.0, 3.0)[0].came_s == first_s


def test_a_way_remembers_the_frames_of_the_last_seconds():
    way = Way(Conditions(), random.Random(1))
    carry(way, *SENT_S)
    remembered = way.carried(0.0, 1e6)
    assert [each.sent_s for each in remembered] == SENT_S[-LOGGED:]
    assert {each.bytes for each in remembered} == {len(FRAME)}
