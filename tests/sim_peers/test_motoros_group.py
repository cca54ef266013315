"""Conversion of points to increments in one control group of the simulated Motoman controller."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.simple_message.codes import InvalidSubcode
from cardan.sim_peers.motoros_controller.group import ControlGroup, milliseconds
from tests.examples import examples

PER_RAD = (40_000.0, 32_595.5)
IPC_S = 0.004


def group(start=(0.0, 0.0), queue=200, ipc_s=IPC_S, speeds=(4.0, 6.5)):
    return ControlGroup(PER_RAD, speeds, (-3.0, -3.0), (3.0, 3.0), start, ipc_s, queue)


def single(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def play(it, resend=True, share=None, ticks=100_000):
    """Run IPCs until the queue is empty; return the increments of each."""
    rows = []
    for _ in range(ticks):
        wanted = it.take(resend)
        done = wanted if share is None else it.limited(wanted, share)
        it.execute(done, resend)
        it.fill(True)
        rows.append(list(done))
        if not (it.has_data or it.holding_data):
            return rows
    raise AssertionError("it never ends")


def test_milliseconds_truncate_the_single_precision_product():
    assert milliseconds(0.04) == 40
    low = sum(milliseconds(k / 1000) != k for k in range(10_000))
    assert 0.003 < low / 10_000 < 0.02
    assert all(milliseconds(single(k / 1000 + 0.0005)) == k for k in range(0, 8_000_000, 997))


def test_times_that_do_not_fit_are_the_longest_that_do():
    assert milliseconds(3e38) == 2**31 - 1
    assert milliseconds(-1e9) == -(2**31) + 1


def test_pulses_are_truncated_toward_zero():
    it = group()
    assert it.pulses((1.9 / PER_RAD[0], -1.9 / PER_RAD[1])) == [1, -1]


def test_point_0_must_be_within_30_pulses_of_the_command():
    it = group()
    assert it.begin(0.0, (30.5 / PER_RAD[0], -30.5 / PER_RAD[1]), (0.0, 0.0)) == 0
    assert it.begin(0.0, (31.5 / PER_RAD[0], 0.0), (0.0, 0.0)) == InvalidSubcode.DATA_START_POS
    assert it.begin(0.0, (0.0, -31.5 / PER_RAD[1]), (0.0, 0.0)) == InvalidSubcode.DATA_START_POS
    assert not it.queue
    assert it.command == [0, 0]


@pytest.mark.parametrize(
    ("joints", "speeds", "subcode"),
    [
        ((0.01, 0.0), (0.0, 0.0), InvalidSubcode.DATA_START_POS),
        ((0.01, 0.0), (99.0, 0.0), InvalidSubcode.DATA_START_POS),
        ((0.0, 0.0), (99.0, 0.0), InvalidSubcode.DATA_SPEED),
        # The axes are checked in sequence: the first one's speed before the second one's start.
        ((0.0, 0.01), (99.0, 0.0), InvalidSubcode.DATA_SPEED),
        ((0.01, 0.0), (0.0, 99.0), InvalidSubcode.DATA_START_POS),
        ((0.0, 0.01), (0.0, 99.0), InvalidSubcode.DATA_START_POS),
    ],
)
def test_point_0_is_checked_axis_by_axis(joints, speeds, subcode):
    assert group().begin(0.0, joints, speeds) == subcode


def test_a_refused_point_0_is_kept_and_the_next_increment_has_the_whole_way_to_it():
    it = group()
    assert it.begin(0.0, (0.0, 0.0), (0.0, 0.0)) == 0
    for time_s in (0.0105, 0.0205):  # leaves a partial step
        it.add(time_s, (0.0, 0.0), (0.0, 0.0))
        it.fill(True)
    play(it)
    away = (100.5 / PER_RAD[0], -60.5 / PER_RAD[1])
    assert it.begin(5.0, away, (0.0, 0.0)) == InvalidSubcode.DATA_START_POS
    assert it.add(5.0125, away, (0.0, 0.0)) == 0
    it.fill(True)
    assert list(it.queue) == [(5004, [100, -60]), (5008, [0, 0]), (5012, [0, 0])]
    assert len(play(it)) == 3
    assert it.command == [100, -60]


def test_a_refused_speed_of_point_0_is_kept():
    it = group(speeds=(0.5, 0.5))
    assert it.begin(0.0, (0.0, 0.0), (2.0, 0.0)) == InvalidSubcode.DATA_SPEED
    it.add(0.4005, (0.0, 0.0), (0.0, 0.0))
    it.fill(True)
    assert it.queue[0][1][0] == pytest.approx(2.0 * PER_RAD[0] * IPC_S, rel=0.05)


def converting():
    """Return a group whose filler waits for space in the queue."""
    it = group(queue=50)
    it.begin(0.0, (0.0, 0.0), (0.0, 0.0))
    it.add(0.4005, (0.1, 0.0), (0.0, 0.0))
    it.fill(True)
    it.execute(it.take(True), True)
    return it


@pytest.mark.parametrize("away", [0.0, 1.0])
def test_point_0_while_a_point_is_converted_changes_nothing_of_that(away):
    """The waiting sample is already counted, and sets the pulses of the previous one again."""
    it, other = converting(), converting()
    it.begin(0.0, (away, 0.0), (0.0, 0.0))
    assert play(it) == play(other)
    assert it.command == it.pulses((0.1, 0.0))


def test_point_0_while_a_point_is_converted_stays_when_that_is_dropped():
    it = converting()
    it.begin(1.0, (1.0, 0.0), (0.5, 0.0))
    it.clear()
    before = list(it.command)
    it.add(1.4005, (1.0, 0.0), (0.0, 0.0))
    it.fill(True)
    time_ms, pulses = it.queue[0]
    assert time_ms == 1004
    assert before[0] + pulses[0] == pytest.approx(1.002 * PER_RAD[0], abs=10)


def test_what_is_no_number_is_refused_and_of_point_0_kept_all_the_same():
    it = group()
    for bad in (math.nan, math.inf, -math.inf):
        for time_s, joints, speeds in (
            (bad, (0.0, 0.0), (0.0, 0.0)),
            (0.0, (0.0, bad), (0.0, 0.0)),
            (0.0, (0.0, 0.0), (0.0, bad)),
        ):
            assert it.begin(0.0, (0.0, 0.0), (0.0, 0.0)) == 0
            assert it.add(0.1 + time_s, joints, speeds) == InvalidSubcode.DATA
            assert not it.has_data
            assert it.begin(time_s, joints, speeds) == InvalidSubcode.DATA
            assert it.add(0.1, (0.0, 0.0), (0.0, 0.0)) == 0
            it.fill(True)
            if time_s == 0.0:
                assert it.refuses(it.take(True))
            it.clear()


def test_only_the_whole_part_of_a_speed_is_checked():
    it = group(speeds=(4.2, 6.5))
    assert it.begin(0.0, (0.0, 0.0), (4.9, -6.9)) == 0
    assert it.begin(0.0, (0.0, 0.0), (5.0, 0.0)) == InvalidSubcode.DATA_SPEED
    assert it.add(1.0, (0.0, 0.0), (0.0, -7.0)) == InvalidSubcode.DATA_SPEED
    assert not it.has_data


def test_a_point_is_busy_until_the_queue_has_all_of_it():
    it = group(queue=50)
    it.begin(0.0, (0.0, 0.0), (0.0, 0.0))
    it.add(0.4, (0.1, 0.0), (0.0, 0.0))
    it.fill(True)
    assert it.has_data
    assert len(it.queue) == 50
    for _ in range(49):
        it.execute(it.take(True), True)
        it.fill(True)
        assert it.has_data
    it.execute(it.take(True), True)
    it.fill(True)
    assert not it.has_data
    assert len(it.queue) == 50


@pytest.mark.parametrize("time_s", [0.5, 0.3])
def test_a_point_that_is_not_later_does_nothing(time_s):
    it = group()
    it.begin(0.5, (0.0, 0.0), (0.0, 0.0))
    it.add(time_s, (1.0, 1.0), (0.0, 0.0))
    it.fill(True)
    assert not it.has_data
    assert not it.queue
    # The start of the next segment is unchanged.
    it.add(0.9, (0.2, 0.0), (0.0, 0.0))
    it.fill(True)
    assert len(it.queue) == 100
    play(it)
    assert it.command == it.pulses((0.2, 0.0))


def test_a_partial_step_is_completed_by_the_next_segment():
    it = group()
    it.begin(0.0, (0.0, 0.0), (0.0, 0.0))
    for time_s in (0.0105, 0.0205):
        it.add(time_s, (0.001 * time_s, 0.0), (0.0, 0.0))
        it.fill(True)
    assert [time_ms for time_ms, _ in it.queue] == [4, 8, 10, 12, 16, 20]
    rows = play(it)
    # 8 to 10 and 10 to 12 belong to the same period.
    assert len(rows) == 5


points = st.lists(
    st.tuples(st.integers(1, 90), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-3.0, 3.0)),
    min_size=1,
    max_size=8,
)


@settings(max_examples=examples(60))
@given(points, st.sampled_from([0.002, 0.004, 0.008]))
def test_increments_add_up_to_the_truncated_end_exactly(way, ipc_s):
    it = group(ipc_s=ipc_s)
    assert it.begin(0.0, (0.0, 0.0), (0.0, 0.0)) == 0
    time_ms, rows = 0, []
    for step_ms, a, b, speed in way:
        time_ms += step_ms
        assert it.add(single(time_ms / 1000 + 0.0005), (a, b), (speed, -speed)) == 0
        while it.has_data:
            rows.append(it.take(True))
            it.execute(rows[-1], True)
            it.fill(True)
            assert len(it.queue) <= 200
    rows += play(it)
    assert it.command == it.pulses((a, b))
    assert [sum(axis) for axis in zip(*rows, strict=True)] == it.command


@settings(max_examples=examples(40))
@given(points)
def test_a_steady_trajectory_takes_its_own_time(way):
    it = group()
    it.begin(0.0, (0.0, 0.0), (0.0, 0.0))
    time_ms = 0
    for step_ms, *_ in way:
        time_ms += step_ms
        # Ramps move every axis in every period, so that periods can be counted.
        it.add(single(time_ms / 1000 + 0.0005), (0.5 * time_ms / 1000, 0.0), (0.5, 0.0))
        it.fill(True)
    rows = play(it)
    assert len(rows) == pytest.approx(time_ms / 4, abs=1 + len(way) / 2)


def test_the_cubic_keeps_both_ends_speeds():
    it = group()
    it.begin(0.0, (0.0, 0.0), (0.5, 0.0))
    it.add(0.4005, (0.1, 0.0), (0.25, 0.0))
    it.fill(True)
    rows = [axes[0] / PER_RAD[0] / IPC_S for _, axes in it.queue]
    assert rows[0] == pytest.approx(0.5, abs=0.02)
    assert rows[-1] == pytest.approx(0.25, abs=0.02)


def test_a_point_is_dropped_when_motion_is_no_longer_possible():
    it = group(queue=20)
    it.begin(0.0, (0.0, 0.0), (0.0, 0.0))
    it.add(1.0, (0.5, 0.0), (0.0, 0.0))
    it.fill(True)
    it.fill(False)
    assert not it.has_data
    assert len(it.queue) == 20
    it.restart()
    assert not it.holding_data


def loaded():
    it = group()
    it.begin(0.0, (0.0, 0.0), (0.0, 0.0))
    it.add(0.4005, (0.5, -0.3), (0.0, 0.0))
    it.fill(True)
    return it


def test_a_speed_limit_stretches_a_trajectory_and_loses_nothing():
    it = loaded()
    rows = play(it, share=0.1)
    assert it.command == it.pulses((0.5, -0.3))
    most = [0.1 * each for each in it.largest_increments]
    assert all(abs(a) <= m for row in rows for a, m in zip(row, most, strict=True))
    assert len(rows) > 1.5 * 100


def test_after_a_speed_limit_nothing_is_faster_than_was_asked_for():
    it = loaded()
    fastest = [max(abs(axes[k]) for _, axes in it.queue) for k in range(2)]
    rows = []
    for tick in range(1000):
        wanted = it.take(True)
        done = it.limited(wanted, 0.05) if tick < 60 else wanted
        it.execute(done, True)
        rows.append(done)
        if not it.holding_data:
            break
    assert it.command == it.pulses((0.5, -0.3))
    assert all(abs(a) <= m for row in rows for a, m in zip(row, fastest, strict=True))


def test_old_firmware_loses_what_a_speed_limit_holds_back():
    it = loaded()
    rows = play(it, resend=False, share=0.1)
    assert len(rows) == pytest.approx(100, abs=1)
    assert 0 < it.command[0] < it.pulses((0.5, 0.0))[0] // 2


def test_a_speed_limit_keeps_the_path():
    it = loaded()
    for a, b in play(it, resend=False, share=0.1):
        assert abs(a * it.pulses((0.5, -0.3))[1] - b * it.pulses((0.5, -0.3))[0]) < 6e4


def test_increments_the_arm_cannot_make_are_refused():
    it = group(start=(2.99, 0.0))
    at_most = it.largest_increments[1]
    assert not it.refuses([0, round(at_most)])
    assert it.refuses([0, math.ceil(1.2 * at_most)])
    assert it.refuses([600, 0])
    assert not it.refuses([-600, 0])
