"""Channels and types of the arm's topics."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple


class Channel(NamedTuple):
    """Topic or service, as a channel of timelines."""

    name: str
    type: str
    way: Literal["heard", "latched", "sent", "called"] = "heard"


STATES, DESCRIPTION, COMMANDS = "states", "description", "commands"
"""Channels of timelines."""
TOPICS = {
    STATES: Channel("/joint_states", "sensor_msgs/msg/JointState"),
    DESCRIPTION: Channel("/robot_description", "std_msgs/msg/String", "latched"),
    COMMANDS: Channel(
        "/forward_position_controller/commands", "std_msgs/msg/Float64MultiArray", "sent"
    ),
}

_JOINT = re.compile(r"<joint\b[^>]*>")
_NAME = re.compile(r"\bname\s*=\s*[\"']([^\"']+)[\"']")
_MOVES = re.compile(r"\btype\s*=\s*[\"'](revolute|continuous|prismatic)[\"']")


def joints_of(urdf: str) -> dict[str, str]:
    """Return the kind of each moving joint, by name, in the order of the description."""
    found: dict[str, str] = {}
    for tag in _JOINT.findall(urdf):
        name, kind = _NAME.search(tag), _MOVES.search(tag)
        if name is not None and kind is not None:
            found.setdefault(name[1], kind[1])
    return found
