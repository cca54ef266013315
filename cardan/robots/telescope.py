"""Telescopes: consecutive slides that follow one of them, modeled as one slide.

Its position is the sum of theirs. The links between move less than its end: each is modeled with
the nearer end, and :func:`swept` extends its bodies over all their positions, so that no distance
exceeds the true one.
"""

from __future__ import annotations

import copy
import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

from cardan.errors import ConfigurationError
from cardan.robots.arm_model import Capsule, JointKind, OrientedBox, Shape
from cardan.robots.urdf import Tree, TreeJoint
from cardan.spatial import (
    add,
    conjugate,
    cross,
    dot,
    from_axes,
    multiply,
    norm,
    rotate,
    scale,
    subtract,
)
from cardan.types import IDENTITY_POSE, Pose, Vector3

_PARALLEL = 1e-6


class Sweep(NamedTuple):
    """Displacements of a link's bodies from their modeled place, along a joint of the arm, m."""

    joint: str
    low: float
    high: float


def is_telescope(tree: Tree, path: Sequence[TreeJoint], leader: TreeJoint) -> bool:
    """True if `leader` and the joints on the path that follow it are consecutive slides in the same
    direction, with only fixed joints between them."""
    row = _row(tree, path, leader)
    between = path[path.index(row[0]) : path.index(row[-1]) + 1]
    if not all(joint in row or joint.kind == "fixed" for joint in between):
        return False
    if not all(joint.kind == JointKind.PRISMATIC.value for joint in row):
        return False
    turned, directions = IDENTITY_POSE.orientation, []
    for joint in between:
        turned = multiply(turned, joint.orientation())
        if joint in row:
            directions.append(rotate(turned, joint.axis()))
    alike = all(norm(subtract(each, directions[0])) < _PARALLEL for each in directions)
    return alike and all(tree.leader(joint.name)[1] > 0.0 for joint in row)


def telescoped(
    tree: Tree, path: Sequence[TreeJoint], leader: TreeJoint
) -> tuple[Tree, dict[str, Sweep]]:
    """Return the tree with a single joint named as `leader` in place of these, and the links
    between. Raises ConfigurationError if the ranges of its joints do not overlap."""
    row = _row(tree, path, leader)
    factors, offsets = zip(*(tree.leader(joint.name)[1:] for joint in row), strict=True)
    # Sums of the motions of the first joint, the first two, ...
    ways, starts = (list(itertools.accumulate(each)) for each in (factors, offsets))
    ranges = [joint.range() for joint in row]
    low, high = (
        choose((ends[side] - o) / f for ends, f, o in zip(ranges, factors, offsets, strict=True))
        for side, choose in ((0, max), (1, min))
    )
    if not -math.inf < low < high < math.inf:
        names = ", ".join(joint.name for joint in row)
        raise ConfigurationError("", f"{names} move as one, but have no range in common")
    moving = next(number for number, way in enumerate(ways) if 2.0 * way >= ways[-1])
    sweeps = {}
    for link in tree.links:
        number = sum(joint in row for joint in tree.path(link)) - 1
        if 0 <= number < len(row) - 1:
            ends = [ways[number] * q + starts[number] for q in (low, high)]
            if number >= moving:
                ends = [
                    end - (ways[-1] * q + starts[-1])
                    for end, q in zip(ends, (low, high), strict=True)
                ]
            sweeps[link] = Sweep(leader.name, min(ends), max(ends))
    limit = ET.Element("limit")
    for name, value in {
        "lower": ways[-1] * low + starts[-1],
        "upper": ways[-1] * high + starts[-1],
        **_speeds(row, factors, ways[-1]),
    }.items():
        limit.set(name, repr(value))
    (effort,) = (each.limits()[0].effort for each in row if each.name == leader.name)
    if math.isfinite(effort):
        limit.set("effort", repr(effort / ways[-1]))
    return _replaced(tree, row, row[moving], leader, limit), sweeps


def swept(shape: Shape, direction: Vector3, sweep: Sweep) -> Shape:
    """Return a shape that contains `shape` throughout its sweep along a unit vector."""
    longer = sweep.high - sweep.low
    moved = scale(direction, 0.5 * (sweep.low + sweep.high))
    if isinstance(shape, OrientedBox):
        along = rotate(conjugate(shape.pose.orientation), direction)
        size = Vector3(*(s + abs(a) * longer for s, a in zip(shape.size_m, along, strict=True)))
        pose = Pose(add(shape.pose.position, moved), shape.pose.orientation)
        return OrientedBox(pose, size)
    middle = add(scale(add(shape.start, shape.end), 0.5), moved)
    axis = subtract(shape.end, shape.start)
    along_m = abs(dot(axis, direction)) + longer
    across = subtract(axis, scale(direction, dot(axis, direction)))
    across_m = norm(across)
    if across_m < 1e-9:
        half = scale(direction, 0.5 * along_m)
        return Capsule(subtract(middle, half), add(middle, half), shape.radius_m + across_m)
    x = scale(across, 1.0 / across_m)
    around = 2.0 * shape.radius_m
    size = Vector3(across_m + around, around, along_m + around)
    return OrientedBox(Pose(middle, from_axes(x, cross(direction, x))), size)


def _row(tree: Tree, path: Sequence[TreeJoint], leader: TreeJoint) -> list[TreeJoint]:
    return [joint for joint in path if tree.leader(joint.name)[0] == leader]


def _speeds(row: Sequence[TreeJoint], factors: Sequence[float], way: float) -> dict[str, float]:
    """Return velocity and acceleration of the end, limited by the slowest joint."""
    found = {}
    for name in ("velocity", "acceleration"):
        values = [
            getattr(joint.limits()[0], name) / factor
            for joint, factor in zip(row, factors, strict=True)
        ]
        known = [each for each in values if not math.isnan(each)]
        if known:
            found[name] = min(known) * way
    return found


def _replaced(
    tree: Tree, row: Sequence[TreeJoint], moving: TreeJoint, leader: TreeJoint, limit: ET.Element
) -> Tree:
    robot = ET.Element(tree.robot.tag, tree.robot.attrib)
    made = {}
    for joint in row:
        slides = joint == moving
        name = leader.name if slides else moving.name if joint == leader else joint.name
        kind = JointKind.PRISMATIC.value if slides else "fixed"
        element = ET.Element("joint", name=name, type=kind)
        retained = (
            ("parent", "child", "origin", "axis") if slides else ("parent", "child", "origin")
        )
        element.extend(copy.deepcopy(each) for each in joint.element if each.tag in retained)
        if slides:
            element.append(limit)
        made[joint.name] = TreeJoint(name, kind, joint.parent, joint.child, element)
    elements = {joint.element: made[joint.name].element for joint in row}
    # Its home is the sum of the joints' homes.
    frozen_elements = (each for each in tree.robot if each.tag != "group_state")
    robot.extend(elements.get(each, each) for each in frozen_elements)
    joints = [made.get(joint.name, joint) for joint in tree.joints.values()]
    return tree._replace(
        robot=robot,
        text=ET.tostring(robot, encoding="unicode"),
        joints={joint.name: joint for joint in joints},
        above={joint.child: joint for joint in joints},
    )
