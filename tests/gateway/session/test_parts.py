"""Behavior common to the parts of a session."""

import dataclasses
from types import SimpleNamespace

import pytest

from cardan.gateway.arm.loop import Cycle
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.parts import REFUSAL_SHOWN_S, Now, Operator, Whole
from cardan.gateway.session.snapshot import Snapshot
from cardan.types import (
    ButtonEvent,
    DeviceLink,
    DeviceState,
    RobotLink,
    RobotState,
)

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
MOVED = (0.3, *HOME[1:])


def joints_alone(joints, link=RobotLink.LIVE, hold_reason=""):
    return RobotState(0.0, link, 1, 0, 0.004, joints, (), None, hold_reason)


@pytest.fixture(scope="module")
def whole():
    config = parse_config(
        {
            "device": {"driver": "spacemouse"},
            "robot": {"driver": "sim_arm", "robot": "ur5", "pacing": "virtual"},
            "arm": {"model": "ur5"},
            "mapping": {"deadman": "left"},
        }
    )
    robot = make_robot(config)
    return Whole(config, robot, make_controller(config, robot), *4 * [None])


def test_a_robot_that_only_holds_shows_its_tcp_of_now(whole):
    ready = whole.tcp(joints_alone(MOVED))
    assert ready.position != whole.tcp(joints_alone(HOME)).position
    assert whole.tcp(joints_alone(MOVED, hold_reason="motion is not enabled")) == ready


def test_the_tcp_of_a_robot_that_is_lost_or_tells_no_joints_is_not_known(whole):
    assert whole.tcp(joints_alone(MOVED, RobotLink.LOST)) is None
    assert whole.tcp(joints_alone(())) is None


class Enabled:
    """A robot's driver that counts how often it is enabled."""

    def __init__(self):
        self.times = 0

    def enable(self):
        self.times += 1


def operator(whole):
    lease = SimpleNamespace(held=False, problem="")
    robot = Enabled()
    config = dataclasses.replace(
        whole.config, mapping=dataclasses.replace(whole.config.mapping, enable="right")
    )
    whole = dataclasses.replace(whole, config=config, robot=robot)
    whole.controller.operator.mapping.options = config.mapping
    return Operator(whole, None, lease, False), robot


def test_a_press_of_the_enable_button_that_is_refused_is_said_for_a_while(whole):
    part, robot = operator(whole)
    status = SimpleNamespace(filters=())

    def said(*held, pressed_s, now_s):
        device = DeviceState(pressed_s, DeviceLink.LIVE, (0.0,) * 6, frozenset(held))
        cycle = Cycle(joints_alone(HOME), device, [ButtonEvent(pressed_s, "right", True)], None)
        part.after(cycle._replace(robot=cycle.robot._replace(stamp_s=pressed_s)), pressed_s)
        snapshot = Snapshot()
        part.tell(snapshot, Now(cycle, status, now_s))
        return snapshot.diagnosis

    refused = ["'right' enables nothing while 'left' is held: let go, then press it again"]
    assert said("left", "right", pressed_s=1.0, now_s=1.1) == refused
    assert robot.times == 0
    assert said("left", "right", pressed_s=2.0, now_s=2.0 + REFUSAL_SHOWN_S) == []
    assert said("right", pressed_s=9.0, now_s=9.1) == []
    assert robot.times == 1
