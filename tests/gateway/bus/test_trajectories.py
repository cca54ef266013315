"""FollowJointTrajectory goals as MoveIt sends them."""

import time

import numpy as np
import pytest

from cardan.gateway.bus import trajectories as fjt
from cardan.gateway.bus.commands import Instant
from cardan.protocols.ros2.actions import GoalStatus
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import action_type
from cardan.protocols.ros2.messages import completed
from tests.gateway.arm.arms import DT_S
from tests.gateway.bus.bench import Bench

ACTION = "//controller/follow_joint_trajectory/_action"
STEP = np.array([0.3, -0.2, 0.1, 0.0, 0.2, -0.4])
NOW_NS = 1_700_000_000_000_000_000


@pytest.fixture
def bench():
    return Bench()


def duration(seconds):
    return {"sec": int(seconds // 1), "nanosec": round(seconds % 1 * 1e9)}


def goal(bench, *steps, duration_s=2.0, names=None, order=None, **more):
    """A goal from the arm's joints over points that are offset by `steps`."""
    q = bench.world.q
    names = list(bench.world.model.joint_names) if names is None else names
    order = range(len(q)) if order is None else order
    points = [
        {
            "positions": (q + share)[list(order)].tolist(),
            "time_from_start": duration(duration_s * index / len(steps)),
        }
        for index, share in enumerate((0.0 * q, *steps))
    ]
    names = [names[index] for index in order]
    return {"trajectory": {"joint_names": names, "points": points}} | more


def send(bench, given, number=1):
    request = {"goal_id": {"uuid": bytes([number]) * 16}, "goal": given}
    assert bench.call(f"{ACTION}/send_goal", request).answer["accepted"]


def result(bench, number=1):
    request = {"goal_id": {"uuid": bytes([number]) * 16}}
    answer = bench.call(f"{ACTION}/get_result", request).answer
    reported = answer["result"]
    return GoalStatus(answer["status"]), reported["error_code"], reported["error_string"]


def tolerances(bench, position, **more):
    return [{"name": name, "position": position} | more for name in bench.world.model.joint_names]


def test_a_plan_is_carried_out(bench):
    begin = bench.world.q.copy()
    send(bench, goal(bench, 0.5 * STEP, STEP))
    bench.finish()
    assert result(bench) == (GoalStatus.SUCCEEDED, fjt.SUCCESSFUL, "")
    np.testing.assert_allclose(bench.world.q, begin + STEP, atol=1e-4)


def test_joints_may_come_in_any_order(bench):
    begin = bench.world.q.copy()
    send(bench, goal(bench, STEP, order=[3, 1, 5, 0, 2, 4]))
    bench.finish()
    assert result(bench)[0] is GoalStatus.SUCCEEDED
    np.testing.assert_allclose(bench.world.q, begin + STEP, atol=1e-4)


def test_feedback_has_where_it_is_and_where_it_is_to_be(bench):
    send(bench, goal(bench, STEP))
    bench.world.tick(100)
    verbs = bench.world.verbs
    now = Instant(5, "base_link", None, bench.world.state(), verbs.desired())
    bench.server.report(now, 0)
    (message,) = bench.heard("/controller/follow_joint_trajectory/_action/feedback")
    feedback = message["feedback"]
    assert tuple(feedback["joint_names"]) == bench.world.model.joint_names
    np.testing.assert_allclose(feedback["actual"]["positions"], bench.world.q)
    np.testing.assert_allclose(feedback["desired"]["positions"], verbs.desired()[0])
    following_error = np.subtract(feedback["desired"]["positions"], feedback["actual"]["positions"])
    np.testing.assert_allclose(feedback["error"]["positions"], following_error)
    assert len(feedback["error"]["velocities"]) == 6


def test_feedback_of_kilted_has_the_index_of_the_point(bench):
    send(bench, goal(bench, 0.5 * STEP, STEP))
    bench.world.tick(int(1.5 / DT_S))
    desired = bench.world.verbs.desired()
    action = fjt.follow_joint_trajectory("c", bench.world.model.joint_names, since_kilted=True)
    feedback = action.feedback(Instant(5, "base_link", None, bench.world.state(), desired))
    message = {"goal_id": {"uuid": bytes(16)}, "feedback": feedback}
    codec = codec_of(action_type(action.type_name).feedback)
    back = codec.decode(codec.encode(message))["feedback"]
    assert (back["index"], back["multi_dof_index"]) == (1, 0)
    assert desired[2] == 1


def test_canceling_brakes(bench):
    send(bench, goal(bench, STEP))
    bench.world.tick(int(0.9 / DT_S))
    bench.call(f"{ACTION}/cancel_goal")
    bench.finish()
    status, _, reason = result(bench)
    assert status is GoalStatus.CANCELED
    assert reason == "stopped"


def test_a_new_goal_ends_the_one_before(bench):
    send(bench, goal(bench, STEP), 1)
    bench.world.tick(int(0.3 / DT_S))
    send(bench, goal(bench, 0.5 * STEP), 2)
    status, _, reason = result(bench, 1)
    assert (status, reason) == (GoalStatus.ABORTED, "trajectory took over")
    bench.finish()


def test_tolerances_have_their_codes(bench):
    send(bench, goal(bench, STEP, path_tolerance=tolerances(bench, 0.02)), 1)
    bench.world.tick(int(0.6 / DT_S))
    bench.world.sag[0] = -0.05
    bench.finish()
    status, code, reason = result(bench, 1)
    assert (status, code) == (GoalStatus.ABORTED, fjt.PATH_TOLERANCE_VIOLATED)
    assert "shoulder_pan_joint" in reason

    bench = Bench()
    given = goal(bench, STEP, duration_s=3.0, goal_tolerance=tolerances(bench, 0.01))
    send(bench, given | {"goal_time_tolerance": duration(0.5)}, 1)
    bench.world.tick(int(2.0 / DT_S))
    bench.world.sag[1] = 0.03
    bench.finish()
    assert result(bench, 1)[1] == fjt.GOAL_TOLERANCE_VIOLATED


def changed(given, index, **fields):
    given["trajectory"]["points"][index] |= fields
    return given


BAD = {
    "no joints": (lambda b: goal(b, STEP, names=[""] * 6), fjt.INVALID_JOINTS, "the arm has sho"),
    "some joints": (lambda b: goal(b, STEP, order=range(5)), fjt.INVALID_JOINTS, "the arm has"),
    "other joints": (
        lambda b: goal(b, STEP, names=list("abcdef")), fjt.INVALID_JOINTS, "a, b, c, d, e, f",
    ),
    "no points": (
        lambda b: {"trajectory": {"joint_names": list(b.world.model.joint_names)}},
        fjt.INVALID_GOAL, "it has 0 points",
    ),
    "no positions": (
        lambda b: {
            "trajectory": {
                "joint_names": list(b.world.model.joint_names),
                "points": [{"time_from_start": duration(1)}],
            }
        }, fjt.INVALID_GOAL, "it has no positions",
    ),
    "NaN": (
        lambda b: changed(goal(b, STEP), 1, positions=[None] * 6), fjt.INVALID_GOAL, "not finite",
    ),
    "infinity": (
        lambda b: changed(goal(b, STEP), 1, positions=[1e999] * 6), fjt.INVALID_GOAL, "not finite",
    ),
    "unequal lengths": (
        lambda b: changed(goal(b, STEP), 1, positions=[0.0]), fjt.INVALID_GOAL, "not all points",
    ),
    "some velocities": (
        lambda b: changed(goal(b, STEP), 1, velocities=[0.0] * 6), fjt.INVALID_GOAL, "velocities",
    ),
    "efforts": (
        lambda b: changed(goal(b, STEP), 1, effort=[0.0] * 6), fjt.INVALID_GOAL, "efforts",
    ),
    "times that stand still": (
        lambda b: changed(goal(b, STEP), 1, time_from_start=duration(0)), fjt.INVALID_GOAL,
        "point 1 comes 0 s after",
    ),
    "negative times": (
        lambda b: changed(goal(b, STEP), 0, time_from_start={"sec": -1}), fjt.INVALID_GOAL,
        "times are not all",
    ),
    "elsewhere": (
        lambda b: changed(goal(b, STEP), 0, positions=(b.world.q + 0.2).tolist()),
        fjt.INVALID_GOAL, "plan it from where the arm is",
    ),
    "beyond a limit": (
        lambda b: goal(b, np.array([0, 0, 0, 0, 0, 9.0]), duration_s=20.0), fjt.INVALID_GOAL,
        "wrist_3_joint would have to be",
    ),
    "several degrees of freedom": (
        lambda b: goal(b, STEP) | {"multi_dof_trajectory": {"joint_names": ["x"]}},
        fjt.INVALID_GOAL, "several degrees of freedom",
    ),
    "a tolerance of another joint": (
        lambda b: goal(b, STEP, path_tolerance=[{"name": "x", "position": 1.0}]),
        fjt.INVALID_JOINTS, "no joint 'x'",
    ),
    "a tolerance of speed": (
        lambda b: goal(b, STEP, goal_tolerance=tolerances(b, 0.1, velocity=0.1)),
        fjt.INVALID_GOAL, "only positions are watched",
    ),
    "a tolerance that is none": (
        lambda b: goal(b, STEP, goal_tolerance=tolerances(b, None)), fjt.INVALID_GOAL,
        "is not a tolerance",
    ),
    "a tolerance of components": (
        lambda b: goal(b, STEP, component_path_tolerance=[{"joint_name": "x"}]),
        fjt.INVALID_GOAL, "there are no such joints",
    ),
    "too late": (
        lambda b: _stamped(goal(b, STEP), int(time.time()) - 600), fjt.OLD_HEADER_TIMESTAMP,
        "it was to begin 60",
    ),
    "too early": (
        lambda b: _stamped(goal(b, STEP), int(time.time()) + 60), fjt.INVALID_GOAL,
        "with a stamp of 0",
    ),
}  # fmt: skip


def _stamped(given, sec):
    given["trajectory"]["header"] = {"stamp": {"sec": sec}}
    return given


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_plan_for_this_arm_is_refused_with_code_and_reason(bench, name):
    make, expected, words = BAD[name]
    send(bench, make(bench))
    status, code, reason = result(bench)
    assert status is GoalStatus.ABORTED
    assert (code, words in reason) == (expected, True), reason
    assert bench.world.verbs.at_rest


def test_a_stamp_of_now_is_now():
    joints = ("a", "b")
    given = {
        "trajectory": {
            "joint_names": ["b", "a"],
            "points": [{"positions": [1, 2], "time_from_start": {"sec": 1}}],
        },
        "path_tolerance": [{"name": "b", "position": 0.5}, {"name": "a", "position": -1}],
        "goal_time_tolerance": {"sec": 2},
    }
    _stamped(given, NOW_NS // 10**9)
    message = completed(f"{fjt.FOLLOW}_Goal", given)
    found = fjt.trajectory_of(message, joints, NOW_NS + 500_000_000)
    assert found.positions == [[2.0, 1.0]]
    assert found.path_tolerance == [0.0, 0.5]
    assert found.goal_tolerance is None
    assert found.goal_time_s == 2.0
