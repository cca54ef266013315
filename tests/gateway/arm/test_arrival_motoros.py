"""With `wait` true, the arm of a simulated MotoROS controller, which lags like a real GP8, is at
its goal when the motion is done: over TCP, by the controller's own measured joints."""

import numpy as np
import pytest

from cardan.drivers.motoros import Motoros, MotorosOptions
from cardan.gateway.arm import CartesianDevice
from cardan.gateway.arm.arrival import ArrivalOptions
from cardan.sim_peers.motoros_controller import MotorosControllerOptions, MotorosControllerPeer
from cardan.spatial import norm, rotation_between, subtract
from tests.gateway.arm.arms import QUICK, World
from tests.serving import in_a_thread
from tests.waiting import until

pytestmark = pytest.mark.matrix

ALLOWED = ArrivalOptions()


@pytest.fixture(params=["velocity", "stream"])
def cell(request):
    """The controller of ``cardan sim motoman-gp8 --plant paper``, and the arm that moves it."""
    options = MotorosControllerOptions(base_port=0, servo_on=True, plant="paper")
    with in_a_thread(MotorosControllerPeer(options)) as peer:
        robot = Motoros(
            MotorosOptions(
                motion_port=peer.motion_port,
                state_port=peer.state_port,
                io_port=peer.io_port,
                mode=request.param,
                enable="at-start",
            )
        )
        with CartesianDevice(robot, arm="gp8") as arm:
            until(lambda: arm.status().ready, "the arm's readiness")
            arm.set_parameters(QUICK)
            yield peer.controller, arm


@pytest.mark.parametrize("verb", ["movl", "movj"])
def test_wait_is_true_when_the_arm_is_there(cell, verb):
    controller, arm = cell
    pose_at = World("gp8").verbs.servo.pose_at
    x, y, z, *turn = arm.stat().pose
    goal = [x, y + 0.1, z - 0.15, *turn]
    joints = arm.inv(goal)
    motion = getattr(arm, verb)(goal)
    arrived = arm.wait(timeout_s=30.0)
    q = controller.measured_rad(0)
    assert arrived, motion
    if verb == "movj":
        assert np.abs(np.subtract(q, joints)).max() < ALLOWED.arrival_joint
    pose, meant = pose_at(q), pose_at(joints)
    assert norm(subtract(meant.position, goal[:3])) < 1e-4
    assert norm(subtract(pose.position, goal[:3])) < ALLOWED.arrival_m
    assert norm(rotation_between(pose.orientation, meant.orientation)) < ALLOWED.arrival_rad
