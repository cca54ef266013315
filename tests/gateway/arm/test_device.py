"""The arm's interface for programs, in one suite for both implementations.

Tests with `reach` run for CartesianDevice, on a simulated robot that runs as fast as it can, and
for RemoteArm, through a session on its own Zenoh network in real time.
"""

import inspect
import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from cardan.drivers import registry
from cardan.drivers.sim_arm import SimArm, SimArmOptions
from cardan.errors import (
    CollisionError,
    CommandError,
    ConfigurationError,
    MotionLoopError,
    MotionRefusedError,
    OptionError,
    OutOfReachError,
)
from cardan.gateway.arm import (
    CartesianArm,
    CartesianDevice,
    ControllerOptions,
    ControllerStatus,
    Motion,
    Outcome,
    Stat,
    State,
    digital_output_gripper,
)
from cardan.gateway.arm.loop_link import LoopLink
from cardan.gateway.arm.remote_arm import RemoteArm
from cardan.gateway.arm.verb_server import VerbServer
from cardan.gateway.arm.verb_table import IN_PACKETS
from cardan.types import (
    CommandKind,
    DeviceLink,
    DeviceState,
    Frame,
    Pose,
    Quaternion,
    RobotCapabilities,
    Vector3,
)
from tests.gateway.arm.reaching import TIMEOUT_S, Here, OnTheBus
from tests.gateway.fakes import FakeDevice, FakeRobot
from tests.waiting import until

DOWN = np.array([0.0, 0.0, -0.1])
QUICK = {"cpts": 0.25, "cpta": 1.0, "cprs": 1.0, "cpra": 4.0, "cpjs": 0.5}


@pytest.fixture(params=[Here, pytest.param(OnTheBus, marks=pytest.mark.matrix)])
def reach(request, monkeypatch):
    """Factory of arms, in this process or through the network."""
    for kind in (Gripping, Failing, AtRest):
        monkeypatch.setitem(registry.BUILT_IN, kind.__name__, f"{__name__}:{kind.__name__}")
    return request.param()


@pytest.fixture
def arm(reach):
    with reach.arm() as device:
        device.set_parameters(QUICK)
        yield device


def until_at(arm, pose):
    """Wait until the arm's measured pose is there: the command is there some cycles before."""
    until(lambda: np.allclose(arm.stat().pose[:3], pose[:3], atol=2e-4))


def simulated(**options):
    return SimArm(SimArmOptions(pacing="virtual", drive="ideal", **options))


def test_motions_are_waited_for(arm):
    start = np.array(arm.stat().pose)
    target = [*(start[:3] + DOWN), *start[3:]]
    for verb in (arm.movl, arm.movj):
        motion = verb(target)
        assert arm.wait(20.0) is True
        assert motion.outcome is Outcome.DONE
        until_at(arm, target)
    assert arm.relj([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]).verb == "relj"
    assert arm.wait() is True
    assert arm.stat().state is State.NOT_CONTROLLING


def test_nothing_to_wait_for_is_true(arm):
    assert arm.wait(1.0) is True
    arm.movv([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
    assert arm.wait(1.0) is True
    assert arm.stat().state is State.MOVV
    with pytest.raises(MotionRefusedError, match="timeout"):
        arm.wait(-1.0)


def test_a_timeout_stops_and_is_false(arm):
    start = np.array(arm.stat().pose)
    arm.set_parameter("cpts", 0.02)
    motion = arm.movl([*(start[:3] + 2.0 * DOWN), *start[3:]])
    assert arm.wait(0.5) is False
    assert motion.reason == "stopped"
    assert arm.wait() is False
    arm.set_parameter("cpts", 0.25)  # waits until the arm is at rest
    assert arm.status().state is State.NOT_CONTROLLING


def test_a_motion_takes_over(arm):
    start = np.array(arm.stat().pose)
    first = arm.movl([*(start[:3] + 2.0 * DOWN), *start[3:]])
    second = arm.movj(start)
    assert first.over
    assert arm.wait(20.0) is True
    assert second.outcome is Outcome.DONE
    until_at(arm, start)


def test_refusals_raise_and_change_nothing(arm):
    with pytest.raises(MotionRefusedError, match="out of reach"):
        arm.movj([5.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(MotionRefusedError, match="no gripper"):
        arm.act("accg")
    assert arm.status().refusals == 2


def test_streams_answer(arm):
    assert "select twist" in arm.twist([0.0] * 6)
    arm.set_parameter("cpsc", "twst")
    assert arm.get_parameter("streamingCommand") == arm.get_parameters()["streamingCommand"]
    assert arm.twist([0.0] * 6, owner="pendant", sequence=1) == ""
    assert "'pendant' has authority" in arm.twist([0.0] * 6, owner="phone")
    with pytest.raises(MotionRefusedError, match="'pendant' has authority"):
        arm.set_parameter("cpsc", "pose")
    arm.release("pendant")
    arm.set_parameter("cpsc", "pose")
    assert arm.pose(arm.stat().pose) == ""
    assert "pose" in arm.wrench([0.0] * 6)


def test_a_rehearsal_tells_what_would_stop_a_motion_and_moves_nothing(arm):
    start, joints = arm.stat().pose, arm.inv(arm.stat().pose)
    near = [*(np.array(start[:3]) + DOWN), *start[3:]]
    found = arm.rehearse_line(near)
    assert (found.refusal, type(found.duration_s)) == ("", float)
    assert found.duration_s > 0.0
    far = arm.rehearse_line([start[0] + 5.0, *start[1:]])
    assert "out of reach" in far.refusal
    assert not far.refusal.startswith("movl")
    assert far.duration_s == 0.0
    turned = [joints[0] + 0.3, *joints[1:]]
    assert arm.rehearse_joints(turned).refusal == ""
    assert arm.rehearse_joints(joints).note == "the arm is there already"
    beyond = arm.rehearse_joints([joints[0] + 50.0, *joints[1:]])
    assert "its limit is" in beyond.refusal
    assert "% of the way" in beyond.refusal
    with pytest.raises(MotionRefusedError, match="rehearse_joints takes"):
        arm.rehearse_joints([0.0])
    assert arm.stat().pose == pytest.approx(start)
    assert arm.status().authority.owner in ("", arm.source)
    arm.movv([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
    until(lambda: arm.status().moving)
    assert "when it rests" in arm.rehearse_line(near).refusal
    arm.stop()
    # A rehearsal waits for the end of braking.
    assert arm.rehearse_line(near).refusal == ""


def test_authority_is_taken_kept_and_passed_on_while_nothing_moves(arm):
    arm.release()
    arm.acquire("pendant")
    arm.acquire("pendant")
    assert arm.status().authority.owner == "pendant"
    assert not arm.status().moving
    with pytest.raises(MotionRefusedError, match="acquire: 'pendant' has authority"):
        arm.acquire("phone")
    with pytest.raises(MotionRefusedError, match="'pendant' has authority"):
        arm.movv([0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    arm.release("pendant")
    arm.acquire()
    assert arm.status().authority.owner == arm.source
    arm.hand_over("phone")
    arm.acquire("phone")
    with pytest.raises(MotionRefusedError, match="'phone' has authority"):
        arm.acquire()


def test_torque_verbs_and_tools(reach):
    with reach.arm(robot={"drive": "dynamic"}) as arm:
        start = np.array(arm.stat().pose)
        arm.gcmp()
        assert arm.stat().state is State.GRAVITY
        began = arm.stat().stamp_s
        until(lambda: arm.stat().stamp_s >= began + 0.5)
        assert arm.status().torque, arm.status().message
        assert np.linalg.norm(np.array(arm.stat().pose[:3]) - start[:3]) < 0.05
        arm.forc([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
        assert arm.stat().state is State.FORCE
        arm.stop()
        arm.tool([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
        arm.tool([0.0] * 6)


def test_closed_and_ended_loops_say_so(reach):
    with reach.place() as (device, end_loop, *_):
        with pytest.raises(MotionLoopError, match="the arm is not open"):
            device.movj([0.0] * 6)
        device.stop()
        device.close()
        device.open()
        device.open()
        motion = device.movv([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
        end_loop()
        until(lambda: motion.over)
        assert motion.outcome is Outcome.ABORTED
        for ask in (device.stat, lambda: device.movl([0.0] * 6), lambda: device.twist([0.0] * 6)):
            with pytest.raises(
                MotionLoopError, match=r"has ended|has left the network|no server offers it"
            ):
                ask()
        device.close()
        device.close()
        with pytest.raises(MotionLoopError, match="the arm is not open"):
            device.stat()
        device.stop()


def test_what_waits_for_a_motion_ends_with_the_loop(reach):
    with reach.place() as (device, end_loop, *_):
        device.open()
        device.set_parameters({"cpts": 0.01})
        start = device.stat().pose
        motion = device.movl([*(np.array(start[:3]) + DOWN), *start[3:]])
        said = []

        def wait():
            try:
                said.append(device.wait())
            except MotionLoopError as error:
                said.append(str(error))

        waiting = threading.Thread(target=wait)
        waiting.start()
        until(lambda: device.status().moving)
        end_loop()
        waiting.join(TIMEOUT_S)
        # The motion's end and the loop's end race.
        assert said[0] is False or isinstance(said[0], str)
        until(lambda: motion.over)


def test_it_can_be_opened_again(reach):
    with reach.place() as (device, *_):
        for _ in range(2):
            with device as arm:
                arm.set_parameters(QUICK)
                start = np.array(arm.stat().pose)
                arm.movl([*(start[:3] + 0.2 * DOWN), *start[3:]])
                assert arm.wait() is True
                assert arm.stat().state is State.NOT_CONTROLLING


def test_it_brakes_when_it_is_closed(reach):
    with reach.place() as (device, *_):
        with device as arm:
            arm.set_parameters({"cpts": 0.001})
            start = np.array(arm.stat().pose)
            motion = arm.movl([*(start[:3] + DOWN), *start[3:]])
            until(lambda: arm.stat().pose[2] < start[2] - 1e-4)
        assert motion.outcome is Outcome.ABORTED
        with device as arm:
            status = arm.status()
            assert not status.moving
            assert status.authority.owner == ""
            assert arm.stat().pose[2] > start[2] - 0.05


def test_it_brakes_whoever_moves_the_arm_when_it_is_closed():
    with CartesianDevice(simulated(), arm="ur5") as arm:
        motion = arm.verbs.movv([0.0, 0.0, -0.01, 0.0, 0.0, 0.0], source="another")
    assert motion.reason == "stopped"
    assert arm.verbs.at_rest


def test_a_motion_is_refused_without_the_loop_and_given_up_with_it():
    link = LoopLink()
    motion = SimpleNamespace(outcome=Outcome.WAITING, error=None)
    tries = iter([lambda: link.end("the loop has ended")])
    server = VerbServer(SimpleNamespace(start_pending=lambda: next(tries)()), link)
    with pytest.raises(MotionLoopError, match="not open"):
        server.start(lambda: pytest.fail("begun"))
    link.begin()
    with pytest.raises(MotionLoopError, match="the loop has ended"):
        server.start(lambda: motion)


POSE = Pose(Vector3(0.4, 0.1, 0.4), Quaternion(1.0, 0.0, 0.0, 0.0), Frame.BASE)
SIX = [0.0] * 6
LONG = "x" * 100
CUT = f"'{'x' * 63}…"
NO_ACTION = "act: allowed are accg (close), acog (open), acsg (stop), not"
NO_NAME = "takes a name of 1 to 64 characters, not"
NO_SEQUENCE = "is not an integer from 0 to 9007199254740992"

REFUSED = [
    ("inv", ([1.0, 2.0],), "inv takes six numbers, not 2"),
    ("inv", (None,), "inv takes six numbers, not None"),
    ("movj", ([math.nan] * 6,), "movj: number 1 of 6 is nan"),
    ("rehearse_line", ("abcdef",), "rehearse_line takes six numbers, not 'abcdef'"),
    ("rehearse_joints", ([0.0] * 5,), "rehearse_joints takes 6 numbers, not 5"),
    ("movl", ("abcdef",), "movl takes six numbers, not 'abcdef'"),
    ("movv", ([1e9] * 6,), "movv: number 1 of 6 is 1e+09; no arm goes beyond 10000"),
    ("tool", ([0.0] * 5,), "tool takes six numbers, not 5"),
    (
        "movj",
        (POSE._replace(orientation=Quaternion(0.0, 0.0, 0.0, 0.0)),),
        "movj: the quaternion (0.0, 0.0, 0.0, 0.0) has length 0, not 1",
    ),
    ("wait", (-1.0,), "wait: a timeout is a number >= 0, not -1.0"),
    ("wait", (math.inf,), "wait: a timeout is a number >= 0, not inf"),
    ("wait", (math.nan,), "wait: a timeout is a number >= 0, not nan"),
    ("wait", (None,), "wait: a timeout is a number >= 0, not None"),
    ("act", ("nope",), f"{NO_ACTION} 'nope'"),
    ("act", (None,), f"{NO_ACTION} None"),
    ("act", (2.5,), f"{NO_ACTION} 2.5"),
    ("act", ([1],), f"{NO_ACTION} [1]"),
    ("act", ("",), f"{NO_ACTION} ''"),
    ("act", (LONG,), f"{NO_ACTION} {CUT}"),
    ("act", (10**30,), f"{NO_ACTION} {10**30}"),
    ("act", ("accg",), "act: this arm has no gripper"),
    ("hand_over", ("",), f"hand_over: {NO_NAME} ''"),
    ("hand_over", (None,), f"hand_over: {NO_NAME} None"),
    ("hand_over", (LONG,), f"hand_over: {NO_NAME} {CUT}"),
    ("acquire", ("device",), "acquire: 'device' is the operator device, not a program"),
    ("acquire", (LONG,), f"acquire: {NO_NAME} {CUT}"),
    ("release", ("device",), "release: 'device' is the operator device, not a program"),
    ("release", (LONG,), f"release: {NO_NAME} {CUT}"),
    ("release", (5,), f"release: {NO_NAME} 5"),
]
"""Requests that both implementations refuse: verb, arguments, message."""

STREAMS_REFUSED = [
    ("twist", SIX, {"owner": "device"}, "twist: 'device' is the operator device, not a program"),
    ("twist", SIX, {"owner": LONG}, f"twist: {NO_NAME} {CUT}"),
    ("twist", SIX, {"owner": 5}, f"twist: {NO_NAME} 5"),
    ("twist", SIX, {"sequence": "x"}, f"twist: the sequence number 'x' {NO_SEQUENCE}"),
    ("twist", SIX, {"sequence": True}, f"twist: the sequence number True {NO_SEQUENCE}"),
    ("twist", SIX, {"sequence": 2.5}, f"twist: the sequence number 2.5 {NO_SEQUENCE}"),
    ("twist", SIX, {"sequence": -5}, f"twist: the sequence number -5 {NO_SEQUENCE}"),
    ("twist", SIX, {"sequence": 2**60}, f"twist: the sequence number {2**60} {NO_SEQUENCE}"),
    ("twist", [1.0] * 5, {}, "twist takes six numbers, not 5"),
    ("pose", None, {}, "pose takes six numbers, not None"),
    ("jog", [math.nan] * 6, {}, "jog: number 1 of 6 is nan"),
    ("wrench", "x", {}, "wrench takes six numbers, not 'x'"),
    ("joints", [0.0] * 5, {}, "joints takes 6 numbers, not 5"),
    ("joints", None, {}, "joints takes numbers, one for each joint, not None"),
    ("joints", [math.nan] * 6, {}, "joints: number 1 of 6 is nan"),
    ("joints", [1e9] * 6, {}, "joints: number 1 of 6 is 1e+09; no arm goes beyond 10000"),
]
"""Streamed commands that both implementations refuse: verb, value, keywords, message."""

NOT_SET = [
    ("cpts", math.nan, OptionError, "trajectoryRefSpeed", "nan is not allowed"),
    ("cpts", -1, OptionError, "trajectoryRefSpeed", "-1 is not allowed"),
    ("cpts", "x", OptionError, "trajectoryRefSpeed", "'x' is not allowed"),
    ("cpts", [1] * 500, OptionError, "trajectoryRefSpeed", "is not allowed"),
    ("cpsc", "bad", OptionError, "streamingCommand", "'bad' is not allowed"),
    ("nope", 1.0, ConfigurationError, "nope", "there is no such parameter"),
]


def test_bad_arguments_are_refused_in_the_same_words(arm):
    for verb, arguments, words in REFUSED:
        with pytest.raises(MotionRefusedError) as error:
            getattr(arm, verb)(*arguments)
        assert (type(error.value), str(error.value)) == (MotionRefusedError, words)
    for verb, value, keywords, words in STREAMS_REFUSED:
        assert getattr(arm, verb)(value, **keywords) == words
    for key, value, kind, name, words in NOT_SET:
        with pytest.raises(ConfigurationError, match=words) as wrong:
            arm.set_parameter(key, value)
        assert (type(wrong.value), wrong.value.key) == (kind, name)
    with pytest.raises(ConfigurationError, match="there is no such parameter"):
        arm.get_parameter("nope")
    with pytest.raises(ConfigurationError, match="is given twice"):
        arm.set_parameters({"cpts": 0.1, "trajectoryRefSpeed": 0.1})
    assert arm.stat().state is State.NOT_CONTROLLING


def test_what_is_impossible_is_refused_with_its_numbers(arm):
    with pytest.raises(OutOfReachError) as far:
        arm.inv([5.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert far.value.distance_m > 1.0
    assert far.value.angle_rad >= 0.0
    with pytest.raises(CollisionError) as met:
        arm.movl(Pose(Vector3(0.0, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0), Frame.BASE))
    assert type(met.value.pair) is tuple
    assert 0.0 < met.value.share < 1.0


def test_answers_are_of_the_same_types(arm):
    stat, status = arm.stat(), arm.status()
    assert type(stat) is Stat
    measured, commanded = stat[:4], (stat.twist, stat.heard)
    assert [type(each) for each in measured] == [tuple, State, float, tuple]
    assert [type(each) for each in commanded] == [tuple, bool]
    for six in (stat.pose, stat.joints, stat.twist, stat.target or stat.pose):
        assert type(six) is tuple
        assert [type(each) for each in six] == [float] * 6
    assert stat.heard
    assert [type(each) for each in arm.inv(stat.pose)] == [float] * 6
    assert type(status) is ControllerStatus
    motion = arm.movj([*(stat.pose[:2]), stat.pose[2] - 0.01, *stat.pose[3:]])
    assert type(motion) is Motion
    assert (motion.verb, motion.source, motion.ends) == ("movj", arm.source, True)
    assert (type(motion.duration_s), motion.error) == (float, None)
    assert type(arm.wait()) is bool
    status = arm.status()
    assert [type(each) for each in status.pose] == [float] * 6
    assert type(status.authority.since_s) is type(status.stream_age_s) is float
    assert math.isinf(status.stream_age_s)
    assert status.authority.owner == arm.source
    servo = [float] * 3 + [tuple, float, tuple, int] + [float] * 4 + [int, int, bool, str, float]
    assert [type(each) for each in status.servo] == servo
    values = arm.get_parameters()
    assert {type(each) for each in values.values()} == {float}
    assert arm.get_parameter("cpts") == values["trajectoryRefSpeed"] == 0.25
    assert arm.tool(SIX) is arm.release() is arm.stop() is arm.set_parameters({}) is None


def test_every_way_has_the_same_verbs():
    """All members of an arm except `open` and `close` come from CartesianArm, with signatures and
    docstrings."""
    for kind in (CartesianDevice, RemoteArm):
        for name in ("set_parameter", *IN_PACKETS):
            assert getattr(kind, name) is getattr(CartesianArm, name)
        for name in ("open", "close"):
            assert inspect.getdoc(getattr(kind, name))


class Gripping(SimArm):
    """A simulated arm with one output."""

    def __init__(self):
        super().__init__(SimArmOptions(pacing="virtual", drive="ideal"))
        self.outputs = []

    @property
    def capabilities(self) -> RobotCapabilities:
        return super().capabilities._replace(digital_outputs=1)

    def set_outputs(self, digital=None, values=()):
        self.outputs.append((digital, threading.current_thread().name))


def test_a_gripper_on_a_digital_output_is_driven_by_the_loop():
    robot = Gripping()
    with CartesianDevice(robot, arm="ur5", gripper=digital_output_gripper(robot)) as arm:
        arm.act("accg")
        arm.act("acog")
        with pytest.raises(MotionRefusedError, match="half way"):
            arm.act("acsg")
    assert robot.outputs == [(True, "cartesian"), (False, "cartesian")]


def test_a_robot_without_outputs_has_no_gripper():
    robot = simulated()
    with (
        CartesianDevice(robot, arm="ur5", gripper=digital_output_gripper(robot)) as arm,
        pytest.raises(MotionRefusedError, match="has no outputs"),
    ):
        arm.act("accg")


@pytest.mark.matrix("CommandKind.JOINT")
@pytest.mark.parametrize("drive", [CommandKind.JOINT, CommandKind.JOINT_VELOCITY])
def test_an_arm_with_mass_arrives(drive):
    robot = SimArm(SimArmOptions(pacing="virtual", gravity_feedforward=drive is CommandKind.JOINT))
    options = ControllerOptions(drive=drive)
    with CartesianDevice(robot, arm="ur5", options=options) as arm:
        arm.set_parameters({**QUICK, "cpcg": 0.25})
        start = np.array(arm.stat().pose)
        motion = arm.movl([*(start[:3] + DOWN), *start[3:]])
        assert arm.wait(20.0), motion
        began = arm.stat().stamp_s
        until(lambda: arm.stat().stamp_s >= began + 2.0)
        print(arm.stat().pose[:3] - start[:3] - DOWN, arm.status().following_error_rad)
        np.testing.assert_allclose(arm.stat().pose[:3], start[:3] + DOWN, atol=5e-3)


class Failing(FakeRobot):
    def send(self, command):
        raise CommandError("the cable is cut")


def test_a_driver_that_fails_ends_in_an_error():
    device = CartesianDevice(Failing(), arm="gofa_crb15000_5")
    device.open()
    device._link.wait_for(lambda: not device._link.running, 5.0)
    with pytest.raises(MotionLoopError, match="the cable is cut"):
        device.movj([0.0] * 6)
    device.close()


def test_an_owner_that_was_entrusted_with_the_arm_streams_at_once(reach):
    with reach.arm() as arm:
        arm.movj(arm.stat().pose)
        arm.hand_over("pendant")
        assert arm.status().authority.owner == "pendant"
        arm.set_parameter("cpsc", "twst")
        assert "'pendant' has authority" in arm.twist([0.0] * 6, owner="phone")
        assert arm.twist([0.0] * 6, owner="pendant") == ""
        with pytest.raises(MotionRefusedError, match="'pendant' has authority"):
            arm.movj(arm.stat().pose)


def test_the_arm_can_be_reserved_for_one_stream(reach):
    with reach.arm(authority={"policy": "named", "named": "pendant"}) as arm:
        with pytest.raises(MotionRefusedError, match="reserved for 'pendant'"):
            arm.movj(arm.stat().pose)
        arm.set_parameter("cpsc", "twst")
        assert "reserved" in arm.twist([0.0] * 6, owner="phone")
        assert arm.twist([0.0] * 6, owner="pendant") == ""


class AtRest(FakeDevice):
    """A device at rest, without dead-man's switch and clutch."""

    def state(self):
        return DeviceState(0.0, DeviceLink.LIVE, (0.0,) * 6, frozenset())

    def button_events(self):
        return []


def test_a_device_that_nobody_touches_does_not_keep_the_arm_from_the_verbs(reach):
    with reach.arm(device={"driver": "AtRest"}) as arm:
        here = list(arm.stat().pose)
        here[2] -= 0.02
        motion = arm.movl(here)
        assert arm.wait(), motion
