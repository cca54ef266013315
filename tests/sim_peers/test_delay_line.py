"""Line between a simulated device and its host."""

from __future__ import annotations

import math

from hypothesis import given, strategies as st

from cardan.sim_peers.delay_line import DelayLine


def test_reports_arrive_when_they_are_sent_in_order():
    line = DelayLine({}, 0)
    assert line.next_due_s == math.inf
    for time_s, report in ((2.0, b"c"), (1.0, b"a"), (1.0, b"b")):
        line.carry(report, time_s)
    assert line.next_due_s == 1.0
    assert line.arrived(0.9) == []
    assert line.arrived(1.5) == [b"a", b"b"]
    assert line.arrived(2.0) == [b"c"]
    assert line.next_due_s == math.inf


def test_a_cut_line_loses_what_is_under_way():
    line = DelayLine({}, 0)
    line.carry(b"a", 1.0)
    line.cut()
    assert line.arrived(2.0) == []


def test_a_burst_holds_back_every_other_window():
    line = DelayLine({"burst": 0.5}, 0)
    for report, time_s in ((b"a", 0.4), (b"b", 0.6), (b"c", 0.9), (b"d", 1.1)):
        line.carry(report, time_s)
    assert line.arrived(0.5) == [b"a"]
    assert line.arrived(0.99) == []
    assert line.arrived(1.0) == [b"b", b"c"]
    assert line.arrived(1.1) == [b"d"]


@given(st.floats(0.001, 10.0), st.lists(st.floats(0.0, 100.0)))
def test_nothing_is_early_lost_or_later_than_a_burst(burst_s, times_s):
    line = DelayLine({"burst": burst_s}, 0)
    for time_s in times_s:
        line.carry(repr(time_s).encode(), time_s)
    arrived: list[float] = []
    while (due_s := line.next_due_s) < math.inf:
        for report in line.arrived(due_s):
            sent_s = float(report)
            assert sent_s <= due_s <= sent_s + burst_s * (1.0 + 1e-9) + 1e-9
            arrived.append(sent_s)
    assert sorted(arrived) == sorted(times_s)
