"""Candidates for the end link of an arm in a tree of links, and the fingers behind it."""

from __future__ import annotations

import math
import re
import shlex
from typing import NamedTuple

from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError
from cardan.robots.arm_chain import MOST_JOINTS
from cardan.robots.urdf import Tree, TreeJoint

TOOL_NAME = re.compile(
    r"(^|[^a-z])(tool0?|tcp|ee|eef|end_effector|attachment(_site)?|gripper|grasp\w*)([^a-z]|$)"
)
"""Common names of tool frames."""

FINGER_NAME = re.compile(r"finger|jaw|claw")
GRIPPER_NAME = re.compile(r"gripper")
GRIPPER_TRAVEL_RAD, GRIPPER_TRAVEL_M = math.radians(120.0), 0.2
"""Largest travel of a gripper's joint; a joint with more may turn a gripper as a wrist does."""

MOST_SHOWN = 12


class End(NamedTuple):
    """A candidate for the end link."""

    link: str
    joints: tuple[str, ...]
    """Moving joints on the way from the root or `base`."""
    is_tool: bool
    """True if its name is that of a tool frame."""
    fingers: tuple[str, ...]
    """Joints among these, the last ones, that move a finger of a gripper."""


def finger_joints(tree: Tree, link: str) -> list[TreeJoint]:
    """Return the moving joints on the way to a link that move a finger: the first one that
    :data:`FINGER_NAME` or a short travel of a gripper says so of, and all behind it; none if the
    others are no arm."""
    moving = [joint for joint in tree.path(link) if joint.moves]
    for number, joint in enumerate(moving):
        if _moves_finger(joint, joint is moving[-1]):
            return moving[number:] if number else []
    return []


def _moves_finger(joint: TreeJoint, is_last: bool) -> bool:
    names = f"{joint.name} {joint.child}".lower()
    if FINGER_NAME.search(names):
        return True
    if not is_last or joint.kind == "continuous" or not GRIPPER_NAME.search(names):
        return False
    lower, upper = joint.range()
    return upper - lower <= (GRIPPER_TRAVEL_M if joint.kind == "prismatic" else GRIPPER_TRAVEL_RAD)


def ends_of(tree: Tree, base: str = "") -> list[End]:
    """Return the leaf links, all links with a tool's name and links before fingers that joints
    move, likeliest first: at most MOST_JOINTS joints, no finger, a tool's name, most joints,
    farthest out."""
    before = {joint.name for joint in tree.path(base)} if base in tree.links else set()
    last = set(tree.ends())
    found: list[End] = []
    before_fingers: dict[str, None] = {}

    def take(link: str, is_tool: bool) -> None:
        path = [joint for joint in tree.path(link) if joint.name not in before]
        joints = tuple(joint.name for joint in path if joint.moves)
        # Fingers often mimic each other: no arm ends behind a joint that mimics another.
        if joints and all(joint.mimic is None for joint in path):
            fingers = finger_joints(tree, link)
            if fingers:
                before_fingers[fingers[0].parent] = None
            names = tuple(joint.name for joint in fingers if joint.name in joints)
            found.append(End(link, joints, is_tool, names))

    for link in tree.links:
        is_tool = TOOL_NAME.search(link.lower()) is not None
        if link in last or is_tool:
            take(link, is_tool)
    there = {end.joints for end in found}
    for link in before_fingers:
        joints = tuple(each.name for each in tree.path(link) if each.moves)
        if tuple(name for name in joints if name not in before) not in there:
            take(link, False)

    def order(end: End) -> tuple[bool, bool, bool, int, int]:
        joints, far = len(end.joints), len(tree.path(end.link))
        return joints > MOST_JOINTS, bool(end.fingers), not end.is_tool, -joints, -far

    return sorted(found, key=order)


def which_end(tree: Tree, base: str = "") -> ConfigurationError:
    """Return the error that asks the user to choose an end link."""
    ends = ends_of(tree, base)
    lines = [
        f"--tcp {shlex.quote(printable(end.link))}  # {len(end.joints)} "
        f"{'joints move' if len(end.joints) > 1 else 'joint moves'}: "
        f"{printable(', '.join(end.joints))}"
        + (f"; of a finger: {printable(', '.join(end.fingers))}" if end.fingers else "")
        for end in ends[:MOST_SHOWN]
    ]
    if len(ends) > MOST_SHOWN:
        lines.append(f"and {len(ends) - MOST_SHOWN} more")
    text = "\n".join(lines)
    return ConfigurationError(
        "--tcp",
        "the tree has several ends: name the link that the arm ends at, one of these or one before "
        f"them, the likely ones first:\n{text}",
    )
