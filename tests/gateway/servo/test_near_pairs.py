"""Pairs of bodies that the compiled servo checks: leaving the others out changes nothing."""

import numpy as np
import pinocchio as pin
import pytest

from cardan.common.braking import stopping_speed
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel, box_obstacle
from cardan.gateway.servo import native
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import (
    MAX_ROWS,
    TIGHT_M_S,
    closing_decelerations,
    safety_distances,
)
from cardan.robots import BodyShape, Capsule, parse_urdf
from cardan.types import Vector3
from tests.servo_oracles import surroundings

BALL = BodyShape("ball", 1, Capsule(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.1), 0.08))


def words(numbers):
    return " ".join(f"{each:.6f}" for each in numbers)


def random_arm(rng):
    """An arm of 2 to 9 joints of any kind, some of them slow, with 0 to 3 shapes on each body."""
    parts, joints = [], int(rng.integers(2, 10))
    for body in range(joints + 1):
        shapes = ""
        for _ in range(int(rng.integers(0, 4))):
            size, at = rng.uniform(0.02, 0.15, 3), rng.uniform(-0.1, 0.2, 3)
            # Like a propeller, which comes near without a motion of its middle.
            if rng.random() < 0.3:
                size, at = np.array((0.02, rng.uniform(0.4, 1.0), 0.02)), 0.1 * at
            shape = (
                f'<box size="{words(size)}"/>'
                if rng.random() < 0.5
                else f'<cylinder radius="{size[0] / 2:.6f}" length="{size[1]:.6f}"/>'
            )
            origin = f'xyz="{words(at)}" rpy="{words(rng.normal(size=3))}"'
            shapes += f"<collision><origin {origin}/><geometry>{shape}</geometry></collision>"
        parts.append(f'<link name="l{body}">{shapes}</link>')
    for joint in range(joints):
        kind = rng.choice(("revolute", "revolute", "prismatic", "continuous"))
        fastest = rng.choice((0.07, 1.0, 5.0)) * (0.2 if kind == "prismatic" else 1.0)
        low, high = rng.uniform(-2.0, -0.1), rng.uniform(0.1, 2.0)
        reach = "" if kind == "continuous" else f'lower="{low:.6f}" upper="{high:.6f}"'
        axis = rng.normal(size=3)
        place = f'xyz="{words(rng.uniform(-0.15, 0.25, 3))}" rpy="{words(rng.normal(size=3))}"'
        parts.append(
            f'<joint name="j{joint}" type="{kind}"><parent link="l{joint}"/>'
            f'<child link="l{joint + 1}"/><origin {place}/><axis xyz="{words(axis)}"/>'
            f'<limit {reach} velocity="{fastest:.6f}" effort="9"/></joint>'
        )
    return parse_urdf(f'<robot name="any">{"".join(parts)}</robot>')


def distances_of(servo, q):
    """Distances and gradients of all pairs at `q`, computed by the kernel of `servo`."""
    count = len(servo.collision.pairs)
    distances, rows = np.zeros(count), np.zeros((count, servo.joints))
    pointer = native.POINTER(native.c_double)
    native.kernel_library().kernel_distances(
        servo._handle,
        native.numbers(q),
        distances.ctypes.data_as(pointer),
        rows.ctypes.data_as(pointer),
    )
    return distances, rows


class AllPairs:
    """Constraints and nearest pair of a servo's next tick, from the distances and gradients of all
    pairs."""

    def __init__(self, servo):
        self.servo, collision = servo, servo.collision
        self._other = CompiledServo(servo.kinematics, collision, servo.options)
        self._safety = np.array(safety_distances(servo.options, collision))
        self._decelerations = closing_decelerations(servo.options, servo.bounds, collision)

    def move(self, *moved):
        for each in (self.servo, self._other):
            each.move(*moved)

    def find(self, dt_s):
        """Number of constraints, their difference by rounding, and the remaining slack of the
        distances."""
        servo, n = self.servo, self.servo.joints
        count = len(servo.collision.pairs)
        distances, rows = distances_of(self._other, servo.q)
        low, high = np.zeros(n), np.zeros(n)
        servo.bounds.fill(servo.q.tolist(), servo.v.tolist(), dt_s, low, high)
        grown = np.array([servo.collision.grown_of(pair) for pair in range(count)])
        left = distances - grown
        may = [
            stopping_speed(room, deceleration, dt_s)
            for room, deceleration in zip(left - self._safety, self._decelerations, strict=True)
        ]
        room = np.maximum(rows, 0.0) @ low + np.minimum(rows, 0.0) @ high + may
        unclear = np.abs(room - TIGHT_M_S) < 1e-9
        return int((room < TIGHT_M_S).sum()), int(unclear.sum()), left


@pytest.mark.parametrize("seed", range(12))
def test_rows_and_nearest_pair_are_those_of_all_pairs(seed):
    """Random arms at random speeds among obstacles, one of which is moved."""
    rng = np.random.default_rng(seed)
    arm = ArmKinematics(random_arm(rng))
    collision = CollisionModel(arm, tuple(surroundings(rng)), movers=[(BALL,)])
    servo = CompiledServo(arm, collision, ServoOptions())
    every, counts = AllPairs(servo), set()
    low, high = np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0)
    for _ in range(12):
        servo.place(rng.uniform(low, high))
        servo.move_at(arm.velocity * rng.uniform(-1.0, 1.0, servo.joints) * rng.choice((0, 0.1, 1)))
        goal, dt_s = rng.uniform(low, high), float(rng.choice((0.004, 0.02)))
        at, twist = rng.uniform(-0.8, 0.8, 3), 0.3 * rng.normal(size=(2, 3))
        slides = rng.random() < 0.3
        for tick in range(40):
            frame = pin.SE3(np.eye(3), at + np.array((0.002 * tick, 0.0, 0.0)))
            every.move(0, [frame], [0.03])
            count, unclear, left = every.find(dt_s)
            if slides:
                servo.tick(servo.pose, twist, dt_s)
            else:
                servo.tick_joints(goal, np.zeros(servo.joints), dt_s)
            found = servo.status()
            assert abs(found.active_pairs - min(count, MAX_ROWS)) <= unclear
            assert found.distance_m - found.nearer_m == pytest.approx(left.min(), abs=1e-9)
            assert left[servo._state.nearest] == pytest.approx(left.min(), abs=1e-9)
            counts.add(found.active_pairs)
    assert len(counts) > 2  # constraints appear and disappear


@pytest.mark.parametrize("seed", range(6))
def test_what_was_nearest_before_changes_no_distance(seed):
    """A path in small steps, in large ones, and past bodies that overlap on the way."""
    rng = np.random.default_rng(seed)
    arm = ArmKinematics(random_arm(rng))
    collision = CollisionModel(arm, tuple(surroundings(rng)))
    servo = CompiledServo(arm, collision)
    q = rng.uniform(np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0))
    for _ in range(100):
        q = q + rng.normal(size=arm.joints) * rng.choice((1e-3, 1e-2, 0.3))
        distances, rows = distances_of(servo, q)
        expected, gradients = distances_of(CompiledServo(arm, collision), q)
        np.testing.assert_allclose(distances, expected, rtol=0.0, atol=1e-12)
        separated = expected > 1e-3
        np.testing.assert_allclose(rows[separated], gradients[separated], rtol=0.0, atol=1e-5)


PROPELLER = """<robot name="propeller"><link name="base"/><link name="bar"><collision><geometry>
<box size="1 0.04 0.04"/></geometry></collision></link><link name="end"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="bar"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="1" effort="9"/></joint>
<joint name="lift" type="prismatic"><parent link="bar"/><child link="end"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="9"/></joint></robot>"""


def test_a_body_that_turns_about_its_middle_comes_near():
    """The body's bounding ball does not move, and another body is nearer all the time."""
    hub = box_obstacle("hub", Vector3(-0.01, -0.01, 0.04), Vector3(0.01, 0.01, 0.06))
    post = box_obstacle("post", Vector3(-0.02, 0.4, -0.1), Vector3(0.02, 0.44, 0.1))
    kinematics = ArmKinematics(parse_urdf(PROPELLER))
    servo = CompiledServo(kinematics, CollisionModel(kinematics, (hub, post)), ServoOptions())
    servo.place(np.zeros(2))
    nearest = set()
    for _ in range(1000):
        servo.tick_joints(np.array((1.5, 0.0)), np.zeros(2), 0.004)
        nearest.add(servo.status().nearest_pair)
    assert servo.status().active_pairs == 1
    assert nearest == {("hub", "bar"), ("post", "bar")}
    assert servo.status().distance_m == pytest.approx(servo.options.safety_distance_m, abs=1e-4)
