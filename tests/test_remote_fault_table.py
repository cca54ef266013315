"""Table of a device at another computer: it equals the measurements, the arm is at rest in time,
and no motion occurs without a request."""

import math

import pytest

from tests import remote_fault_table
from tests.fault_scenarios import SPEED_M_S
from tests.fault_table import HARDEST_M_S2, HIGHEST_M_S
from tests.remote_fault_table import (
    AGAIN_M,
    CAMERA,
    CAP,
    FAULTS,
    NETWORKS,
    OVERTAKEN,
    OVERTAKEN_S,
    TWICE,
)
from tests.test_fault_table import assert_are

STILL_M = 5e-5
"""Distance until rest of an arm that moves by less than 1 mm/s: 0.0 mm."""


@pytest.fixture(scope="module")
def rows():
    return list(remote_fault_table.rows())


def assert_safe(row):
    assert row.motion.stop_s <= row.rest_by_s, row
    assert row.motion.peak_m_s <= HIGHEST_M_S, row
    assert row.motion.peak_m_s2 <= HARDEST_M_S2, row
    assert row.motion.back_m <= STILL_M, row
    assert row.unasked_m <= STILL_M, row
    # Only re-arming lets a stopped arm move again.
    assert math.isinf(row.motion.stop_s) or row.again_m >= AGAIN_M, row


def test_a_network_that_is_cut_in_one_direction_stops_the_arm_in_time():
    (row,) = remote_fault_table.rows(["LTE"], ["only the way to the operator is cut"])
    assert_safe(row)
    assert not math.isinf(row.rest_by_s)


@pytest.mark.matrix
@pytest.mark.timeout(1200)
def test_what_is_written_is_what_is_measured(rows):
    assert_are(remote_fault_table.RESULTS, remote_fault_table.table(rows))


@pytest.mark.matrix
@pytest.mark.timeout(1200)
def test_the_arm_is_at_rest_in_time_and_moves_only_when_asked(rows):
    assert {(row.fault, row.network) for row in rows} == {(f, n) for f in FAULTS for n in NETWORKS}
    for row in rows:
        assert_safe(row)


@pytest.mark.matrix
@pytest.mark.timeout(1200)
def test_all_but_a_camera_ends_motion(rows):
    """If `max_age_s` is long, a state delayed by a picture may still be young enough."""
    assert {row.fault for row in rows if math.isinf(row.rest_by_s)} <= {CAMERA}


@pytest.mark.matrix
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(("fault", "jitter_s"), [(TWICE, 0.0), (OVERTAKEN, OVERTAKEN_S)])
def test_what_comes_twice_or_late_moves_nothing_further_or_faster(rows, fault, jitter_s):
    found = {(row.fault, row.network): row.motion for row in rows}
    for name, network in NETWORKS.items():
        there, without = found[fault, name], found[CAP, name]
        # By chance one state may be later than another.
        most_s = max(jitter_s, network.link.jitter_s)
        assert there.distance_m <= without.distance_m + SPEED_M_S * most_s + STILL_M, (name, there)
        assert there.peak_m_s <= without.peak_m_s * 1.001, (name, there)
