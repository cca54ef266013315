"""No motion beyond the request: at the ends of joint ranges, near bodies, near singularities."""

import math

import numpy as np
import pinocchio as pin
import pytest

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.servo import Servo
from cardan.robots import arm_names, load_arm
from tests.servo_oracles import surroundings

DT_S = 0.005
OFF_M, OFF_RAD = 0.005, math.radians(2.0)
"""Greatest motion beyond the request."""

FEW = ("ur5", "pr2_left_arm", 0, 1)
"""Arms and seeds that `make test` runs."""


def few_now(values):
    """`values`; those not in FEW run only in the test matrix."""
    return [
        each if each in FEW else pytest.param(each, marks=pytest.mark.matrix) for each in values
    ]


KINDS = pytest.mark.parametrize("kind", [Servo, CompiledServo], ids=["python", "compiled"])


def servo(kind, name, obstacles=None):
    kinematics = ArmKinematics(load_arm(name))
    collision = None if obstacles is None else CollisionModel(kinematics, obstacles)
    return kind(kinematics, collision, None, kinematics.arm.task.weights)


class Stream:
    """A stream of twists in base axes, and the TCP's deviation from the requested motion."""

    def __init__(self, made):
        self.servo, self.goal, self.start = made, made.placement, made.placement
        self.off_m = self.off_rad = 0.0

    def run(self, linear, angular, seconds):
        """Run for a time, or until the arm no longer moves."""
        made, goal = self.servo, self.goal
        for tick in range(round(seconds / DT_S)):
            ramp = min(1.0, (tick + 1) * DT_S / 0.1)
            made.tick(to_pose(goal), (ramp * linear, ramp * angular), DT_S, slide=True)
            goal.translation = goal.translation + made.twist[0] * DT_S
            goal.rotation = pin.exp3(made.twist[1] * DT_S) @ goal.rotation
            if tick % 10 == 0:
                self._note(linear, angular)
                if tick > 50 and not made.moving and np.abs(made.twist).max() < 1e-9:
                    break

    def _note(self, linear, angular):
        here = self.servo.placement
        moved = here.translation - self.start.translation
        turned = here.rotation @ self.start.rotation.T
        if linear.any():
            line = linear / np.linalg.norm(linear)
            moved = moved - line * (line @ moved)
        if angular.any():
            axis = angular / np.linalg.norm(angular)
            x, y, z, w = pin.Quaternion(turned).coeffs()
            about = 2.0 * math.atan2(axis @ (x, y, z), w)
            turned = turned @ pin.exp3(-about * axis)
        self.off_m = max(self.off_m, float(np.linalg.norm(moved)))
        self.off_rad = max(self.off_rad, float(np.linalg.norm(pin.log3(turned))))


def near(made, joint, side, distance=0.2):
    """Home position with one joint near an end of its range."""
    lower, upper = made.kinematics.lower[joint], made.kinematics.upper[joint]
    q = np.array(made.kinematics.arm.home)
    q[joint] = (upper if side > 0 else lower) - side * min(distance, 0.1 * (upper - lower))
    made.place(q)
    made.kinematics.update(q)


def ends(made):
    """Every joint with a limited range, with both ends."""
    return [
        (joint, side)
        for joint in np.flatnonzero(np.isfinite(made.kinematics.upper)).tolist()
        for side in (-1, 1)
    ]


def into(made, joint, side, axis, speed):
    """A twist along or about an axis of the TCP that moves `joint` toward the end of its range."""
    kinematics, own = made.kinematics, np.zeros(6)
    own[axis] = speed
    rate = np.linalg.pinv(kinematics.jacobian, rcond=1e-3) @ own
    if rate[joint] * side < 0.0:
        own = -own
    rotation = kinematics.placement.rotation
    return rotation @ own[:3], rotation @ own[3:]


@KINDS
@pytest.mark.parametrize(
    ("name", "speed_rad_s"),
    [("ur5", 0.5), ("ur5", 0.1), ("ur5e", 0.2), ("gofa_crb15000_5", 0.2)],
)
def test_a_turn_ends_at_the_end_of_the_last_joint_which_is_named_and_left_at_once(
    kind, name, speed_rad_s
):
    made = servo(kind, name)
    last = made.joints - 1
    near(made, last, 1)
    linear, angular = into(made, last, 1, 5, speed_rad_s)
    stream = Stream(made)
    stream.run(linear, angular, 8.0)
    assert stream.off_m <= OFF_M
    assert stream.off_rad <= OFF_RAD
    status = made.status()
    assert status.limiting_joints == (made.kinematics.names[last],)
    assert any(made.kinematics.names[last] in words for words in status.in_words())
    before = made.q[last]
    stream.run(linear, -angular, 0.5)
    assert before - made.q[last] > 0.8 * speed_rad_s * 0.45
    made.brake(DT_S)
    while made.moving:
        made.brake(DT_S)
    assert made.status().limiting_joints == ()


@KINDS
def test_translation_goes_on_where_only_the_turn_is_at_its_end(kind):
    made = servo(kind, "ur5")
    near(made, 5, 1)
    _, angular = into(made, 5, 1, 5, 0.5)
    stream = Stream(made)
    linear = np.array((0.0, 0.0, 0.05))
    stream.run(linear, angular, 3.0)
    assert stream.off_m <= OFF_M
    assert stream.off_rad <= OFF_RAD
    moved = made.placement.translation - stream.start.translation
    assert moved[2] > 0.95 * 0.05 * 2.95
    assert made.kinematics.upper[5] - made.q[5] < 0.02


@pytest.mark.matrix("slow-ur5", "fast-pr2_left_arm")
@pytest.mark.parametrize("name", few_now(arm_names()))
@pytest.mark.parametrize(
    ("speed_m_s", "speed_rad_s"), [(0.03, 0.1), (0.1, 0.5)], ids=["slow", "fast"]
)
def test_every_twist_into_every_end_of_a_range_stays_on_its_line(name, speed_m_s, speed_rad_s):
    made = servo(CompiledServo, name)
    turns = made.kinematics.arm.task.weights[3:] == (1.0, 1.0, 1.0)
    for joint, side in ends(made):
        for axis in (joint % 3, 3 + (joint + 1) % 3) if turns else (joint % 3,):
            near(made, joint, side)
            stream = Stream(made)
            twist = into(made, joint, side, axis, speed_m_s if axis < 3 else speed_rad_s)
            stream.run(*twist, 8.0)
            what = made.kinematics.names[joint], side, axis
            assert stream.off_m <= OFF_M, what
            assert not turns or stream.off_rad <= OFF_RAD, what
    assert made.status().failures == 0


@pytest.mark.parametrize("name", few_now(arm_names()))
def test_the_servo_in_python_stays_on_the_line_into_every_end(name):
    made = servo(Servo, name)
    turns = made.kinematics.arm.task.weights[3:] == (1.0, 1.0, 1.0)
    for joint, side in ends(made):
        near(made, joint, side, distance=0.1)
        stream = Stream(made)
        axis = joint % (6 if turns else 3)
        stream.run(*into(made, joint, side, axis, 0.1 if axis < 3 else 0.5), 2.0)
        assert stream.off_m <= OFF_M, (joint, side)
        assert not turns or stream.off_rad <= OFF_RAD, (joint, side)


@pytest.mark.parametrize("around", ["nothing", "itself", "obstacles"])
@pytest.mark.parametrize("seed", few_now(range(8)))
def test_from_any_posture_nothing_is_added_to_what_is_asked(seed, around):
    """A blocked translation slides along the obstacle without rotation; a blocked rotation stays in
    place."""
    generator = np.random.default_rng(seed)
    names = [n for n in arm_names() if min(load_arm(n).task.weights) == 1.0]
    shapes = {"nothing": None, "itself": (), "obstacles": tuple(surroundings(generator))}
    tried = 0
    for attempt in range(4000):
        if attempt % 200 == 0:
            made = servo(CompiledServo, generator.choice(names), shapes[around])
            kinematics = made.kinematics
            lower = np.where(kinematics.continuous, -3.0, kinematics.lower)
            upper = np.where(kinematics.continuous, 3.0, kinematics.upper)
        q = generator.uniform(lower, upper)
        joint = generator.integers(made.joints)
        q[joint] = generator.choice((lower[joint] + 0.1, upper[joint] - 0.1))
        made.place(q)
        made.tick(made.pose, np.zeros((2, 3)), DT_S)
        status = made.status()
        if status.distance_m < 0.02 or status.smallest_singular_value < 0.06:
            continue
        direction = generator.normal(size=3)
        direction /= np.linalg.norm(direction)
        stream, still = Stream(made), np.zeros(3)
        if tried % 2:
            stream.run(0.1 * direction, still, 8.0)
        else:
            stream.run(still, 0.3 * direction, 8.0)
        if around == "nothing" or not tried % 2:
            assert stream.off_m <= OFF_M
        assert stream.off_rad <= OFF_RAD
        tried += 1
        if tried == 2:
            return
    pytest.fail("no posture is free of what is around")
