"""Intersection of Cardan's limits and those that a controller reports for its velocity mode."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import pytest

from cardan.drivers.motoros.agreed_limits import agreed_limits
from cardan.protocols.simple_message.messages import VelocityInfo
from cardan.types import JointLimits

OURS = JointLimits((-1.0, -2.0), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0))


def agreed(
    *,
    lower: Sequence[float] = (0.0, 0.0),
    upper: Sequence[float] = (0.0, 0.0),
    velocity: Sequence[float] = (0.0, 0.0),
    acceleration: Sequence[float] = (0.0, 0.0),
) -> JointLimits:
    """Return the limits for a controller that reports these of two joints, and zeros for eight
    more."""
    joints = [(*values, *[0.0] * 8) for values in (velocity, acceleration, lower, upper)]
    return agreed_limits(OURS, VelocityInfo(1, 4000, 100, 0, 1, 2, *joints))


def test_a_controller_that_gives_no_limits_leaves_ours():
    assert agreed() == OURS


@pytest.mark.parametrize("bad", [0.0, -0.5, math.inf, math.nan])
def test_a_limit_that_is_none_leaves_ours(bad):
    assert agreed(velocity=(bad, bad), acceleration=(bad, bad)) == OURS


def test_of_speeds_and_accelerations_the_lesser_of_each_joint_holds():
    limits = agreed(velocity=(0.5, 40.0), acceleration=(50.0, 0.25))
    assert limits.velocity == pytest.approx((0.5, 4.0), rel=1e-5)
    assert limits.acceleration == pytest.approx((5.0, 0.25), rel=1e-5)
    assert (limits.lower, limits.upper) == (OURS.lower, OURS.upper)


@pytest.mark.parametrize("theirs", [0.1, 0.7, 1.0 / 3.0, 2.9])
def test_what_is_sent_as_float32_is_not_above_their_limit(theirs):
    given = struct.unpack("f", struct.pack("f", theirs))[0]
    ours = agreed(velocity=(given, given), acceleration=(given, given))
    for limit in (*ours.velocity, *ours.acceleration):
        assert struct.unpack("f", struct.pack("f", limit))[0] < given
        assert limit > given * (1.0 - 1.5e-6)


@pytest.mark.parametrize(
    ("theirs", "agreed_on"),
    [
        ((-0.5, 0.25), (-0.5, 0.25)),
        ((-9.0, 0.25), (-1.0, 0.25)),
        ((-0.5, 9.0), (-0.5, 1.0)),
        ((-9.0, 9.0), (-1.0, 1.0)),
        ((-1.0, 1.0), (-1.0, 1.0)),
        # Reported limits that are no range, or do not overlap with Cardan's, are ignored.
        ((0.5, 0.5), (-1.0, 1.0)),
        ((0.5, -0.5), (-1.0, 1.0)),
        ((1.0, 3.0), (-1.0, 1.0)),
        ((-3.0, -1.0), (-1.0, 1.0)),
        ((2.0, 3.0), (-1.0, 1.0)),
        ((math.nan, 0.5), (-1.0, 1.0)),
        ((-0.5, math.nan), (-1.0, 1.0)),
    ],
)
def test_of_ranges_the_part_in_common_holds(theirs, agreed_on):
    limits = agreed(lower=(theirs[0], -0.125), upper=(theirs[1], 0.5))
    assert (limits.lower, limits.upper) == ((agreed_on[0], -0.125), (agreed_on[1], 0.5))
    assert (limits.velocity, limits.acceleration) == (OURS.velocity, OURS.acceleration)
