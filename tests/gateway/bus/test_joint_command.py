"""Joint speeds as JointState: messages of JointStateTopicSystem to a session."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from cardan.errors import MotionRefusedError
from cardan.gateway.bus.commands import joint_command
from cardan.protocols.ros2.messages import default_message
from cardan.robots import load_arm

NAMES = ("one", "two", "three")
XACRO = Path(__file__).parents[3] / "examples" / "ros2" / "cardan_arm.ros2_control.xacro"


def message(names, velocity, position=()):
    made = default_message("sensor_msgs/msg/JointState")
    return made | {"name": list(names), "velocity": list(velocity), "position": list(position)}


def test_speeds_are_ordered_by_their_names():
    command = joint_command(NAMES)
    assert (command.topic, command.verb, command.depth) == ("~/command/joints", "joints", 1)
    speeds = command.value(message(("three", "one", "two"), (0.3, 0.1, 0.2), (9.0, 9.0, 9.0)))
    assert speeds == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (message(NAMES, (), (1.0, 2.0, 3.0)), "there is no stream of joint positions"),
        (message((), ()), "takes speeds"),
        (message(NAMES, (1.0,)), "1 numbers of velocity for 3 names"),
        (message(("one", "two"), (1.0, 2.0)), "without three"),
        (message((*NAMES, "four"), (1.0,) * 4), "with four"),
        (message(("one", "two", "tree"), (1.0,) * 3), "without three and with tree"),
        (message((*NAMES, "one"), (1.0,) * 4), "one twice"),
    ],
)
def test_other_messages_are_refused_in_words(given, words):
    with pytest.raises(MotionRefusedError, match=words):
        joint_command(NAMES).value(given)


def test_the_example_commands_the_joints_of_its_arm():
    text = XACRO.read_text(encoding="utf-8")
    tag = "{http://www.ros.org/wiki/xacro}cardan_joint"
    names = [each.get("name", "") for each in ET.fromstring(text).iter(tag)]
    assert [name.removeprefix("${prefix}") for name in names] == list(load_arm("ur5").joint_names)
    assert "/command/joints" in text
    assert '<param name="trigger_joint_command_threshold">-1</param>' in text
