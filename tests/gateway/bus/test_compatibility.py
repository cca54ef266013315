"""An arm under the topic names of other programs: MoveIt Servo, CRTK, FZI's controllers,
cmd_vel."""

import math
import time

import numpy as np
import pytest

from cardan.gateway.arm.vocab import State, Stream
from cardan.gateway.bus.compatibility import (
    NamesTopics,
    PublishedState,
    ServoScales,
    same_topics,
    servo_status,
)
from cardan.gateway.bus.sources import BEGINS_S, STREAM_RETENTION_S
from cardan.protocols.ros2.cdr import Codec, codec_of
from cardan.types import CommandKind, RobotLink
from tests.gateway.bus.bench import Bench, ros_pose

DT_S = 0.004
WITHOUT_TORQUE = frozenset({CommandKind.JOINT})
TWIST = "//servo_node/delta_twist_cmds"
JOG = "//servo_node/delta_joint_cmds"
POSE = "//servo_node/pose_target_cmds"


@pytest.fixture
def bench():
    return Bench(names=("servo",))


def header(frame="base_link", stamp_s=0.0):
    sec, rest = divmod(stamp_s, 1.0)
    return {"frame_id": frame, "stamp": {"sec": int(sec), "nanosec": int(rest * 1e9)}}


def twist(frame="base_link", stamp_s=0.0, **linear):
    return {"header": header(frame, stamp_s), "twist": {"linear": linear}}


def stream(bench, topic, message, seconds=0.2, **more):
    """Publish a message in every cycle for some time."""
    for _ in range(round(seconds / DT_S)):
        bench.command(topic, message, **more, after_s=DT_S)
        bench.world.tick()


def rest(bench, seconds=1.0):
    for _ in range(round(seconds / DT_S)):
        bench.poll(DT_S)
        bench.world.tick()


def outcomes(bench):
    return [(command, outcome, reason) for command, _, outcome, reason in bench.results()]


def untouched(bench):
    verbs = bench.world.verbs
    return verbs.at_rest and verbs.state is State.NOT_CONTROLLING and not verbs.streams.owner


# -- automatic start of a stream -------------------------------------------------------------------


def test_the_first_type_that_arrives_is_taken_and_reported(bench):
    before = bench.world.six()
    stream(bench, TWIST, twist(z=0.1))
    assert bench.world.verbs.streams.kind is Stream.TWIST
    assert outcomes(bench) == [
        ("twist", "accepted", "its stamp is zero: it counts as sent when it arrived")
    ]
    rest(bench)
    assert bench.world.six()[2] > before[2]
    assert bench.world.verbs.streams.kind is Stream.NONE
    stream(bench, JOG, {"joint_names": ["wrist_3_joint"], "velocities": [0.5]})
    assert bench.world.verbs.streams.kind is Stream.JOINT
    assert outcomes(bench)[1:] == [
        ("joints", "accepted", "its stamp is zero: it counts as sent when it arrived")
    ]


def test_another_type_meanwhile_is_refused_in_words(bench):
    stream(bench, TWIST, twist(z=0.1))
    bench.command(JOG, {"joint_names": ["wrist_3_joint"], "velocities": [0.5]}, after_s=DT_S)
    assert outcomes(bench)[-1] == ("joints", "refused", "jnts: the streaming command is twst")


def test_a_stream_that_was_stopped_does_not_begin_again_by_itself(bench):
    stream(bench, TWIST, twist(z=0.1))
    bench.publish("/command/stop")
    stream(bench, TWIST, twist(z=0.1), 2 * BEGINS_S)
    assert untouched(bench)
    assert "does not begin again by itself" in outcomes(bench)[-1][2]
    rest(bench, STREAM_RETENTION_S + DT_S)
    stream(bench, TWIST, twist(z=0.1))
    assert bench.world.verbs.commanded.moving


def test_zero_lets_it_begin_again_and_begins_nothing(bench):
    stream(bench, TWIST, twist(z=0.1))
    bench.publish("/command/stop")
    stream(bench, TWIST, twist(), 1.0)
    assert untouched(bench)
    assert bench.world.verbs.streams.kind is Stream.NONE
    assert "zero begins no stream" in outcomes(bench)[-1][2]
    stream(bench, TWIST, twist(z=0.1))
    assert bench.world.verbs.commanded.moving


def test_a_stream_with_gaps_brakes_in_them_and_goes_on(bench):
    # As of a held key with auto-repeat: one message, a pause, then many.
    stream(bench, TWIST, twist(z=0.1), DT_S)
    rest(bench, 0.35)
    assert bench.world.verbs.streams.kind is Stream.NONE
    stream(bench, TWIST, twist(z=0.1))
    assert bench.world.verbs.commanded.moving


def test_a_stop_in_a_gap_of_a_stream_ends_it_too(bench):
    stream(bench, TWIST, twist(z=0.1))
    rest(bench, 0.35)
    bench.publish("/command/stop")
    stream(bench, TWIST, twist(z=0.1), 1.0)
    assert untouched(bench)
    assert "does not begin again by itself" in outcomes(bench)[-1][2]


def test_a_stop_while_a_stream_tries_to_begin_ends_that(bench):
    bench.world.verbs.controller.authority.take("panel", bench.world.now_s)
    stream(bench, TWIST, twist(z=0.1), 0.1)
    bench.command("/command/stop", after_s=DT_S)
    bench.world.verbs.release("panel")
    stream(bench, TWIST, twist(z=0.1))
    assert untouched(bench)
    assert "does not begin again by itself" in outcomes(bench)[-1][2]


def test_a_stream_that_was_refused_for_long_does_not_move_the_arm_unexpectedly(bench):
    assert not bench.world.verbs.controller.authority.take("panel", bench.world.now_s)
    for _ in range(round((BEGINS_S + 0.1) / DT_S)):
        bench.world.verbs.controller.authority.take("panel", bench.world.now_s)
        stream(bench, TWIST, twist(z=0.1), DT_S)
    assert "panel" in outcomes(bench)[0][2]
    bench.world.verbs.release("panel")
    stream(bench, TWIST, twist(z=0.1))
    assert untouched(bench)
    assert "does not begin again by itself" in outcomes(bench)[-1][2]


def test_a_command_that_is_none_chooses_nothing(bench):
    for _ in range(3):
        bench.command(POSE, {"header": header(), "pose": {"position": {"x": 9}}})
        bench.world.tick()
    assert outcomes(bench)[0][1] == "refused"
    assert bench.world.verbs.streams.kind is Stream.NONE
    stream(bench, TWIST, twist(z=0.1))
    assert bench.world.verbs.streams.kind is Stream.TWIST


def test_topics_of_one_verb_share_its_stream(bench):
    stream(bench, TWIST, twist(z=0.1))
    bench.command("/command/twist", {"linear": {"z": -0.1}}, gid=b"b" * 16, after_s=DT_S)
    assert bench.server.contested == 1
    assert "'ros2' has authority over the arm" in outcomes(bench)[-1][2]


def test_who_sends_what_cannot_be_taken_keeps_no_stream_from_others(bench):
    bench.command(TWIST, twist("odom", z=0.1), gid=b"b" * 16, after_s=DT_S)
    stream(bench, TWIST, twist(z=0.1))
    assert bench.server.contested == 0
    assert bench.world.verbs.commanded.moving


def test_what_waited_on_its_way_is_refused(bench):
    sent_s = 1_700_000_000.0
    for cycle in range(50):
        bench.command(TWIST, twist(z=0.1, stamp_s=sent_s + cycle * DT_S), after_s=DT_S)
        bench.world.tick()
    (first, second) = outcomes(bench)
    assert first[1] == "refused"
    assert "not known yet" in first[2]
    assert second == ("twist", "accepted", "")
    bench.world.tick(20)
    late_s = sent_s + 50 * DT_S - 0.4
    bench.command(TWIST, twist(z=0.1, stamp_s=late_s), after_s=DT_S)
    assert outcomes(bench)[-1][1] == "refused"
    assert "after one of" in outcomes(bench)[-1][2]


# -- MoveIt Servo ----------------------------------------------------------------------------------


def test_a_share_is_of_the_full_speed(bench):
    bench.publish(TWIST, twist(x=0.5))
    bench.command(JOG, {"joint_names": ["elbow_joint"], "velocities": [-1.0]})
    values = [request.value for request in bench.requests]
    assert values[0].linear == (0.2, 0.0, 0.0)
    assert values[1] == [0.0, 0.0, -0.5, 0.0, 0.0, 0.0]


def test_in_speed_units_nothing_is_scaled():
    bench = Bench(names=("servo",), scales=ServoScales(unitless=False))
    bench.command(TWIST, twist(x=1.5))
    assert bench.requests[0].value.linear == (1.5, 0.0, 0.0)


def test_the_frame_of_the_message_counts_not_the_arms(bench):
    bench.world.verbs.set_parameter("cpf", "cpft", source="ros2")
    before = bench.world.six()
    stream(bench, TWIST, twist("base_link", z=0.2), 0.4)
    rest(bench)
    moved = np.subtract(bench.world.six(), before)[:3]
    assert moved[2] > 0.01
    assert abs(moved[0]) + abs(moved[1]) < 1e-4
    bench.world.verbs.set_parameter("cpf", "cpfb", source="ros2")
    axis = bench.world.verbs.servo.placement.rotation[:, 2].copy()
    before = bench.world.six()
    stream(bench, TWIST, twist("tcp", z=-0.2), 0.4)
    rest(bench)
    moved = np.subtract(bench.world.six(), before)[:3]
    assert moved / np.linalg.norm(moved) == pytest.approx(-axis, abs=1e-2)


def test_a_pose_target_is_gone_to(bench):
    bench.world.verbs.set_parameter("cpf", "cpft", source="ros2")
    target = bench.world.moved(0.0, 0.0, 0.02)
    stream(bench, POSE, {"header": header(), "pose": ros_pose(target)}, 2.0)
    assert math.dist(bench.world.six()[:3], target[:3]) < 1e-3
    bench.world.verbs.stop()
    rest(bench)
    bench.world.verbs.set_parameter("cpf", "cpfb", source="ros2")
    relative = {"header": header("tcp"), "pose": {"position": {"z": -0.01}}}
    before = bench.world.six()
    bench.command(POSE, relative)
    bench.world.tick(20)
    assert 1e-4 < math.dist(bench.world.six()[:3], before[:3]) < 0.011


@pytest.mark.parametrize(
    ("topic", "given", "words"),
    [
        (TWIST, twist("", x=0.1), "header.frame_id is empty: it has to be 'base_link' (base)"),
        (TWIST, twist("odom", x=0.1), "the frame 'odom' is not known"),
        (TWIST, twist(x=None), "nan is not a share"),
        (TWIST, twist(x=1.01), "1.01 is not a share of the full speed"),
        (JOG, {"joint_names": ["knee"], "velocities": [0.1]}, "there is no joint 'knee'"),
        (JOG, {"joint_names": ["elbow_joint"], "velocities": []}, "1 joint names and 0"),
        (JOG, {"joint_names": ["elbow_joint"] * 2, "velocities": [0.1, 0.1]}, "named twice"),
        (JOG, {"joint_names": ["elbow_joint"], "velocities": [None]}, "nan is not a share"),
        (JOG, {"displacements": [0.1]}, "displacements are not taken"),
        (POSE, {"header": header("map")}, "the frame 'map' is not known"),
        (POSE, {"header": header(), "pose": {"position": {"x": None}}}, "not numbers"),
        (POSE, {"header": header(), "pose": {"orientation": {"w": 2}}}, "has length 2"),
    ],
)
def test_what_servo_would_not_take_is_refused_in_words(bench, topic, given, words):
    bench.command(topic, given)
    ((_, outcome, reason),) = outcomes(bench)
    assert outcome == "refused"
    assert words in reason
    assert untouched(bench)


def test_nan_in_speed_units_is_refused_by_the_verb():
    bench = Bench(names=("servo",), scales=ServoScales(unitless=False))
    bench.command(TWIST, twist(x=None))
    assert "number 1 of 6 is nan" in outcomes(bench)[0][2]
    assert bench.world.verbs.streams.kind is Stream.NONE


def test_the_command_type_is_switched(bench):
    switch = "//servo_node/switch_command_type"
    for code, kind in enumerate((Stream.JOINT, Stream.TWIST, Stream.POSE)):
        assert bench.call(switch, {"command_type": code}).answer == {"success": True}
        assert bench.world.verbs.streams.kind is kind
    bench.command(TWIST, twist(z=0.1))
    assert outcomes(bench)[-1] == ("twist", "refused", "twst: the streaming command is pose")
    assert bench.call(switch, {"command_type": 7}).answer == {"success": False}
    assert "7 is not a command type" in outcomes(bench)[-1][2]


def test_pausing_brakes_and_refuses_until_it_is_resumed(bench):
    stream(bench, TWIST, twist(z=0.1))
    assert bench.call("//servo_node/pause_servo", {"data": True}).answer["success"]
    stream(bench, TWIST, twist(z=0.1), 1.0)
    assert untouched(bench)
    assert outcomes(bench)[-1][2] == "paused; call servo_node/pause_servo with false"
    bench.command(
        "/command/movl", ros_pose(bench.world.moved(0.0, 0.0, -0.02))
    )  # other commands are not paused
    bench.finish()
    assert outcomes(bench)[-1][:2] == ("movl", "done")
    asked = len(bench.requests)
    assert bench.call("//servo_node/pause_servo", {"data": False}).answer["success"]
    assert len(bench.requests) == asked
    rest(bench)
    stream(bench, TWIST, twist(z=0.1))
    assert bench.world.verbs.commanded.moving


def test_a_pause_passes_while_the_worker_has_enough_to_do(bench):
    bench.server._full = lambda: True
    bench.call("//servo_node/pause_servo", {"data": True})
    assert [request.verb for request in bench.requests] == ["stop"]


def shown(bench, **more):
    state = bench.world.state()
    return PublishedState.of(
        state._replace(**more), bench.world.verbs.controller.status(), bench.world.verbs,
        state.stamp_s, time.time_ns(),
    )  # fmt: skip


def test_the_status_says_what_limits_the_arm(bench):
    tell = bench.others[0].published[0].message
    stream(bench, TWIST, twist(z=0.1))
    assert tell(shown(bench)) == {"code": 0, "message": ""}
    bench.call("//servo_node/pause_servo", {"data": True})
    rest(bench)
    assert "paused" in tell(shown(bench))["message"]
    codec_of("moveit_msgs/msg/ServoStatus").encode(tell(shown(bench)))


def test_the_status_of_an_arm_at_its_bound(bench):
    # The arm stretches away from its base until it reaches a singularity.
    bench.call("//servo_node/pause_servo", {"data": False})
    x, y, *_ = bench.world.six()
    length = math.hypot(x, y)
    codes = set()
    for _ in range(1500):
        stream(bench, TWIST, twist(x=0.5 * x / length, y=0.5 * y / length), DT_S)
        codes.add(servo_status(shown(bench))["code"])
    assert codes & {1, 2}
    assert -1 not in codes


def test_without_a_robot_the_status_is_invalid(bench):
    bench.world.link = RobotLink.LOST
    bench.world.tick(10)
    published = servo_status(shown(bench))
    assert published["code"] == -1
    assert published["message"]


def test_what_is_reported_besides_is_published_with_each_instant(bench):
    topics = NamesTopics(bench.node, bench.others)
    topics.publish(shown(bench), time.time_ns())
    assert bench.node.publishers["/servo_node/status"].messages == [{"code": 0, "message": ""}]


def test_what_is_reported_is_encoded_when_it_changes_and_published_always(bench, monkeypatch):
    encoded = []
    encode = Codec.encode

    def counted(codec, message):
        encoded.append(message)
        return encode(codec, message)

    monkeypatch.setattr(Codec, "encode", counted)
    topics = NamesTopics(bench.node, bench.others)
    fine = shown(bench)
    held = fine._replace(status=fine.status._replace(message="held"))
    for each in (fine, fine, fine, held, held, fine):
        topics.publish(each, time.time_ns())
    published = bench.node.publishers["/servo_node/status"].messages
    assert [each["message"] for each in published] == ["", "", "", "held", "held", ""]
    assert len(encoded) == 3


def test_sets_of_names_have_further_topics_for_the_same():
    sets = Bench(names=("crtk", "fzi")).others
    assert same_topics(sets)["state/pose"] == ["measured_cp", "current_pose"]


# -- cmd_vel ---------------------------------------------------------------------------------------


@pytest.fixture
def driven():
    return Bench(names=("cmd_vel",))


def test_both_types_of_cmd_vel_move_the_arm(driven):
    plain, stamped = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
    stream(driven, "//cmd_vel", {"linear": {"z": -0.1}}, type_name=plain)
    assert outcomes(driven) == [("twist", "accepted", "")]
    stream(driven, "//cmd_vel", twist("tcp", z=-0.1, stamp_s=5.0), DT_S, type_name=stamped)
    assert driven.requests[0].value == [0.0, 0.0, -0.1, 0.0, 0.0, 0.0]
    assert driven.requests[-1].value.frame.value == "tool"
    assert driven.requests[-1].stamp_s == 5.0
    stream(driven, "//cmd_vel", twist("", z=-0.1), DT_S, type_name=stamped)
    assert driven.requests[-1].value == driven.requests[0].value
    assert driven.server.refused == 0


def test_the_two_types_are_one_stream(driven):
    stream(driven, "//cmd_vel", {"linear": {"z": -0.1}})
    stamped = "geometry_msgs/msg/TwistStamped"
    driven.command("//cmd_vel", twist(z=0.1), type_name=stamped, gid=b"b" * 16, after_s=DT_S)
    assert driven.server.contested == 1


def test_a_third_type_on_cmd_vel_is_refused_with_what_it_takes(driven):
    driven.command("//cmd_vel", type_name="geometry_msgs/msg/Wrench")
    reason = outcomes(driven)[0][2]
    assert "dds_::Twist_/" in reason
    assert "dds_::TwistStamped_/" in reason
    assert "not geometry_msgs::msg::dds_::Wrench_" in reason


@pytest.mark.parametrize(
    ("given", "words"),
    [(twist("odom", x=0.1), "the frame 'odom' is not known"), (twist(x=None), "is nan")],
)
def test_bad_values_of_cmd_vel_are_refused(driven, given, words):
    driven.command("//cmd_vel", given, type_name="geometry_msgs/msg/TwistStamped")
    assert words in outcomes(driven)[0][2]
    assert untouched(driven)


# -- FZI -------------------------------------------------------------------------------------------


def test_a_target_frame_is_gone_to():
    bench = Bench(names=("fzi",))
    target = bench.world.moved(0.0, 0.0, 0.02)
    stream(bench, "//target_frame", {"header": header(), "pose": ros_pose(target)}, 2.0)
    assert math.dist(bench.world.six()[:3], target[:3]) < 1e-3


def test_a_target_wrench_needs_an_arm_that_takes_torques():
    bench = Bench(names=("fzi",), commands=WITHOUT_TORQUE)
    bench.command("//target_wrench", {"header": header(), "wrench": {"force": {"z": 1.0}}})
    ((_, outcome, reason),) = outcomes(bench)
    assert outcome == "refused"
    assert "torque" in reason
    assert untouched(bench)


def test_a_target_wrench_is_exerted_along_the_frame_of_its_message():
    bench = Bench(names=("fzi",))
    for _ in range(3):
        bench.command(
            "//target_wrench",
            {"header": header("tcp"), "wrench": {"force": {"z": 1.0}}},
            after_s=DT_S,
        )
        bench.world.tick()
    assert [each[1] for each in outcomes(bench)] == ["accepted"]
    assert bench.world.verbs.streams.kind is Stream.WRENCH
    bench.command(
        "//target_wrench", {"header": header(), "wrench": {"force": {"z": None}}}, after_s=DT_S
    )
    assert "is nan" in outcomes(bench)[-1][2]


# -- CRTK ------------------------------------------------------------------------------------------


@pytest.fixture
def crtk():
    return Bench(names=("crtk",), commands=WITHOUT_TORQUE)


def state_command(bench, word):
    bench.command("//state_command", {"string": word}, after_s=DT_S)
    return outcomes(bench)[-1]


def operating(bench):
    published = {each.topic: each.message for each in bench.others[0].published}
    message = published["operating_state"](shown(bench))
    codec_of("crtk_msgs/msg/OperatingState").encode(message)
    return message["state"], message["is_busy"]


@pytest.mark.parametrize("topic", ["servo_cp", "interpolate_cp"])
@pytest.mark.parametrize("frame", ["", "base_link"])
def test_servo_cp_and_interpolate_cp(crtk, topic, frame):
    target = crtk.world.moved(0.0, 0.0, 0.02)
    stream(crtk, f"//{topic}", {"header": header(frame), "pose": ros_pose(target)}, 2.0)
    assert math.dist(crtk.world.six()[:3], target[:3]) < 1e-3


def test_servo_cv_and_servo_jv(crtk):
    stream(crtk, "//servo_cv", twist(z=-0.1))
    assert crtk.world.verbs.commanded.moving
    rest(crtk)
    stream(crtk, "//servo_jv", {"velocity": [0.0, 0.0, 0.0, 0.0, 0.0, 0.2]})
    assert crtk.world.v[5] > 0.1
    stream(crtk, "//servo_jv", {"name": ["wrist_3_joint"], "velocity": [-0.2]})
    assert crtk.world.v[5] < -0.1


def test_move_cp_plans_a_line(crtk):
    target = crtk.world.moved(0.0, 0.0, -0.1)
    crtk.command("//move_cp", {"header": header(), "pose": ros_pose(target)})
    crtk.finish()
    assert [each[:2] for each in outcomes(crtk)] == [("movl", "accepted"), ("movl", "done")]
    assert math.dist(crtk.world.six()[:3], target[:3]) < 1e-3
    before = crtk.world.six()
    crtk.command("//move_cp", {"header": header("tcp"), "pose": {"position": {"z": -0.03}}})
    crtk.finish()
    assert math.dist(crtk.world.six()[:3], before[:3]) == pytest.approx(0.03, abs=1e-3)


@pytest.mark.parametrize(
    ("topic", "given", "words"),
    [
        ("servo_jp", {"position": [0.0] * 6}, "servo_jp: joint positions are not streamed"),
        ("interpolate_jp", {"position": [0.0] * 6}, "interpolate_jp: joint positions are not"),
        ("move_jp", {"position": [0.0] * 6}, "follow_joint_trajectory"),
        ("servo_jv", {"velocity": [0.1]}, "0 joint names and 1 velocities"),
        ("servo_jv", {"name": ["knee"], "velocity": [0.1]}, "there is no joint 'knee'"),
        ("servo_jv", {"velocity": [None] * 6}, "number 1 of 6 is nan"),
        ("servo_cv", twist("tool0", z=0.1), "the frame 'tool0' is not known"),
        ("servo_cf", {"wrench": {"force": {"z": 1.0}}}, "torque"),
        ("move_cp", {"header": header("map")}, "the frame 'map' is not known"),
        ("move_cp", {"pose": {"position": {"x": None}}}, "not numbers"),
        ("state_command", {"string": "jump"}, "unknown command 'jump'; allowed: enable, disable"),
        ("state_command", {"string": "resume"}, "not possible in ENABLED, only in PAUSED"),
        ("state_command", {"string": "unhome"}, "it has no homing"),
    ],
)
def test_what_crtk_asks_and_the_arm_cannot_is_refused_in_words(crtk, topic, given, words):
    crtk.command(f"//{topic}", given)
    ((_, outcome, reason),) = outcomes(crtk)
    assert outcome == "refused"
    assert words in reason
    assert untouched(crtk)


def test_the_operating_state_is_changed_by_command_only(crtk):
    assert operating(crtk) == ("ENABLED", False)
    stream(crtk, "//servo_cv", twist(z=-0.1))
    assert operating(crtk) == ("ENABLED", True)
    assert state_command(crtk, "pause")[:2] == ("stop", "done")
    stream(crtk, "//servo_cv", twist(z=-0.1), 1.0)
    assert operating(crtk) == ("PAUSED", False)
    assert outcomes(crtk)[-1][2] == "paused; send resume on state_command"
    assert state_command(crtk, "enable")[1] == "refused"
    assert state_command(crtk, "resume")[1] == "done"
    assert operating(crtk) == ("ENABLED", False)
    assert state_command(crtk, "disable")[1] == "done"
    assert operating(crtk) == ("DISABLED", False)
    assert state_command(crtk, "pause")[1] == "refused"
    assert state_command(crtk, "resume")[1] == "refused"
    assert state_command(crtk, "enable")[1] == "done"
    assert state_command(crtk, "home")[1] == "done"
    rest(crtk)
    stream(crtk, "//servo_cv", twist(z=-0.1))
    assert crtk.world.verbs.commanded.moving


def test_a_fault_is_left_by_enabling(crtk):
    crtk.world.link = RobotLink.LOST
    crtk.world.tick(10)
    assert operating(crtk)[0] == "FAULT"
    crtk.world.link = RobotLink.LIVE
    crtk.world.tick(10)
    state_command(crtk, "enable")
    asked = [request.verb for request in crtk.requests]
    assert asked == ["acknowledge"]
    assert operating(crtk)[0] == "ENABLED"


def test_what_is_commanded_of_the_joints_is_reported_while_it_is(crtk):
    published = {each.topic: each.message for each in crtk.others[0].published}
    assert published["setpoint_js"](shown(crtk)) is None
    stream(crtk, "//servo_cv", twist(z=-0.1))
    message = published["setpoint_js"](shown(crtk))
    assert message["position"] == crtk.world.verbs.servo.q.tolist()
    assert message["name"] == list(crtk.world.model.joint_names)
    codec_of("sensor_msgs/msg/JointState").encode(message)


def test_the_measured_twist_is_that_of_the_joints_speeds():
    crtk = Bench(names=("crtk", "fzi"))
    published = {each.topic: each.message for others in crtk.others for each in others.published}
    message_of = published["measured_cv"]
    assert message_of(shown(crtk, velocities=())) is None
    turning = {"linear": {"z": -0.1}, "angular": {"x": 0.1, "y": 0.05}}
    stream(crtk, "//servo_cv", {"header": header(), "twist": turning}, 0.6)
    now = shown(crtk)
    commanded, message = now.status.twist, message_of(now)
    codec_of("geometry_msgs/msg/TwistStamped").encode(message)
    assert message["header"]["frame_id"] == "base_link"
    assert published["current_twist"](now) == message
    found = message["twist"]
    assert list(found["linear"].values()) == pytest.approx(list(commanded.linear), abs=2e-3)
    assert list(found["angular"].values()) == pytest.approx(list(commanded.angular), abs=2e-3)
    assert found["linear"]["z"] < -0.05


# -- YARP's joint server ---------------------------------------------------------------------------


@pytest.fixture
def yarp():
    return Bench(names=("yarp",))


def test_yarps_velocity_streams_joint_speeds_by_names_or_of_all(yarp):
    stream(yarp, "/velocity", {"velocities": [0.0, 0.0, 0.0, 0.0, 0.0, 0.2]})
    assert yarp.world.verbs.streams.kind is Stream.JOINT
    assert yarp.world.v[5] > 0.1
    stream(yarp, "/velocity", {"names": ["wrist_3_joint"], "velocities": [-0.2]})
    assert yarp.world.v[5] < -0.1
    rest(yarp)
    assert yarp.world.verbs.at_rest
    assert [each[:2] for each in outcomes(yarp)] == [("joints", "accepted")]


@pytest.mark.parametrize(
    ("topic", "message", "words"),
    [
        ("velocity", {"velocities": [0.1]}, "0 joint names and 1 velocities"),
        ("velocity", {"names": ["elbow"], "velocities": [0.1]}, "there is no joint 'elbow'"),
        (
            "velocity",
            {"velocities": [0.1] * 6, "ref_accelerations": [1.0] * 6},
            "ref_accelerations are not taken",
        ),
        ("velocity", {"velocities": [math.nan] * 6}, "is nan"),
        ("position_direct", {"positions": [0.1] * 6}, "stream speeds by velocity"),
        ("position", {"positions": [0.1] * 6}, "joint positions are not streamed"),
    ],
)
def test_what_yarps_clients_cannot_have_is_refused_in_words(yarp, topic, message, words):
    stream(yarp, f"/{topic}", message, 0.02)
    assert words in outcomes(yarp)[0][2]
    assert outcomes(yarp)[0][1] == "refused"
    assert untouched(yarp)


def test_yarps_state_is_the_arms_joints(yarp):
    assert same_topics(yarp.others) == {"joint_states": ["~/state"]}
