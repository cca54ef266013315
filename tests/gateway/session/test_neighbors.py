"""Two arms that avoid each other, in virtual time: the controllers of two sessions on simulated
arms, each of which receives the other arm's joint states."""

import json
import math
import re

import numpy as np
import pinocchio as pin
import pytest

from cardan.bus.node import Received
from cardan.common.native import NativePartError
from cardan.errors import CollisionError, ConfigurationError
from cardan.gateway.arm.neighbors import NS
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.arm.status import Phase
from cardan.gateway.bus.neighbors import MAX_BYTES, MESSAGES_AT_ONCE
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo import choice
from cardan.gateway.session.arm_assembly import (
    disagreements,
    make_neighbor_bodies,
    make_neighbors,
)
from cardan.gateway.session.assembly import make_controller, make_robot, make_verbs
from cardan.gateway.session.cautions import cautions
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.scene import scene_of
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.names import dds_type
from cardan.protocols.ros2.zenoh import Attachment
from cardan.recording.verify import REPEATED
from cardan.robots import load_arm
from cardan.robots.arm_bodies import to_se3
from cardan.types import IDENTITY, DeviceLink, DeviceState, Pose
from tests.robots.test_arm_tree import TREE, WHOLE, put

STATE = "sensor_msgs/msg/JointState"
KEY = f"0/joint_states/{dds_type(STATE)}/hash"
PERIOD_S = 0.01
EPOCH_NS = 1_700_000_000 * NS
SAFETY_M = 0.02
REST = (0.0,) * 6


FACING = {"base_xyz_m": [1.4, 0.0, 0.0], "base_rpy_deg": [0.0, 0.0, 180.0]}
"""Two arms of a cell, facing each other: both approach along their own x."""


def table(own="ur5", other="ur5", name="right", neighbor=FACING, **more):
    neighbor = {
        "name": name,
        "model": other,
        "topic": f"/{name}/joint_states",
        **neighbor,
    }
    return {
        "device": {"driver": "spacemouse"},
        "robot": {
            "driver": "sim_arm",
            "robot": own,
            "pacing": "virtual",
            "drive": "ideal",
            "period_s": PERIOD_S,
        },
        "arm": {"model": own, "safety_distance_m": SAFETY_M},
        "limits": {"linear_speed_m_s": 0.25, "linear_acceleration_m_s2": 1.0},
        "mapping": {"linear_speed_m_s": 0.25, "deadman": "left"},
        "network": {},
        "neighbors": [neighbor],
        **more,
    }


FACED = table()["neighbors"][0]


class Topic:
    """A topic of joint states, whose messages are delayed."""

    def __init__(self, names):
        self._names, self._codec = names, codec_of(STATE)
        self._waiting, self._there = [], []

    def say(self, joints, velocities=(), *, stamp_s, at_s, names=None, key=KEY, sender=None):
        stamp_ns = EPOCH_NS + round(stamp_s * NS)
        message = default_message(STATE) | {
            "header": {"stamp": {"sec": stamp_ns // NS, "nanosec": stamp_ns % NS}, "frame_id": ""},
            "name": list(names or self._names),
            "position": list(joints),
            "velocity": list(velocities),
        }
        attachment = None if sender is None else Attachment(1, stamp_ns, sender)
        self._waiting.append((at_s, Received(self._codec.encode(message), key, attachment, None)))

    def junk(self, data, at_s):
        self._waiting.append((at_s, Received(data, KEY, None, None)))

    def arrive(self, now_s):
        self._there += [each for at_s, each in self._waiting if at_s <= now_s]
        del self._there[:-MESSAGES_AT_ONCE]
        self._waiting = [each for each in self._waiting if each[0] > now_s]

    def poll(self):
        return self._there.pop(0) if self._there else None


class Session:
    """Session of an arm without its process and network: a scripted device, and a topic."""

    def __init__(self, **config):
        self.config = parse_config(table(**config))
        self.robot = make_robot(self.config)
        self.core = make_controller(self.config, self.robot)
        self.neighbors = make_neighbors(self.config, self.robot, self.core)
        self.topic = Topic(load_arm(self.config.neighbors[0].model).joint_names)
        self.neighbors._subscriptions = [self.topic]
        self.robot.open()
        self.cycles = self.robot.cycles()
        self.state = None
        self.core.inhibit(self.neighbors.turn(0.0), Inhibit.WHILE_SAID)

    def cycle(self, axes=REST, held=True):
        self.state = state = next(self.cycles)
        hand = DeviceState(
            state.stamp_s, DeviceLink.LIVE, axes, frozenset(("left",) if held else ())
        )
        self.robot.send(self.core.tick(state, hand))
        now_s = state.stamp_s
        self.topic.arrive(now_s)
        self.neighbors.hear(now_s, EPOCH_NS + round(now_s * NS))
        self.core.inhibit(self.neighbors.turn(now_s), Inhibit.WHILE_SAID)

    @property
    def q(self):
        return np.array(self.state.joints)

    @property
    def message(self):
        return self.core.status().message


class Between:
    """True distance between two arms of one robot, computed by Coal."""

    def __init__(self, session):
        self._bodies = session.core.commanded.neighbors[0]
        own = ArmKinematics(load_arm(session.config.arm.model))
        self._model = CollisionModel(own, movers=[self._bodies.shapes])
        self._pairs = [
            pair
            for pair, (one, _) in enumerate(self._model.pair_solids)
            if one >= self._model.first_mover
        ]

    def __call__(self, own, other):
        frames = self._bodies.frames(other)
        self._model.move(0, frames, [0.0] * len(frames))
        distances = self._model.at(np.array(own))
        return min(distances[pair] for pair in self._pairs)


HOME = np.array(load_arm("ur5").home)
INWARD = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Device of either arm, deflected toward the other arm."""


def hear(session, joints, age_s, velocities=(), **more):
    now_s = session.state.stamp_s if session.state else 0.0
    session.topic.say(joints, velocities, stamp_s=now_s - age_s, at_s=now_s, **more)


def known(joints=HOME, age_s=0.0, **config):
    """A disarmed session that has received its neighbor's state."""
    session = Session(**config)
    for _ in range(5):
        session.cycle(held=False)
        hear(session, joints, age_s)
    return session


def armed(joints=HOME, age_s=0.0):
    session = known(joints, age_s)
    for _ in range(3):
        session.cycle()
        hear(session, joints, age_s)
    assert session.core.phase is Phase.HOLDING, session.message
    return session


SWING = np.array((0.0, 1.0, -0.6, 0.0, 0.0, 0.0))
"""Joint motion that moves the neighbor's hand toward this arm."""


@pytest.mark.matrix
@pytest.mark.parametrize("age_s", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("speed", [0.0, 0.1, 0.3])
def test_an_arm_driven_at_the_other_stops_before_it_at_rest_or_moving(age_s, speed):
    """The neighbor moves to and fro, and brakes for this arm; joint states are delayed."""
    session, between = armed(age_s=age_s), None
    between = Between(session)
    history, other, v, nearest, least = [], HOME.copy(), 0.0, math.inf, math.inf
    late = round(age_s / PERIOD_S)
    for step in range(600):
        goal_v = speed * math.cos(step * PERIOD_S * 2.0)
        if between(session.q, other) < 0.15:
            goal_v = 0.0  # the neighbor avoids this arm as well
        limit = 0.8 * PERIOD_S
        v += min(max(goal_v - v, -limit), limit)
        other = other + v * PERIOD_S * SWING
        history.append((other, v * SWING))
        q, qv = history[max(0, len(history) - 1 - late)]
        hear(session, q, age_s, qv)
        session.cycle(INWARD)
        nearest = min(nearest, between(session.q, other))
        least = min(least, session.core.status().arm.distance_m)
    assert SAFETY_M <= nearest < 0.15
    assert session.core.trips == 0


def test_two_arms_that_are_driven_at_each_other_both_stop():
    left, right = Session(), Session(name="left")
    between, nearest = Between(left), math.inf
    moved = {}
    for step in range(700):
        driven = step >= 10
        for one, other, axes in ((left, right, INWARD), (right, left, INWARD)):
            one.cycle(axes if driven else REST, held=step >= 5)
            if step == 5:
                moved[id(one)] = one.q
            now_s = one.state.stamp_s
            # Published as by a session: every second cycle, over a network.
            if step % 2 == 0:
                other.topic.say(one.q, one.state.velocities, stamp_s=now_s, at_s=now_s + 0.005)
        nearest = min(nearest, between(left.q, right.q))
    for one in (left, right):
        assert one.core.phase is not Phase.DISARMED, one.message
        assert np.abs(one.q - moved[id(one)]).max() > 0.05
        assert not one.core.commanded.moving
    assert SAFETY_M <= nearest < 0.12


VERBS_INWARD = {
    "movj": lambda verbs, pose: verbs.movj(pose),
    "movl": lambda verbs, pose: verbs.movl(pose),
}


@pytest.mark.parametrize("verb", VERBS_INWARD)
def test_a_verb_through_a_neighbor_is_refused_before_it_begins(verb):
    """The verb is refused while the neighbor is in the way, and moves the arm when it has left."""
    session = known(neighbor={**FACING, "base_xyz_m": [1.2, 0.218, 0.0]})
    session.cycle(held=False)
    verbs = make_verbs(session.config, session.robot, session.core, None)
    begin = session.core.commanded.pose
    goal = begin._replace(position=begin.position._replace(x=begin.position.x + 0.22))
    with pytest.raises(CollisionError, match=r"'s \w+, where that is now, after \d+%") as refused:
        VERBS_INWARD[verb](verbs, goal)
    assert any(name.startswith("right's ") for name in refused.value.pair)
    assert not session.core.commanded.moving

    away = HOME + np.array((math.pi / 2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    hear(session, away, 0.0)
    session.cycle(held=False)
    VERBS_INWARD[verb](verbs, goal)


def test_one_that_comes_moves_no_arm_at_rest_and_the_words_say_so():
    session = armed()
    between, before, comes = Between(session), session.q, load_arm("ur5").home
    at = session.core.commanded.neighbors[0]
    arm, q = ArmKinematics(load_arm("ur5")), np.array(comes)
    for _ in range(500):
        arm.update(q)
        ahead = np.linalg.solve(
            arm.jacobian,
            np.concatenate(
                (arm.placement.rotation.T @ np.array((0.001, -0.0006, 0.0)), np.zeros(3))
            ),
        )
        if between(session.q, q) < 0.005:
            break
        q = q + ahead
        hear(session, q, 0.0)
        session.cycle()
        assert np.abs(session.q - before).max() < 1e-6
    there = between(session.q, q)
    assert there < 0.006
    for _ in range(30):
        hear(session, q, 0.0)
        session.cycle(INWARD)
        assert between(session.q, q) >= there - 1e-5
    assert f"{at.name}'s " in session.message
    assert "mm apart" in session.message


def test_before_anything_is_heard_nothing_moves_and_the_words_say_what_to_do():
    session = Session()
    for step in range(40):
        session.cycle(INWARD, held=step > 5)
        if step == 0:
            before = session.q
    assert (session.q == before).all()
    assert session.core.phase is Phase.DISARMED
    assert "start what publishes its joint states on /right/joint_states" in session.message


def flood(session, step):
    for _ in range(50):
        session.topic.junk(bytes(40), session.state.stamp_s)


def second(session, step):
    hear(session, HOME, 0.002, sender=b"one")
    hear(session, HOME + 0.3, 0.0, sender=b"two")


SILENCES = {
    "silence": lambda session, step: None,
    "numbers that are none": lambda session, step: hear(session, HOME * math.nan, 0.0),
    "stamps that lie": lambda session, step: hear(session, HOME, -5.0),
    "stamps that stay": lambda session, step: hear(session, HOME, 0.01 * step + 0.02),
    "other joints": lambda session, step: hear(session, HOME, 0.0, names=list("abcdef")),
    "another type": lambda session, step: hear(session, HOME, 0.0, key="0/joint_states/x/hash"),
    "a flood of junk": flood,
    "a second publisher": second,
}


@pytest.mark.parametrize("silence", SILENCES)
def test_an_arm_that_moves_brakes_and_stays_until_it_is_armed_again(silence):
    session = armed()
    for _ in range(30):
        hear(session, HOME, 0.0)
        session.cycle(INWARD)
    assert session.core.phase is Phase.MOVING
    before = sum(session.neighbors._watches[0].refused.values())
    for step in range(60):
        SILENCES[silence](session, step)
        session.cycle(INWARD)
    assert session.core.phase is Phase.DISARMED
    assert not session.core.commanded.moving
    assert session.core.trips == 1
    assert "the neighbor right" in session.message
    refused = sum(session.neighbors._watches[0].refused.values())
    assert (refused > before) == (silence != "silence")
    there = session.q
    # The neighbor's state is known again, but the operator has not released the device.
    for _ in range(20):
        hear(session, HOME, 0.0)
        session.cycle(INWARD)
    assert np.abs(session.q - there).max() < 1e-6
    for held in (False, True, True):
        hear(session, HOME, 0.0)
        session.cycle(held=held)
    assert session.core.phase is Phase.HOLDING


def test_a_flood_beside_the_true_states_costs_no_cycle_more_than_four_messages():
    session = armed()
    flood(session, 0)
    session.topic.arrive(session.state.stamp_s)
    before = sum(session.neighbors._watches[0].refused.values())
    session.neighbors.hear(session.state.stamp_s, EPOCH_NS)
    assert sum(session.neighbors._watches[0].refused.values()) - before <= MESSAGES_AT_ONCE


def test_what_is_too_long_is_not_decoded():
    session = armed()
    names = [*load_arm("ur5").joint_names, *(f"joint {each}" for each in range(2000))]
    hear(session, np.zeros(len(names)), 0.0, names=names)
    session.cycle()
    assert "refused 1 messages of more than 8192 bytes" in session.neighbors.diagnosis()[-1]
    assert len(names) * 8 > MAX_BYTES


def test_whatever_junk_comes_little_is_said_of_it():
    session, generator = armed(), np.random.default_rng(1)
    codec = codec_of(STATE)
    good = codec.encode(
        default_message(STATE)
        | {"name": list(load_arm("ur5").joint_names), "position": HOME.tolist()}
    )
    for _ in range(400):
        session.topic.junk(good[: generator.integers(len(good))], session.state.stamp_s)
        other = bytearray(good)
        other[generator.integers(4, len(good))] ^= generator.integers(1, 256)
        session.topic.junk(bytes(other), session.state.stamp_s)
        session.cycle()
    assert sum(session.neighbors._watches[0].refused.values()) > 700
    assert len(session.neighbors.diagnosis()) < 15


def test_the_words_say_how_far_a_neighbor_may_come_that_is_fast():
    session = armed()
    for step in range(40):
        swing = HOME + 0.4 * math.sin(0.3 * step) * SWING
        hear(session, swing, 0.0)
        session.cycle(INWARD)
        if "nearer" in session.message:
            break
    reported = re.search(
        r"right's \w+, which may come (\d+) mm nearer by itself, and \w+ are", session.message
    )
    assert reported is not None
    assert int(reported[1]) > SAFETY_M * 1e3


def unavailable(*_arguments):
    raise NativePartError("left out by a test")


@pytest.mark.parametrize("compiled", [True, False])
def test_both_servos_tell_how_far_a_neighbor_may_come(compiled, monkeypatch):
    if not compiled:
        monkeypatch.setattr(choice, "CompiledServo", unavailable)
    session = Session()
    session.cycle(held=False)
    ways = [0.6 + 0.01 * each for each in range(len(session.core.commanded.neighbors[0].shapes))]
    session.core.place_neighbor(0, HOME, ways)
    session.core.commanded.brake(PERIOD_S)
    status = session.core.commanded.servo.status()
    names = [each.name for each in session.core.commanded.neighbors[0].shapes]
    assert status.compiled is compiled
    assert status.nearer_m == ways[names.index(status.nearest_pair[0])]


def test_a_record_places_the_neighbors_where_they_were():
    session, said = armed(), []
    session.core.recorder = lambda _ticks, what, text: said.append((what, text))
    hear(session, HOME + 0.1 * SWING, 0.0)
    session.cycle()
    name, text = next(each for each in said if each[0] == "place_neighbor")
    again = Session()
    REPEATED[name](again.core, text)
    for one in (session, again):
        one.core.commanded.brake(PERIOD_S)
    found = [one.core.commanded.servo.status().distance_m for one in (session, again)]
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"network": None}, "neighbors: their joint states come from the network"),
        ({"arm": {"model": "ur5", "collisions": False}}, "neighbors: only an arm's"),
        ({"neighbor": {"topic": "/a b"}}, "topic"),
        (
            {"neighbor": {"topic": "/joint_states"}},
            "neighbors.0.topic: /joint_states is that of this",
        ),
        ({"neighbor": {"topic": "joint_states"}}, "/joint_states is that of this session"),
        (
            {"neighbor": {"base_xyz_m": None, "base_rpy_deg": [0.0] * 3}},
            "neighbors.0.base_xyz_m: is missing.*say where",
        ),
        ({"neighbors": [FACED, {**FACED, "name": "it"}]}, "neighbors.1.topic.*neighbor 'right'"),
        ({"neighbor": {"max_age_s": 0.01}}, "neighbors.0.max_age_s.*0.02"),
        ({"neighbor": {"name": ""}}, "name"),
        ({"neighbor": {"base_xyz_m": None}}, "given with base_xyz_m"),
        ({"neighbor": {"model": "ur55"}}, "neighbors.0.model.*ur5"),
        ({"neighbor": {"ignore": [["wrist_3_link", "link_9"]]}}, "neighbors.0.ignore.*link_9"),
        ({"neighbor": {"ignore": [["base", "wrist_3_link"]]}}, "neighbors.0.ignore.*'base'"),
    ],
)
def test_what_cannot_be_is_refused(changes, words):
    given = {key: value for key, value in {**table(), **changes}.items() if value is not None}
    if "neighbor" in changes:
        given = table(neighbor={**FACING, **changes["neighbor"]})
        for key in [key for key, value in changes["neighbor"].items() if value is None]:
            del given["neighbors"][0][key]

    def made():
        config = parse_config(given)
        return make_controller(config, make_robot(config))

    with pytest.raises(ConfigurationError, match=words):
        made()


def test_too_many_pairs_are_refused_and_the_remedy_is_said():
    one = table()["neighbors"][0]
    many = [{**one, "name": f"{number}", "topic": f"/arm{number}"} for number in range(40)]
    config = parse_config({**table(), "neighbors": many})
    with pytest.raises(ConfigurationError, match=r'at most 256 fit: set fit = "coarse"'):
        make_controller(config, make_robot(config))


def test_bodies_that_overlap_at_home_are_said_and_can_be_ignored():
    pan = ["l_shoulder_pan_link", "r_shoulder_pan_link"]
    found, planned = [], []
    for ignore in ([], [pan]):
        neighbor = {"ignore": ignore}
        arms = table("pr2_left_arm", "pr2_right_arm", neighbor=neighbor)
        found.append([w for w in cautions(parse_config(arms)) if w.startswith("neighbors")])
        config = parse_config(arms)
        robot = make_robot(config)
        verbs = make_verbs(config, robot, make_controller(config, robot), None)
        planned.append(("right's r_shoulder_pan_link", pan[0]) in verbs.planner.collision.pairs)
    assert planned == [True, False]
    assert len(found[0]) == 1
    assert "right's r_shoulder_pan_link and l_shoulder_pan_link overlap by" in found[0][0]
    assert not found[1]


def of_one_tree(folder, left, right):
    """Configuration of the left arm's session, with the right arm as its neighbor."""
    (folder / "tree.urdf").write_text(TREE, encoding="utf-8")
    for side, more in (("l", left), ("r", right)):
        text = f'urdf = "tree.urdf"\ntcp = "{side}/tcp"\n{more}'
        (folder / f"{side}.toml").write_text(text, encoding="utf-8")
    load_arm.cache_clear()
    own, other = (str(folder / f"{side}.toml") for side in "lr")
    arm = {"model": own, "i_accept_links_without_bodies": True}
    return parse_config(table(own, other, neighbor={}, arm=arm))


@pytest.mark.parametrize(
    ("left", "right"), [("l/mount", "r/mount"), ("torso", "r/mount"), ("torso", "torso")]
)
def test_the_base_of_the_other_arm_of_a_robot_is_where_its_description_has_it(
    tmp_path, left, right
):
    config = of_one_tree(tmp_path, f'base = "{left}"', f'base = "{right}"')
    (bodies,) = make_neighbor_bodies(config)
    whole = pin.buildModelFromXML(WHOLE)
    data, q = whole.createData(), pin.neutral(whole)
    joints = (0.3, -1.1, 0.7)
    for name, value in zip(bodies.names, joints, strict=True):
        put(whole, q, name, value)
    pin.framesForwardKinematics(whole, data, q)
    own, hand = (data.oMf[whole.getFrameId(link, pin.BODY)] for link in (left, "r/hand"))
    there = own.actInv(hand)
    (hand_at,) = (
        frame * to_se3(Pose(shape.shape.start, IDENTITY))
        for shape, frame in zip(bodies.shapes, bodies.frames(joints), strict=True)
        if shape.name == "right's r/hand"
    )
    np.testing.assert_allclose(hand_at.translation, there.translation, atol=1e-9)
    assert {shape.name.split("/")[0] for shape in bodies.shapes} == {"right's r"}


def test_arms_of_one_robot_that_hold_it_differently_are_refused(tmp_path):
    held = [f'base = "{side}/mount"\n[hold]\nlift = 0.{side == "r":d}5' for side in "lr"]
    with pytest.raises(
        ConfigurationError, match=r"hold joints between 'world' and '\S+' diff"
    ) as no:
        make_neighbor_bodies(of_one_tree(tmp_path, *held))
    assert no.value.key == "neighbors.0.base_xyz_m"
    assert "by 100 mm and 0.0 degrees: give both files the same [hold]" in str(no.value)


def test_what_a_neighbor_of_the_same_robot_moves_is_reported_once(tmp_path):
    config = of_one_tree(tmp_path, 'base = "l/mount"', 'base = "r/mount"')
    around = json.loads(scene_of(config))
    own = {each["name"] for each in around["shapes"]}
    assert {"torso", "l/hand"} <= own
    assert not {name for name in own if name.startswith("r/")}
    assert "right's r/hand" in {each["name"] for each in around["neighbors"][0]["shapes"]}


def test_arms_that_both_move_a_joint_are_refused(tmp_path):
    config = of_one_tree(tmp_path, 'base = "base_link"', 'base = "base_link"')
    with pytest.raises(
        ConfigurationError, match=r"both move lift, .* let both hold it, with base = 'torso' in"
    ) as no:
        make_neighbor_bodies(config)
    assert no.value.key == "neighbors.0.model"


def test_arms_of_two_robots_need_the_base_said():
    config = parse_config(table("ur5", "pr2_left_arm", neighbor={}))
    with pytest.raises(
        ConfigurationError, match=r"'ur5' and 'pr2_left_arm' have no link in common"
    ):
        make_neighbor_bodies(config)


def two(left=(), right=(), **changes):
    """Configurations of two sessions that are each other's neighbors."""
    made = {}
    for name, other, change in (("left", "right", dict(left)), ("right", "left", dict(right))):
        one = table(name=other, neighbor={**FACING, **change})
        made[name] = parse_config({**one, "network": {"namespace": name}, **changes})
    return made


def test_two_sessions_that_agree_are_not_warned_of():
    assert disagreements(two()) == []
    moved = {"base_xyz_m": [1.0, 0.5, 0.2], "base_rpy_deg": [0.0, 0.0, 90.0]}
    seen = {"base_xyz_m": [-0.5, 1.0, -0.2], "base_rpy_deg": [0.0, 0.0, -90.0]}
    assert disagreements(two(moved, seen)) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"base_xyz_m": [1.5, 0.0, 0.0]}, ["left: neighbors.0.base_xyz_m: .* 100 mm and 0.0 deg"]),
        ({"base_rpy_deg": [0.0, 0.0, 170.0]}, ["base_xyz_m: .* 244 mm and 10.0 degrees"]),
        ({"model": "ur5e"}, ["left: neighbors.0.model: is 'ur5e', .* 'right' has 'ur5'"]),
        (
            {"topic": "/rihgt/joint_states"},
            ["/rihgt/joint_states; did you mean '/right/joint_states'"],
        ),
    ],
)
def test_two_sessions_that_say_different_things_of_each_other_are_warned_of(change, words):
    found = disagreements(two(left=change))
    for each in words:
        assert any(re.search(each, line) for line in found), found


def test_a_neighbor_that_no_session_of_ours_moves_is_not_warned_of():
    assert disagreements(two({"topic": "/welder/states"}, {"topic": "/other/arm"})) == []


def test_a_neighbor_that_does_not_know_this_arm_or_stops_later_is_warned_of():
    one = two()
    deaf = parse_config({**table(), "network": {"namespace": "right"}, "neighbors": []})
    assert disagreements({**one, "right": deaf}) == [
        "left: neighbors.0: the session 'right' has no neighbor for this arm, and may drive into "
        "it: add one"
    ]
    slow = two(arm={"model": "ur5", "acceleration_share": 0.5})
    found = disagreements({**one, "right": slow["right"]})
    assert len(found) == 1
    assert "acceleration_share: is 1, and the session 'right' has 0.5" in found[0]
