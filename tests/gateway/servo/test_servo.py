"""The control tick: lines through singularities, limits, obstacles, arms with few joints."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.kinematics.collision import CollisionModel, Obstacle, box_obstacle
from cardan.gateway.kinematics.soft_neck import SoftNeck
from cardan.gateway.servo import compiled, servo as in_python
from cardan.gateway.servo.choice import choose_servo
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.options import Policy, ServoOptions
from cardan.gateway.servo.servo import MAX_ROWS, Servo
from cardan.robots import load_arm
from cardan.types import Vector3
from tests.examples import examples

DT_S = 0.002
ACCELERATION = 15.0
"""Acceleration of the published prototype's lines, rad/s²."""


@pytest.fixture(autouse=True, params=[Servo, CompiledServo], ids=["python", "compiled"])
def kind(request, monkeypatch):
    """Run every test with the servo in Python and with the compiled one."""
    monkeypatch.setattr(f"{__name__}.Kind", request.param)
    return request.param


Kind = Servo


def servo(name="ur5", obstacles=(), q_deg=None, **options):
    kinematics = ArmKinematics(load_arm(name))
    kinematics.acceleration[:] = ACCELERATION
    collision = CollisionModel(kinematics, obstacles) if obstacles else None
    weights = kinematics.arm.task.weights
    made = Kind(kinematics, collision, ServoOptions(**options), weights)
    home = kinematics.arm.home if q_deg is None else np.radians(q_deg)
    made.place(np.array(home))
    return made


class Drive:
    """Drives a servo by twists, with its goal updated as in a session; stores the worst values."""

    def __init__(self, made):
        self.servo = made
        self.goal = made.placement
        self.acceleration = 0.0
        self.clearance_m = math.inf

    def run(self, linear, seconds, angular=(0, 0, 0), ramp_s=0.1, **how):
        made, steps = self.servo, round(seconds / DT_S)
        progress = 0.0
        for i in range(steps):
            share = min(1.0, (i + 1) * DT_S / ramp_s)
            twist = share * np.array((linear, angular), dtype=float)
            before = made.v.copy()
            progress += share * made.tick(to_pose(self.goal), twist, DT_S, **how) * DT_S
            self.goal.translation = self.goal.translation + made.twist[0] * DT_S
            self.goal.rotation = pin.exp3(made.twist[1] * DT_S) @ self.goal.rotation
            self.acceleration = max(self.acceleration, np.abs(made.v - before).max() / DT_S)
            assert (made.q <= made.kinematics.upper + 1e-5).all()
            assert (made.q >= made.kinematics.lower - 1e-5).all()
            assert (np.abs(made.v) <= made.kinematics.velocity + 1e-9).all()
            if made.collision is not None:
                self.clearance_m = min(self.clearance_m, *wall_distances(made))
        assert self.acceleration <= ACCELERATION * (1 + 1e-6)
        assert made.status().failures == 0
        return progress

    @property
    def error(self):
        difference = self.servo.placement.actInv(self.goal)
        return np.linalg.norm(difference.translation), np.linalg.norm(pin.log3(difference.rotation))


def wall_distances(made):
    distances = made.collision.at(made.q)
    pairs = zip(made.collision.pairs, distances, strict=True)
    return [distance for pair, distance in pairs if "wall" in pair]


def test_where_the_tcp_is_for_any_joints_and_how_it_moves():
    made = servo()
    q = made.q + 0.1
    for found, joints in ((made.pose_at(q.tolist()), q), (made.pose, made.q)):
        expected = to_pose(made.kinematics.forward(joints))
        assert found.position == pytest.approx(expected.position, abs=1e-12)
        assert abs(np.dot(found.orientation, expected.orientation)) == pytest.approx(1.0)
    made.move_at(np.full(6, 0.1))
    step = 1e-6
    ahead = made.kinematics.forward(made.q + step * made.v)
    here = made.placement
    assert made.motion[0] == pytest.approx((ahead.translation - here.translation) / step, abs=1e-6)
    turned = pin.log3(ahead.rotation @ here.rotation.T)
    assert made.motion[1] == pytest.approx(turned / step, abs=1e-6)


def test_a_twist_is_followed_at_once_and_exactly():
    drive = Drive(servo())
    start = drive.servo.placement.translation.copy()
    drive.run((0.0, 0.1, -0.05), 1.0, (0.0, 0.0, 0.2))
    moved = drive.servo.placement.translation - start
    assert moved == pytest.approx((0.0, 0.0951, -0.04755), abs=2e-4)
    assert drive.error == pytest.approx((0.0, 0.0), abs=1e-4)
    assert drive.servo.path_speed > 0.999


@pytest.mark.parametrize("policy", Policy)
def test_a_line_through_the_wrist_singularity_passes(policy):
    made = servo(q_deg=(0, -80, 100, -20, 20, 0), policy=policy)
    beyond = np.radians((4.0, -78.0, 98.0, -20.0, -20.0, 0.0))
    start, end = made.placement, made.kinematics.forward(beyond)
    line = end.translation - start.translation
    length = float(np.linalg.norm(line))
    turn = pin.log3(end.rotation @ start.rotation.T)
    speed, drive = 0.1, Drive(made)
    smallest, offset_m, offset_rad, progress = 1.0, 0.0, 0.0, 0.0
    for tick in range(600):
        if progress * speed >= length:
            break
        ramp = min(1.0, (tick + 1) * DT_S / 0.1)
        pace = ramp * speed / length
        progress += ramp * drive.run(pace * line, DT_S, pace * turn, ramp_s=DT_S)
        smallest = min(smallest, made.status().smallest_singular_value)
        here = made.placement
        on_line = start.translation + line / length * speed * progress
        ideal = pin.exp3(turn * speed * progress / length) @ start.rotation
        offset_m = max(offset_m, float(np.linalg.norm(here.translation - on_line)))
        offset_rad = max(offset_rad, float(np.linalg.norm(pin.log3(ideal.T @ here.rotation))))
    assert progress * speed >= length  # the line was completed
    assert smallest < 1e-3  # through a singularity
    assert offset_m < 3e-3
    assert offset_rad < math.radians(1.0)


def test_holding_the_line_stops_at_the_end_of_reach_and_comes_back():
    drive = Drive(servo(q_deg=(0, -60, 60, -90, -90, 0)))
    outward = drive.servo.placement.translation * (1, 1, 0)
    outward /= np.linalg.norm(outward)
    start = drive.servo.placement.translation.copy()
    drive.run(0.1 * outward, 5.0)
    there = drive.servo.placement.translation - start
    across = there - outward * (there @ outward)
    assert np.linalg.norm(across) < 1e-3
    assert drive.servo.path_speed < 0.1
    assert drive.error[0] < 5e-3  # no error accumulated
    drive.run(-0.1 * outward, 1.0)
    back = (drive.servo.placement.translation - start) @ outward
    assert there @ outward - back > 0.075


@pytest.mark.matrix("python-gp8", "python-amor", "compiled-gp8", "compiled-amor")
@pytest.mark.parametrize("name", ["ur5", "gp8", "pr2_right_arm", "asibot", "amor"])
def test_random_commands_never_break_a_limit_nor_the_program(name):
    drive = Drive(servo(name))
    generator = np.random.default_rng(5)
    for _ in range(12):
        linear, angular = generator.normal(size=(2, 3)) * generator.choice((0.1, 1.0, 5.0))
        rate = generator.normal(size=drive.servo.joints) * generator.choice((0.0, 3.0))
        drive.servo.policy = generator.choice(tuple(Policy))
        drive.run(linear, 0.25, angular, joint_rate=rate)
        drive.goal = drive.servo.placement


def test_into_both_limits_of_every_joint_the_full_range_is_used():
    made = servo("gofa_crb15000_5")
    for end in (made.kinematics.upper, made.kinematics.lower):
        for _ in range(2500):
            made.tick_joints(end, np.zeros(made.joints), DT_S)
        assert made.q == pytest.approx(end, abs=1e-5)


# ---------------------------------------------------------------------------------------------
# Obstacles


def wall(made_q_deg=(0, -90, 100, -100, -90, 0)):
    """The servo in front of a wall 5 mm thick, 25 cm from the TCP."""
    probe = servo(q_deg=made_q_deg)
    x = float(probe.placement.translation[0]) + 0.25
    obstacle = box_obstacle("wall", Vector3(x, -0.5, -0.2), Vector3(x + 0.005, 0.5, 1.2))
    return Drive(servo(obstacles=(obstacle,), q_deg=made_q_deg))


@pytest.mark.matrix("python-0.1-Policy.PATH", "python-0.1-Policy.REACH")
@pytest.mark.parametrize("policy", Policy)
@pytest.mark.parametrize("speed", [0.1, pytest.param(0.5, marks=pytest.mark.matrix), 1.0])
def test_a_thin_wall_is_not_touched_slid_along_and_left_without_hesitation(policy, speed):
    drive = wall()
    made = drive.servo
    made.policy = policy
    drive.run((speed, 0, 0), 0.5 + 0.4 / speed, ramp_s=0.5, slide=True)
    assert 0.009 < drive.clearance_m < 0.0105
    before = made.placement.translation.copy()
    drive.run((0.1, 0.1, 0), 1.0, ramp_s=DT_S, slide=True)
    assert drive.clearance_m > 0.009
    assert (made.placement.translation - before)[1] > 0.95 * 0.1
    before = made.placement.translation.copy()
    drive.run((-0.1, 0, 0), 0.5 / 0.95, ramp_s=DT_S, slide=True)
    assert (made.placement.translation - before)[0] < -0.95 * 0.1 * 0.5


@pytest.mark.matrix("python")
def test_bodies_that_stay_near_hide_none_that_comes():
    """More near bodies than there are constraints, like many covers of two adjacent links: nearer
    than allowed, and no motion of the arm brings them nearer."""
    drive = wall()
    posts = [
        box_obstacle(f"post {i}", Vector3(-0.1, -0.1, low), Vector3(-0.088, 0.1, low + 0.001))
        for i, low in enumerate(np.linspace(0.07, 0.09, 2 * MAX_ROWS))
    ]
    near = Obstacle("wall", drive.servo.collision.solids[-1].shape)
    crowded = Drive(servo(obstacles=(*posts, near), q_deg=np.degrees(drive.servo.q)))
    made = crowded.servo
    distances = dict(zip(made.collision.pairs, made.collision.at(made.q), strict=True))
    beside = [d for pair, d in distances.items() if pair[0].startswith("post") and d < 0.01]
    assert len(beside) >= 2 * MAX_ROWS
    crowded.run((0.5, 0, 0), 1.5, ramp_s=0.5, slide=True)
    drive.run((0.5, 0, 0), 1.5, ramp_s=0.5, slide=True)
    assert crowded.clearance_m > 0.009
    assert made.q == pytest.approx(drive.servo.q, abs=0.005)


def test_without_sliding_the_line_ends_at_the_wall():
    drive = wall()
    drive.run((0.25, 0.1, 0), 3.0)
    before = drive.servo.placement.translation.copy()
    drive.run((0.25, 0.1, 0), 0.5)
    assert np.linalg.norm(drive.servo.placement.translation - before) < 1e-3
    assert drive.error[0] < 5e-3
    status = drive.servo.status()
    assert status.active_pairs > 0
    assert "wall" in status.nearest_pair
    assert status.path_speed < 0.05
    drive.servo.place(drive.servo.q)
    assert drive.servo.status().active_pairs == 0


def test_nothing_is_pushed_away_from_an_obstacle_that_nobody_moves_at():
    drive = wall()
    drive.run((0.5, 0, 0), 1.5, slide=True)
    near = drive.servo.q.copy()
    obstacle = drive.servo.collision.solids[-1]
    wider = servo(obstacles=(Obstacle("wall", obstacle.shape),), safety_distance_m=0.05)
    wider.place(near)
    drive = Drive(wider)  # an obstacle that is suddenly too near
    drive.run((0, 0, 0), 0.5)
    assert drive.servo.q == pytest.approx(near, abs=1e-6)


def test_braking_minds_the_obstacle_in_its_path():
    drive = wall()
    drive.run((1.0, 0, 0), 0.3, ramp_s=0.3, slide=True)
    made = drive.servo
    while made.moving:
        before = made.v.copy()
        made.brake(DT_S)
        assert np.abs(made.v - before).max() <= ACCELERATION * DT_S * (1 + 1e-6)
        assert min(wall_distances(made)) > 0.009


# ---------------------------------------------------------------------------------------------
# Few joints, many joints, joints beside axes


def test_an_arm_of_five_joints_keeps_position_and_tells_what_it_cannot_do():
    drive = Drive(servo("asibot"))
    made = drive.servo
    before = made.placement.translation.copy()
    sideways = made.placement.rotation @ (1.0, 0.0, 0.0)  # a rotation out of the arm's plane
    drive.run((0, 0, 0), 1.0, 0.3 * sideways)
    assert np.linalg.norm(made.placement.translation - before) < 2e-3
    assert made.status().unreachable_rad_s > 0.05
    drive.run((0, 0, -0.02), 1.0)
    assert made.status().unreachable_m_s < 0.01
    assert (made.placement.translation - before)[2] == pytest.approx(-0.019, abs=2e-3)


def test_seven_joints_drift_to_their_posture_while_the_tcp_moves_and_rest_when_it_rests():
    drive = Drive(servo("pr2_right_arm"))
    made = drive.servo
    made.posture = made.q.copy()
    made.posture[2] -= 0.3
    start = made.q.copy()
    made.tick(to_pose(drive.goal), np.zeros((2, 3)), DT_S)
    assert np.abs(made.q - start).max() < 1e-9
    for _ in range(5):
        drive.run((0, 0, 0.05), 0.5)
        drive.run((0, 0, -0.05), 0.5)
        assert drive.error[0] < 1e-4
    distance = np.linalg.norm(made.posture - made.q)
    assert distance < 0.9 * np.linalg.norm(made.posture - start)
    drive.run((0, 0, 0), 0.3)
    assert not made.moving


def test_the_turns_that_a_joint_has_counted_pull_no_other_joint_along():
    ways = []
    for turns in (1, 7):
        drive = Drive(servo("pr2_right_arm"))
        made = drive.servo
        made.posture = made.q.copy()
        wound = made.q.copy()
        wound[6] += turns * math.tau
        made.place(wound)
        drive.run((0, 0, 0.05), 1.0, angular=(1.0, 0, 0))
        ways.append(made.q - wound)
    assert ways[0] == pytest.approx(ways[1], abs=1e-6)


def test_a_soft_neck_of_three_tendons_leans_as_asked_and_stays_relaxed():
    neck = SoftNeck()
    made = choose_servo(neck, weights=SoftNeck.TASK)
    assert "rigid links" in made.not_compiled
    made.place(neck.tendons(0.0, 0.0))
    drive = Drive(made)
    for _ in range(4):
        made.posture = neck.relaxed(made.q)
        for _ in range(250):
            made.tick(to_pose(drive.goal), np.array(((0, 0, 0), (0.1, 0.05, 0.2))), DT_S)
            drive.goal.translation = drive.goal.translation + made.twist[0] * DT_S
            drive.goal.rotation = pin.exp3(made.twist[1] * DT_S) @ drive.goal.rotation
    shape = neck.shape(made.q)
    assert shape.inclination_rad == pytest.approx(math.hypot(0.1, 0.05) * 2.0, rel=0.05)
    assert abs(shape.co_contraction_m) < 3e-4
    assert made.status().unreachable_rad_s > 0.15  # the neck cannot turn about its own axis


@pytest.mark.parametrize("error", [5e-4, 0.01])
@pytest.mark.parametrize("turns", [False, True])
def test_an_error_is_taken_back_no_faster_than_can_be_stopped_within_it(error, turns):
    made = servo(linear_deceleration_m_s2=0.2, angular_deceleration_rad_s2=0.2)
    goal = made.placement.copy()
    if turns:
        goal.rotation = pin.exp3(np.array((0.0, 0.0, error))) @ goal.rotation
    else:
        goal.translation = goal.translation - (0.0, 0.0, error)
    fastest = 0.0
    for _ in range(1000):
        before = made.placement.copy()
        made.tick(to_pose(goal), np.zeros((2, 3)), DT_S)
        way = pin.log6(before.actInv(made.placement)).vector / DT_S
        fastest = max(fastest, np.linalg.norm(way[3:] if turns else way[:3]))
    assert fastest <= math.sqrt(2.0 * 0.2 * error)
    assert max(made.status()[7:9]) < 1e-9


def test_joint_rates_add_to_the_twist():
    """Equation 7 of Baklouti et al. 2021: some axes of the device move joints, others the TCP."""
    drive = Drive(servo())
    made, rate = drive.servo, np.zeros(6)
    rate[0] = 0.2
    start = made.q.copy()
    for _ in range(250):
        made.tick(to_pose(drive.goal), np.zeros((2, 3)), DT_S, rate)
        drive.goal.translation = drive.goal.translation + made.twist[0] * DT_S
        drive.goal.rotation = pin.exp3(made.twist[1] * DT_S) @ drive.goal.rotation
    moved = made.q - start
    assert moved[0] == pytest.approx(0.1, abs=2e-3)
    assert moved[1:] == pytest.approx(np.zeros(5), abs=2e-3)


@pytest.mark.matrix("python-10")
@pytest.mark.parametrize("turns", [10, pytest.param(-10, marks=pytest.mark.matrix)])
def test_a_continuous_wrist_turns_ten_times_without_a_refusal(turns):
    drive = Drive(servo("pr2_right_arm"))
    made = drive.servo
    axis = made.placement.rotation @ (1.0, 0.0, 0.0)
    start = made.q[6]
    seconds = 10 * 2 * math.pi / 3.0
    progress = drive.run((0, 0, 0), seconds, math.copysign(3.0, turns) * axis)
    assert progress > 0.97 * seconds
    assert (made.q[6] - start) / (2 * math.pi) == pytest.approx(turns, abs=0.5)


@settings(max_examples=examples(30), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1))
def test_placing_it_anew_never_moves_it(seed):
    made = servo()
    generator = np.random.default_rng(seed)
    q = generator.uniform(made.kinematics.lower, made.kinematics.upper)
    made.place(q)
    made.tick(made.pose, np.zeros((2, 3)), DT_S)
    assert np.abs(made.q - q).max() <= 1e-6


def test_a_variable_period_is_no_harm():
    made = servo()
    generator = np.random.default_rng(3)
    goal = made.placement
    for _ in range(800):
        dt_s = float(generator.choice((0.001, 0.002, 0.008, 0.05)))
        before = made.v.copy()
        made.tick(to_pose(goal), np.array(((0.2, 0.1, 0.3), (0.5, 0.0, 0.0))), dt_s)
        goal.translation = goal.translation + made.twist[0] * dt_s
        goal.rotation = pin.exp3(made.twist[1] * dt_s) @ goal.rotation
        assert (np.abs(made.v - before) <= ACCELERATION * dt_s * (1 + 1e-6)).all()
        assert (made.q <= made.kinematics.upper + 1e-5).all()
        assert (made.q >= made.kinematics.lower - 1e-5).all()


def test_a_step_that_would_strike_is_braked_whatever_the_program_says(monkeypatch):
    for module in (in_python, compiled):  # constraints without effect
        monkeypatch.setattr(
            module,
            "closing_decelerations",
            lambda options, bounds, collision: np.full(len(collision.pairs), 1e7),
        )
    start = (0, -90, 100, -100, -90, 0)
    probe = servo(q_deg=start)
    x = float(probe.placement.translation[0]) + 0.25
    thin = box_obstacle("wall", Vector3(x, -0.5, -0.2), Vector3(x + 0.0005, 0.5, 1.2))
    drive = Drive(servo(obstacles=(thin,), q_deg=start, safety_distance_m=1e-6))
    made = drive.servo
    goal = made.placement
    for _ in range(1000):
        before = made.v.copy()
        made.tick(to_pose(goal), np.array(((0.5, 0, 0), (0, 0, 0))), DT_S)
        goal.translation = goal.translation + made.twist[0] * DT_S
        if made.status().failures:
            break
    assert made.status().failures == 1
    slower = np.maximum(np.abs(before) - ACCELERATION * DT_S, 0.0)
    assert np.abs(made.v) == pytest.approx(slower, abs=1e-9)
