"""Universal Robots' own program for external control, which its driver for ROS 2 uploads, with the
simulated controller: a client plays the driver.

The program is on no package index: CARDAN_UR_CLIENT_LIBRARY names a checkout of
github.com/UniversalRobots/Universal_Robots_Client_Library.
"""

from __future__ import annotations

import math
import os
from itertools import count
from pathlib import Path

import pytest

from cardan.protocols.ur.states import RuntimeState, SafetyMode
from cardan.sim_peers.ur_controller import UrControllerOptions
from cardan.sim_peers.ur_controller.tcp import UrControllerPeer
from tests.sim_peers.ur_reverse_client import (
    Command,
    Mode,
    Point,
    ReverseClient,
    moved,
    scaled,
    splined,
)
from tests.waiting import until

CHECKOUT = os.environ.get("CARDAN_UR_CLIENT_LIBRARY", "")
HOME = (0.0, -1.570796, 1.570796, -1.570796, -1.570796, 0.0)
STILL = (0.0,) * 6
PLANE_M = 0.4
CLOSE = 2e-3
"""With splines the arm is 8 ms behind its target, and the program starts each segment at the arm's
position."""
SUCCESS, CANCELED = 0, 1

pytestmark = [
    pytest.mark.matrix,
    pytest.mark.skipif(not CHECKOUT, reason="CARDAN_UR_CLIENT_LIBRARY names no checkout"),
]


class Setup:
    """Simulated controller, and the driver's end."""

    def __init__(self, peer, client):
        self.controller, self.motion = peer.controller, peer.controller.motion
        self.client = client

    @property
    def events(self):
        return [text for _, text in self.controller.events]

    @property
    def pose(self):
        return list(self.motion.actual_tcp_pose())

    def pose_by(self, x=0.0, y=0.0, z=0.0):
        pose = self.pose
        return [a + b for a, b in zip(pose, (x, y, z, *STILL[:3]), strict=True)]

    def reaches(self, q):
        until(lambda: math.dist(self.motion.actual_q, q) < CLOSE, f"the joints {q}")

    def rests(self):
        until(lambda: max(map(abs, self.motion.actual_qd)) < 1e-4, "rest")

    def ends(self):
        until(lambda: self.controller.runtime is RuntimeState.STOPPED, "the program's end")
        self.rests()
        assert self.controller.safety is SafetyMode.NORMAL
        assert self.events[-1] == "program externalControl has ended: its end"

    def goes_through(self, *points):
        self.client.trajectory(points)
        assert self.client.result() == SUCCESS, self.events

    def home(self):
        self.goes_through(moved(Point.MOVEJ, HOME))
        self.reaches(HOME)


def turned(angle):
    return [angle, *HOME[1:]]


def ramp(start, goal, steps=100):
    """Return a function whose results go from one list to another."""
    counted = count(1)

    def value():
        share = min(next(counted) / steps, 1.0)
        return [a + (b - a) * share for a, b in zip(start, goal, strict=True)]

    return value


@pytest.fixture(params=[("ur5e", "5.12"), ("ur5e", "5.26"), ("ur5", "3.15")], ids="-".join)
def arm(request):
    robot, software = request.param
    options = UrControllerOptions(
        robot=robot,
        software=software,
        running=True,
        rtde_port=0,
        primary_port=0,
        dashboard_port=0,
        contact_z_m=PLANE_M,
    )
    script = Path(CHECKOUT, "resources", "external_control.urscript").read_text(encoding="utf-8")
    version = (*map(int, software.split(".")), 0)
    with UrControllerPeer(options) as peer, ReverseClient(script, version) as client:
        client.upload(peer.port("secondary"))
        arm = Setup(peer, client)
        yield arm
        assert not any("exception" in event for event in arm.events), arm.events


def test_the_arm_follows_what_is_streamed(arm):
    client, motion = arm.client, arm.motion
    client.stream(Mode.SERVOJ, ramp(motion.actual_q, turned(0.1)))
    arm.reaches(turned(0.1))
    client.stream(Mode.SPEEDJ, [0.2, *STILL[1:]])
    until(lambda: abs(motion.actual_qd[0] - 0.2) < CLOSE, "the joint's speed")
    client.stream(Mode.SPEEDL, [0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    until(lambda: abs(motion.actual_tcp_speed()[2] - 0.05) < CLOSE, "the tool's speed")
    client.stream(Mode.IDLE)
    arm.rests()
    up = arm.pose_by(z=0.02)
    client.stream(Mode.POSE, ramp(arm.pose, up))
    until(lambda: math.dist(arm.pose[:3], up[:3]) < CLOSE, "the pose")
    client.pause()
    client.command(Mode.STOPPED)
    arm.ends()


def test_trajectories_of_moves_and_splines(arm):
    arm.goes_through(moved(Point.MOVEJ, turned(0.3), time_s=1.0), moved(Point.MOVEJ, HOME))
    arm.reaches(HOME)
    here, up, side = arm.pose, arm.pose_by(z=0.05), arm.pose_by(y=0.05)
    for kind in (Point.MOVEL, Point.MOVEP):
        arm.goes_through(moved(kind, up, 0.2, blend_m=0.01), moved(kind, here, 0.2))
        arm.reaches(HOME)
    arm.goes_through(moved(Point.MOVEC, side, 0.1, via=up))
    assert math.dist(arm.pose[:3], side[:3]) < CLOSE
    arm.goes_through(moved(Point.MOVEL_JOINT, HOME, 0.2))
    arm.reaches(HOME)
    arm.goes_through(
        moved(Point.MOVEC, arm.pose_by(y=0.04), 0.05, via=arm.pose_by(y=0.02, z=0.002), mode=1)
    )
    arm.goes_through(moved(Point.MOVEJ_POSE, here), moved(Point.MOVEJ_POSE, here, via=HOME, mode=1))
    arm.reaches(HOME)
    speeds = [0.1, *STILL[1:]]
    arm.goes_through(splined(turned(0.1), speeds, 1.0), splined(turned(0.2), STILL, 1.0))
    arm.reaches(turned(0.2))
    arm.goes_through(splined(turned(0.1), STILL, 1.0, STILL), splined(HOME, STILL, 1.0, STILL))
    arm.reaches(HOME)
    # The program steps in controller cycles, and meets times above 2 s up to rounding.
    arm.goes_through(
        splined(turned(0.1), speeds, 1.0),
        splined(turned(0.31), speeds, 2.1),
        splined(turned(0.4), STILL, 1.0),
    )
    arm.reaches(turned(0.4))


def test_optimal_moves_are_those_of_software_that_has_them(arm):
    up = arm.pose_by(z=0.05)
    has_them = arm.controller.options.version[:2] >= (5, 21)
    arm.goes_through(moved(Point.OPTIMOVEJ, turned(0.2), 0.5, 0.5))
    arm.reaches(turned(0.2) if has_them else HOME)
    arm.goes_through(moved(Point.OPTIMOVEL, up, 0.5, 0.5))
    assert (math.dist(arm.pose[:3], up[:3]) < CLOSE) is has_them
    assert (
        any("only supported from software 5.21.0" in event for event in arm.events) is not has_them
    )


def test_a_trajectory_is_canceled_and_another_one_runs(arm):
    slow = moved(Point.MOVEJ, turned(1.5), 0.2, 0.5)
    arm.client.trajectory([slow, *[moved(Point.MOVEJ, HOME)] * 30])
    until(lambda: arm.motion.actual_q[0] > 0.05, "a part of the way")
    arm.client.cancel()
    assert arm.client.result() == CANCELED
    arm.rests()
    assert arm.motion.actual_q[0] < 1.0
    arm.home()


def test_freedrive_and_settings_of_the_script_command_connection(arm):
    client, motion = arm.client, arm.motion
    client.freedrive(True)
    until(lambda: motion.freedrive, "freedrive")
    client.freedrive(False)
    until(lambda: not motion.freedrive, "its end")
    client.stream(Mode.IDLE)
    client.script(Command.ZERO_FTSENSOR)
    client.script(Command.SET_PAYLOAD, scaled([1.5, 0.0, 0.0, 0.05]))
    until(lambda: motion.payload.mass == 1.5, "the payload")
    assert motion.payload.cog == (0.0, 0.0, 0.05)
    client.script(Command.SET_GRAVITY, scaled([0.0, 9.82, 0.0]))
    until(lambda: motion.gravity == (0.0, 9.82, 0.0), "gravity")
    client.script(Command.SET_TOOL_VOLTAGE, scaled([24.0]))
    until(lambda: arm.controller.io.tool_voltage == 24, "the tool's voltage")
    client.script(Command.FT_RTDE_INPUT_ENABLE, [1, *scaled([0.1, 0.0, 0.0, 0.05, 0.0, 0.0, 0.02])])
    until(lambda: motion.sensor is not None, "the external sensor")
    client.script(Command.FT_RTDE_INPUT_ENABLE, [0])
    until(lambda: motion.sensor is None, "its end")
    client.script(Command.SET_TCP_OFFSET, scaled([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    until(lambda: motion.tcp.position[2] == 0.1, "the TCP")


def test_force_mode_pushes_and_a_contact_ends_a_motion(arm):
    client, motion = arm.client, arm.motion
    frame, axes, push = STILL, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -10.0, 0.0, 0.0, 0.0]
    force = [*frame, *axes, *push, 2.0, *[0.1] * 3, *[0.2] * 3, 0.1, 0.5]
    client.stream(Mode.IDLE)
    client.script(Command.START_FORCE_MODE, scaled(force))
    until(lambda: abs(motion.tcp_force()[2] - 10.0) < 0.1, "10 N")
    client.script(Command.END_FORCE_MODE)
    until(lambda: motion.force.asked is None, "the end of force mode")
    arm.rests()
    client.pause()
    arm.home()

    client.stream(Mode.IDLE)
    client.script(Command.START_TOOL_CONTACT)
    client.script(Command.END_TOOL_CONTACT)
    assert client.contact() == CANCELED
    client.script(Command.START_TOOL_CONTACT)
    client.stream(Mode.SPEEDL, [0.0, 0.0, -0.05, 0.0, 0.0, 0.0])
    assert client.contact() == SUCCESS
    arm.rests()
    assert arm.pose[2] == pytest.approx(PLANE_M, abs=2e-3)
    client.script(Command.END_TOOL_CONTACT)


@pytest.mark.parametrize("arm", [("ur5e", "5.26")], indirect=True, ids=["5.26"])
def test_torques_turn_a_joint(arm):
    arm.client.stream(Mode.TORQUE, [8.0, *STILL[1:]])
    until(lambda: arm.motion.actual_q[0] > 0.01, "a turn")
    arm.client.stream(Mode.IDLE)
    arm.rests()


@pytest.mark.parametrize("mode", [Mode.SERVOJ, Mode.SPEEDJ, Mode.FREEDRIVE])
def test_a_pause_longer_than_the_time_out_ends_program_and_motion(arm, mode):
    client, motion = arm.client, arm.motion
    if mode is Mode.FREEDRIVE:
        client.freedrive(True)
        until(lambda: motion.freedrive, "freedrive")
        client.words(mode, (), 200)
    else:
        speeds = [0.1, *STILL[1:]]
        client.stream(mode, speeds if mode is Mode.SPEEDJ else ramp(HOME, turned(2.0), 5000))
        until(lambda: motion.actual_qd[0] > 0.05, "motion")
        client.pause()
        client.command(mode, speeds if mode is Mode.SPEEDJ else turned(motion.target_q[0]), 200)
    arm.ends()
    assert not arm.motion.freedrive


def test_a_client_that_is_killed_ends_program_and_motion(arm):
    arm.client.stream(Mode.SPEEDJ, [0.1, *STILL[1:]])
    until(lambda: arm.motion.actual_qd[0] > 0.05, "motion")
    arm.client.close()
    arm.ends()
