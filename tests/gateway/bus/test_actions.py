"""Motions as actions: goals, feedback, results, cancellation, preemption."""

import pytest

from cardan.gateway.bus.actions import MAX_WAITING
from cardan.gateway.bus.arm_server import GOALS_PERIOD_S
from cardan.gateway.bus.commands import Instant
from cardan.protocols.ros2.actions import CAPACITY, CancelCode, GoalStatus
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from tests.gateway.bus.bench import Asked, Bench, ros_pose

MOTIONS = ("movj", "relj", "movl", "movv", "forc", "gcmp")


@pytest.fixture
def bench():
    return Bench()


def goal_id(number):
    return number.to_bytes(2, "little") * 8


def send(bench, action, given=None, number=1):
    request = {"goal_id": {"uuid": goal_id(number)}, "goal": given or {}}
    return bench.call(f"/action/{action}/_action/send_goal", request).answer["accepted"]


def ask(bench, action, number=1):
    """Request a result; the reply is there once the motion has one."""
    request = {"goal_id": {"uuid": goal_id(number)}}
    return bench.call(f"/action/{action}/_action/get_result", request)


def result(bench, action, number=1):
    answer = ask(bench, action, number).answer
    return GoalStatus(answer["status"]), answer["result"]


def cancel(bench, action, number=None):
    info = {"goal_id": {"uuid": bytes(16) if number is None else goal_id(number)}}
    answer = bench.call(f"/action/{action}/_action/cancel_goal", {"goal_info": info}).answer
    return answer["return_code"], len(answer["goals_canceling"])


def states(bench, action):
    array = bench.heard(f"/action/{action}/_action/status")[-1]
    return [GoalStatus(each["status"]) for each in array["status_list"]]


def below(bench, by=0.05):
    return {"x": ros_pose(bench.world.moved(0.0, 0.0, -by))}


def test_every_motion_is_an_action_beside_its_topic_and_service(bench):
    for verb in MOTIONS:
        for part in ("send_goal", "cancel_goal", "get_result"):
            assert f"/arm/action/{verb}/_action/{part}" in bench.node.types
        assert bench.heard(f"/action/{verb}/_action/status")[-1] == {"status_list": []}


@pytest.mark.parametrize("verb", ["movj", "movl"])
def test_a_goal_is_reached(bench, verb):
    before = bench.world.six()
    assert send(bench, verb, below(bench))
    assert states(bench, verb) == [GoalStatus.EXECUTING]
    waiting = ask(bench, verb)
    assert waiting.answers == []
    bench.finish()
    assert states(bench, verb) == [GoalStatus.SUCCEEDED]
    assert waiting.answer == {"status": 4, "result": {"success": True, "message": ""}}
    assert result(bench, verb) == (GoalStatus.SUCCEEDED, {"success": True, "message": ""})
    assert bench.world.six()[2] == pytest.approx(before[2] - 0.05, abs=1e-3)


def test_a_goal_where_the_arm_is_already_is_reached_at_once(bench):
    assert send(bench, "movl", {"x": ros_pose(bench.world.six())})
    assert result(bench, "movl")[0] is GoalStatus.SUCCEEDED


@pytest.mark.parametrize(
    ("verb", "given", "words"),
    [
        ("movl", {"x": {"position": {"x": 9}}}, "out of reach"),
        ("movj", {"x": {"position": {"x": None}}}, "not numbers"),
        ("relj", {"x": {"orientation": {"w": 3}}}, "has length 3"),
        ("movv", {}, "moves nothing"),
        ("forc", {"fd": {"force": {"z": None}}}, "forc"),
    ],
)
def test_what_the_arm_refuses_ends_the_goal_with_the_reason(bench, verb, given, words):
    assert send(bench, verb, given)
    status, reported = result(bench, verb)
    assert status is GoalStatus.ABORTED
    assert not reported["success"]
    assert words in reported["message"]
    assert bench.world.verbs.at_rest


def test_feedback_is_published_while_the_goal_moves_the_arm(bench):
    pose = bench.world.verbs.commanded.pose
    now = Instant(3_000_000_001, "base_link", pose, bench.world.state())
    assert not bench.server.running
    bench.server.report(now, 0)
    send(bench, "movl", below(bench))
    assert bench.server.running
    bench.server.report(now, 0)
    (feedback,) = bench.heard("/action/movl/_action/feedback")
    assert feedback["goal_id"]["uuid"] == goal_id(1)
    stamped = feedback["feedback"]["pose"]
    assert stamped["header"] == {"stamp": {"sec": 3, "nanosec": 1}, "frame_id": "base_link"}
    assert stamped["pose"]["position"]["x"] == pose.position.x
    assert bench.heard("/action/movj/_action/feedback") == []
    bench.finish()
    assert not bench.server.running


@pytest.mark.parametrize("number", [1, None])
def test_canceling_brakes_the_arm(bench, number):
    before = bench.world.six()
    send(bench, "movl", below(bench, 0.2))
    bench.world.tick(200)
    waiting = ask(bench, "movl")
    assert cancel(bench, "movl", number) == (0, 1)
    bench.finish()
    assert waiting.answer["status"] == GoalStatus.CANCELED
    assert waiting.answer["result"] == {"success": False, "message": "stopped"}
    assert states(bench, "movl") == [GoalStatus.CANCELED]
    assert before[2] - 0.15 < bench.world.six()[2] < before[2] - 0.005


def test_motions_without_end_are_ended_by_canceling(bench):
    assert send(bench, "movv", {"xdot": {"linear": {"z": -0.02}}})
    bench.world.tick(100)
    assert cancel(bench, "movv") == (0, 1)
    bench.finish()
    assert result(bench, "movv")[0] is GoalStatus.CANCELED


def test_canceling_another_goal_moves_nothing_and_brakes_nothing(bench):
    send(bench, "movl", below(bench), number=1)
    bench.finish()
    send(bench, "movl", below(bench), number=2)
    bench.world.tick(10)
    assert cancel(bench, "movl", 1) == (3, 0)  # already ended
    assert cancel(bench, "movl", 9) == (1 + 1, 0)  # unknown goal
    assert cancel(bench, "movj") == (0, 0)  # another action
    bench.finish()
    assert result(bench, "movl", 2)[0] is GoalStatus.SUCCEEDED


def test_a_later_goal_takes_the_arm_through_rest(bench):
    send(bench, "movl", below(bench, 0.2), number=1)
    bench.world.tick(200)
    assert send(bench, "movj", below(bench, -0.02), number=2)
    status, reported = result(bench, "movl", 1)
    assert status is GoalStatus.ABORTED
    assert reported["message"] == "movj took over"
    bench.finish()
    assert result(bench, "movj", 2)[0] is GoalStatus.SUCCEEDED


def test_a_goal_that_is_refused_leaves_the_one_before_alone(bench):
    send(bench, "movl", below(bench), number=1)
    bench.world.tick(10)
    assert send(bench, "movl", {"x": {"position": {"x": 9}}}, number=2)
    assert states(bench, "movl") == [GoalStatus.EXECUTING, GoalStatus.ABORTED]
    bench.finish()
    assert result(bench, "movl", 1)[0] is GoalStatus.SUCCEEDED


def test_a_goal_that_is_canceled_before_it_begins_does_not_go_on(bench):
    # The goal is accepted but has not begun, as while another motion comes to rest.
    begin, offered = [], bench.offer

    def late(client, packet, now_s):
        if type(client).__name__ == "_GoalClient":
            request = client.decode(packet)
            begin.append((client, request))
        else:
            offered(client, packet, now_s)

    bench.server._offer = late
    before = bench.world.six()
    send(bench, "movl", below(bench, 0.2))
    assert states(bench, "movl") == [GoalStatus.ACCEPTED]
    assert cancel(bench, "movl", 1) == (0, 1)
    assert states(bench, "movl") == [GoalStatus.CANCELING]
    ((client, request),) = begin
    motion = bench._perform(request)
    bench.motions[1] = motion, client
    client.done(request, bench._note(1, motion))
    bench.finish()
    assert result(bench, "movl")[0] is GoalStatus.CANCELED
    assert bench.world.six()[2] == pytest.approx(before[2], abs=1e-4)


def waiting(bench, action, part, given, gid=None):
    """Put a request to an action into its queue, before the server reads it."""
    name = f"/arm/action/{action}/_action/{part}"
    type_name = bench.node.types[name]
    request = completed(f"{type_name}_Request", given)
    asked = Asked(type_name, codec_of(f"{type_name}_Request").encode(request), gid)
    bench.node.rings[name].waiting.append(asked)
    return asked


@pytest.mark.parametrize("number", [1, None])
@pytest.mark.parametrize("verb", ["movl", "movv"])
@pytest.mark.parametrize("full", [False, True])
def test_a_goal_and_its_cancellation_that_come_together(verb, number, full):
    bench = Bench(full=lambda: full)
    before = bench.world.six()
    given = below(bench, 0.2) if verb == "movl" else {"xdot": {"linear": {"z": -0.02}}}
    goal = {"goal_id": {"uuid": goal_id(1)}}
    sent = waiting(bench, verb, "send_goal", {**goal, "goal": given})
    info = {"goal_id": {"uuid": bytes(16) if number is None else goal_id(number)}}
    ended = waiting(bench, verb, "cancel_goal", {"goal_info": info})
    bench.poll()
    assert sent.answer["accepted"]
    assert ended.answer["return_code"] == 0
    assert [each["goal_id"]["uuid"] for each in ended.answer["goals_canceling"]] == [goal_id(1)]
    assert bench.requests == []
    assert states(bench, verb) == [GoalStatus.CANCELED]
    assert bench.world.six() == pytest.approx(before)


@pytest.mark.parametrize("waits_for_token", [False, True])
def test_a_goal_whose_sender_is_not_known_yet_and_its_cancellation(bench, waits_for_token):
    # The sender's token arrives later, and a motion without end waits for it.
    goal = {"goal_id": {"uuid": goal_id(1)}}
    given = {"xdot": {"linear": {"z": -0.02}}}
    stranger = b"s" * 16
    sent = waiting(bench, "movv", "send_goal", {**goal, "goal": given}, stranger)
    if waits_for_token:
        bench.poll()
        assert sent.answers == []
    ended = waiting(bench, "movv", "cancel_goal", {"goal_info": goal}, stranger)
    for _ in range(3):
        bench.poll(GOALS_PERIOD_S)
    assert sent.answer["accepted"]
    assert (ended.answer["return_code"], len(ended.answer["goals_canceling"])) == (0, 1)
    bench.poll()
    assert bench.requests == []
    assert result(bench, "movv")[0] is GoalStatus.CANCELED


def test_other_goals_that_come_with_a_cancellation_begin(bench):
    goal = {"goal_id": {"uuid": goal_id(1)}}
    others = {"goal_id": {"uuid": goal_id(2)}}
    waiting(bench, "movl", "send_goal", {**goal, "goal": below(bench, 0.2)})
    waiting(bench, "movl", "cancel_goal", {"goal_info": goal})
    waiting(bench, "movl", "send_goal", {**others, "goal": below(bench)})
    spoilt = Asked("cardan_msgs/action/MovePose_SendGoal", b"")
    bench.node.rings["/arm/action/movl/_action/send_goal"].waiting.append(spoilt)
    bench.poll()
    assert not spoilt.answer["accepted"]
    assert bench.malformed == 1
    assert states(bench, "movl") == [GoalStatus.CANCELED, GoalStatus.EXECUTING]
    bench.finish()
    assert result(bench, "movl", 2)[0] is GoalStatus.SUCCEEDED


@pytest.mark.parametrize("verb", ["movl", "movv"])
def test_a_goal_that_comes_after_its_cancellation_does_not_begin(bench, verb):
    assert cancel(bench, verb, 1) == (2, 0)
    given = below(bench, 0.2) if verb == "movl" else {"xdot": {"linear": {"z": -0.02}}}
    assert send(bench, verb, given)
    assert [each.verb for each in bench.requests] == []
    assert bench.world.verbs.at_rest
    status, reported = result(bench, verb)
    assert status is GoalStatus.CANCELED
    assert reported == {"success": False, "message": f"{verb}: it was canceled before it began"}
    assert send(bench, verb, given, number=2)
    assert bench.requests[-1].verb == verb


def test_a_goal_that_is_canceled_while_it_waits_for_its_turn_is_not_asked_for_any_more(bench):
    held, offered = [], bench.offer

    def late(client, packet, now_s):
        if type(client).__name__ == "_GoalClient":
            held.append((client, client.decode(packet)))
        else:
            offered(client, packet, now_s)

    bench.server._offer = late
    send(bench, "movl", below(bench, 0.2), number=1)
    send(bench, "movl", below(bench, 0.2), number=2)
    (_, first), (_, second) = held
    assert first.wanted()
    assert second.wanted()
    assert cancel(bench, "movl", 1) == (0, 1)
    assert not first.wanted()
    assert second.wanted()
    assert bench.requests == []  # A goal that moves nothing causes no braking.


def test_an_id_is_taken_once(bench):
    assert send(bench, "movl", below(bench))
    assert not send(bench, "movl", below(bench))
    assert len(bench.requests) == 1
    assert "goal id is known already" in bench.results()[-1][3]


def test_a_goal_that_nobody_sent_has_no_result(bench):
    status, reported = result(bench, "movl", 77)
    assert status is GoalStatus.UNKNOWN
    assert reported == {"success": False, "message": ""}


def test_results_are_kept_for_a_bounded_number_of_goals(bench):
    for number in range(1, CAPACITY + 11):
        send(bench, "movl", {"x": {"position": {"x": 9}}}, number=number)
    assert len(states(bench, "movl")) == CAPACITY
    assert result(bench, "movl", 1)[0] is GoalStatus.UNKNOWN
    assert result(bench, "movl", CAPACITY + 10)[0] is GoalStatus.ABORTED


def test_who_waits_for_a_result_is_bounded(bench):
    send(bench, "movl", below(bench))
    waiting = [ask(bench, "movl") for _ in range(MAX_WAITING + 1)]
    refused = waiting[-1].answer
    assert refused["status"] == GoalStatus.UNKNOWN
    assert "wait for this result already" in refused["result"]["message"]
    bench.finish()
    assert [each.answer["status"] for each in waiting[:-1]] == [4] * MAX_WAITING


@pytest.mark.parametrize("part", ["send_goal", "cancel_goal", "get_result"])
@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(9), bytes(500) + b"\1"])
def test_what_is_no_request_is_refused(bench, part, data):
    answer = bench.call(f"/action/movl/_action/{part}", data=data).answer
    if part == "send_goal":
        assert not answer["accepted"]
    elif part == "cancel_goal":
        assert answer == {"return_code": CancelCode.REJECTED, "goals_canceling": []}
    else:
        assert answer["status"] == GoalStatus.UNKNOWN
        assert not answer["result"]["success"]
        assert answer["result"]["message"]
    assert bench.server.refused == bench.malformed == 1
    assert bench.requests == []
    assert states(bench, "movl") == []


def test_the_torque_actions_carry_wrenches_and_weight():
    bench = Bench(arm="gofa_crb15000_5")
    assert send(bench, "gcmp")
    assert states(bench, "gcmp") == [GoalStatus.EXECUTING]
    bench.world.tick(10)
    cancel(bench, "gcmp")
    bench.finish()
    assert result(bench, "gcmp")[0] is GoalStatus.CANCELED


def test_a_second_force_takes_over_the_goal_of_the_first():
    bench = Bench(arm="gofa_crb15000_5")
    given = {"fd": {"force": {"z": -5.0}}}
    assert send(bench, "forc", given, number=1)
    bench.world.tick(5)
    assert send(bench, "forc", given, number=2)
    assert states(bench, "forc") == [GoalStatus.ABORTED, GoalStatus.EXECUTING]
    cancel(bench, "forc", 2)
    bench.finish()
    assert states(bench, "forc") == [GoalStatus.ABORTED, GoalStatus.CANCELED]
