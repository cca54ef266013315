"""Unmodified third-party programs that move Universal Robots arms, with the simulated controller.

The control interface of SDU's ur_rtde uploads a program of 1,200 lines, communicates with it
through registers, and needs the standard ports: each controller has a separate address on loopback.
"""

from __future__ import annotations

import importlib
import math
import sys
import time

import pytest

from tests.serving import served
from tests.sim_peers.test_ur_public_client import own_address
from tests.waiting import until

pytestmark = [
    pytest.mark.matrix,
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8"),
]

rtde_control = importlib.import_module("rtde_control")
rtde_receive = importlib.import_module("rtde_receive")
dashboard_client = importlib.import_module("dashboard_client")

HOME = [0.0, -1.570796, 1.570796, -1.570796, -1.570796, 0.0]
HEIGHT_M = 0.4879
PLANE_M = 0.4
STILL = [0.0] * 6


class Arm:
    """Both interfaces of ur_rtde, with the arm's motion."""

    def __init__(self, address):
        self.address = address
        # A busy computer can still read all states at 125 Hz.
        self.receive = rtde_receive.RTDEReceiveInterface(address, 125.0)
        self.control = rtde_control.RTDEControlInterface(address)

    def close(self):
        self.control.disconnect()
        self.receive.disconnect()

    @property
    def z(self):
        return self.receive.getActualTCPPose()[2]

    def up(self, way_m):
        pose = self.receive.getActualTCPPose()
        pose[2] += way_m
        return pose

    def at(self, q):
        until(lambda: math.dist(self.receive.getActualQ(), q) < 1e-3, f"the arm at {q}")

    def rests(self):
        until(lambda: max(map(abs, self.receive.getActualQd())) < 1e-4, "the arm's rest")

    def home(self):
        assert self.control.moveJ(HOME, 1.5, 3.0)
        self.at(HOME)

    def stream(self, send, count):
        for _ in range(count):
            began = self.control.initPeriod()
            assert send()
            self.control.waitPeriod(began)


def turned(angle):
    return [angle, *HOME[1:]]


@pytest.fixture
def arm():
    address = own_address(3)
    words = ("--running", "--contact-z", str(PLANE_M))
    with served("sim", "ur", "--host", address, *words):
        arm = Arm(address)
        yield arm
        arm.close()


def test_ur_rtde_moves_servoes_and_pushes(arm):
    control = arm.control
    assert control.moveJ(turned(0.3), 1.5, 3.0)
    arm.at(turned(0.3))
    arm.home()

    arm.stream(lambda: control.servoJ(turned(0.1), 0, 0, 0.002, 0.1, 300), 200)
    arm.at(turned(0.1))
    assert control.servoStop()
    arm.rests()
    arm.home()

    push = (STILL, [0, 0, 1, 0, 0, 0], [0, 0, -10.0, 0, 0, 0], 2, [2, 2, 0.1, 1, 1, 1])
    arm.stream(lambda: control.forceMode(*push), 400)
    until(lambda: abs(arm.receive.getActualTCPForce()[2] - 10.0) < 1.5, "10 N")
    assert arm.z == pytest.approx(PLANE_M, abs=2e-3)
    assert control.forceModeStop()
    arm.rests()


def test_moves_in_tool_space_and_on_paths(arm):
    control = arm.control
    pose = arm.up(0.05)
    assert control.moveL(pose, 0.25, 1.2)
    assert arm.z == pytest.approx(pose[2], abs=1e-3)
    assert control.moveL_FK(HOME, 0.25, 1.2)
    arm.at(HOME)
    assert control.moveJ_IK(pose, 1.5, 3.0)
    until(lambda: abs(arm.z - pose[2]) < 1e-3, "the pose")
    arm.home()
    goals = ((0.2, 0.02), (0.3, 0.02), (0.1, 0.0))
    assert control.moveJ([[*turned(angle), 1.0, 2.0, blend] for angle, blend in goals])
    arm.at(turned(0.1))
    arm.home()
    back = arm.receive.getActualTCPPose()
    assert control.moveL([[*arm.up(0.05), 0.2, 1.0, 0.01], [*back, 0.2, 1.0, 0.0]])
    arm.at(HOME)
    path, entry = rtde_control.Path(), rtde_control.PathEntry
    for joints, blend in ((turned(0.2), 0.02), (HOME, 0.0)):
        kinds = (entry.MoveJ, entry.PositionJoints)
        path.addEntry(entry(*kinds, [*joints, 1.0, 2.0, blend]))
    assert control.movePath(path)
    arm.at(HOME)


def test_moves_that_go_on_while_the_client_does(arm):
    control = arm.control
    assert control.moveJ(turned(0.5), 0.5, 1.0, True)
    until(lambda: control.getAsyncOperationProgressEx().isAsyncOperationRunning(), "a move")
    until(lambda: control.getAsyncOperationProgress() < 0, "its end")
    arm.at(turned(0.5))
    assert control.moveJ(HOME, 0.5, 1.0, True)
    until(lambda: arm.receive.getActualQ()[0] < 0.45, "a part of the way")
    control.stopJ(2.0)
    arm.rests()
    assert 0.05 < arm.receive.getActualQ()[0] < 0.45
    arm.home()
    assert control.moveL(arm.up(0.08), 0.05, 1.0, True)
    until(lambda: arm.z > HEIGHT_M + 0.01, "a part of the way")
    control.stopL(2.0)
    arm.rests()
    assert arm.z < HEIGHT_M + 0.07


def test_speeds_jogging_and_servoing_in_tool_space(arm):
    control, receive = arm.control, arm.receive
    assert control.speedJ([0.2, 0, 0, 0, 0, 0], 1.0)
    until(lambda: abs(receive.getActualQd()[0] - 0.2) < 5e-3, "the joint's speed")
    assert control.speedStop()
    arm.rests()
    arm.home()
    assert control.speedL([0, 0, 0.05, 0, 0, 0], 0.5)
    until(lambda: abs(receive.getActualTCPSpeed()[2] - 0.05) < 5e-3, "the tool's speed")
    assert control.speedStop()
    arm.rests()
    arm.home()
    assert control.jogStart([0, 0, 50, 0, 0, 0])
    until(lambda: arm.z > HEIGHT_M + 0.01, "what it jogs")
    assert control.jogStop()
    arm.rests()
    arm.home()
    pose = arm.up(0.03)
    arm.stream(lambda: control.servoL(pose, 0, 0, 0.002, 0.1, 300), 200)
    until(lambda: abs(arm.z - pose[2]) < 1e-3, "the pose")
    assert control.servoStop()


def test_contact_and_freedrive(arm):
    control = arm.control
    assert control.zeroFtSensor()
    assert control.toolContact([0, 0, 1, 0, 0, 0]) == 0
    assert control.moveUntilContact([0, 0, -0.1, 0, 0, 0])
    assert arm.z == pytest.approx(PLANE_M, abs=5e-3)
    arm.home()
    assert control.freedriveMode()
    assert control.getFreedriveStatus() == 0
    assert control.endFreedriveMode()
    assert control.teachMode()
    assert control.endTeachMode()
    arm.home()


def test_a_sensor_of_others_feels_the_payload_that_nobody_wrote_away(arm):
    control, receive = arm.control, arm.receive
    assert control.setPayload(1.0, [0.0, 0.0, 0.0])
    until(lambda: receive.getPayload() == 1.0, "the payload")
    for enable in (control.ftRtdeInputEnable, control.enableExternalFtSensor):
        assert not any(receive.getActualTCPForce())
        assert enable(True, 0.3, [0.0, 0.0, 0.05], [0.0, 0.0, 0.02])
        until(lambda: abs(receive.getActualTCPForce()[2] - 9.82) < 1e-6, "its weight")
        assert enable(False)
        until(lambda: not any(receive.getActualTCPForce()), "the arm's own sensor")
    assert control.isProgramRunning()


def test_torques_move_a_joint():
    address = own_address(3)
    with served("sim", "ur", "--host", address, "--running", "--software", "5.26"):
        arm = Arm(address)
        arm.stream(lambda: arm.control.directTorque([8.0, 0, 0, 0, 0, 0]), 50)
        assert arm.receive.getActualQ()[0] > 1e-3
        # Its program repeats the last call until the next one.
        assert arm.control.stopJ(2.0) is None
        arm.rests()
        assert arm.control.isProgramRunning()
        arm.close()


def test_answers_and_settings(arm):
    control, receive = arm.control, arm.receive
    pose = receive.getActualTCPPose()
    assert control.getInverseKinematics(pose, HOME) == pytest.approx(HOME, abs=1e-4)
    assert control.getInverseKinematicsHasSolution(pose, HOME)
    assert not control.getInverseKinematicsHasSolution([3.0, 0, 0, 0, 0, 0], HOME)
    assert control.getForwardKinematics()[:3] == pytest.approx(pose[:3], abs=1e-4)
    assert control.poseTrans([0.1, 0.2, 0.3, 0, 0, 0], [0.1, 0, 0, 0, 0, 0]) == pytest.approx(
        [0.2, 0.2, 0.3, 0, 0, 0]
    )
    assert control.isPoseWithinSafetyLimits(pose)
    assert not control.isPoseWithinSafetyLimits([3.0, 0, 0, 0, 0, 0])
    assert control.setPayload(1.5, [0, 0, 0.05])
    until(lambda: receive.getPayload() == 1.5, "the payload")
    assert control.setTcp([0, 0, 0.05, 0, 0, 0])
    assert control.getTCPOffset() == pytest.approx([0, 0, 0.05, 0, 0, 0])
    until(lambda: abs(arm.z - HEIGHT_M + 0.05) < 1e-3, "the pose of the new TCP")
    until(control.isSteady, "an arm that is steady")


def test_its_program_ends_and_comes_again(arm):
    control = arm.control
    control.stopScript()
    until(lambda: not control.isProgramRunning(), "the program's end")
    assert control.reuploadScript()
    until(control.isProgramRunning, "the program")
    arm.home()
    assert control.setWatchdog(1.0)
    for _ in range(10):
        assert control.kickWatchdog()
        time.sleep(0.05)
    assert control.isProgramRunning()
    until(lambda: not control.isProgramRunning(), "the watchdog")
    assert control.reuploadScript()
    until(control.isProgramRunning, "the program")
    control.disconnect()
    assert not control.isConnected()
    assert control.reconnect()
    until(control.isProgramRunning, "the program")
    arm.home()
