"""Streaming commands in simulated time: accepted, refused, limited, and ended by silence."""

import math

import numpy as np
import pytest

from cardan.gateway.arm.backlog import STALE_S, Delays
from cardan.gateway.arm.options import STREAM_LIMITS, ControllerOptions
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.verb_table import SEQUENCED, preset_of
from cardan.gateway.arm.vocab import Begins, Stream
from tests.gateway.arm.arms import DT_S, World, quick, streaming, streams, turned


def test_a_stream_has_to_be_chosen():
    world = World()
    for name in sorted(SEQUENCED):
        why = world.verbs.stream(name, [0.0] * world.verbs.servo.joints)
        assert f"select {preset_of(name).name.lower()} streaming first" in why
    world.verbs.set_parameter("cpsc", "twst")
    assert world.verbs.get_parameter("cpsc") == Stream.TWIST
    assert world.verbs.stream("pose", world.six()) == "pose: the streaming command is twst"
    world.verbs.set_parameter("cpsc", "nset")
    assert "select twist" in world.verbs.stream("twist", [0.0] * 6)


def test_a_stream_that_its_sender_has_left_is_in_the_way_of_no_other_one():
    world = quick()
    world.verbs.release()
    joints = world.verbs.servo.joints

    def twist(owner, begins=Begins.NEW):
        return world.verbs.stream("twist", [0.0, 0.0, -0.1, 0, 0, 0], owner=owner, begins=begins)

    assert world.verbs.stream("joints", [0.1] * joints, owner="one", begins=Begins.NEW) == ""
    world.tick()
    assert world.verbs.stream("joints", [0.0] * joints, owner="one") == ""
    world.rest()
    # While its sender has authority, its stream stays selected.
    assert twist("two") == "twst: 'one' has authority over the arm"
    world.tick(int(2.5 / DT_S))
    assert world.verbs.status().authority.owner == ""
    assert world.verbs.streams.kind is Stream.JOINT
    for begins in (None, Begins.GOING_ON, Begins.REST):
        assert twist("two", begins) == "twst: the streaming command is jnts"
    assert twist("two") == ""
    assert (world.verbs.streams.kind, world.verbs.streams.owner) == (Stream.TWIST, "two")
    # The owner selects another stream at rest.
    world.verbs.stream("twist", [0.0] * 6, owner="two")
    world.rest()
    assert world.verbs.stream("joints", [0.1] * joints, owner="two", begins=Begins.NEW) == ""
    assert (world.verbs.streams.kind, world.verbs.status().authority.owner) == (Stream.JOINT, "two")
    # A stream that was selected but not used yet stays selected.
    world.verbs.release("two")
    world.rest()
    world.verbs.set_parameter("cpsc", "jnts")
    assert twist("two") == "twst: the streaming command is jnts"


def test_a_motion_clears_the_choice():
    world = streaming("twst")
    for _ in range(50):
        assert world.verbs.stream("twist", [0.0, 0.0, -0.1, 0.0, 0.0, 0.0]) == ""
        world.tick()
    motion = world.verbs.movl(world.moved(0.0, 0.0, -0.05))
    assert motion.outcome is Outcome.WAITING
    for _ in range(2):  # while the arm brakes for the motion, and afterwards
        assert world.verbs.get_parameter("cpsc") == Stream.NONE
        assert "movl took over" in world.verbs.stream("twist", [0.0] * 6)
        world.run(motion)
    world.verbs.set_parameter("cpsc", "twst")
    world.verbs.tool([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert "the tool was changed" in world.verbs.stream("twist", [0.0] * 6)


@pytest.mark.parametrize("frame", ["cpfb", "cpft"])
def test_twists_move_and_silence_brakes(frame):
    world = quick()
    world.verbs.set_parameters({"cpf": frame, "cpsc": "twst"})
    start, rotation = world.six(), world.tcp[1]
    direction = np.array([0.0, 0.0, -1.0]) if frame == "cpfb" else -rotation[:, 2]
    for _ in range(100):
        assert world.verbs.stream("twist", [0.0, 0.0, -0.1, 0.0, 0.0, 0.0]) == ""
        world.tick()
    step = world.six()[:3] - start[:3]
    np.testing.assert_allclose(step, np.linalg.norm(step) * direction, atol=1e-3)
    silent = world.six()
    world.tick(int(0.1 / DT_S) + 2)
    assert world.verbs.status().message.startswith("the stream was silent")
    world.rest()
    # 0.1 s of silence, and a braking distance of v²/2a
    assert np.linalg.norm(world.six()[:3] - silent[:3]) < 0.1 * 0.11 + 0.005 + 0.004
    twist, going_on = [0.0, 0.0, -0.1, 0.0, 0.0, 0.0], Begins.GOING_ON
    assert "silent" in world.verbs.stream("twist", twist)
    held = world.q.copy()
    world.tick(50)
    np.testing.assert_array_equal(world.q, held)
    # Only the same sender may continue, and not after a stop.
    assert "does not begin again" in world.verbs.stream("twist", twist, owner="x", begins=going_on)
    assert world.verbs.stream("twist", twist, begins=going_on) == ""
    world.verbs.stop()
    world.rest()
    assert "does not begin again" in world.verbs.stream("twist", twist, begins=going_on)


def test_a_resting_stream_may_be_silent():
    world = streaming("twst")
    world.verbs.stream("twist", [0.0] * 6)
    world.tick(500)
    assert world.verbs.stream("twist", [0.0, 0.0, 0.01, 0.0, 0.0, 0.0]) == ""


def test_fast_twists_are_slowed_and_keep_their_direction():
    world = streaming("twst")
    start = world.six()
    for _ in range(100):
        world.verbs.stream("twist", [0.0, 3.0, -4.0, 0.0, 0.0, 0.0])
        before = world.tcp[0]
        world.tick()
        assert np.linalg.norm(world.tcp[0] - before) / DT_S < 0.2505
    step = world.six()[:3] - start[:3]
    np.testing.assert_allclose(step / np.linalg.norm(step), [0.0, 0.6, -0.8], atol=1e-2)
    assert world.verbs.status().stream_scaled == 100


def test_streamed_poses_are_followed_inside_limits():
    world = streaming("pose")
    target = world.moved(0.0, 0.05, -0.1)
    fastest, before_speed = 0.0, np.zeros(3)
    for _ in range(400):
        assert world.verbs.stream("pose", target) == ""
        before = world.tcp[0]
        world.tick()
        speed = (world.tcp[0] - before) / DT_S
        fastest = max(fastest, np.linalg.norm(speed))
        assert np.linalg.norm(speed - before_speed) <= 1.2 * DT_S + 0.004
        before_speed = speed
    assert 0.1 < fastest <= 0.2505
    np.testing.assert_allclose(world.six()[:3], target[:3], atol=2e-5)


def test_a_predicted_pose_is_not_overshot_by_more_than_the_prediction():
    world = streaming("pose", options=ControllerOptions(stream_prediction_s=0.02))
    world.verbs.stream("pose", world.six())
    assert not world.verbs.controller.motion.driven
    target = world.six()
    for _ in range(40):
        target[2] -= 0.05 * 5 * DT_S
        assert world.verbs.stream("pose", target) == ""
        world.tick(5)
    lowest = world.six()[2]
    for _ in range(25):
        world.tick()
        lowest = min(lowest, world.six()[2])
    assert target[2] - 0.05 * 0.021 <= lowest < target[2] - 0.05 * 0.01


def test_a_silent_pose_stream_stops_short_of_its_target():
    world = streaming("pose")
    target = world.moved(0.0, 0.0, -0.15)
    for _ in range(50):
        world.verbs.stream("pose", target)
        world.tick()
    world.tick(500)
    assert world.six()[2] > target[2] + 0.03
    assert not world.verbs.servo.moving


def test_poses_too_far_away_are_answered():
    world = streaming("pose")
    assert "a step of 0.500 m" in world.verbs.stream("pose", world.moved(0.0, 0.0, -0.5))
    turned_too_far = turned(world.six(), (0.0, 0.0, 1.5))
    assert "1.500 rad; allowed: 0.200 m and 1.000 rad" in world.verbs.stream("pose", turned_too_far)
    world.tick(10)
    assert not world.verbs.servo.moving


def test_poses_out_of_reach_are_answered_with_how_far():
    world = streaming("pose", options=ControllerOptions(stream_step_m=5.0))
    assert "out of reach by" in world.verbs.stream("pose", world.moved(2.0, 0.0, 0.0))
    world.tick(10)
    assert not world.verbs.servo.moving


def test_a_pose_stream_is_relative_in_the_tcp_frame():
    world = quick()
    world.verbs.set_parameters({"cpf": "cpft", "cpsc": "pose"})
    start, rotation = world.six(), world.tcp[1]
    assert world.verbs.stream("pose", [0.0, 0.0, -0.03, 0.0, 0.0, 0.0]) == ""
    world.tick(20)
    step = world.six()[:3] - start[:3]
    np.testing.assert_allclose(step / -np.linalg.norm(step), rotation[:, 2], atol=1e-2)


def test_late_datagrams_are_dropped():
    world = streaming("twst")
    twist = [0.0, 0.0, 0.01, 0.0, 0.0, 0.0]
    assert world.verbs.stream("twist", twist, sequence=5, stamp_s=1.0) == ""
    assert "number 5 came after number 5" in world.verbs.stream("twist", twist, sequence=5)
    assert "number 4" in world.verbs.stream("twist", twist, sequence=4)
    for stamp_s in (0.5, 1.0):
        assert f"sent at {stamp_s}" in world.verbs.stream("twist", twist, stamp_s=stamp_s)
    assert world.verbs.stream("twist", twist, sequence=6, stamp_s=1.1) == ""
    assert world.verbs.status().stream_late == 4


def test_one_owner_streams_and_anybody_stops():
    world = streaming("twst")
    assert world.verbs.stream("twist", [0.0, 0.0, 0.01, 0.0, 0.0, 0.0], owner="a") == ""
    assert "'a' has authority over the arm" in world.verbs.stream("twist", [0.0] * 6, owner="b")
    assert world.verbs.status().stream_owner == "a"
    world.verbs.stream("twist", [0.0] * 6, owner="a")
    world.tick(int(1.0 / DT_S) + 2)
    assert "'a' has authority" in world.verbs.stream("twist", [0.0] * 6, owner="b")
    assert world.verbs.status().authority.owner == "a"
    world.tick(int(1.0 / DT_S) + 2)
    assert world.verbs.stream("twist", [0.0] * 6, owner="b") == ""
    world.verbs.stop()
    assert "stopped" in world.verbs.stream("twist", [0.0] * 6, owner="b")


@pytest.mark.parametrize("values", [[1.0] * 5, [math.nan] * 6])
def test_bad_streamed_values_change_nothing(values):
    for kind, name in (("pose", "pose"), ("twst", "twist"), ("wrnc", "wrench")):
        world = streaming(kind)
        assert world.verbs.stream(name, values)
        world.tick(5)
        assert not world.verbs.servo.moving


def test_streams_keep_to_the_workspace():
    world = streaming("twst", options=streams(workspace_z_m=(0.75, 2.0)))
    limits = world.verbs.controller.motion.reference.limits
    assert limits.linear_acceleration_m_s2 == STREAM_LIMITS.linear_acceleration_m_s2
    assert limits.angular_acceleration_rad_s2 == STREAM_LIMITS.angular_acceleration_rad_s2
    for _ in range(400):
        world.verbs.stream("twist", [0.0, 0.0, -0.2, 0.0, 0.0, 0.0])
        world.tick()
        assert world.tcp[0][2] >= 0.75 - 1e-6
    assert world.tcp[0][2] == pytest.approx(0.75, abs=1e-3)


def test_sequence_numbers_and_stamps_have_to_be_some():
    world = streaming("twst")
    assert "not an integer from 0" in world.verbs.stream("twist", [0.0] * 6, sequence="a")
    assert "not a time" in world.verbs.stream("twist", [0.0] * 6, stamp_s=math.nan)
    assert world.verbs.stream("twist", [0.0] * 6, sequence=1, stamp_s=1.0) == ""


def test_a_queue_is_no_measure_of_the_delay_when_a_stream_is_chosen_again():
    world = streaming("twst")
    twist = [0.05, 0.0, 0.0, 0.0, 0.0, 0.0]
    sent_s = world.verbs.stamp_s
    assert world.verbs.stream("twist", twist, stamp_s=sent_s) == ""
    world.tick(250)
    world.verbs.set_parameter("cpsc", "twst")
    assert "on its way" in world.verbs.stream("twist", twist, stamp_s=sent_s + 0.01)
    world.tick(50)
    assert not world.verbs.servo.moving
    assert world.verbs.stream("twist", twist, stamp_s=world.verbs.stamp_s) == ""


DRIFT = 1e-4
"""Relative drift of a sender's clock against ours, as of two cheap crystals."""


@pytest.mark.parametrize("drift", [DRIFT, -DRIFT])
def test_a_clock_that_drifts_is_believed_for_hours(drift):
    delays = Delays()
    waited_s = [delays.hear("a", at_s * (1.0 - drift), at_s) for at_s in range(4 * 3600)]
    assert max(waited_s) < 0.05 * STALE_S


def test_a_clock_that_was_set_back_is_believed_again_while_its_sender_goes_on():
    delays = Delays()
    for at_s in range(10):
        delays.hear("a", float(at_s), float(at_s))
    waited_s = [delays.hear("a", at_s - 5.0, float(at_s)) for at_s in range(10, 80)]
    assert waited_s[0] == waited_s[25] == 5.0
    assert waited_s[-1] == 0.0


def test_stamps_of_the_future_are_no_measure_for_other_senders():
    delays = Delays()
    delays.hear("liar", 1000.0, 0.0)
    assert delays.hear("a", 0.5, 1.0) == delays.hear("a", 1.5, 2.0) == 0.0
    assert delays.hear("liar", 3.0, 3.0) == 1000.0


@pytest.mark.parametrize("waited_s", [0.5, 59.0, 61.0, 3000.0])
def test_a_queue_is_too_late_however_long_it_was(waited_s):
    world = streaming("twst")
    twist = [0.05, 0.0, 0.0, 0.0, 0.0, 0.0]
    now_s = world.verbs.stamp_s
    assert world.verbs.stream("twist", twist, stamp_s=now_s) == ""
    why = world.verbs.stream("twist", twist, owner="", stamp_s=now_s - waited_s)
    assert "on its way" in why or "after one of" in why


def test_the_queue_of_a_sender_that_was_refused_is_no_measure_of_its_delay():
    world = streaming("twst")
    twist = [0.05, 0.0, 0.0, 0.0, 0.0, 0.0]
    begun_s = world.verbs.stamp_s
    while world.verbs.stamp_s < begun_s + 3.0:
        assert world.verbs.stream("twist", twist, owner="a") == ""
        age_s = world.verbs.stamp_s - begun_s
        # Fresh at first; then each message is delayed more than the one before.
        assert "'a' has authority" in world.verbs.stream(
            "twist", twist, owner="b", stamp_s=begun_s + min(age_s, 0.2) + 0.1 * age_s
        )
        world.tick(5)
    world.verbs.release("a")
    world.rest()
    world.verbs.set_parameter("cpsc", "twst")
    why = world.verbs.stream("twist", twist, owner="b", stamp_s=begun_s + 0.51)
    assert "on its way" in why
    assert world.verbs.stream("twist", twist, owner="b", stamp_s=world.verbs.stamp_s) == ""


def test_the_first_stamp_of_a_sender_moves_nothing_until_another_one_agrees():
    world = streaming("twst")
    twist = [0.05, 0.0, 0.0, 0.0, 0.0, 0.0]
    sent_s = world.verbs.stamp_s - 2.0
    # Commands queued during an outage arrive at once, the oldest first.
    for number in range(50):
        why = world.verbs.stream("twist", twist, owner="a", stamp_s=sent_s + 0.04 * number)
        assert "not known yet" in why
        world.tick(number % 2)
    assert not world.verbs.servo.moving
    taken = 0
    for _ in range(3):
        world.tick(5)
        taken += not world.verbs.stream("twist", twist, owner="a", stamp_s=world.verbs.stamp_s)
    assert taken >= 2
    # The estimate of the sender's clock outlives a silence.
    world.tick(int(5.0 / DT_S))
    world.verbs.set_parameter("cpsc", "twst")
    why = world.verbs.stream("twist", twist, owner="a", stamp_s=world.verbs.stamp_s - 2.0)
    assert "it waited for 2.00 s" in why


def test_a_sender_that_is_silent_for_an_hour_is_forgotten():
    delays = Delays()
    for at_s in (0.0, 0.1, 0.2):
        delays.hear("a", at_s, at_s)
    assert delays.late("a") == ""
    assert delays.hear("a", 3000.0, 3002.0) == pytest.approx(2.0 - 3002.0 * DRIFT, abs=0.01)
    assert delays.hear("a", 9998.0, 10000.0) == 0.0
    assert "not known yet" in delays.late("a")


def test_senders_that_are_many_do_not_displace_the_one_that_has_the_arm():
    delays = Delays()
    for at_s in (0.0, 0.1):
        delays.hear("a", at_s, at_s)
    for number in range(1000):
        delays.hear(f"other{number}", 0.0, 0.2, "a")
    assert delays.hear("a", -1.8, 0.2, "a") == pytest.approx(2.0)
