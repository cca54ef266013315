"""The arm as its users have it, on a simulated robot that runs as fast as it can."""

import threading

import numpy as np
import pytest

from cardan.drivers.sim_arm import SimArm, SimArmOptions
from cardan.errors import CommandError, MotionLoopError, MotionRefusedError
from cardan.gateway.arm import (
    CartesianDevice,
    ControllerOptions,
    Outcome,
    State,
    digital_output_gripper,
)
from cardan.gateway.arm.authority import AuthorityOptions, AuthorityPolicy
from cardan.types import CommandKind, DeviceLink, DeviceState, RobotCapabilities
from tests.gateway.fakes import FakeDevice, FakeRobot

DOWN = np.array([0.0, 0.0, -0.1])
QUICK = {"cpts": 0.25, "cpta": 1.0, "cprs": 1.0, "cpra": 4.0, "cpjs": 0.5}


def simulated(**options):
    return SimArm(SimArmOptions(pacing="virtual", drive="ideal", **options))


@pytest.fixture
def arm():
    with CartesianDevice(simulated(), arm="ur5") as device:
        device.set_parameters(QUICK)
        yield device


def test_motions_are_waited_for(arm):
    start = np.array(arm.stat().pose)
    target = [*(start[:3] + DOWN), *start[3:]]
    for verb in (arm.movl, arm.movj):
        motion = verb(target)
        assert arm.wait(20.0) is True
        assert motion.outcome is Outcome.DONE
        np.testing.assert_allclose(arm.stat().pose[:3], target[:3], atol=2e-4)
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
    arm.set_parameter("cpts", 0.25)  # Waits until the arm is at rest.
    assert arm.status().state is State.NOT_CONTROLLING


def test_a_motion_takes_over(arm):
    start = np.array(arm.stat().pose)
    first = arm.movl([*(start[:3] + 2.0 * DOWN), *start[3:]])
    second = arm.movj(start)
    assert first.over
    assert arm.wait(20.0) is True
    assert second.outcome is Outcome.DONE
    np.testing.assert_allclose(arm.stat().pose[:3], start[:3], atol=2e-4)


def test_refusals_raise_and_change_nothing(arm):
    with pytest.raises(MotionRefusedError, match="out of reach"):
        arm.movj([5.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(MotionRefusedError, match="no gripper"):
        arm.act("accg")
    assert arm.status().refusals == 2


def test_streams_answer(arm):
    assert "choose" in arm.twist([0.0] * 6)
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


def test_torque_verbs_and_tools():
    with CartesianDevice(SimArm(SimArmOptions(pacing="virtual")), arm="ur5") as arm:
        start = np.array(arm.stat().pose)
        arm.gcmp()
        assert arm.stat().state is State.GRAVITY
        began = arm.stat().stamp_s
        while arm.stat().stamp_s < began + 0.5:
            threading.Event().wait(0.001)
        assert arm.status().torque, arm.status().message
        assert np.linalg.norm(np.array(arm.stat().pose[:3]) - start[:3]) < 0.05
        arm.forc([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
        assert arm.stat().state is State.FORCE
        arm.stop()
        arm.tool([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
        arm.tool([0.0] * 6)


def test_closed_and_ended_loops_say_so():
    device = CartesianDevice(simulated(), arm="ur5")
    with pytest.raises(MotionLoopError, match="not open"):
        device.movj([0.0] * 6)
    device.open()
    device.open()
    device.robot.close()
    device._link.wait_for(lambda: not device._link.running, 5.0)
    with pytest.raises(MotionLoopError, match="has ended"):
        device.stat()
    device.stop()
    device.close()
    device.close()


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
        while arm.stat().stamp_s < began + 2.0:
            threading.Event().wait(0.001)
        print(arm.stat().pose[:3] - start[:3] - DOWN, arm.status().following_error_rad)
        np.testing.assert_allclose(arm.stat().pose[:3], start[:3] + DOWN, atol=5e-3)


def test_a_driver_that_fails_ends_in_an_error():
    class Failing(FakeRobot):
        def send(self, command):
            raise CommandError("the cable is cut")

    device = CartesianDevice(Failing(), arm="gofa_crb15000_5")
    device.open()
    device._link.wait_for(lambda: not device._link.running, 5.0)
    with pytest.raises(MotionLoopError, match="the cable is cut"):
        device.movj([0.0] * 6)
    device.close()


def test_an_owner_that_was_entrusted_with_the_arm_streams_at_once():
    with CartesianDevice(simulated(), arm="ur5") as arm:
        arm.movj(arm.stat().pose)
        arm.hand_over("pendant")
        assert arm.status().authority.owner == "pendant"
        arm.set_parameter("cpsc", "twst")
        assert "'pendant' has authority" in arm.twist([0.0] * 6, owner="phone")
        assert arm.twist([0.0] * 6, owner="pendant") == ""
        with pytest.raises(MotionRefusedError, match="'pendant' has authority"):
            arm.movj(arm.stat().pose)


def test_the_arm_can_be_reserved_for_one_stream():
    options = ControllerOptions(
        authority=AuthorityOptions(policy=AuthorityPolicy.NAMED, named="pendant")
    )
    with CartesianDevice(simulated(), "ur5", options) as arm:
        with pytest.raises(MotionRefusedError, match="reserved for 'pendant'"):
            arm.movj(arm.stat().pose)
        arm.set_parameter("cpsc", "twst")
        assert "reserved" in arm.twist([0.0] * 6, owner="phone")
        assert arm.twist([0.0] * 6, owner="pendant") == ""


class AtRest(FakeDevice):
    """A device that nobody touches, without dead-man and clutch."""

    def state(self):
        return DeviceState(0.0, DeviceLink.LIVE, (0.0,) * 6, frozenset())

    def button_events(self):
        return []


def test_a_device_that_nobody_touches_does_not_keep_the_arm_from_the_verbs():
    robot = simulated()
    with CartesianDevice(robot, "ur5", device=AtRest()) as arm:
        here = list(arm.stat().pose)
        here[2] -= 0.02
        arm.movl(here)
        assert arm.wait()
