"""Candidates for the end link of an arm in a tree of links."""

from __future__ import annotations

import re
import shlex
from typing import NamedTuple

from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError
from cardan.robots.arm_chain import MOST_JOINTS
from cardan.robots.urdf import Tree

TOOL_NAME = re.compile(
    r"(^|[^a-z])(tool0?|tcp|ee|eef|end_effector|attachment(_site)?|gripper|grasp\w*)([^a-z]|$)"
)
"""Common names of tool frames."""

MOST_SHOWN = 12


class End(NamedTuple):
    """A candidate for the end link."""

    link: str
    joints: tuple[str, ...]
    """Moving joints on the way from the root or `base`."""
    is_tool: bool
    """True if its name is that of a tool frame."""


def ends_of(tree: Tree, base: str = "") -> list[End]:
    """Return the leaf links and all links with a tool's name that joints move, likeliest first: at
    most MOST_JOINTS joints, a tool's name, most joints, farthest out."""
    before = {joint.name for joint in tree.path(base)} if base in tree.links else set()
    last = set(tree.ends())
    found = []
    for link in tree.links:
        is_tool = TOOL_NAME.search(link.lower()) is not None
        if link in last or is_tool:
            path = [joint for joint in tree.path(link) if joint.name not in before]
            joints = tuple(joint.name for joint in path if joint.moves)
            # Fingers often mimic each other: no arm ends behind a joint that mimics another.
            if joints and all(joint.mimic is None for joint in path):
                found.append(End(link, joints, is_tool))

    def order(end: End) -> tuple[bool, bool, int, int]:
        joints = len(end.joints)
        return joints > MOST_JOINTS, not end.is_tool, -joints, -len(tree.path(end.link))

    return sorted(found, key=order)


def which_end(tree: Tree, base: str = "") -> ConfigurationError:
    """Return the error that asks the user to choose an end link."""
    ends = ends_of(tree, base)
    lines = [
        f"--tcp {shlex.quote(printable(end.link))}  # {len(end.joints)} "
        f"{'joints move' if len(end.joints) > 1 else 'joint moves'}: "
        f"{printable(', '.join(end.joints))}"
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
