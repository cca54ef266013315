"""Warnings about settings that are allowed and rarely intended."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cardan.common import bounds
from cardan.drivers.base import RobotDriver
from cardan.gateway.kinematics.singularity import SINGULAR
from cardan.gateway.session.arm_assembly import (
    has_rigid_arm,
    make_collision_model,
    make_neighbor_bodies,
    make_obstacle,
    own_model,
)
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.driver_assembly import make_driver
from cardan.robots import ArmJoint, ArmModel, JointKind, arm_names, load_arm
from cardan.spatial import norm

if TYPE_CHECKING:
    from cardan.gateway.kinematics.collision import CollisionModel, Obstacle

SAME_RANGE_RAD = 0.1
"""Excess of a joint's range (rad, or m) up to which two arms count as the same."""

MOST_TURNS_RAD = 5.0 * 2.0 * math.pi
"""Largest plausible end of a joint's range: beyond it degrees were probably written as rad."""

LONGEST_M = bounds.NEAR_M.highest
"""Largest plausible length of an arm or travel: beyond it millimeters were probably written as m.
"""


def cautions(config: SessionConfig) -> list[str]:
    """Return warnings: those of the drivers about their options, bodies that are not kept apart or
    that overlap at home, and a singular home."""
    drivers = {"robot": config.robot, "device": config.device}
    found = [
        f"{key}: {words}"
        for key, table in drivers.items()
        if table is not None
        for words in make_driver(table, key).cautions()
    ]
    if config.device is not None:
        # The device is on another computer.
        given_s = config.device.options.get("max_age_s", 0.0)
        least_s = config.watchdogs.device_age_s
        if given_s > least_s:
            found.append(
                f"device: max_age_s is {given_s:g} s, but what is older than {least_s:g} s moves "
                "no arm: set device_age_s under [watchdogs], too"
            )
    if config.arm is not None and has_rigid_arm(config):
        load_arm(config.arm.model, "arm.model")
        robot = make_driver(config.robot, "robot")
        assert isinstance(robot, RobotDriver)
        found += _wider_ranges(config.arm.model, robot.capabilities.robot)
        model = own_model(config)
        obstacles = [make_obstacle(each) for each in config.obstacles]
        words = arm_cautions(model, obstacles, config.arm.collisions)
        found += [f"arm: {each}" for each in words]
        found += _touching_neighbors(config, model)
    return found


def _wider_ranges(model: str, robot: str) -> list[str]:
    """Return a warning if one of these is a built-in arm, and the other a file by which a joint
    moves farther than that arm's."""
    if not robot or (model in arm_names()) == (robot in arm_names()):
        return []
    ours, file = (model, robot) if model in arm_names() else (robot, model)
    if not Path(file).suffix:
        return []  # A name that only its driver knows.
    wider = [
        its.name
        for its, our in zip(load_arm(file).joints, load_arm(ours).joints, strict=False)
        if its.kind is not our.kind
        or our.lower - its.lower > SAME_RANGE_RAD
        or its.upper - our.upper > SAME_RANGE_RAD
    ]
    if not wider:
        return []
    return [
        f"arm: by {file} the range of {', '.join(wider)} is wider than that of a {ours} (arm.model "
        "and robot.robot): is it the file of this arm?"
    ]


def arm_cautions(
    model: ArmModel, obstacles: Sequence[Obstacle] = (), collisions: bool = True
) -> list[str]:
    """Return the warnings about an arm. Without `collisions` bodies are never kept apart."""
    found = []
    if collisions:
        if bare := model.links_without_body():
            found.append(f"{bare}; neither obstacles nor the arm itself stop them")
        if held := model.held_words():
            found.append(held)
        found += _touching(model, obstacles)
    return found + _other_units(model) + _unbent(model)


def _other_units(model: ArmModel) -> list[str]:
    """Return warnings about numbers that look like degrees or millimeters."""
    found = []
    turns, ways = [], []
    for joint in model.joints:
        if joint.kind is JointKind.REVOLUTE and _widest(joint) > MOST_TURNS_RAD:
            turns.append(f"{joint.name} ({joint.lower:g} to {joint.upper:g} rad)")
        if joint.kind is JointKind.PRISMATIC and _widest(joint) > LONGEST_M:
            ways.append(f"{joint.name} ({joint.lower:g} to {joint.upper:g} m)")
    # The first joint's place depends on the base frame, which may be far.
    steps = [*(joint.placement for joint in model.joints[1:]), model.tcp]
    long_m = sum(norm(each.position) for each in steps)
    if long_m > LONGEST_M:
        ways.append(f"the links ({long_m:.0f} m from the first joint to the TCP)")
    if turns:
        found.append(
            f"turns more than {MOST_TURNS_RAD / math.tau:g} times: {', '.join(turns)}: are these "
            "degrees? The URDF's are rad: correct it, or give lower_deg and upper_deg"
        )
    if ways:
        found.append(
            f"is longer than {LONGEST_M:g} m: {', '.join(ways)}: are these millimeters? The URDF's "
            "are m: correct it"
        )
    return found


def _widest(joint: ArmJoint) -> float:
    return max(abs(joint.lower), abs(joint.upper))


def _touching(model: ArmModel, obstacles: Sequence[Obstacle]) -> list[str]:
    """Return pairs of bodies that are left out, and those that overlap at home."""
    from cardan.gateway.kinematics.arm import ArmKinematics
    from cardan.gateway.kinematics.collision import CollisionModel

    found = []
    if pairs := model.touching_names():
        named = ", ".join(" and ".join(pair) for pair in pairs)
        found.append(f"touch in every posture, and are not kept apart: {named}")
    bodies = CollisionModel(ArmKinematics(model), obstacles)
    for (first, second), (distance, index) in _overlaps(bodies, model).items():
        remedy = (
            f'ignore = [["{first}", "{second}"]] in [collision] of the arm\'s .toml if they do so '
            "in every posture"
        )
        if bodies.with_obstacle[index]:
            remedy = "move the obstacle"
        found.append(
            f"at home {first} and {second} overlap by {distance * -1e3:.1f} mm, which ends "
            f"motions there: {remedy}, or give another home_deg"
        )
    return found


def _overlaps(bodies: CollisionModel, model: ArmModel) -> dict[tuple[str, str], tuple[float, int]]:
    """Return the distance, m, and the pair's index of each two bodies that overlap at home, by
    their names."""
    from cardan.common.arm_libraries import np

    found: dict[tuple[str, str], tuple[float, int]] = {}
    distances = bodies.at(np.array(model.home))
    for index, (names, distance) in enumerate(zip(bodies.pairs, distances, strict=True)):
        if distance < min(0.0, found.get(names, (0.0, 0))[0]):
            found[names] = distance, index
    return found


def _touching_neighbors(config: SessionConfig, model: ArmModel) -> list[str]:
    """Return warnings about bodies of neighbors that overlap with the arm's while both arms are at
    home."""
    if not config.neighbors:
        return []
    from cardan.gateway.kinematics.arm import ArmKinematics

    neighbors = make_neighbor_bodies(config)
    bodies, first = make_collision_model(config, ArmKinematics(model), neighbors), 0
    for each in neighbors:
        bodies.move(first, each.frames(each.model.home), [0.0] * len(each.shapes))
        first += len(each.shapes)
    return [
        f"neighbors: at home {theirs} and {own} overlap by {distance * -1e3:.1f} mm, which ends "
        "motions there: check base_xyz_m, or name the two in `ignore` if they do so in every "
        "posture"
        for (theirs, own), (distance, index) in _overlaps(bodies, model).items()
        if bodies.pair_solids[index][0] >= bodies.first_mover
    ]


def _unbent(model: ArmModel) -> list[str]:
    from cardan.common.arm_libraries import np
    from cardan.gateway.kinematics.arm import ArmKinematics

    value = ArmKinematics(model).smallest_singular_value(np.array(model.home), model.task.weights)
    if value >= SINGULAR:
        return []
    return [
        f"its home is singular ({value:.3f}): straight motions from there are refused or "
        "slow; give a bent home_deg in the arm's .toml"
    ]
