"""Relative and absolute jogging: by time, not by messages; no refusals beyond 90 degrees; through
±pi; along walls."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cardan.gateway.arm import ControllerOptions
from cardan.gateway.kinematics.collision import box_obstacle
from cardan.spatial import from_rotation_vector, multiply, to_rotation_vector
from cardan.types import Pose, Vector3
from tests.gateway.arm.arms import DT_S, World, streams

pytestmark = pytest.mark.matrix


def streaming(kind, arm="ur5", **more):
    world = World(arm, **more)
    world.verbs.set_parameter("cpsc", kind)
    world.tick()
    return world


def test_relative_steps_add_up_however_they_are_bunched():
    even, bunched = streaming("pose"), streaming("pose")
    begin = even.six()
    for tick in range(500):
        assert even.verbs.stream("jog", [0.0, 0.0002, -0.0002, 0.0, 0.0, 0.0004]) == ""
        if tick % 25 == 0:
            for _ in range(25):
                assert bunched.verbs.stream("jog", [0.0, 0.0002, -0.0002, 0.0, 0.0, 0.0004]) == ""
        else:
            bunched.verbs.stream("jog", [0.0] * 6)
        even.tick()
        bunched.tick()
    for world in (even, bunched):
        for _ in range(200):
            world.verbs.stream("jog", [0.0] * 6)
            world.tick()
        assert world.six()[:3] - begin[:3] == pytest.approx((0.0, 0.1, -0.1), abs=1e-4)
        assert not world.verbs.servo.moving


def test_relative_steps_are_along_the_tcp_in_its_frame():
    world = World()
    world.verbs.set_parameters({"cpf": "cpft", "cpsc": "pose"})
    world.tick()
    position, rotation = world.tcp
    for _ in range(200):
        world.verbs.stream("jog", [0.0, 0.0, 0.0002, 0.0, 0.0, 0.0])
        world.tick()
    for _ in range(200):
        world.verbs.stream("jog", [0.0] * 6)
        world.tick()
    assert world.tcp[0] - position == pytest.approx(rotation @ (0.0, 0.0, 0.04), abs=1e-4)


def test_a_sum_that_runs_away_is_refused():
    world = streaming("pose")
    answers = [world.verbs.stream("jog", [0.0, 0.01, 0.0, 0.0, 0.0, 0.0]) for _ in range(40)]
    assert answers[0] == ""
    assert "a step of 0.2" in answers[-1]
    world.tick(200)


@pytest.mark.parametrize("wrong", [[0.0] * 5, [math.nan] + [0.0] * 5, [math.inf] * 6])
def test_a_wrong_step_changes_nothing(wrong):
    world = streaming("pose")
    assert world.verbs.stream("jog", wrong) != ""
    world.tick(50)
    assert not world.verbs.servo.moving


def test_damping_is_a_time_constant_and_not_a_share_of_a_message():
    """The thesis's factor 0.5 at its 10 Hz loop: the distance halves every 0.1 s."""
    options = streams(linear_speed_m_s=0.5, linear_acceleration_m_s2=8.0, linear_jerk_m_s3=400.0)
    left = {}
    for every in (1, 12):  # messages at a rate of 250 Hz and of 21 Hz
        world = World(options=options)
        world.verbs.set_parameters({"cpda": 0.5, "cpsc": "pose"})
        world.tick()
        target = world.moved(0.0, 0.05, 0.0)
        away = []
        for tick in range(200):
            if tick % every == 0:
                assert world.verbs.stream("pose", target) == ""
            world.tick()
            away.append(target[1] - world.six()[1])
        first, second = away[50], away[75]  # 0.1 s apart
        assert second / first == pytest.approx(0.5, abs=0.03)
        left[every] = away
    assert left[1] == pytest.approx(left[12], abs=1e-4)


def test_the_continuous_wrist_of_a_pr2_is_turned_by_poses_without_a_refusal():
    """The thesis's failure: joints beyond ±180 degrees, commanded by absolute poses at 50 Hz."""
    world = streaming(
        "pose",
        "pr2_right_arm",
        options=streams(angular_speed_rad_s=3.0),
    )
    begin = world.six()
    start = from_rotation_vector(Vector3(*begin[3:]))
    rate, refused = 2.0, 0
    seconds = 10.0 * 2.0 * math.pi / rate
    for tick in range(round(seconds / DT_S)):
        if tick % 5 == 0:
            turn = from_rotation_vector(Vector3(rate * tick * DT_S, 0.0, 0.0))
            target = Pose(Vector3(*begin[:3]), multiply(start, turn))
            refused += world.verbs.stream("pose", target) != ""
        world.tick()
    assert refused == 0
    turned = world.verbs.servo.q[6] - world.model.home[6]
    assert turned == pytest.approx(10.0 * 2.0 * math.pi, abs=2.0)  # full turns are counted


def test_through_half_a_turn_the_way_goes_on():
    """From 170 to 190 degrees the rotation vector jumps by 340 degrees; the arm must not."""
    world = streaming("pose", "pr2_right_arm")
    begin = world.six()
    start = from_rotation_vector(Vector3(*begin[3:]))
    signs = set()
    for degrees in range(0, 360, 2):
        turn = multiply(start, from_rotation_vector(Vector3(math.radians(degrees), 0.0, 0.0)))
        vector = to_rotation_vector(turn)
        signs.add(vector.x > 0.0)
        for _ in range(15):
            assert world.verbs.stream("pose", [*begin[:3], *vector]) == ""
            before = world.verbs.servo.q.copy()
            world.tick()
            assert np.abs(world.verbs.servo.q - before).max() < 0.02
    assert len(signs) == 2


def test_streams_slide_along_a_wall_and_never_jump_through_it():
    x = World("ur5").six()[0] + 0.15
    wall = box_obstacle("wall", Vector3(x, -0.6, -0.2), Vector3(x + 0.005, 0.6, 1.2))
    world = streaming(
        "pose", "ur5", obstacles=(wall,), options=ControllerOptions(stream_step_m=0.5)
    )
    beyond = world.moved(0.2, 0.08, 0.0)
    collision = world.verbs.servo.collision
    nearest = math.inf
    for _ in range(1500):
        world.verbs.stream("pose", beyond)
        world.tick()
        distances = collision.at(world.verbs.servo.q)
        nearest = min(
            nearest, *(d for d, p in zip(distances, collision.pairs, strict=True) if "wall" in p)
        )
    assert nearest > 0.009
    assert world.six()[0] < x
    # slid over the full commanded distance
    assert beyond[1] - world.six()[1] == pytest.approx(0.0, abs=2e-3)
    begin = world.six()
    for _ in range(250):
        world.verbs.stream("pose", [*(begin[:3] - (0.05, 0.0, 0.0)), *begin[3:]])
        world.tick()
    assert begin[0] - world.six()[0] == pytest.approx(0.05, abs=2e-3)


def lag_m(options, speed=0.1, every=12):
    """Lag of the TCP behind a device at constant speed, with poses at 21 Hz."""
    world = World(options=options)
    world.verbs.set_parameter("cpsc", "pose")
    world.tick()
    begin, behind = world.six(), []
    for tick in range(600):
        hand = begin[1] + speed * tick * DT_S
        if tick % every == 0:
            assert world.verbs.stream("pose", [begin[0], hand, *begin[2:]]) == ""
        world.tick()
        behind.append(hand - world.six()[1])
    for _ in range(250):
        world.verbs.stream("pose", [begin[0], hand, *begin[2:]])
        world.tick()
    assert world.six()[1] == pytest.approx(hand, abs=1e-4)
    assert not world.verbs.servo.moving
    return float(np.mean(behind[300:]))


def test_prediction_takes_the_delay_of_a_stream_away_and_still_ends_where_it_was_reported():
    quick = streams(linear_acceleration_m_s2=5.0, linear_jerk_m_s3=1000.0)
    newest_only = lag_m(quick)
    predicted = lag_m(replace(quick, stream_prediction_s=0.06))
    assert newest_only > 0.004
    assert abs(predicted) < 0.0015


def test_a_resting_pose_stream_may_be_silent():
    world = streaming("pose")
    target = world.moved(0.0, 0.03, 0.0)
    for _ in range(400):
        world.verbs.stream("pose", target)
        world.tick()
    world.tick(300)
    assert world.verbs.stream("pose", target) == ""


def test_a_senders_clock_that_is_set_back_is_believed_again_within_a_minute():
    """Until then each command seems to be an hour old, and is refused."""
    world = streaming("pose")

    def asked(stamp_s):
        return world.verbs.stream("pose", world.moved(0.0, 0.0005, 0.0), stamp_s=stamp_s)

    for stamp_s in (5000.0, 5000.02):
        assert asked(stamp_s) == ""
        world.tick(5)
    assert "it waited for 3600.00 s" in asked(1400.04)
    for each in range(1, 3000):
        world.tick(5)
        asked(1400.04 + 0.02 * each)
    assert asked(1460.04) == ""
    assert "sent at 1460.030000 s" in asked(1460.03)
