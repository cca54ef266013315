"""Limits in effect on an arm, each as a word of its metrics."""

import math

import pytest

from cardan.gateway.arm.status import LIMITS, ArmStatus, AuthorityState, Phase
from cardan.gateway.servo.status import ServoStatus
from cardan.types import NEVER_S, ZERO_TWIST

FREE = ServoStatus(1.0, 0.2, 0.0, (), math.inf, ("a", "b"), 0, 0.0, 0.0, 0.0, 0.0, 0)
SLOW = {"path_speed": 0.5}


def limits(lead_used=0.0, at_workspace_limit=False, **servo):
    return ArmStatus(
        Phase.MOVING, "", ZERO_TWIST, ZERO_TWIST, None, lead_used, at_workspace_limit, False, 0,
        AuthorityState("", NEVER_S, ""), (), FREE._replace(**servo),
    ).limits()  # fmt: skip


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({}, []),
        ({"limiting_joints": ("elbow",), "smallest_singular_value": 0.001}, []),
        ({"limiting_joints": ("elbow",), **SLOW}, ["joint"]),
        ({"smallest_singular_value": 0.001, **SLOW}, ["singularity"]),
        ({"active_pairs": 2, **SLOW}, ["collision"]),
        ({"distance_m": -0.01}, ["collision"]),
        ({"unreachable_rad_s": 0.1}, ["unreachable"]),
        ({"at_workspace_limit": True, "lead_used": 1.0}, ["workspace", "max_lead"]),
        ({"lead_used": 0.5}, []),
    ],
)
def test_what_limits_the_arm(given, found):
    assert limits(**given) == found
    assert {*found} <= {*LIMITS}


def test_how_near_two_bodies_are():
    assert FREE._replace(distance_m=0.0307).nearest_in_words == "a and b are 30.7 mm apart"
    assert FREE._replace(distance_m=-0.034).nearest_in_words == "a and b overlap by 34.0 mm"
    comes = FREE._replace(distance_m=0.3, nearer_m=0.31).nearest_in_words
    assert comes == "a, which may come 310 mm nearer by itself, and b are 300.0 mm apart"
    assert "by itself" not in FREE._replace(distance_m=0.3, nearer_m=0.001).nearest_in_words
