"""Commands through topics and services are carried out, or refused with a reason to their
sender."""

import json
import math
import time

import pytest

from cardan.bus.node import gid_of_token
from cardan.gateway.arm.vocab import State, Stream
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from tests.gateway.bus.bench import NODE, Asked, Bench, ros_pose

DT_S = 4e-3
DOWN = {"linear": {"x": 0.0, "y": 0.0, "z": -0.02}}
MOVE = "cardan_msgs/action/MoveTwist"
POSE = "geometry_msgs/msg/Pose"
TWIST = "geometry_msgs/msg/Twist"
TABLE_1 = {
    "pose": POSE,
    "twist": TWIST,
    "wrench": "geometry_msgs/msg/Wrench",
    "movj": POSE,
    "relj": POSE,
    "movl": POSE,
    "movv": TWIST,
    "forc": "geometry_msgs/msg/Wrench",
    "tool": POSE,
    "gripper": "std_msgs/msg/Int32",
}
SERVICES = {
    "inv": "rl_cartesian_control_msgs/srv/Inv",
    "gcmp": "std_srvs/srv/Trigger",
    "stop": "std_srvs/srv/Trigger",
}


@pytest.fixture
def bench():
    return Bench()


def still(bench):
    """True if the arm is at rest and has not moved."""
    return bench.world.verbs.at_rest and bench.world.verbs.state is State.NOT_CONTROLLING


def test_the_papers_topics_and_services_are_there(bench):
    for name, type_name in TABLE_1.items():
        assert bench.node.types[f"{NODE}/command/{name}"] == type_name
    for name, type_name in SERVICES.items():
        assert bench.node.types[f"{NODE}/{name}"] == type_name


@pytest.mark.parametrize("verb", ["movj", "movl"])
def test_a_pose_moves_the_arm_there_and_is_reported(bench, verb):
    target = bench.world.moved(0.0, 0.0, -0.05)
    number = bench.command(f"/command/{verb}", ros_pose(target))
    assert bench.results() == [(verb, number, "accepted", "")]
    bench.finish()
    assert bench.results()[1:] == [(verb, number, "done", "")]
    assert math.dist(bench.world.six()[:3], target[:3]) < 1e-3


def test_a_step_and_a_speed(bench):
    before = bench.world.six()
    bench.command("/command/relj", {"position": {"z": -0.05}})
    bench.finish()
    assert bench.world.six()[2] == pytest.approx(before[2] - 0.05, abs=1e-3)
    bench.command("/command/movv", {"linear": {"z": 0.02}})
    bench.world.tick(250)
    number = bench.command("/command/stop")
    bench.world.rest()
    bench.poll()
    assert ("stop", number, "done", "") in bench.results()
    assert bench.world.six()[2] > before[2] - 0.05


def test_a_result_is_reported_as_json_to_who_has_no_cardan_msgs(bench):
    bench.command("/command/movl", data=b"")
    (result,), (text,) = bench.heard("/result"), bench.heard("/result_text")
    assert json.loads(text["data"]) == result
    assert result["outcome"] == "refused"
    assert "no plain CDR" in result["reason"]


def test_a_motion_that_another_takes_over_is_reported(bench):
    first = bench.command("/command/movl", ros_pose(bench.world.moved(0.0, 0.0, -0.2)))
    bench.world.tick(100)
    bench.command("/command/movj", ros_pose(bench.world.moved(0.0, 0.0, 0.02)))
    assert ("movl", first, "aborted", "movj took over") in bench.results()


@pytest.mark.parametrize(
    ("topic", "given", "words"),
    [
        ("movl", {"position": {"x": 9}}, "out of reach"),
        ("movl", {"position": {"x": None}}, "not numbers"),
        ("movj", {"orientation": {"w": 3}}, "has length 3, not 1"),
        ("movv", {}, "moves nothing"),
        ("movv", {"linear": {"x": None}}, "movv"),
        ("gripper", {"data": 7}, "7 is not an action"),
        ("gripper", {"data": 1}, "no gripper"),
        ("forc", {"force": {"z": None}}, "forc"),
        ("tool", {"orientation": {"w": 0}}, "has length 0"),
    ],
)
def test_bad_values_are_refused_with_the_reason(bench, topic, given, words):
    number = bench.command(f"/command/{topic}", given)
    ((_, reported, outcome, reason),) = bench.results()
    assert (reported, outcome) == (number, "refused")
    assert words in reason
    assert still(bench)


@pytest.mark.parametrize("topic", sorted(TABLE_1))
@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(3), b"nonsense"])
def test_what_is_no_message_is_refused_and_counted(bench, topic, data):
    bench.command(f"/command/{topic}", data=data)
    assert bench.server.refused == 1
    assert bench.requests == []
    assert [each[2] for each in bench.results()] == ["refused"]
    assert still(bench)


def test_a_message_that_is_too_long_is_refused(bench):
    data = codec_of(POSE).encode(completed(POSE, ros_pose(bench.world.six())))
    bench.command("/command/movl", data=data + b"\7" * 1_000_000)
    assert "1000000 bytes are too many" in bench.results()[0][3]
    assert bench.server.refused == 1


def test_another_type_or_hash_is_refused_with_what_it_takes(bench):
    bench.command("/command/movl", type_name=TWIST)
    reason = bench.results()[0][3]
    assert "it takes geometry_msgs::msg::dds_::Pose_/RIHS01_d501954e" in reason
    assert "not geometry_msgs::msg::dds_::Twist_" in reason
    bench.publish("/command/movl", ros_pose(bench.world.moved(0, 0, -0.02)))
    ring = bench.node.rings[f"{NODE}/command/movl"]
    ring.waiting[0] = ring.waiting[0]._replace(key=ring.waiting[0].key[:-4] + "0000")
    bench.poll()
    assert bench.server.refused == 2
    assert still(bench)


def test_what_comes_twice_or_late_is_dropped_and_counted(bench):
    pose = ros_pose(bench.world.moved(0.0, 0.0, -0.02))
    for sequence in (5, 5, 4):
        bench.publish("/command/movj", pose, sequence=sequence)
    bench.poll()
    assert len(bench.requests) == 1
    assert bench.server.late == 2


def test_a_publisher_that_begins_again_under_its_gid_is_heard(bench):
    pose = ros_pose(bench.world.moved(0.0, 0.0, -0.02))
    bench.publish("/command/movj", pose, sequence=500, source_ns=10)
    bench.publish("/command/movj", pose, sequence=1, source_ns=20)
    bench.command("/command/movj", pose, sequence=1, source_ns=20)
    assert len(bench.requests) == 2
    assert bench.server.late == 1


def test_a_stop_is_carried_out_though_it_comes_late(bench):
    for sequence in (500, 3):
        bench.command("/command/movv", {"linear": {"z": 0.02}})
        bench.world.tick(250)
        bench.command("/command/stop", sequence=sequence)
        bench.world.rest()
    assert still(bench)
    assert [each.verb for each in bench.requests] == ["movv", "stop", "movv", "stop"]


def test_publishers_are_distinguished(bench):
    for gid in (b"a" * 16, b"b" * 16):
        bench.publish("/command/stop", sequence=1, gid=gid)
    bench.poll()
    assert len(bench.requests) == 2


def test_a_flood_keeps_the_newest_and_is_reported(bench):
    pose = ros_pose(bench.world.moved(0.0, 0.0, -0.02))
    bench.command("/command/movj", pose, sequence=1)
    for sequence in range(2, 1002):
        bench.publish("/command/movj", pose, sequence=sequence)
    before = len(bench.requests)
    bench.poll()
    assert len(bench.requests) - before == 8  # the depth of the queue
    assert bench.server.lost == 992
    reasons = [reason for _, _, _, reason in bench.results() if "replaced" in reason]
    assert reasons == ["movj: numbers 2 to 993 were lost on their way, or replaced by newer ones"]


def test_of_a_stream_only_the_newest_counts_and_only_changes_are_reported(bench):
    for sequence in range(1, 50):
        bench.publish("/command/twist", {"linear": {"z": 0.01}}, sequence=sequence, source_ns=0)
    bench.poll()
    assert len(bench.requests) == 1
    assert bench.results()[0][1:3] == (49, "refused")
    assert "select twist streaming first" in bench.results()[0][3]
    for sequence in range(50, 60):
        bench.command(
            "/command/twist", {"linear": {"z": 0.01}}, sequence=sequence, source_ns=0, after_s=0.02
        )
    assert len(bench.results()) == 1
    bench.world.verbs.set_parameter("cpsc", "twst")
    bench.command("/command/twist", {"linear": {"z": 0.01}}, sequence=60, source_ns=0, after_s=0.02)
    assert bench.results()[1][1:] == (60, "accepted", "")


def test_a_stream_that_begins_anew_is_answered_though_the_answer_is_the_same(bench):
    for sequence, after_s in ((1, 0.02), (2, 0.02), (3, 1.0), (4, 0.02)):
        bench.publish("/command/twist", {"linear": {"z": 0.01}}, sequence=sequence, source_ns=0)
        bench.poll(after_s)
    reported = [(number, outcome) for _, number, outcome, _ in bench.results()]
    assert reported == [(1, "refused"), (3, "refused")]


def test_a_publisher_that_dies_brakes_the_arm(bench):
    bench.world.verbs.set_parameter("cpsc", "twst")
    for _ in range(100):
        bench.command("/command/twist", {"linear": {"z": -0.05}})
        bench.world.tick()
    assert bench.world.verbs.commanded.moving
    ticks = 0
    while bench.world.verbs.commanded.moving:
        bench.world.tick()
        ticks += 1
        assert ticks < 100  # 0.1 s of silence, and the ramp
    assert "silent" in bench.world.verbs.status().message


def test_a_stop_passes_while_the_worker_has_enough_to_do(bench):
    bench.server._full = lambda: True
    bench.publish("/command/movj", ros_pose(bench.world.moved(0.0, 0.0, -0.02)))
    bench.command("/command/stop")
    assert [request.verb for request in bench.requests] == ["stop"]
    bench.server._full = lambda: False
    bench.poll()
    assert [request.verb for request in bench.requests] == ["stop", "movj"]


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("other", [False, True])
@pytest.mark.parametrize("verb", ["movl", "movv", "goal"])
def test_a_motion_and_a_stop_that_come_together(bench, verb, other, known):
    # Stops are read first, and goals less often. Another program's clock does not determine the
    # order.
    user = gid_of_token(bench.appear("/left/user"))
    stop = gid_of_token(
        bench.appear("/left/other", number="1") if other else bench.appear("/left/user")
    )
    if known:
        bench.poll()
    if verb == "goal":
        name = "/arm/action/movv/_action/send_goal"
        request = completed(f"{MOVE}_SendGoal_Request", {"goal": {"xdot": DOWN}})
        data = codec_of(f"{MOVE}_SendGoal_Request").encode(request)
        bench.node.rings[name].waiting.append(Asked(f"{MOVE}_SendGoal", data, user))
    else:
        given = DOWN if verb == "movv" else ros_pose(bench.world.moved(0.0, 0.0, -0.1))
        bench.publish(f"/command/{verb}", given, gid=user, source_ns=10)
    bench.command("/command/stop", gid=stop, source_ns=5 if other else 20, after_s=DT_S)
    bench.finish()
    bench.poll(DT_S)
    assert [each.verb for each in bench.requests] == ["movv" if verb == "goal" else verb, "stop"]
    assert bench.world.verbs.at_rest
    assert bench.motions == {}


def test_a_motion_that_its_sender_sent_after_a_stop_begins(bench):
    user, same = (gid_of_token(bench.appear("/left/user")) for _ in range(2))
    bench.publish("/command/movv", DOWN, gid=user, source_ns=20)
    bench.command("/command/stop", gid=same, source_ns=10, after_s=DT_S)
    assert [each.verb for each in bench.requests] == ["stop", "movv"]


# -- services -------------------------------------------------------------------------------------


def test_the_inverse_answers_in_radians(bench):
    answer = bench.call("/inv", {"x": ros_pose(bench.world.six())}).answer
    assert answer["success"]
    assert answer["q"]["data"] == pytest.approx(bench.world.q.tolist(), abs=1e-6)
    assert not bench.call("/inv", {"x": {"position": {"x": 9}}}).answer["success"]


@pytest.mark.parametrize(("verb", "given"), [
    ("movj", {"x": {"position": {"x": 9}}}), ("movl", {"x": {"position": {"x": None}}}),
    ("movv", {}), ("act", {"action": 9}), ("act", {"action": 1}), ("tool", {"x": {"orientation":
    {"w": 0}}}),
])  # fmt: skip
def test_a_refusal_is_answered_with_the_reason(bench, verb, given):
    answer = bench.call(f"/{verb}", given).answer
    assert not answer["success"]
    assert verb in answer["message"]
    assert still(bench)


def test_a_motion_is_answered_when_it_has_begun(bench):
    answer = bench.call("/movl", {"x": ros_pose(bench.world.moved(0, 0, -0.05))}).answer
    assert answer == {"success": True, "message": ""}
    assert bench.world.verbs.state is State.MOVL
    assert bench.call("/stop").answer["success"]
    bench.world.rest()


def test_stat_says_where_and_what(bench):
    answer = bench.call("/stat").answer
    assert answer["success"]
    assert answer["state"] == int(State.NOT_CONTROLLING)
    assert answer["pose"]["pose"]["position"] == ros_pose(bench.world.six())["position"]
    header = answer["pose"]["header"]
    assert header["frame_id"] == "base_link"
    age_s = time.time() - header["stamp"]["sec"] - header["stamp"]["nanosec"] * 1e-9
    assert age_s == pytest.approx(time.monotonic() - bench.world.verbs.stat().stamp_s, abs=1.0)


def test_many_requests_at_once_are_all_answered(bench):
    ring = bench.node.rings[f"{NODE}/stat"]
    data = codec_of("cardan_msgs/srv/Stat_Request").encode(
        completed("cardan_msgs/srv/Stat_Request", {})
    )
    asked = [Asked("cardan_msgs/srv/Stat", data) for _ in range(30)]
    ring.waiting.extend(asked)
    for _ in range(5):
        bench.poll()
    assert all(each.answer["success"] for each in asked)


@pytest.mark.parametrize("service", ["inv", "stop", "movj", "wait", "stat", "act", "gcmp"])
def test_what_is_no_request_is_answered(bench, service):
    answer = bench.call(f"/{service}", data=b"\1\2\3").answer
    assert not answer["success"]
    assert bench.server.refused == 1
    assert bench.requests == []


def test_no_request_to_any_service_waits_for_ever(bench):
    asked = {}
    for name, type_name in bench.node.types.items():
        if "/srv/" in type_name or type_name.endswith(("_SendGoal", "_GetResult")):
            asked[name] = bench.call(f"/{name}", data=b"\0\1\0\0" + b"\xff" * 3)
    assert len(asked) > 40
    assert [name for name, each in asked.items() if len(each.answers) != 1] == []
    for name, each in asked.items():
        words = each.answer.get("message", "")
        assert not each.answer.get("success"), (name, words)
    assert still(bench)


# -- topics for operator interfaces ----------------------------------------------------------------

TWIST_TOPIC = "/command/twist"


def streamed(bench, cycles=50, message=DOWN, **more):
    """Stream twists, each with the time at which it was sent."""
    for _ in range(cycles):
        sent_ns = 10**18 + round(bench.now_s * 1e9)
        bench.command(TWIST_TOPIC, message, **{"source_ns": sent_ns, **more}, after_s=DT_S)
        bench.world.tick()


def reasons(bench):
    return [reason for _, _, _, reason in bench.results()]


def test_the_first_command_chooses_the_stream_of_a_free_arm_at_rest(bench):
    streamed(bench)
    assert bench.world.verbs.commanded.moving
    assert bench.world.verbs.streams.owner == "ros2"
    assert [outcome for _, _, outcome, _ in bench.results()] == ["accepted"]


def test_one_that_does_not_say_when_it_was_sent_chooses_nothing(bench):
    streamed(bench, source_ns=0)
    assert still(bench)
    assert "select twist streaming first" in reasons(bench)[0]


def test_zero_chooses_nothing(bench):
    streamed(bench, message={})
    assert still(bench)
    assert bench.world.verbs.streams.kind is Stream.NONE


def test_none_is_chosen_while_a_motion_is_under_way(bench):
    bench.command("/command/movl", ros_pose(bench.world.moved(0.0, 0.0, -0.1)))
    bench.world.tick(10)
    streamed(bench, 5)
    assert bench.results()[-1][2] == "refused"
    assert bench.world.verbs.state is State.MOVL


def test_what_waited_on_its_way_does_not_go_on_with_a_stream(bench):
    streamed(bench)
    bench.command("/command/stop", source_ns=2, after_s=DT_S)
    bench.world.rest()
    bench.poll(1.0)
    bench.world.tick()
    # A known publisher sends messages that are a second old.
    streamed(bench, 20, source_ns=10**18 + round(bench.now_s * 1e9) - 10**9)
    assert still(bench)


def flooded(bench):
    for _ in range(20):
        for _ in range(200):
            bench.publish(TWIST_TOPIC, DOWN, source_ns=10**18 + round(bench.now_s * 1e9))
        bench.poll(DT_S)
        bench.world.tick()


def test_a_flood_chooses_by_its_newest_command_alone(bench):
    flooded(bench)
    assert len(bench.requests) <= 20
    assert bench.world.verbs.streams.owner == "ros2"
    bench.command("/command/stop", after_s=DT_S)
    flooded(bench)
    bench.world.rest()
    assert still(bench)


def test_the_authority_is_taken_and_given_up_by_topics(bench):
    authority = bench.world.verbs.controller.authority
    bench.command("/command/acquire")
    assert authority.owner == "ros2"
    bench.command("/command/release")
    assert authority.owner == ""
    assert [(verb, outcome) for verb, _, outcome, _ in bench.results()] == [
        ("acquire", "done"),
        ("release", "done"),
    ]
    authority.take("panel", bench.world.now_s)
    bench.command("/command/acquire")
    assert bench.results()[-1][2] == "refused"
    assert "panel" in reasons(bench)[-1]


def test_an_acknowledgment_is_an_act_and_none_that_is_repeated(bench):
    acts = []
    bench.world.verbs.acknowledge = lambda: acts.append(bench.now_s)
    for _ in range(4):
        bench.publish("/command/acknowledge")
        bench.poll(1.0)
    assert len(acts) == 1
    assert [outcome for _, _, outcome, _ in bench.results()] == ["done", *["refused"] * 3]
    assert "does not re-arm" in reasons(bench)[-1]
    bench.poll(2.0)
    bench.command("/command/acknowledge")
    assert len(acts) == 2
