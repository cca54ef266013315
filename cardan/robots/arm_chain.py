"""Selection of an arm's joints in a tree, and held positions of the others."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import NamedTuple

from cardan.common.options import suggestion
from cardan.errors import ConfigurationError
from cardan.robots.arm_file import ArmFile
from cardan.robots.arm_model import JointKind
from cardan.robots.telescope import Sweep, is_telescope, telescoped
from cardan.robots.urdf import LOOSE, MOVING, Tree, TreeJoint

MOST_JOINTS = 9
"""Most joints of an arm: seven on a torso of two."""

LEAST_OF_ANOTHER = 3
"""Fewest consecutive held joints beside the arm that count as another arm, or a leg; fewer are a
head or a gripper."""


class Chain(NamedTuple):
    """An arm in a tree."""

    base: str
    tcp: str
    joints: tuple[TreeJoint, ...]
    """Moving joints, in kinematic order."""
    held: dict[str, float]
    """Positions of all other joints with one direction, rad or m."""
    tree: Tree
    """Tree of the arm, in which each telescope is one joint."""
    sweeps: dict[str, Sweep]
    """Links inside telescopes."""

    def held_rows(self) -> tuple[tuple[str, str], ...]:
        """Return other arms of the tree: the first and the last joint of each."""
        own = self.tree.path(self.tcp)
        rows: dict[str, list[TreeJoint]] = {}
        for end in self.tree.ends():
            path = self.tree.path(end)
            if self.joints[-1] in path:
                continue  # Held by the arm's file.
            row = [joint for joint in path if joint.moves and joint not in own]
            if len(row) >= LEAST_OF_ANOTHER and len(row) > len(rows.get(row[0].name, ())):
                rows[row[0].name] = row
        return tuple((first, row[-1].name) for first, row in rows.items())


def unit_of(kind: str) -> float:
    """Return rad (m for a prismatic joint) per unit of the arm's file, deg (m)."""
    return 1.0 if kind == JointKind.PRISMATIC.value else math.pi / 180.0


def no_link(key: str, name: str, links: Iterable[str]) -> ConfigurationError:
    """Make the error of a setting `key` that names a link which is not among `links`."""
    there = tuple(links)
    words = f"there is no link {name!r}; allowed: {', '.join(there)}{suggestion(name, there)}"
    return ConfigurationError(key, words)


def chain_of(tree: Tree, file: ArmFile) -> Chain:
    """Select the arm. Raises ConfigurationError."""
    tcp = file.tcp or _only_end(tree)
    for key, link in (("tcp", tcp), ("base", file.base)):
        if link and link not in tree.links:
            raise no_link(key, link, tree.links)
    path = tree.path(tcp)
    if file.base:
        beside = {joint.name for joint in tree.path(file.base)}
        path = [joint for joint in path if joint.name not in beside]
    moving = [joint for joint in path if joint.moves]
    if file.joints:
        moving = _chosen(moving, file)
    if not moving:
        _refuse_loose(path)
        _refuse_lost(tree, path)
        if file.base:
            raise ConfigurationError("base", f"no joint moves between {file.base!r} and {tcp!r}")
        raise ConfigurationError("", "the arm's URDF has no moving joint")
    if len(moving) > MOST_JOINTS:
        raise ConfigurationError(
            "joints",
            f"{len(moving)} joints move, at most {MOST_JOINTS} can: {_names(moving)}; name those "
            "that are to, the others are held",
        )
    first = path.index(moving[0])
    _refuse_loose(path[first:])
    _refuse_lost(tree, path[first:])
    if (leader := _leader_of_telescope(tree, path, moving)) is not None:
        joined, sweeps = telescoped(tree, path, leader)
        chain = chain_of(joined, file)
        return chain._replace(sweeps={**sweeps, **chain.sweeps})
    welded = all(joint.kind == "fixed" for joint in path[:first])
    return Chain(
        file.base or (tree.root if welded else moving[0].parent),
        tcp,
        tuple(moving),
        _held(tree, moving, file),
        tree,
        {},
    )


def _names(joints: list[TreeJoint]) -> str:
    return ", ".join(joint.name for joint in joints)


def _only_end(tree: Tree) -> str:
    ends = tree.ends()
    if len(ends) > 1:
        parents = [joint.parent for joint in tree.joints.values()]
        branching = next(link for link in tree.links if parents.count(link) > 1)
        raise ConfigurationError(
            "tcp",
            f"link {branching!r} branches: name the link that the arm ends at, {', '.join(ends)} "
            "or one before them",
        )
    return ends[0]


def _chosen(moving: list[TreeJoint], file: ArmFile) -> list[TreeJoint]:
    there = {joint.name for joint in moving}
    for name in file.joints:
        if name not in there:
            raise ConfigurationError(
                "joints",
                f"the arm has no moving joint {name!r}; allowed: {_names(moving)}"
                + suggestion(name, there),
            )
    return [joint for joint in moving if joint.name in file.joints]


def _refuse_loose(path: list[TreeJoint]) -> None:
    for joint in path:
        if joint.kind in LOOSE:
            raise joint.refused()


def _refuse_lost(tree: Tree, path: list[TreeJoint]) -> None:
    for joint in path:
        leader = tree.leader(joint.name)[0]
        if leader.mimic is not None:
            followed = leader.mimic.get("joint", "")
            raise ConfigurationError(
                "", f"joint {joint.name!r} mimics {followed!r}, which cannot be followed"
            )


def _leader_of_telescope(
    tree: Tree, path: list[TreeJoint], moving: list[TreeJoint]
) -> TreeJoint | None:
    """Return the first of the arm's joints that others follow. Raises ConfigurationError if they
    are not a telescope."""
    for joint in path:
        leader = tree.leader(joint.name)[0]
        if joint.mimic is None or leader not in moving:
            continue
        if not is_telescope(tree, path, leader):
            raise _mimicry(joint, leader, moving)
        return leader
    return None


def _mimicry(joint: TreeJoint, leader: TreeJoint, moving: list[TreeJoint]) -> ConfigurationError:
    """Make the error of a `joint` that follows `leader` if both are within the arm."""
    others = json.dumps([each.name for each in moving if each is not leader], ensure_ascii=False)
    if len(moving) == 1:
        return ConfigurationError(
            "joints",
            f"joint {joint.name!r} mimics {leader.name!r}, and they are not a telescope: no other "
            "joint moves that could be an arm's",
        )
    return ConfigurationError(
        "joints",
        f"joint {joint.name!r} mimics {leader.name!r}, and they are not a telescope: write joints ="
        f" {others} into the arm's .toml, without {leader.name!r}, and both are held",
    )


def _held(tree: Tree, moving: list[TreeJoint], file: ArmFile) -> dict[str, float]:
    others = {
        name: joint
        for name, joint in tree.joints.items()
        if joint.kind in MOVING and joint not in moving
    }
    given = {}
    for name, value in file.hold.items():
        key = f"hold.{name}"
        if name not in others:
            raise ConfigurationError(
                key, f"there is no such joint to hold; allowed: {', '.join(others) or 'none'}"
            )
        unit = unit_of(others[name].kind)
        lower, upper = others[name].range()
        given[name] = value * unit
        if not lower <= given[name] <= upper:
            raise ConfigurationError(
                key, f"{value:g} is outside {lower / unit:g} to {upper / unit:g}"
            )
    return {name: tree.resting(name, given) for name in others}
