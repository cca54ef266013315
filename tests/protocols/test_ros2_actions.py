"""Goals of an action server, without a bus."""

import pytest

from cardan.protocols.ros2.actions import CancelCode, Goals, GoalStatus
from cardan.protocols.ros2.cdr import codec_of

A, B, C = (bytes([number]) * 16 for number in (1, 2, 3))
RESULT = {"success": True, "message": ""}


@pytest.fixture
def goals():
    return Goals(retained=3, retained_s=100.0)


def request(goal_id=bytes(16), stamp_ns=0):
    return {
        "goal_info": {
            "goal_id": {"uuid": goal_id},
            "stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9},
        }
    }


def states(goals):
    name = "action_msgs/msg/GoalStatusArray"
    message = codec_of(name).decode(codec_of(name).encode(goals.status_array()))
    return {
        bytes(each["goal_info"]["goal_id"]["uuid"]): GoalStatus(each["status"])
        for each in message["status_list"]
    }


def test_a_goal_goes_through_its_states(goals):
    goal = goals.accept(A, 5, 0.0)
    assert states(goals) == {A: GoalStatus.ACCEPTED}
    goals.execute(goal)
    assert states(goals) == {A: GoalStatus.EXECUTING}
    assert goals.finish(goal, GoalStatus.SUCCEEDED, RESULT, 1.0)
    assert states(goals) == {A: GoalStatus.SUCCEEDED}
    assert goals.find(A).result == RESULT
    assert not goals.finish(goal, GoalStatus.ABORTED, RESULT, 2.0)
    assert goal.status is GoalStatus.SUCCEEDED


def test_an_id_is_accepted_once(goals):
    assert goals.accept(A, 0, 0.0) is not None
    assert goals.accept(A, 0, 0.0) is None


def test_goals_that_go_on_are_bounded_and_ended_ones_make_room(goals):
    first = goals.accept(A, 0, 0.0)
    second = goals.accept(B, 0, 0.0)
    goals.accept(C, 0, 0.0)
    assert goals.accept(bytes([4]) * 16, 0, 0.0) is None
    goals.finish(second, GoalStatus.ABORTED, RESULT, 1.0)
    goals.finish(first, GoalStatus.SUCCEEDED, RESULT, 2.0)
    assert goals.accept(bytes([4]) * 16, 0, 3.0) is not None
    assert goals.find(B) is None  # it ended first
    assert goals.find(A) is first


def test_results_are_forgotten_after_a_while(goals):
    goal = goals.accept(A, 0, 0.0)
    goals.finish(goal, GoalStatus.SUCCEEDED, RESULT, 1.0)
    goals.accept(B, 0, 100.0)
    assert goals.find(A) is goal
    goals.accept(C, 0, 101.5)
    assert goals.find(A) is None


def test_canceling_one_goal(goals):
    goal, other = goals.accept(A, 0, 0.0), goals.accept(B, 0, 0.0)
    response, going = goals.cancel(request(A))
    assert going == [goal]
    assert response["return_code"] == CancelCode.NONE
    assert [each["goal_id"]["uuid"] for each in response["goals_canceling"]] == [A]
    assert other.status is GoalStatus.ACCEPTED
    goals.execute(goal)
    assert goal.status is GoalStatus.CANCELING


@pytest.mark.parametrize(
    ("stamp_ns", "expected"), [(0, {A, B}), (10, {A}), (9, set()), (20, {A, B})]
)
def test_canceling_all_or_those_before(goals, stamp_ns, expected):
    goals.accept(A, 10, 0.0), goals.accept(B, 20, 0.0)
    response, going = goals.cancel(request(stamp_ns=stamp_ns))
    assert {goal.id for goal in going} == expected
    assert response["return_code"] == CancelCode.NONE


def test_canceling_one_and_those_before(goals):
    for number, goal_id in enumerate((A, B, C), 1):
        goals.accept(goal_id, 10 * number, 0.0)
    _, going = goals.cancel(request(C, 10))
    assert {goal.id for goal in going} == {A, C}


def test_what_cannot_be_canceled_is_reported(goals):
    assert goals.cancel(request(A))[0]["return_code"] == CancelCode.UNKNOWN_GOAL_ID
    goal = goals.accept(A, 0, 0.0)
    goals.finish(goal, GoalStatus.SUCCEEDED, RESULT, 0.0)
    response, going = goals.cancel(request(A))
    assert response == {"return_code": CancelCode.GOAL_TERMINATED, "goals_canceling": []}
    assert going == []
    assert goal.status is GoalStatus.SUCCEEDED


def test_a_goal_that_is_canceled_before_it_comes_is_accepted_and_never_begins(goals):
    response, going = goals.cancel(request(A))
    assert response == {"return_code": CancelCode.UNKNOWN_GOAL_ID, "goals_canceling": []}
    assert going == []
    assert states(goals) == {}
    goal = goals.accept(A, 0, 0.0)
    assert goal.status is GoalStatus.CANCELING
    goals.execute(goal)
    assert goal.status is GoalStatus.CANCELING
    assert goals.accept(B, 0, 0.0).status is GoalStatus.ACCEPTED


def test_a_goal_that_comes_after_its_cancellation_may_be_one_of_several(goals):
    before = goals.accept(A, 10, 0.0)
    response, going = goals.cancel(request(B, 10))
    assert going == [before]
    assert response["return_code"] == CancelCode.NONE
    assert goals.accept(B, 20, 0.0).status is GoalStatus.CANCELING


def test_cancellations_of_goals_that_never_come_are_bounded(goals):
    ids = [bytes([number]) * 16 for number in range(10, 14)]
    for each in ids:
        goals.cancel(request(each))
    assert goals.accept(ids[-1], 0, 0.0).status is GoalStatus.CANCELING
    assert goals.accept(ids[0], 0, 0.0).status is GoalStatus.ACCEPTED


def test_to_cancel_all_says_nothing_of_goals_that_come_later(goals):
    goals.cancel(request())
    goals.cancel(request(stamp_ns=10))
    assert goals.accept(A, 20, 0.0).status is GoalStatus.ACCEPTED
