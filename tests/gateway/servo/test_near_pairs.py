"""Which pairs of bodies the compiled servo looks at: whatever it leaves out changes nothing."""

import numpy as np
import pinocchio as pin
import pytest

from cardan.common.braking import stopping_speed
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo import native
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import (
    MAX_ROWS,
    TIGHT_M_S,
    closing_deceleration,
    safety_distances,
)
from cardan.robots import BodyShape, Capsule, parse_urdf
from cardan.types import Vector3
from tests.servo_oracles import surroundings

DT_S = 0.004
BALL = BodyShape("ball", 1, Capsule(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.1), 0.08))


def words(numbers):
    return " ".join(f"{each:.6f}" for each in numbers)


def random_arm(rng):
    """An arm of 2 to 9 joints of any kind, slow ones among them, 0 to 3 shapes on each body."""
    parts, joints = [], int(rng.integers(2, 10))
    for body in range(joints + 1):
        shapes = ""
        for _ in range(int(rng.integers(0, 4))):
            size = rng.uniform(0.02, 0.15, 3)
            shape = (
                f'<box size="{words(size)}"/>'
                if rng.random() < 0.5
                else f'<cylinder radius="{size[0] / 2:.6f}" length="{size[1]:.6f}"/>'
            )
            origin = f'xyz="{words(rng.uniform(-0.1, 0.2, 3))}" rpy="{words(rng.normal(size=3))}"'
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


class AllPairs:
    """Rows and nearest pair of a servo's next tick, of the distances and gradients of all pairs."""

    def __init__(self, servo):
        self.servo, collision = servo, servo.collision
        self._other = CompiledServo(servo.kinematics, collision, servo.options)
        self._safety = np.array(safety_distances(servo.options, collision))
        self._deceleration = closing_deceleration(servo.options, servo.bounds)

    def move(self, *moved):
        for each in (self.servo, self._other):
            each.move(*moved)

    def find(self):
        """How many rows, how many more or fewer by rounding, and what is left of distances."""
        servo, n = self.servo, self.servo.joints
        count = len(servo.collision.pairs)
        distances, rows = np.zeros(count), np.zeros((count, n))
        pointer = native.POINTER(native.c_double)
        native.kernel_library().kernel_distances(
            self._other._handle,
            native.numbers(servo.q),
            distances.ctypes.data_as(pointer),
            rows.ctypes.data_as(pointer),
        )
        low, high = np.zeros(n), np.zeros(n)
        servo.bounds.fill(servo.q.tolist(), servo.v.tolist(), DT_S, low, high)
        grown = np.array([servo.collision.grown_of(pair) for pair in range(count)])
        left = distances - grown
        may = [stopping_speed(each, self._deceleration, DT_S) for each in left - self._safety]
        room = np.maximum(rows, 0.0) @ low + np.minimum(rows, 0.0) @ high + may
        unclear = np.abs(room - TIGHT_M_S) < 1e-9
        return int((room < TIGHT_M_S).sum()), int(unclear.sum()), left


@pytest.mark.parametrize("seed", range(12))
def test_rows_and_nearest_pair_are_those_of_all_pairs(seed):
    """Random arms at random speeds among obstacles, one of which others move."""
    rng = np.random.default_rng(seed)
    arm = ArmKinematics(random_arm(rng))
    collision = CollisionModel(arm, tuple(surroundings(rng)), movers=[(BALL,)])
    servo = CompiledServo(arm, collision, ServoOptions())
    every, counts = AllPairs(servo), set()
    low, high = np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0)
    for _ in range(12):
        servo.place(rng.uniform(low, high))
        servo.move_at(arm.velocity * rng.uniform(-1.0, 1.0, servo.joints) * rng.choice((0, 0.1, 1)))
        goal, slow = rng.uniform(low, high), rng.choice((0.0, 0.1, 1.0))
        at, twist = rng.uniform(-0.8, 0.8, 3), 0.3 * rng.normal(size=(2, 3))
        for tick in range(25):
            frame = pin.SE3(np.eye(3), at + np.array((0.002 * tick, 0.0, 0.0)))
            every.move(0, [frame], [0.03])
            count, unclear, left = every.find()
            if tick % 5 < 3:
                servo.tick_joints(servo.q + slow * (goal - servo.q), np.zeros(servo.joints), DT_S)
            else:
                servo.tick(servo.pose, twist, DT_S)
            found = servo.status()
            assert abs(found.active_pairs - min(count, MAX_ROWS)) <= unclear
            assert found.distance_m - found.nearer_m == pytest.approx(left.min(), abs=1e-9)
            assert left[servo._state.nearest] == pytest.approx(left.min(), abs=1e-9)
            counts.add(found.active_pairs)
    assert len(counts) > 2  # Rows come and go.
