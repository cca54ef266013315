"""Channels and types of the arm's topics."""

from __future__ import annotations

import re

STATES, DESCRIPTION, COMMANDS = "states", "description", "commands"
"""Channels of timelines."""
TOPICS = {
    STATES: ("/joint_states", "sensor_msgs/msg/JointState"),
    DESCRIPTION: ("/robot_description", "std_msgs/msg/String"),
    COMMANDS: ("/forward_position_controller/commands", "std_msgs/msg/Float64MultiArray"),
}
"""Topic and type of each."""

_JOINT = re.compile(r"<joint\b[^>]*>")
_NAME = re.compile(r"\bname\s*=\s*[\"']([^\"']+)[\"']")
_MOVES = re.compile(r"\btype\s*=\s*[\"'](?:revolute|continuous|prismatic)[\"']")


def joints_of(urdf: str) -> tuple[str, ...]:
    """Names of the joints that move, as a description has them, in its order."""
    found = []
    for tag in _JOINT.findall(urdf):
        name = _NAME.search(tag)
        if name is not None and _MOVES.search(tag):
            found.append(name[1])
    return tuple(dict.fromkeys(found))
