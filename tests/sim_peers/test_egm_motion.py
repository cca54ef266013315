"""Control law in numbers, limits of the servos, and geometry of the arm."""

import math
import random

import pytest

from cardan.sim_peers.egm_controller.motion import ControlLaw, JointMove, RampDown, ServoAxes
from cardan.sim_peers.kinematics import (
    GOFA,
    Differential,
    forward,
    jacobian,
    pose_error,
)
from cardan.spatial import to_euler_zyx

TS = 0.004032
UNLIMITED = GOFA._replace(velocity=(math.inf,) * 6, acceleration=(math.inf,) * 6)


def servo(arm=UNLIMITED, delay_s=0.0, start=(0.0,) * 6):
    return ServoAxes(arm, TS, delay_s, start)


def follow(cycles, gain, filter_hz=None, cap_deg_s=math.inf, reference=lambda t: 1.0, feed=0.0):
    """Return axis 1 in degrees after `cycles` of the law."""
    law = ControlLaw(gain, filter_hz, TS)
    arm = servo()
    for n in range(cycles):
        error = [math.radians(reference(n * TS)) - arm.planned[0]] + [0.0] * 5
        speeds = law.speeds(error, [math.radians(feed)] + [0.0] * 5)
        arm.drive(speeds, math.radians(cap_deg_s))
    return math.degrees(arm.planned[0])


@pytest.mark.parametrize(
    ("arguments", "expected_deg"),
    [
        ({"cycles": 50, "gain": 5.0}, 1.0 - (1.0 - 5.0 * TS) ** 50),
        ({"cycles": 50, "gain": 5.0}, 0.638791),
        ({"cycles": 50, "gain": 5.0, "filter_hz": 20.0}, 0.638671),
        ({"cycles": 50, "gain": 5.0, "cap_deg_s": 1.0}, 0.201600),
        ({"cycles": 250, "gain": 5.0, "cap_deg_s": 1.0}, 0.930053),
        ({"cycles": 50, "gain": 20.0, "filter_hz": 100.0}, 0.985436),
        ({"cycles": 250, "gain": 0.0, "feed": 10.0, "reference": lambda t: -77.0}, 10.080),
    ],
)
def test_law_in_numbers(arguments, expected_deg):
    assert follow(**arguments) == pytest.approx(expected_deg, abs=5e-7)


@pytest.mark.parametrize(("feed", "lag_deg"), [(0.0, 2.0), (10.0, 0.0)])
def test_a_ramp_is_followed_v_over_k_behind_without_speed_ref(feed, lag_deg):
    cycles = 1000
    reached = follow(cycles, 5.0, reference=lambda t: 10.0 * t, feed=feed)
    assert 10.0 * cycles * TS - reached == pytest.approx(lag_deg, abs=1e-3)


def test_the_cap_scales_all_joints_by_the_same_ratio():
    arm = servo()
    arm.drive([0.4, -0.1, 0.0, 0.2, 0.0, 0.0], cap_rad_s=0.1)
    assert arm.speeds == pytest.approx([0.1, -0.025, 0.0, 0.05, 0.0, 0.0])


def test_joint_speed_limits_shorten_the_motion_and_show_as_utilization():
    arm = servo(GOFA._replace(acceleration=(math.inf,) * 6))
    top = GOFA.velocity
    arm.drive([0.5 * top[0], 2.0 * top[1], 0.0, 0.0, 0.0, 0.0])
    assert arm.utilization == pytest.approx(2.0)
    assert arm.speeds[:2] == pytest.approx([0.25 * top[0], top[1]])
    arm.drive([0.1 * top[0]] + [0.0] * 5)
    assert arm.utilization == pytest.approx(0.1)


def test_acceleration_limits_hold_in_every_cycle():
    arm = servo(GOFA)
    noise = random.Random(4)
    for _ in range(300):
        before = list(arm.speeds)
        arm.drive([noise.uniform(-9.0, 9.0) for _ in range(6)])
        for v0, v1, a, top in zip(
            before, arm.speeds, arm.accelerations, GOFA.acceleration, strict=True
        ):
            assert abs(v1 - v0) <= top * TS * (1.0 + 1e-9)
            assert (v1 - v0) / TS == pytest.approx(a, abs=1e-9)


@pytest.mark.parametrize("delay_s", [0.0, TS, 0.016, 0.0201])
def test_the_arm_is_the_servo_delay_behind_the_plan(delay_s):
    arm = servo(delay_s=delay_s)
    for _ in range(20):
        arm.drive([0.5] * 6)
    assert arm.planned[0] - arm.actual[0] == pytest.approx(0.5 * delay_s, abs=1e-12)


def test_encoders_are_noisy_and_the_same_for_the_same_seed():
    def measured(seed):
        arm = ServoAxes(GOFA, TS, 0.016, (0.0,) * 6, noise_rad=1e-6, seed=seed)
        values = []
        for _ in range(5):
            arm.drive([0.0] * 6)
            values.append(tuple(arm.measured))
        return values

    assert measured(1) == measured(1)
    assert measured(1) != measured(2)
    assert len(set(measured(1))) == 5
    assert max(abs(q) for row in measured(1) for q in row) < 1e-5


def test_ramp_down_takes_its_time_and_quick_stop_the_axes_ability():
    arm = servo(GOFA)
    for _ in range(30):
        arm.drive([0.5] * 6)
    ramp = RampDown(arm, 0.2)
    cycles = 1
    while not ramp.tick():
        cycles += 1
    assert cycles * TS == pytest.approx(0.2, abs=2 * TS)
    for _ in range(60):
        arm.drive([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    quick = RampDown(arm, 0.0)
    cycles = 1
    while not quick.tick():
        cycles += 1
    assert cycles * TS == pytest.approx(2.0 / GOFA.acceleration[0], abs=2 * TS)


def test_joint_move_arrives_at_rest_within_limits():
    arm = servo(GOFA)
    target = [0.5, -0.2, 0.1, 1.0, 0.3, -2.0]
    move = JointMove(arm, target)
    cycles = 0
    while not move.tick():
        cycles += 1
        assert cycles < 5000
        for v, top in zip(arm.speeds, GOFA.velocity, strict=True):
            assert abs(v) <= 0.51 * top
    assert arm.planned == pytest.approx(target, abs=1e-9)
    assert arm.at_rest


@pytest.mark.parametrize(
    ("joints_deg", "xyz_mm", "quaternion", "euler_deg"),
    [
        ((0, 0, 0, 0, 0, 0), (571, 0, 899), (0.70710678, 0, 0.70710678, 0), (0, 90, 0)),
        (
            (0, 0, 0, 0, 30, 0),
            (597.468566, 0, 837.782032),
            (0.5, 0, 0.8660254, 0),
            (180, 60, 180),
        ),
        ((0, 0, 0, 0, 90, 0), (550, 0, 718), (0, 0, 1, 0), (180, 0, 180)),
        (
            (10, 20, -30, 40, 50, 60),
            (709.469033, 142.034547, 874.507359),
            (0.13582068, 0.44015072, 0.73444697, 0.49840519),
            (118.700811, -13.841726, 126.359980),
        ),
        (
            (20, -30, 25, 40, 50, -60),
            (336.420, 140.196, 791.258),
            (0.449482, -0.479259, 0.731160, 0.183527),
            None,
        ),
    ],
)
def test_published_poses(joints_deg, xyz_mm, quaternion, euler_deg):
    pose = forward([math.radians(q) for q in joints_deg]).pose
    assert [1e3 * v for v in pose.position] == pytest.approx(xyz_mm, abs=1e-3)
    dot = sum(a * b for a, b in zip(pose.orientation, quaternion, strict=True))
    assert abs(dot) == pytest.approx(1.0, abs=1e-6)
    if euler_deg is not None:
        for angle, expected in zip(to_euler_zyx(pose.orientation), euler_deg, strict=True):
            assert math.remainder(math.degrees(angle) - expected, 360.0) == pytest.approx(
                0.0, abs=1e-5
            )


@pytest.mark.parametrize(
    ("joints_deg", "smallest"),
    [
        ((0, 0, 0, 0, 0, 0), 0.0491),
        ((0, 0, 0, 0, 30, 0), 0.1958),
        ((20, -30, 25, 40, 50, -60), 0.1681),
    ],
)
def test_distance_to_singularity(joints_deg, smallest):
    frames = forward([math.radians(q) for q in joints_deg])
    differential = Differential(frames)
    assert not differential.is_singular(smallest - 5e-5)
    assert differential.is_singular(smallest + 5e-5)


def test_jacobian_is_the_derivative_of_the_pose():
    joints = [0.2, -0.3, 0.4, 0.5, 0.6, -0.7]
    frames = forward(joints)
    step = 1e-6
    for axis in range(6):
        moved = list(joints)
        moved[axis] += step
        difference = pose_error(forward(moved).pose, frames.pose)
        assert [d / step for d in difference] == pytest.approx(jacobian(frames)[axis], abs=2e-6)


def test_limits_are_those_of_the_gofa():
    assert [round(math.degrees(v)) for v in GOFA.velocity] == [125, 125, 140, 200, 200, 200]
    assert math.degrees(GOFA.lower[2]) == pytest.approx(-225.0)
    assert math.degrees(GOFA.upper[2]) == pytest.approx(85.0)
