"""What the parts of a session share."""

import pytest

from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.parts import Whole
from cardan.types import RobotLink, RobotState

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
    return Whole(config, robot, make_controller(config, robot), *5 * [None])


def test_a_robot_that_only_holds_shows_its_tcp_of_now(whole):
    ready = whole.tcp(joints_alone(MOVED))
    assert ready.position != whole.tcp(joints_alone(HOME)).position
    assert whole.tcp(joints_alone(MOVED, hold_reason="motion is not enabled")) == ready


def test_the_tcp_of_a_robot_that_is_lost_or_tells_no_joints_is_not_known(whole):
    assert whole.tcp(joints_alone(MOVED, RobotLink.LOST)) is None
    assert whole.tcp(joints_alone(())) is None
