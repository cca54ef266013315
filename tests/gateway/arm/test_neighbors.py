"""Plausibility of a neighbor's joint states, and bounds of its motion, in virtual time."""

import math

import numpy as np
import pytest

from cardan.gateway.arm.neighbors import FASTEST, NS, NeighborBodies, NeighborWatch
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.robots import load_arm
from cardan.types import Pose, Quaternion, Vector3

MODEL = load_arm("ur5")
BODIES = NeighborBodies("right", MODEL, one_robot=True)
NAMES, HOME = MODEL.joint_names, MODEL.home
EPOCH_NS = 1_700_000_000 * NS


class Heard:
    """A watch whose computer shares a clock with the neighbor's."""

    def __init__(self, max_age_s=0.15):
        self.watch, self.now_s = NeighborWatch(BODIES, "/right/joint_states", max_age_s), 50.0

    def say(self, joints=HOME, speeds=(), names=NAMES, late_s=0.0, after_s=0.01, sender=b""):
        self.now_s += after_s
        now_ns = EPOCH_NS + int(self.now_s * NS)
        stamp_ns = now_ns - int(late_s * NS)
        self.watch.take(names, joints, speeds, stamp_ns, self.now_s, now_ns, sender)
        return self

    @property
    def fault(self):
        return self.watch.fault(self.now_s)


def test_nothing_is_known_before_the_first_state_and_after_the_last():
    heard = Heard()
    assert heard.fault == (
        "nothing was received from the neighbor right yet: start what publishes its joint states "
        "on /right/joint_states"
    )
    heard.say()
    assert not heard.fault
    heard.now_s += 0.13
    assert not heard.fault
    heard.now_s += 0.02
    assert heard.fault.startswith(
        "the position of the neighbor right was last known 0.2 s ago: start"
    )
    assert not heard.say().fault


def test_a_state_ages_from_its_stamp_on():
    heard = Heard().say(late_s=0.1)
    assert heard.watch.age_s(heard.now_s) == pytest.approx(0.11)
    heard.now_s += 0.05
    assert heard.fault


def test_names_are_sorted_and_further_joints_are_left():
    heard = Heard()
    names = ("finger", *reversed(NAMES))
    heard.say((7.0, *reversed(HOME)), names=names)
    assert heard.watch.joints == HOME


WRONG = {
    "joint states of other joints": {"names": tuple("abcdef")},
    "joint states without some of its joints": {"names": ("other", *NAMES[1:])},
    "joint states with a joint twice": {"names": (*NAMES, NAMES[0]), "joints": (*HOME, 0.0)},
    "joint states with other numbers of values than of joints": {"joints": HOME[:5]},
    "joint states that are not numbers": {"joints": (math.nan, *HOME[1:])},
    "joint states with speeds that no joint has": {"speeds": (1.01 * FASTEST, *HOME[1:])},
    "joint states outside the joints' ranges": {"joints": (90.0, *HOME[1:])},
    "joint states from the future": {"late_s": -0.02},
    "joint states that are old": {"late_s": 3600.0},
    "joint states with the stamp of earlier ones": {"late_s": 0.03},
}


@pytest.mark.parametrize("reason", WRONG)
def test_what_is_wrong_is_counted_and_refreshes_nothing(reason):
    heard = Heard().say().say()
    before = heard.watch.joints, heard.watch.speeds_m_s.tolist(), heard.watch.age_s(0.0)
    heard.say(**WRONG[reason])
    watch = heard.watch
    assert (watch.joints, watch.speeds_m_s.tolist(), watch.age_s(0.0)) == before
    assert dict(watch.refused) == {reason: 1}
    for _ in range(40):
        heard.say(**{**WRONG[reason], "late_s": WRONG[reason].get("late_s", 0.0)})
        if reason == "joint states with the stamp of earlier ones":
            break
    if reason != "joint states with the stamp of earlier ones":
        assert f": /right/joint_states has {reason}" in heard.fault


def test_a_speed_at_the_limit_is_taken():
    heard = Heard().say(speeds=(FASTEST, *HOME[1:]))
    assert (heard.watch.joints, dict(heard.watch.refused)) == (HOME, {})


def test_joints_that_are_missing_are_named_and_counted_as_one():
    heard = Heard()
    for missing in range(3):
        heard.say(names=tuple("x" if i == missing else each for i, each in enumerate(NAMES)))
    assert heard.watch.refused == {"joint states without some of its joints": 3}
    assert heard.fault.endswith(f"has joint states without some of its joints: {NAMES[2]}")


def test_of_two_publishers_nobody_knows_which_is_the_neighbor():
    heard = Heard().say(sender=b"one").say(sender=b"one")
    heard.say(joints=[0.3 + each for each in HOME], sender=b"two")
    assert heard.watch.joints == HOME
    for _ in range(30):
        assert heard.fault.startswith(
            "two nodes publish joint states of the neighbor right on /right/"
        )
        assert not math.isinf(heard.watch.speeds_m_s.max())
        heard.say(sender=b"one").say(sender=b"two")
    assert heard.watch.refused == {"joint states of a second publisher": 31}
    for _ in range(20):
        heard.say(sender=b"one")
    assert not heard.fault


def test_another_publisher_of_other_joints_is_no_second_and_a_new_one_follows_an_old():
    heard = Heard().say(sender=b"one")
    heard.say(names=("finger",), joints=(0.0,), sender=b"gripper").say(sender=b"one")
    assert not heard.fault
    heard.now_s += 0.2
    assert not heard.say(sender=b"begun again").fault


def test_speeds_that_are_not_numbers_are_refused():
    heard = Heard().say(speeds=(math.inf, *HOME[1:]))
    assert heard.watch.refused == {"joint states that are not numbers": 1}
    assert heard.fault


def test_a_stamp_that_stays_the_same_is_a_robot_that_is_frozen():
    heard = Heard().say()
    for step in range(20):
        heard.say(late_s=0.01 * (step + 1))
    assert heard.fault
    assert heard.watch.refused["joint states with the stamp of earlier ones"] > 5


def test_after_a_clock_was_set_back_states_count_again():
    heard = Heard().say()
    watch, now_s = heard.watch, heard.now_s
    for step in range(30):
        now_s += 0.01
        now_ns = EPOCH_NS - 3600 * NS + int(now_s * NS)
        watch.take(NAMES, HOME, (), now_ns, now_s, now_ns)
        if step == 8:
            assert watch.refused
    assert not watch.fault(now_s)


def test_one_state_alone_may_be_that_of_an_arm_as_fast_as_it_can():
    heard = Heard().say(speeds=(0.0,) * 6)
    assert (heard.watch.speeds_m_s == BODIES.fastest_m_s).all()
    assert (heard.say(speeds=(0.0,) * 6).watch.speeds_m_s == 0.0).all()


def test_speeds_are_the_larger_of_what_is_said_and_what_is_seen():
    velocities = np.full(6, 0.3)
    expected = BODIES.speeds_m_s(np.array(HOME), velocities)
    heard = Heard().say().say(speeds=tuple(velocities))
    assert heard.watch.speeds_m_s == pytest.approx(expected)
    there = np.array(HOME) + 0.01 * velocities
    liar = Heard().say().say(joints=tuple(there), speeds=(0.0,) * 6)
    assert liar.watch.speeds_m_s == pytest.approx(expected, rel=0.05)


def test_without_velocities_it_may_have_become_faster_since_halfway_between_two_states():
    """Starting from rest, with the expected acceleration, for 0.1 s."""
    heard, swing = Heard().say().say(), np.array((0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
    per_speed = BODIES.speeds_m_s(np.array(HOME), swing).max()
    acceleration = BODIES.gained_m_s(1.0).max() / per_speed
    heard.say(joints=HOME + 0.5 * acceleration * 0.1**2 * swing, after_s=0.1)
    real_m_s = BODIES.speeds_m_s(np.array(heard.watch.joints), 0.1 * acceleration * swing)
    assert (heard.watch.speeds_m_s >= real_m_s - 1e-6).all()
    assert heard.watch.speeds_m_s.max() == pytest.approx(real_m_s.max(), rel=1e-3)


@pytest.mark.parametrize("name", ["ur5", "pr2_left_arm", "teo_left_arm"])
def test_no_point_of_a_body_is_faster_than_its_speed_says(name):
    """Compared with differences of points sampled on the shapes; the bound is no larger than the
    fastest point."""
    model = load_arm(name)
    base = Pose(Vector3(0.3, -1.0, 0.2), Quaternion(0.6, 0.0, 0.8, 0.0))
    bodies, arm = NeighborBodies("it", model, base), ArmKinematics(model)
    generator = np.random.default_rng(1)
    for _ in range(30):
        q = generator.uniform(np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0))
        v = generator.uniform(-1.0, 1.0, len(q)) * arm.velocity
        speeds = bodies.speeds_m_s(q, v)
        assert (speeds <= bodies.fastest_m_s + 1e-9).all()
        frames = [bodies.frames(q + step * v) for step in (-1e-6, 1e-6)]
        for index, shape in enumerate(bodies.shapes):
            points = surface(shape.shape, generator)
            ways = [
                frame[index].rotation @ points + frame[index].translation[:, None]
                for frame in frames
            ]
            fastest = np.linalg.norm(ways[1] - ways[0], axis=0).max() / 2e-6
            assert fastest <= speeds[index] + 1e-5
            assert fastest >= 0.6 * speeds[index] - 1e-5


def surface(shape, generator):
    """Points on a shape in its frame, 3×n."""
    directions = generator.normal(size=(3, 400))
    directions /= np.linalg.norm(directions, axis=0)
    if hasattr(shape, "radius_m"):
        ends = np.array((shape.start, shape.end)).T
        return np.repeat(ends, 200, axis=1) + shape.radius_m * directions
    from cardan.robots.arm_bodies import to_se3

    at = to_se3(shape.pose)
    corners = np.sign(directions) * 0.5 * np.array(shape.size_m)[:, None]
    return at.rotation @ corners + at.translation[:, None]


def test_the_way_is_that_of_the_age_and_of_the_stop():
    speeds = np.full(len(MODEL.shapes) - 1, 0.5)
    fast, slow = (
        NeighborBodies("it", MODEL, acceleration_share=share, one_robot=True)
        for share in (1.0, 0.1)
    )
    way = fast.ways_m(speeds, 0.1)[0]
    assert way > 0.05
    assert slow.ways_m(speeds, 0.1)[0] > way
    # 2 m/s² for 0.1 s ends at 0.7 m/s, with a braking distance of 0.1225 m
    assert way == pytest.approx(0.07 + 0.1225)
    assert fast.ways_m(0.0 * speeds, 0.01)[0] == pytest.approx(0.0003)


def test_what_does_not_move_is_as_any_obstacle():
    placement = Pose(Vector3(1.0, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0))
    bodies = NeighborBodies("it", MODEL, placement)
    ways = bodies.ways_m(bodies.fastest_m_s, 0.1)
    assert [way == 0.0 for way in ways] == [shape.body == 0 for shape in bodies.shapes]


def test_of_one_robot_only_what_moves_is_taken_and_of_another_one_all():
    placement = Pose(Vector3(1.0, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0))
    fixed = [shape for shape in MODEL.shapes if shape.body == 0]
    assert fixed
    assert len(NeighborBodies("it", MODEL, placement).shapes) - len(BODIES.shapes) == len(fixed)
    assert BODIES.label("x") == "right's x"
