"""The FollowJointTrajectory suite against a session's own server, and against servers with
defects."""

from __future__ import annotations

import math

import pytest

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.conform import Level, VerdictOutcome, registry, run
from cardan.conform.requirements import failed
from cardan.conform.run import simulated
from cardan.conform.runner import Exchange
from cardan.conform.timeline import Kind, WireEvent, WireTimeline
from cardan.errors import ConfigurationError
from cardan.gateway.arm.verb_plans import VerbPlans
from cardan.gateway.bus.commands import Instant
from cardan.protocols.ros2.actions import Goals
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import revised
from cardan.protocols.ros2.messages import completed
from cardan.robots import JointKind, load_arm
from cardan_conform_arms.joint_trajectory.names import (
    CANCEL,
    FEEDBACK,
    GOAL,
    RESULT,
    STATUS,
    channels_of,
)
from cardan_conform_arms.joint_trajectory.requirements import requires
from cardan_conform_arms.joint_trajectory.scenario import FAR
from cardan_conform_arms.ros2_arm.names import DESCRIPTION, STATES
from tests import conformance_tables as tables
from tests.gateway.arm.arms import DT_S
from tests.gateway.bus.bench import Bench
from tests.serving import ARM_SESSION, session_on_the_network

SUITE = registry.load("joint-trajectory")
PR2 = "pr2_right_arm"
CHANNELS = channels_of("/controller/follow_joint_trajectory")
STATE_CYCLES = 5
LONGEST_S = 300.0


class Call:
    """A request of the scenario to the server."""

    attachment = None

    def __init__(self, data, answers, channel, number):
        self.data = data
        self._answers, self._channel, self._number = answers, channel, number

    def reply(self, data, _now_ns):
        self._answers.append((self._channel, data, str(self._number)))

    def refuse(self, _reason):
        """Send no answer."""


class SimulatedSession:
    """The server of a session with its arm, and a scenario in virtual time."""

    def __init__(self, exchange, bench, earlier=GOAL):
        """`earlier`: request that arrives first if two are sent at the same time."""
        self.exchange, self.bench = exchange, bench
        self._earlier = earlier
        self._answers = []
        self._asked = dict.fromkeys((GOAL, CANCEL, RESULT), 0)
        self._reported = dict.fromkeys((FEEDBACK, STATUS), 0)
        self._start_s = bench.world.now_s

    @property
    def now_s(self):
        return self.bench.world.now_s - self._start_s

    def run(self):
        bench, cycles = self.bench, 0
        while not self.exchange.over:
            assert self.now_s < LONGEST_S
            self._do(self.exchange.due(self.now_s))
            bench.poll(DT_S)
            bench.world.tick()
            bench._tell_ended()
            cycles += 1
            if cycles % STATE_CYCLES == 0:
                self._tell_states()
            self._deliver()

    def _do(self, steps):
        steps = sorted(steps, key=lambda step: step.channel != self._earlier)
        for step in steps:
            if step.kind is Kind.OPENED:
                self._do(self.exchange.heard(self.now_s, step.channel, kind=Kind.OPENED))
                if step.channel == DESCRIPTION:
                    self._hear(DESCRIPTION, {"data": self.bench.world.model.urdf})
            elif step.kind is Kind.DATA:
                self._asked[step.channel] += 1
                call = Call(step.data, self._answers, step.channel, self._asked[step.channel])
                self.bench.node.rings[CHANNELS[step.channel].name].waiting.append(call)
                if self._earlier == CANCEL:
                    self.bench.poll(DT_S)

    def _hear(self, channel, given):
        name = CHANNELS[channel].type
        data = codec_of(name).encode(completed(name, given))
        self._do(self.exchange.heard(self.now_s, channel, data))

    def _tell_states(self):
        world = self.bench.world
        names = list(world.model.joint_names)
        self._hear(STATES, {"name": names, "position": world.q.tolist()})
        now = Instant(5, "base_link", None, world.state(), world.verbs.desired())
        self.bench.server.report(now, 0)

    def _deliver(self):
        for channel in self._reported:
            messages = self.bench.node.publishers[CHANNELS[channel].name].messages
            for message in messages[self._reported[channel] :]:
                self._hear(channel, message)
            self._reported[channel] = len(messages)
        while self._answers:
            channel, data, note = self._answers.pop(0)
            self._do(self.exchange.heard(self.now_s, channel, data, note=note))


def judged(bench, suite=SUITE, simulation=SimulatedSession, **more):
    exchange = Exchange(suite.scenario(Level.MOVE, 0.5))
    simulation(exchange, bench, **more).run()
    decoded = SUITE.decode(exchange.timeline)
    return {each.id[-3:]: each.check(decoded) for each in requires.all()}


def worse_than(outcome, verdicts):
    return {name: each for name, each in verdicts.items() if each.outcome is not outcome}


def turned_arm(turns):
    """Return a PR2's arm whose continuous joints start this many turns from home."""
    model = load_arm(PR2)
    start = [
        at + 2.0 * math.pi * turns * (joint.kind is JointKind.CONTINUOUS)
        for at, joint in zip(model.home, model.joints, strict=True)
    ]
    return Bench(arm=PR2, start=start)


@pytest.mark.matrix("0-cancel_goal")
@pytest.mark.parametrize(("turns", "earlier"), [(0, CANCEL), (-2, GOAL)])
def test_a_session_meets_every_requirement(turns, earlier):
    assert worse_than(VerdictOutcome.PASSED, judged(turned_arm(turns), earlier=earlier)) == {}


FINGER = """
<link name="finger"/><joint name="finger_joint" type="prismatic"><parent link="base_link"/>
<child link="finger"/><limit lower="0" upper="0.04" effort="1" velocity="1"/></joint></robot>"""


class SimulatedGripper(SimulatedSession):
    """Session whose description and joint states also contain a gripper's joint, moved by another
    controller."""

    def _hear(self, channel, given):
        if channel == DESCRIPTION:
            given = {"data": given["data"].replace("</robot>", FINGER)}
        elif channel == STATES:
            now_s = self.now_s
            given = {
                "name": [*given["name"], "finger_joint"],
                "position": [*given["position"], 0.02 + 0.02 * math.sin(now_s)],
            }
        super()._hear(channel, given)


ALL = ("tcp/127.0.0.1:7447", "/controller/follow_joint_trajectory")


@pytest.mark.matrix
@pytest.mark.parametrize("named", [True, False])
def test_of_an_arm_with_a_gripper_the_joints_are_judged_that_are_named(named):
    suite, bench = registry.load(SUITE.name), Bench()
    joints = bench.world.model.joint_names if named else ()
    suite.wires(",".join((*ALL, *joints)))
    found = judged(bench, suite=suite, simulation=SimulatedGripper)
    if named:
        assert list(worse_than(VerdictOutcome.PASSED, found)) == ["212"]
    else:
        assert "error_code -2" in found["102"].said


@pytest.mark.matrix
def test_joints_that_nobody_publishes_are_asked_nothing():
    suite = registry.load(SUITE.name)
    suite.wires(",".join((*ALL, "elbow_of_nobody")))
    assert judged(Bench(), suite=suite)["101"].outcome is VerdictOutcome.NOT_SEEN


@pytest.mark.matrix
def test_a_session_that_leaves_whole_turns_as_they_are_fails(monkeypatch):
    monkeypatch.setattr(VerbPlans, "_nearest_turns", lambda _self, wanted, _start: wanted)
    found = worse_than(VerdictOutcome.PASSED, judged(turned_arm(-2)))
    assert list(found) == ["212"]


@pytest.mark.matrix
def test_a_session_that_forgets_early_cancellations_fails(monkeypatch):
    monkeypatch.setattr(Goals, "_remember_canceled", lambda _self, _goal_id: None)
    found = worse_than(VerdictOutcome.PASSED, judged(turned_arm(0), earlier=CANCEL))
    assert next(iter(found)) == "210"


def test_an_arm_without_continuous_joints_is_not_asked_to_wrap():
    found = worse_than(VerdictOutcome.PASSED, judged(Bench()))
    assert list(found) == ["212"]
    assert found["212"].outcome is VerdictOutcome.NOT_APPLICABLE


@pytest.mark.matrix
def test_each_requirement_is_failed_by_a_fault():
    """Each fault is injected alone; see the page's table."""
    caught = {name for each in tables.tried(SUITE.name) for name in each.caught}
    assert caught == {each.id for each in requires.all()}


@pytest.mark.matrix
def test_an_arm_that_begins_a_whole_turn_is_stopped_and_asked_no_more():
    _, timeline = simulated(SUITE, Level.MOVE, {"whole-turn": 1.0})
    decoded = SUITE.decode(timeline)
    states = decoded.during("wrap")
    assert FAR < decoded.farthest(states)[0] < 3.0 * FAR
    assert "home" not in decoded.phases


@pytest.mark.matrix
def test_nothing_that_comes_ends_the_pilot_or_a_judge():
    """Malformed messages at any time and on any channel."""
    scenario = SUITE.scenario(Level.MOVE, 0.1)
    exchange = Exchange(scenario)
    SUITE.simulate(exchange, {}, 0)
    for channel in CHANNELS:
        exchange.over = False
        exchange.heard(1e3, channel, b"\0\1\0\0junk", note="1")
    decoded = SUITE.decode(exchange.timeline)
    assert len(decoded.unread) == len(CHANNELS) - 1
    assert worse_than(VerdictOutcome.PASSED, {r.id: r.check(decoded) for r in requires.all()}) == {}


@pytest.mark.matrix
def test_joints_of_another_publisher_and_infinite_ones_are_seen_as_they_are():
    timeline = WireTimeline()
    described = {"data": '<joint name="a" type="continuous"/><joint name="b" type="revolute"/>'}
    _hear(timeline, DESCRIPTION, described)
    for given in ({"finger": 0.1}, {"a": 3.0, "b": 1.0}, {"finger": 0.1}, {"a": -3.2, "b": 1.2}):
        _hear(timeline, STATES, {"name": [*given], "position": [*given.values()]})
    decoded = SUITE.decode(timeline)
    assert decoded.farthest(decoded.states) == (pytest.approx(0.2), "b", 4)
    assert decoded.off(decoded.states[-1], {"a": 3.0}) == {"a": pytest.approx(2 * math.pi - 6.2)}
    _hear(timeline, STATES, {"name": ["a"], "position": [math.inf]})
    decoded = SUITE.decode(timeline)
    assert decoded.farthest(decoded.states)[:2] == (math.inf, "a")
    assert requires.all()[0].check(decoded) == failed("a position is not a number", [5])


@pytest.mark.matrix
@pytest.mark.parametrize("index", [None, 0, 1, 7])
@pytest.mark.parametrize("names", [[], ["a"], ["a", "b", "c"]])
def test_feedback_of_every_distribution_is_read(names, index):
    """`index`: index of the failing point, as in Kilted and later; None for earlier versions."""
    timeline = WireTimeline()
    feedback = {"joint_names": names, "actual": {"positions": [0.5] * len(names)}}
    name = CHANNELS[FEEDBACK].type
    if index is not None:
        name, feedback["index"] = revised(name), index
    _hear(timeline, FEEDBACK, {"feedback": feedback}, name)
    decoded = SUITE.decode(timeline)
    assert not decoded.unread
    ((_, message),) = decoded.feedback
    assert message["feedback"]["joint_names"] == names
    assert message["feedback"]["actual"]["positions"] == [0.5] * len(names)
    assert message["feedback"].get("index") == index


def _hear(timeline, channel, given, name=None):
    name = name or CHANNELS[channel].type
    data = codec_of(name).encode(completed(name, given))
    timeline.add(WireEvent(0.0, Kind.DATA, channel=channel, data=data))


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("target", "states"),
    [
        ("tcp/127.0.0.1:7447", "/joint_states"),
        ("tcp/127.0.0.1:7447,/scaled/follow_joint_trajectory", "/joint_states"),
        ("tcp/127.0.0.1:7447,left/arm/follow_joint_trajectory", "/left/joint_states"),
    ],
)
def test_a_target_is_a_router_and_an_action(target, states):
    assert SUITE.wires(target)._channels[STATES].name == states
    assert SUITE._joints == ()


@pytest.mark.matrix
def test_a_target_whose_action_is_no_name_is_an_error():
    with pytest.raises(ConfigurationError, match=r"--target.*'a b' is not a ROS name"):
        SUITE.wires("tcp/127.0.0.1:7447,a b")


SESSION = ARM_SESSION.replace('"ur5"', f'"{PR2}"')
ACTION = "/left/joint_trajectory_controller/follow_joint_trajectory"


@pytest.mark.matrix
@pytest.mark.parametrize(("text", "left_out"), [(SESSION, ()), (ARM_SESSION, ("212",))])
def test_a_session_on_the_bus_meets_every_requirement(text, left_out, tmp_path):
    """Judged by `cardan conform joint-trajectory --target`."""
    with (
        session_on_the_network(tmp_path, text) as endpoint,
        BusNetwork(BusOptions(router=endpoint, listen=()), "watcher") as network,
    ):
        assert network.wait_for_service(f"{ACTION}/_action/get_result", 30.0)
        report, _ = run.at(SUITE, f"{endpoint},{ACTION}", Level.MOVE, print, seconds=1.0)
    found = {each.id[-3:] for each in report.results if each.outcome is not VerdictOutcome.PASSED}
    assert found == {*left_out}, report.as_text()
