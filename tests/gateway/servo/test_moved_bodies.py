"""Bodies moved by others: their places in both servos, and the distances kept from them."""

import math

import numpy as np
import pinocchio as pin
import pytest

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel, Obstacle, box_obstacle
from cardan.gateway.servo import native
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import Servo
from cardan.robots import BodyShape, Capsule, OrientedBox, load_arm
from cardan.types import Pose, Quaternion, Vector3

DT_S = 0.004
OTHER = load_arm("ur5")
BRICK = BodyShape(
    "brick",
    1,
    OrientedBox(Pose(Vector3(0.1, 0.0, 0.02), Quaternion(1.0, 0.0, 0.0, 0.0)), (0.2, 0.1, 0.3)),
)


def made(kind, movers, obstacles=()):
    kinematics = ArmKinematics(load_arm("ur5"))
    return kind(kinematics, CollisionModel(kinematics, obstacles, movers=[movers]))


def compiled_distances(servo, q):
    count, n = len(servo.collision.pairs), servo.joints
    distances, gradients = np.zeros(count), np.zeros(count * n)
    pointer = native.POINTER(native.c_double)
    native.kernel_library().kernel_distances(
        servo._handle,
        native.numbers(q),
        distances.ctypes.data_as(pointer),
        gradients.ctypes.data_as(pointer),
    )
    return distances


def test_moved_bodies_are_where_pinocchio_and_coal_have_them():
    """Compared with one model of both arms, whose joints move all shapes."""
    generator = np.random.default_rng(3)
    movers = (*OTHER.shapes, BRICK)
    servo = made(CompiledServo, movers)
    twin = made(Servo, movers)
    other = ArmKinematics(OTHER)
    base = pin.SE3(pin.exp3(np.array((0.2, -0.3, 2.0))), np.array((0.7, 0.2, 0.1)))
    own = len(servo.collision.kinematics.arm.shapes)
    for _ in range(20):
        q, p = generator.uniform(-3.0, 3.0, (2, 6))
        other.update(p)
        frames = [base * other._data.oMi[shape.body] for shape in movers]
        for each in (servo, twin):
            each.move(0, frames, [0.0] * len(frames))
        expected = []
        for first, second in servo.collision.pair_solids:
            if first < own:
                continue
            servo.kinematics.update(q)
            expected.append(
                coal_distance(
                    (movers[first - own].shape, frames[first - own]),
                    (
                        servo.collision.solids[second].shape,
                        servo.kinematics._data.oMi[servo.collision.solids[second].body],
                    ),
                )
            )
        theirs = [first >= own for first, _ in servo.collision.pair_solids]
        assert np.array(twin.collision.at(q))[theirs] == pytest.approx(expected, abs=1e-9)
        found = compiled_distances(servo, q)[theirs]
        separated = np.array(expected) > 0.0
        assert separated.any()
        assert found[separated] == pytest.approx(np.array(expected)[separated], abs=1e-6)


def coal_distance(one, other):
    """Signed distance between two shapes in their frames, computed by Coal alone."""
    import coal

    from cardan.robots.arm_bodies import coal_shape

    placed = []
    for shape, frame in (one, other):
        geometry, local = coal_shape(shape)
        at = frame * local
        placed += [geometry, coal.Transform3s(at.rotation, at.translation)]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    return coal.distance(*placed, request, result)


BALL = Capsule(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.0), 0.05)


def driven_at(kind, grown_m, mover=True):
    """Remaining distance of the TCP's bodies after driving at a ball."""
    movers = (BodyShape("ball", 0, BALL),) if mover else ()
    servo = made(kind, movers)
    servo.place(np.array(OTHER.home))
    start = servo.placement
    ahead = start.translation + np.array((0.0, 0.0, -0.45))
    obstacle = pin.SE3(np.eye(3), ahead)
    if mover:
        servo.move(0, [obstacle], [grown_m])
    else:
        at = Vector3(*ahead)
        servo = made(kind, (), (Obstacle("ball", Capsule(at, at, 0.05)),))
        servo.place(np.array(OTHER.home))
    goal = servo.pose
    nearest, collision = math.inf, servo.collision
    balls = [pair for pair, names in enumerate(collision.pairs) if "ball" in names]
    if mover:
        collision.move(0, [obstacle], [grown_m])
    for _ in range(700):
        share = servo.tick(goal, np.array(((0.0, 0.0, -0.25), (0.0, 0.0, 0.0))), DT_S)
        position = goal.position
        goal = goal._replace(position=position._replace(z=position.z - share * 0.25 * DT_S))
        distances = collision.at(servo.q)
        nearest = min(nearest, *(distances[pair] for pair in balls))
    return nearest, servo.q.copy()


@pytest.mark.parametrize("kind", [CompiledServo, Servo])
@pytest.mark.parametrize("grown_m", [0.0, 0.03, 0.2])
def test_they_are_kept_farther_away_by_what_is_asked(kind, grown_m):
    nearest, _ = driven_at(kind, grown_m)
    assert nearest == pytest.approx(0.01 + grown_m, abs=2e-3)


@pytest.mark.parametrize("kind", [CompiledServo, Servo])
def test_at_rest_they_are_as_any_obstacle(kind):
    assert (driven_at(kind, 0.0)[1] == driven_at(kind, 0.0, mover=False)[1]).all()


@pytest.mark.parametrize("kind", [CompiledServo, Servo])
def test_one_that_comes_nearer_moves_no_arm_at_rest(kind):
    servo = made(kind, (BodyShape("ball", 0, BALL),))
    servo.place(np.array(OTHER.home))
    before, goal = servo.q.copy(), servo.pose
    for step in range(100):
        at = servo.placement.translation + np.array((0.0, 0.0, 0.5 - 0.005 * step))
        servo.move(0, [pin.SE3(np.eye(3), at)], [0.05])
        servo.tick(goal, np.zeros((2, 3)), DT_S)
        assert np.abs(servo.q - before).max() < 1e-9
    assert servo.status().distance_m < 0.0


def turned(values):
    return pin.SE3(np.array(values, dtype=float).reshape(3, 3), np.zeros(3))


@pytest.mark.parametrize(
    ("frame", "grown_m"),
    [
        (pin.SE3(np.eye(3), np.array((0.0, math.nan, 0.0))), 0.0),
        (pin.SE3(np.eye(3), np.array((0.0, 1e10, 0.0))), 0.0),
        (turned((1, 0, 0, 0, 1, 0, 0, 0, -1)), 0.0),
        (pin.SE3.Identity(), -0.001),
        (pin.SE3.Identity(), math.inf),
        (pin.SE3.Identity(), math.nan),
    ],
)
def test_the_kernel_takes_no_placement_that_is_none(frame, grown_m):
    servo = made(CompiledServo, (BodyShape("ball", 0, BALL),))
    q = np.array(OTHER.home)
    servo.move(0, [pin.SE3(np.eye(3), np.array((1.0, 0.0, 0.0)))], [0.0])
    before = compiled_distances(servo, q)
    with pytest.raises(ValueError, match="placements must be finite"):
        servo.move(0, [frame], [grown_m])
    assert (compiled_distances(servo, q) == before).all()


@pytest.mark.parametrize("name", ["ur5", "pr2_right_arm"])
def test_what_is_not_looked_at_is_farther_away(name):
    """A pair that was far away is checked again before it can have come near: in fast and slow
    motion, after a jump, and with a moved body."""
    kinematics = ArmKinematics(load_arm(name))
    wall = box_obstacle("wall", Vector3(-2.0, -2.0, -0.5), Vector3(2.0, -0.45, 0.9))
    ball = BodyShape("ball", 1, Capsule(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.0), 0.1))
    collision = CollisionModel(kinematics, (wall,), movers=[(ball,)])
    servo, afresh = (CompiledServo(kinematics, collision, ServoOptions()) for _ in range(2))
    rng, home = np.random.default_rng(5), np.array(kinematics.arm.home)
    joints, rows = len(home), set()
    for part in range(6):
        if part % 3 == 0:
            servo.place(home + rng.uniform(-0.2, 0.2, joints))
        goal = home + rng.uniform(-1.2, 1.2, joints)
        for tick in range(100):
            at = np.array((0.8, -0.2, 0.6 + 0.3 * math.sin(0.05 * tick)))
            for each in (servo, afresh):
                each.move(0, [pin.SE3(np.eye(3), at)], [0.02])
            afresh.place(servo.q.copy())
            afresh.move_at(servo.v.copy())
            for each in (servo, afresh):
                each.tick_joints(goal, np.zeros(joints), DT_S)
            found, true = servo.status(), afresh.status()
            assert found.active_pairs == true.active_pairs
            assert found.nearest_pair == true.nearest_pair
            assert found.distance_m == pytest.approx(true.distance_m, abs=1e-9)
            assert servo.q == pytest.approx(afresh.q, abs=1e-9)
            rows.add(found.active_pairs)
    assert len(rows) > 3  # constraints appear and disappear
