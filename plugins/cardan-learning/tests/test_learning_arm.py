"""An arm driven by actions, in virtual time: no jump for any action, the returned action is the one
sent, and silence brakes the arm."""

import math

import numpy as np
import pytest

from cardan.errors import CommandError, MotionRefusedError
from cardan.gateway.operator.mapping import MappingOptions
from cardan.spatial import norm, rotation_between
from cardan.types import Frame, RobotLink
from cardan_learning.arm import ArmActions
from cardan_learning.features import ActionKind, pose_of
from cardan_learning.goal import Approach
from tests.gateway.arm.arms import DT_S, World
from tests.gateway.arm.ticked import FRAME, Ticked


class Driven:
    """A simulated UR5 and a program that sends an action in each frame."""

    def __init__(self, kind="delta", gripped=None, **mapping):
        more = {} if gripped is None else {"gripper": gripped.append}
        self.world = World(**more)
        model = self.world.model
        self.actions = ArmActions(
            Ticked(self.world),
            model.joint_names,
            ActionKind(kind),
            MappingOptions(**mapping),
            gripped is not None,
        )
        self.reported = dict.fromkeys(self.actions.action_names, 0.0)
        if kind == "delta" and gripped is not None:
            self.reported["gripper"] = 1.0

    def frame(self, **numbers):
        """Act for a frame; return the action actually sent."""
        sent = self.actions.act({**self.reported, **numbers}, self.world.now_s)
        self.world.tick(FRAME)
        return sent

    def six(self):
        return np.array(self.world.verbs.stat().pose)

    def asked(self, six, **more):
        return self.frame(**dict(zip(self.actions.action_names, six, strict=False)), **more)


def test_observed_are_joints_and_tcp():
    arm = Driven(gripped=[])
    seen = arm.actions.observe()
    assert tuple(seen) == arm.actions.observation_names
    assert list(seen.values())[:6] == pytest.approx(list(arm.world.q))
    assert list(seen.values())[6:9] == pytest.approx(arm.six()[:3])
    assert seen["gripper.pos"] == 100.0


def test_deltas_are_shares_of_full_speed_and_come_back_as_sent():
    arm = Driven(linear_speed_m_s=0.1)
    before = arm.six()
    for _ in range(30):
        sent = arm.frame(delta_z=-0.5)
    assert arm.actions.why_not == ""
    assert sent["delta_z"] == pytest.approx(-0.5, abs=0.02)
    assert sent["delta_x"] == pytest.approx(0.0, abs=0.02)
    assert arm.six()[2] - before[2] == pytest.approx(-0.05 * 30 * FRAME * DT_S, rel=0.1)
    for _ in range(20):
        sent = arm.frame()
    assert sent == pytest.approx(dict.fromkeys(sent, 0.0), abs=1e-6)


def test_more_than_full_speed_is_full_speed():
    arm = Driven(linear_speed_m_s=0.1)
    for _ in range(20):
        sent = arm.frame(delta_x=50.0)
    assert 0.0 < sent["delta_x"] <= 1.01


def test_deltas_along_the_tools_axes():
    arm = Driven(frame=Frame.TOOL, linear_speed_m_s=0.1)
    before = pose_of(arm.six())
    for _ in range(30):
        sent = arm.frame(delta_z=-0.5)
    assert sent["delta_z"] == pytest.approx(-0.5, abs=0.02)
    way = np.array(arm.six()[:3]) - before.position
    rotation = arm.world.tcp[1]
    assert rotation.T @ way / np.linalg.norm(way) == pytest.approx([0, 0, -1.0], abs=0.05)


def test_silence_brakes_and_the_next_action_goes_on():
    arm = Driven()
    for _ in range(10):
        arm.frame(delta_z=-1.0)
    arm.world.tick(int(2.0 / DT_S))
    assert arm.world.verbs.at_rest
    before = arm.six()
    for _ in range(20):
        arm.frame(delta_z=0.5)
    assert arm.actions.why_not == ""
    assert arm.six()[2] > before[2] + 0.005


def test_rest_begins_no_stream():
    arm = Driven()
    arm.frame()
    assert arm.world.verbs.status().authority.owner == ""


def test_a_target_is_counted_from_where_it_was_enabled():
    arm = Driven("target")
    before = arm.six()
    held = arm.frame(enabled=0.0, target_x=0.5)
    assert held == dict.fromkeys(held, 0.0)
    assert arm.six() == pytest.approx(before, abs=1e-6)
    for step in range(60):
        sent = arm.frame(enabled=1.0, target_z=-0.001 * step)
    assert arm.six()[2] == pytest.approx(before[2] - 0.059, abs=0.01)
    assert sent["enabled"] == 1.0
    assert sent["target_z"] == pytest.approx(arm.six()[2] - before[2], abs=0.005)
    arm.frame(enabled=0.0)
    arm.world.rest()
    rested = arm.six()
    for _ in range(40):
        arm.frame(enabled=1.0, target_x=0.01)
    assert arm.six()[:3] - rested[:3] == pytest.approx([0.01, 0.0, 0.0], abs=0.003)


def test_a_target_turns_about_the_axes_that_the_mapping_says():
    for frame, matrix in ((Frame.BASE, False), (Frame.MIXED, True)):
        arm = Driven("target", frame=frame)
        before = arm.world.tcp[1]
        for step in range(1, 60):
            arm.frame(enabled=1.0, target_wz=min(0.2, 0.004 * step))
        turned = arm.world.tcp[1]
        angle = before.T @ turned if matrix else turned @ before.T
        assert math.atan2(angle[1, 0], angle[0, 0]) == pytest.approx(0.2, abs=0.02)


def test_the_first_pose_is_approached_however_far_it_is():
    arm = Driven("pose", approach_speed_m_s=0.05)
    before = arm.six()
    goal = np.add(before, (0.0, 0.12, 0.0, 0.0, 0.0, 0.0))
    for _ in range(31):
        sent = arm.asked(goal)
    way = arm.six()[1] - before[1]
    assert 0.02 < way < 0.06  # motion of a second at 0.05 m/s
    assert sent["ee.y"] - before[1] == pytest.approx(way, abs=0.01)
    for _ in range(200):
        sent = arm.asked(goal)
    assert arm.six() == pytest.approx(goal, abs=0.003)
    assert list(sent.values())[:3] == pytest.approx(goal[:3], abs=0.003)


def test_a_pose_that_jumps_on_the_way_is_approached_too():
    arm = Driven("pose", approach_speed_m_s=0.05)
    here = arm.six()
    for _ in range(5):
        arm.asked(here)
    for _ in range(15):
        arm.asked(here - [0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    assert arm.actions.why_not == ""
    assert 0.0 < here[2] - arm.six()[2] < 0.04


def test_poses_that_follow_each_other_are_followed_closely():
    arm = Driven("pose")
    here = arm.six()
    for step in range(60):
        arm.asked(np.add(here, (0.0, 0.0, -0.002 * step, 0.0, 0.0, 0.0)))
    assert here[2] - arm.six()[2] == pytest.approx(0.118, abs=0.03)


@pytest.mark.parametrize("kind", ["delta", "target", "pose"])
def test_a_robot_that_is_not_ready_is_reported_and_holds(kind):
    arm = Driven(kind)
    arm.world.hold_reason = "motors are off"
    arm.world.tick(5)
    before = arm.six()
    first = next(iter(arm.actions.action_names))
    numbers = dict(zip(arm.actions.action_names, before, strict=False)) if kind == "pose" else {}
    sent = arm.frame(**{**numbers, first: before[0] + 0.05 if kind == "pose" else 1.0})
    assert "motors are off" in arm.actions.why_not
    assert arm.six() == pytest.approx(before)
    if kind == "pose":
        assert sent["ee.x"] == pytest.approx(before[0])
    arm.world.hold_reason = ""
    arm.world.tick(5)
    arm.frame(**numbers)
    assert arm.actions.why_not == ""


def test_a_silent_robot_is_not_observed():
    arm = Driven()
    arm.world.link = RobotLink.LOST
    arm.world.tick(5)
    with pytest.raises(MotionRefusedError):
        arm.actions.observe()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_move_nothing(bad):
    arm = Driven()
    before = arm.six()
    with pytest.raises(CommandError, match=r"'delta_y' is -?(nan|inf): nothing is sent"):
        arm.frame(delta_y=bad)
    assert arm.six() == pytest.approx(before)
    with pytest.raises(CommandError, match="without 'delta_wz'"):
        arm.actions.act(dict.fromkeys(arm.actions.action_names[:-1], 0.0), 0.0)


def test_the_gripper_of_deltas():
    done = []
    arm = Driven(gripped=done)
    assert arm.frame()["gripper"] == 1.0
    assert arm.frame(gripper=0.0)["gripper"] == 0.0
    assert arm.frame(gripper=0.0)["gripper"] == 1.0  # already closed
    assert arm.actions.observe()["gripper.pos"] == 0.0
    assert arm.frame(gripper=2.0)["gripper"] == 2.0
    assert [each.name for each in done] == ["CLOSE", "OPEN"]


def test_the_gripper_of_targets_and_poses():
    done = []
    arm = Driven("target", gripped=done)
    assert arm.frame(gripper_vel=-1.0)["gripper_vel"] == -1.0
    assert arm.frame(gripper_vel=0.0)["gripper_vel"] == 0.0
    assert arm.frame(gripper_vel=1.0)["gripper_vel"] == 1.0
    arm = Driven("pose", gripped=done)
    here = arm.six()
    assert arm.asked(here, **{"ee.gripper_pos": 10.0})["ee.gripper_pos"] == 0.0
    assert arm.asked(here, **{"ee.gripper_pos": 90.0})["ee.gripper_pos"] == 100.0
    assert [each.name for each in done] == ["CLOSE", "OPEN", "CLOSE", "OPEN"]


def test_a_gripper_that_refuses_is_reported():
    def refuse(_action):
        raise CommandError("no air")

    class Refusing(list):
        append = staticmethod(refuse)

    arm = Driven(gripped=Refusing())
    sent = arm.frame(gripper=0.0)
    assert sent["gripper"] == 1.0
    assert "no air" in arm.actions.why_not


def test_an_approach_waits_for_an_arm_that_does_not_follow():
    approach = Approach(MappingOptions(slip_m=0.05))
    start, goal = pose_of((0.4, 0, 0.4, 0, 0, 0)), pose_of((0.9, 0, 0.4, 0, 0, 1.0))
    approach.engage(start)
    for _ in range(500):
        at = approach.step(goal, start, 0.1)
    assert norm(np.subtract(at.position, start.position)) <= 0.05 + 1e-9
    assert norm(rotation_between(start.orientation, at.orientation)) <= 0.6 + 1e-9
    assert not approach.arrived
    tcp = start
    for _ in range(500):
        tcp = approach.step(goal, tcp, 0.1)
    assert approach.arrived
    assert tcp == goal
