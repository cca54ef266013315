"""Range of an arm's TCP along the axes of its base."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.reach import tcp_range_m
from cardan.robots import load_arm


@pytest.mark.parametrize(
    "name", ["amor", "asibot", "gofa_crb15000_5", "gp8", "pr2_left_arm", "ur5", "ur5e"]
)
def test_no_posture_is_beyond_it_and_some_are_at_its_ends(name):
    arm = ArmKinematics(load_arm(name))
    low, high = np.array(tcp_range_m(arm)).T
    random = np.random.default_rng(1)
    lower = np.where(arm.continuous, -np.pi, arm.lower)
    upper = np.where(arm.continuous, np.pi, arm.upper)
    postures = random.uniform(lower, upper, (20_000, arm.joints))
    points = np.array([arm.forward(q).translation for q in postures])
    assert (points >= low - 0.003).all()
    assert (points <= high + 0.003).all()
    # Random postures come near the limits, and stay within them.
    assert (points.min(axis=0) <= low + 0.12).all()
    assert (points.max(axis=0) >= high - 0.12).all()


def test_a_ur5_reaches_as_far_as_its_links_are_long():
    """d1 0.0892, a2 0.425, a3 0.3922, d4 0.1091, d5 0.0947, d6 0.0823 m."""
    x, y, z = tcp_range_m(ArmKinematics(load_arm("ur5")))
    assert z[1] == pytest.approx(0.0892 + 0.425 + 0.3922 + 0.0947 + 0.0305, abs=0.03)
    for low, high in (x, y):
        assert -low == pytest.approx(high, abs=0.005)
        assert 0.92 < high < 0.96
