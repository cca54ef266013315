"""Feedback to the operator device, in virtual time."""

import pytest

from cardan.gateway.arm.status import ArmStatus, AuthorityState, Phase
from cardan.gateway.operator.feedback import (
    FEEDBACK_PERIOD_S,
    LIMIT_LEVEL,
    TRIP_PULSE_S,
    FeedbackOptions,
    OperatorFeedback,
)
from cardan.gateway.session.parts import arm_feedback_of
from cardan.types import (
    NEVER_S,
    ZERO3,
    ZERO_TWIST,
    DeviceFeedback,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
    Wrench,
)

BOTH = {"led", "rumble"}
ROBOT = RobotState(0.0, RobotLink.LIVE, 1, 0, 0.004, (), (), None, "")
NOBODY = AuthorityState("", NEVER_S, "")
REST = ArmStatus(Phase.HOLDING, "", ZERO_TWIST, ZERO_TWIST, None, 0.0, False, False, 0, NOBODY)
MOVING = REST._replace(phase=Phase.MOVING, target=Twist(Vector3(0.1, 0.0, 0.0), ZERO3))


def played(hand, status, robot=ROBOT, start_s=0.0, seconds=1.0):
    """All feedback that is sent while nothing changes."""
    sent, now_s = [], start_s
    while now_s < start_s + seconds:
        if hand.due(now_s) and (feedback := hand.update(arm_feedback_of(status), robot, now_s)):
            sent.append(feedback)
        now_s += 0.004
    return sent


def test_the_light_says_that_the_hand_is_on_the_robot():
    hand = OperatorFeedback(FeedbackOptions(), {"led"})
    assert played(hand, REST) == [DeviceFeedback(True)]
    assert played(hand, MOVING, start_s=1.0) == []
    assert played(hand, REST._replace(phase=Phase.DISARMED), start_s=2.0) == [DeviceFeedback(False)]
    assert hand.last() is None


def test_it_ends_dark_and_quiet():
    hand = OperatorFeedback(FeedbackOptions(rumble=("max_lead",)), BOTH)
    played(hand, MOVING._replace(lead_used=1.0))
    assert hand.last() == DeviceFeedback(False, 0.0)
    assert hand.last() is None


def test_a_trip_is_felt_for_a_while():
    hand = OperatorFeedback(FeedbackOptions(led=False), BOTH)
    sent = played(hand, REST._replace(trips=1), seconds=2 * TRIP_PULSE_S)
    assert sent[0].rumble == 1.0
    assert sent[-1].rumble == 0.0
    assert played(hand, REST._replace(trips=1), start_s=2.0) == []


@pytest.mark.parametrize(
    ("sources", "status", "robot", "level"),
    [
        (("limit",), MOVING._replace(at_workspace_limit=True), ROBOT, LIMIT_LEVEL),
        (("limit",), REST._replace(at_workspace_limit=True), ROBOT, None),
        (("max_lead",), MOVING._replace(lead_used=0.65), ROBOT, 0.5),
        (("max_lead",), MOVING._replace(lead_used=0.2), ROBOT, None),
        (("max_lead",), MOVING._replace(lead_used=3.0), ROBOT, 1.0),
        ((), MOVING._replace(lead_used=3.0), ROBOT, None),
        (
            ("force", "max_lead"),
            MOVING._replace(lead_used=0.37),
            ROBOT._replace(wrench=Wrench(Vector3(0.0, 3.0, 4.0), ZERO3)),
            0.25,
        ),
    ],
)
def test_what_is_felt(sources, status, robot, level):
    hand = OperatorFeedback(FeedbackOptions(led=False, rumble=sources), BOTH)
    sent = played(hand, status, robot, seconds=0.1)
    assert [each.rumble for each in sent] == ([] if level is None else [pytest.approx(level)])


def test_rumble_that_lasts_is_renewed_before_the_driver_ends_it():
    hand = OperatorFeedback(FeedbackOptions(led=False, rumble=("max_lead",)), BOTH)
    sent = played(hand, MOVING._replace(lead_used=1.0), seconds=2.0)
    assert 4 <= len(sent) <= 6


def test_small_changes_are_not_passed_on():
    hand = OperatorFeedback(FeedbackOptions(led=False, rumble=("max_lead",)), BOTH)
    played(hand, MOVING._replace(lead_used=0.65), seconds=FEEDBACK_PERIOD_S)
    assert played(hand, MOVING._replace(lead_used=0.66), start_s=0.06, seconds=0.1) == []


def test_a_device_without_channels_is_left_alone():
    hand = OperatorFeedback(FeedbackOptions(), ())
    assert not hand.useful
    assert hand.update(MOVING, ROBOT, 0.0) is None
    assert hand.last() is None
