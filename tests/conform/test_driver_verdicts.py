"""Verdicts on drivers that exit, and on references that jump."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from cardan.conform import Level, VerdictOutcome, registry
from cardan.conform.egm.decoded import Robot, SensorDatagram
from cardan.conform.egm_driver.requirements import (
    a_session_begins_where_the_arm_is,
    references_do_not_jump,
)
from cardan.conform.run import simulated
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRobot,
    EgmSensor,
)
from cardan.spatial import Quaternion, Vector3


def answer(joint_deg=0.0, x_m=0.0):
    """Return an answer that commands this position of the first joint and of the TCP."""
    joints = (math.radians(joint_deg), *(0.0,) * 5)
    pose = EgmPose(Vector3(x_m, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0))
    header = EgmHeader(1, 1, EgmMessageType.CORRECTION)
    return SensorDatagram(2, 0.0, EgmSensor(header, EgmMotion(joints, pose)))


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (answer(joint_deg=5.0), "5.00 of at most 1 degrees"),
        (answer(x_m=0.02), "20.00 of at most 4 mm"),
        (answer(5.0, 0.02), "20.00 of at most 4 mm and 5.00 of at most 1 degrees"),
        (answer(0.9, 0.003), ""),
    ],
)
def test_a_jump_is_reported_in_what_was_exceeded(after, words):
    assert references_do_not_jump((answer(), after)) == words


def test_joints_away_from_the_arm_are_reported_in_degrees():
    measured = Robot(1, 0.0, "", EgmRobot(feed_back=answer().message.planned))
    answers = [answer(joint_deg=5.0)]
    decoded = SimpleNamespace(robots=[measured], answers=answers, sessions=[[measured]])
    found = [*a_session_begins_where_the_arm_is(decoded)]
    assert found == [(2, "away by 5.00 of at most 0.05 degrees")]


def test_a_driver_that_has_ended_is_not_judged_by_what_comes_later():
    report, _ = simulated(registry.load("egm-driver"), Level.BY_HAND, {"gives-up": 1.0})
    assert report.failed == ("EGMPC-112",)
    found = {each.id: each for each in report.results}
    for number in (113, 114, 115, 301):
        verdict = found[f"EGMPC-{number}"]
        assert verdict.outcome is VerdictOutcome.NOT_SEEN
        assert verdict.said == "not judged: it had ended (EGMPC-112)"


def test_a_driver_that_only_does_not_follow_is_judged():
    report, _ = simulated(registry.load("egm-driver"), Level.HOLD, {"one-port": 1.0})
    assert report.failed == ("EGMPC-115",)
