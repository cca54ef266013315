"""Distances and their gradients, and a sweep that detects even thin walls."""

import math

import numpy as np
import pinocchio as pin
import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.kinematics import collision as module
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import (
    CollisionModel,
    HalfSpace,
    Obstacle,
    box_obstacle,
)
from cardan.robots import BodyShape, Capsule, JointKind, OrientedBox, load_arm
from cardan.types import Pose, Quaternion, Vector3

FLOOR = Obstacle("floor", HalfSpace(Vector3(0.0, 0.0, 1.0), -0.4))
POST = Obstacle("post", Capsule(Vector3(0.6, 0.5, -0.2), Vector3(0.6, 0.5, 0.9), 0.05))
WALL = box_obstacle("wall", Vector3(0.7, -0.6, -0.3), Vector3(0.705, 0.6, 1.2))
BALL = Obstacle("ball", Capsule(Vector3(-0.5, 0.0, 0.9), Vector3(-0.5, 0.0, 0.9), 0.1))


def world(name="ur5", obstacles=(FLOOR, POST, WALL, BALL), tool=()):
    kinematics = ArmKinematics(load_arm(name))
    return kinematics, CollisionModel(kinematics, obstacles, tool)


def segment_distance(p, q, a, b):
    """Distance between the segments p-q and a-b, by brute force over both parameters."""
    s = np.linspace(0.0, 1.0, 401)
    one = p + np.outer(s, q - p)
    two = a + np.outer(s, b - a)
    return np.sqrt(((one[:, None, :] - two[None, :, :]) ** 2).sum(axis=2).min())


@pytest.mark.parametrize("name", ["ur5", "gofa_crb15000_5", "amor"])
def test_distances_of_capsules_equal_brute_force(name):
    kinematics, collision = world(name, (POST,))
    shapes = [s for s in kinematics.arm.shapes if isinstance(s.shape, Capsule) and s.body > 0]
    post = POST.shape
    generator = np.random.default_rng(0)
    for _ in range(5):
        q = generator.uniform(np.maximum(kinematics.lower, -3), np.minimum(kinematics.upper, 3))
        distances = dict(zip(collision.pairs, collision.at(q), strict=True))
        kinematics.update(q)
        for shape in shapes:
            body = kinematics._data.oMi[shape.body]
            ends = [body.act(np.array(end)) for end in shape.shape[:2]]
            expected = segment_distance(*ends, np.array(post.start), np.array(post.end))
            expected -= shape.shape.radius_m + post.radius_m
            named = [p for p in collision.pairs if set(p) == {shape.name, "post"}]
            if len(named) == 1 and expected > 0.0:
                assert distances[named[0]] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("name", ["ur5", "pr2_right_arm", "gp8", "asibot"])
def test_gradients_equal_differences(name):
    kinematics, collision = world(name)
    pairs = list(range(len(collision.pairs)))
    gradients = np.zeros((len(pairs), kinematics.joints))
    generator = np.random.default_rng(1)
    wrong = 0
    for _ in range(40):
        q = generator.uniform(np.maximum(kinematics.lower, -3), np.minimum(kinematics.upper, 3))
        kinematics.update(q)
        collision.update()
        collision.gradients(pairs, gradients)
        step = generator.normal(size=kinematics.joints)
        step *= 1e-6 / np.linalg.norm(step)
        ahead, behind = np.array(collision.at(q + step)), np.array(collision.at(q - step))
        wrong += int((np.abs(0.5 * (ahead - behind) - gradients @ step) > 1e-9).sum())
    # The distance has no derivative if the nearest feature changes within the step.
    assert wrong <= 0.01 * 40 * len(pairs)


def test_neighbors_and_ignored_pairs_are_left_out_and_obstacles_meet_every_body():
    kinematics, collision = world("ur5", (FLOOR,))
    bodies = {shape.name: shape.body for shape in kinematics.arm.shapes}
    for first, second in collision.pairs:
        if "floor" in (first, second):
            continue
        low, high = sorted((bodies[first], bodies[second]))
        assert high - low > 1
        assert (low, high) not in kinematics.arm.ignored_pairs
    moved = {shape.name for shape in kinematics.arm.shapes if shape.body > 0}
    assert {p for pair in collision.pairs if "floor" in pair for p in pair} == moved | {"floor"}


def test_home_is_free_and_the_nearest_pair_is_named():
    kinematics, collision = world("ur5", (WALL,))
    home = np.array(kinematics.arm.home)
    kinematics.update(home)
    distances = collision.update()
    nearest = collision.closest()
    assert nearest.distance_m == min(distances) > 0.0
    assert nearest.names == collision.pairs[distances.index(min(distances))]


def test_a_tool_is_part_of_the_last_body():
    long = Capsule(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.2), 0.02)
    bare_kinematics, bare = world("ur5", (WALL,))
    _, tooled = world("ur5", (WALL,), (BodyShape("pen", 6, long),))
    home = np.array(bare_kinematics.arm.home)
    with_pen = dict(zip(tooled.pairs, tooled.at(home), strict=True))
    assert any("pen" in pair for pair in with_pen)
    assert all("pen" not in pair for pair in bare.pairs)


def test_a_thin_wall_is_found_however_far_the_jump():
    kinematics, collision = world("ur5", (WALL,))
    home = np.array(kinematics.arm.home)
    beyond = home.copy()
    before = kinematics.forward(home).translation[0]
    beyond[1:3] += 0.9, -0.9  # the arm leans forward and stretches, through the wall
    assert before < 0.7 < kinematics.forward(beyond).translation[0]
    share, pair = collision.free_share(home, beyond, 0.01)
    assert 0.0 < share < 1.0
    assert "wall" in pair
    stop = dict(zip(collision.pairs, collision.at(home + share * (beyond - home)), strict=True))
    # The search stops when a sample gains less than a thousandth: near the margin, never beyond.
    assert 0.01 - 1e-9 <= stop[pair] < 0.02
    assert collision.free_share(home, home, 0.01) == (1.0, None)
    assert collision.free_share(home, home - 0.02, 0.01) == (1.0, None)


def test_the_sweep_bounds_what_any_motion_does_to_any_distance():
    kinematics, collision = world("pr2_right_arm")
    generator = np.random.default_rng(4)
    low = np.where(kinematics.continuous, -math.pi, kinematics.lower)
    high = np.where(kinematics.continuous, math.pi, kinematics.upper)
    for _ in range(60):
        q = generator.uniform(low, high)
        step = generator.normal(size=kinematics.joints) * generator.choice((0.01, 0.3))
        change = np.array(collision.at(q)) - np.array(collision.at(q + step))
        assert (change <= collision.sweep(step) + 1e-6).all()


def test_a_pair_that_is_too_near_already_may_only_part():
    kinematics, collision = world("ur5", (WALL,))
    home = np.array(kinematics.arm.home)
    beyond = home.copy()
    beyond[1:3] += 0.9, -0.9
    share, _ = collision.free_share(home, beyond, 0.01)
    at_wall = home + share * (beyond - home)
    assert collision.free_share(at_wall, home, 0.05) == (1.0, None)
    assert collision.free_share(at_wall, beyond, 0.05)[0] < 0.05


def nested(generator, body):
    """Shapes of a body, each with smaller ones inside, and each of these twice."""
    found = []
    for number in range(4):
        at = Vector3(*generator.uniform(-0.1, 0.1, 3))
        pose = Pose(at, Quaternion(*(each / 2.0 for each in generator.choice((-1.0, 1.0), 4))))
        outer = OrientedBox(pose, tuple(generator.uniform(0.12, 0.2, 3)))
        if number % 2:
            outer = Capsule(at, at._replace(x=at.x + 0.1), 0.12)
        inner = OrientedBox(pose, (0.04, 0.05, 0.06)), Capsule(at, at._replace(y=at.y + 0.01), 0.02)
        found += [BodyShape(f"inner {number}", body, shape) for shape in inner]
        found += [BodyShape(f"outer {number}", body, outer) for _ in range(2)]
    return found


def test_a_shape_inside_another_of_its_body_is_left_out_and_no_distance_is_larger(monkeypatch):
    generator = np.random.default_rng(7)
    tool, movers = nested(generator, 6), [nested(generator, 1), nested(generator, 1)]
    kinematics = ArmKinematics(load_arm("ur5"))
    ignored = {("outer 0", "wrist_1_link")}

    def made():
        return CollisionModel(kinematics, (POST, WALL), tool, movers, ignored)

    fewer = made()
    monkeypatch.setattr(module, "_without_inner", lambda pairs, *_: pairs)
    every = made()
    assert 4 * len(fewer.pairs) < len(every.pairs)
    of_wrist = {pair[0] for pair in fewer.pairs if pair[1] == "wrist_1_link"}
    # The wrist ignores the shape around this one.
    assert "inner 0" in of_wrist
    assert not of_wrist & {"inner 1", "inner 2", "inner 3"}

    def nearest(collision, q):
        """Least distance between each pair of bodies."""
        first = len(kinematics.arm.shapes) + len(tool)
        owners = [each.body for each in collision.solids[:first]]
        owners += ["post", "wall", *("one",) * len(movers[0]), *("other",) * len(movers[1])]
        found = {}
        for distance, (one, other) in zip(collision.at(q), collision.pair_solids, strict=True):
            key = owners[one], owners[other]
            found[key] = min(found.get(key, math.inf), distance)
        return found

    frames = [pin.SE3(pin.exp3(generator.normal(size=3)), generator.normal(size=3)) for _ in movers]
    for collision in (fewer, every):
        per_shape = [frame for frame, shapes in zip(frames, movers, strict=True) for _ in shapes]
        collision.move(0, per_shape, [0.0] * len(per_shape))
    for _ in range(20):
        q = generator.uniform(-3.0, 3.0, 6)
        one, other = nearest(fewer, q), nearest(every, q)
        assert one.keys() == other.keys()
        for key, distance in other.items():
            # The depth of an overlap may differ for the outer shape.
            expected = distance if distance > 0.0 else min(one[key], 1e-6)
            assert one[key] == pytest.approx(expected, abs=1e-6)


def test_what_a_half_space_or_an_obstacle_holds_is_still_kept_away_from():
    crate = box_obstacle("crate", Vector3(0.5, 0.5, -2.0), Vector3(0.6, 0.6, -1.0))
    around = box_obstacle("around", Vector3(-1.0, -1.0, -1.0), Vector3(1.0, 1.0, 1.0))
    kinematics, collision = world("ur5", (FLOOR, crate, around))
    moved = {shape.name for shape in kinematics.arm.shapes if shape.body > 0}
    for name in ("floor", "crate"):
        assert {p for pair in collision.pairs if name in pair for p in pair} == moved | {name}
    assert set(world("ur5", ())[1].pairs) <= set(collision.pairs)


@pytest.mark.parametrize(("lower", "upper"), [(-0.1, 0.5), (-0.5, 0.1)])
def test_a_sliding_joint_reaches_as_far_as_its_longer_end(lower, upper):
    arm = load_arm("ur5")
    slide = arm.joints[3]._replace(kind=JointKind.PRISMATIC, lower=lower, upper=upper)
    fixed = slide._replace(lower=0.0, upper=0.0)
    near, far = (
        module.reach_of(arm._replace(joints=(*arm.joints[:3], joint, *arm.joints[4:])), arm.shapes)
        for joint in (fixed, slide)
    )
    beyond = [column for column, shape in enumerate(arm.shapes) if shape.body > 3]
    assert (far[3, beyond] == 1.0).all()
    np.testing.assert_allclose(far[:3, beyond], near[:3, beyond] + 0.5)


def test_a_box_needs_its_corners_in_order():
    with pytest.raises(ConfigurationError, match=r"lowest corner .* first"):
        box_obstacle("crate", Vector3(0.0, 0.0, 0.0), Vector3(0.1, -0.1, 0.1))
