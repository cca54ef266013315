"""Makes the commanded arm of a session, with the obstacles and neighbors around it."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cardan.common.options import suggestion
from cardan.drivers.base import RobotDriver
from cardan.errors import ConfigurationError
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.servo.kernel_layout import MAX_PAIRS, MAX_SHAPES
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.session.config import NeighborTable, ObstacleTable, SessionConfig
from cardan.robots import ArmModel, load_arm, require_same_arm
from cardan.robots.urdf import ARM_BASE, read_tree
from cardan.spatial import compose, inverse, norm, scale, to_rotation_vector
from cardan.types import IDENTITY_POSE, Pose, RobotCapabilities, Vector3

if TYPE_CHECKING:
    from cardan.gateway.arm.joint_space_arm import JointSpaceArm
    from cardan.gateway.arm.neighbors import NeighborBodies
    from cardan.gateway.bus.neighbors import ArmNeighbors
    from cardan.gateway.kinematics.arm import ArmKinematics
    from cardan.gateway.kinematics.base import Kinematics
    from cardan.gateway.kinematics.collision import CollisionModel, Obstacle

SAME_BASE_M, SAME_BASE_RAD = 1e-3, 2e-3
"""Difference between bases up to which two sessions describe the same place."""

FREE_JOINTS = 6
"""Joints of an arm without redundancy. An arm with more has a posture to choose: its home."""


def why_no_verbs(config: SessionConfig) -> str:
    """Return why no verbs and streams can move a session's arm; empty if they can."""
    if config.arm is None:
        return "verbs and streams need an [arm], with the model of the arm; this session has none"
    from cardan.gateway.kinematics.soft_neck import SOFT_NECKS

    if config.arm.model in SOFT_NECKS:
        return f"verbs and streams need an arm of rigid links, which {config.arm.model} is not"
    return ""


def has_rigid_arm(config: SessionConfig) -> bool:
    """Return whether a session has the model of an arm of rigid links."""
    return not why_no_verbs(config)


def make_neighbors(
    config: SessionConfig, robot: RobotDriver, controller: ArmController
) -> ArmNeighbors | None:
    """Make the subscriber to the neighbors of a session's arm, not open yet; None without any."""
    if not config.neighbors:
        return None
    from cardan.gateway.arm.joint_space_arm import JointSpaceArm
    from cardan.gateway.arm.neighbors import NeighborWatch
    from cardan.gateway.bus.neighbors import ArmNeighbors

    commanded = controller.commanded
    assert isinstance(commanded, JointSpaceArm)
    watches = [
        NeighborWatch(each, table.topic, table.max_age_s)
        for table, each in zip(config.neighbors, commanded.neighbors, strict=True)
    ]
    return ArmNeighbors(watches, controller, robot.capabilities.period_s)


def make_arm(config: SessionConfig, robot: RobotDriver) -> JointSpaceArm | None:
    """The commanded arm of a session; None without an ``[arm]`` table.

    If the robot's driver has limits of its own, the stricter of both apply. Pinocchio is only
    imported here: sessions without an arm's model start without it.
    """
    table = config.arm
    if table is None:
        return None
    from cardan.common.arm_libraries import np
    from cardan.gateway.arm.joint_space_arm import JointSpaceArm
    from cardan.gateway.kinematics.arm import ArmKinematics
    from cardan.gateway.kinematics.soft_neck import SOFT_NECKS, SoftNeck, load_soft_neck
    from cardan.gateway.servo.choice import choose_servo

    kinematics: Kinematics
    arm, collision, posture = None, None, None
    neighbors = make_neighbor_bodies(config)
    try:
        if table.model in SOFT_NECKS:
            kinematics, weights = SoftNeck(load_soft_neck(table.model)), SoftNeck.TASK
            if table.tool() != IDENTITY_POSE or config.obstacles or neighbors:
                raise ConfigurationError(
                    "", f"{table.model} takes neither tool nor obstacles nor neighbors"
                )
        else:
            model = own_model(config)
            kinematics = arm = ArmKinematics(model, table.tool())
            weights = model.task.weights
            if (config.obstacles or neighbors) and not table.i_accept_links_without_bodies:
                model.require_bodies("")
            if len(model.joints) > FREE_JOINTS:
                posture = np.array(model.home)
    except ConfigurationError as error:
        raise ConfigurationError("arm.model", str(error)) from None
    if arm is not None and table.collisions:
        collision = make_collision_model(config, arm, neighbors)
        _check_count(collision, bool(neighbors))
    able = robot.capabilities
    if able.joints != kinematics.joints:
        raise ConfigurationError(
            "arm.model",
            f"{table.model!r} has {kinematics.joints} joints, the robot as configured "
            f"{able.joints}",
        )
    require_same_arm("arm.model", table.model, able.robot)
    _check_joints(config, kinematics.names)
    _take_limits(kinematics, able)
    options = ServoOptions(
        policy=table.policy,
        speed_share=table.speed_share,
        acceleration_share=table.acceleration_share,
        safety_distance_m=table.safety_distance_m,
    )
    servo = choose_servo(kinematics, collision, options, weights)
    servo.posture = posture
    commanded = JointSpaceArm(
        servo,
        able.commands,
        able.lag_s,
        tcp_tolerance_m=table.tcp_tolerance_m,
        neighbors=neighbors,
    )
    for index, each in enumerate(neighbors):
        commanded.place_neighbor(index, each.model.home, [0.0] * len(each.shapes))
    return commanded


def own_topic(config: SessionConfig, name: str) -> str:
    """Return the absolute name of a topic that a session's node calls `name`; empty without a
    network."""
    return "" if config.network is None else config.network.absolute(name)


def disagreements(sessions: Mapping[str, SessionConfig]) -> list[str]:
    """Settings of a daemon's sessions for their neighbors that differ from the neighbors' own."""
    by_topic = {own_topic(each, "joint_states"): name for name, each in sessions.items()}
    found = []
    for name, config in sessions.items():
        for index, table in enumerate(config.neighbors):
            key = f"{name}: neighbors.{index}"
            topic = own_topic(config, table.topic)
            if topic not in by_topic:
                # It may be an arm of another system.
                found += [
                    f"{key}.topic: no session here publishes {topic}; did you mean {near!r}?"
                    for near in difflib.get_close_matches(topic, by_topic, 1, 0.9)
                ]
                continue
            other = by_topic[topic]
            arm = sessions[other].arm
            if arm is None:
                continue
            who = f"the session {other!r}"
            if arm.model != table.model:
                found.append(f"{key}.model: is {table.model!r}, and {who} has {arm.model!r}")
            if arm.acceleration_share < table.acceleration_share:
                found.append(
                    f"{key}.acceleration_share: is {table.acceleration_share:g}, and {who} has "
                    f"{arm.acceleration_share:g}: it stops later than is expected here"
                )
            back = [
                number
                for number, each in enumerate(sessions[other].neighbors)
                if _is_of(sessions, other, each, name)
            ]
            if not back:
                found.append(
                    f"{key}: {who} has no neighbor for this arm, and may drive into it: add one"
                )
            elif name < other and (
                away := _apart(_base_of(config, index), _base_of(sessions[other], back[0]))
            ):
                found.append(
                    f"{key}.base_xyz_m: by where {who} has this arm's base, the two bases are "
                    f"{away[0] * 1e3:.0f} mm and {math.degrees(away[1]):.1f} degrees off: each is "
                    "given in the other's frame"
                )
    return found


def _is_of(
    sessions: Mapping[str, SessionConfig], own: str, table: NeighborTable, other: str
) -> bool:
    """Return whether a neighbor of the session `own` is the arm of `other`."""
    return own_topic(sessions[own], table.topic) == own_topic(sessions[other], "joint_states")


def _base_of(config: SessionConfig, index: int) -> Pose:
    """Return the base of the arm of ``[[neighbors]]`` number `index`, in the base of a session's
    arm."""
    table = config.neighbors[index]
    given = table.base()
    if given is not None or not has_rigid_arm(config):
        return given or IDENTITY_POSE
    assert config.arm is not None
    model = load_arm(config.arm.model, "arm.model")
    own, theirs = (read_tree(each.urdf).fixed_links() for each in (model, load_arm(table.model)))
    common = [link for link in own if link in theirs]
    common = [link for link in common if link.rstrip("_") != ARM_BASE] or common
    key = f"neighbors.{index}.base_xyz_m"
    if not common:
        raise ConfigurationError(
            key,
            f"is missing: {config.arm.model!r} and {table.model!r} have no link in common that "
            "neither moves, as arms of one robot have; say where its base is",
        )
    found = compose(own[common[0]], inverse(theirs[common[0]]))
    for link in common[1:]:
        away = _apart(found, compose(theirs[link], inverse(own[link])))
        if away is not None:
            raise ConfigurationError(
                key,
                f"is missing: {config.arm.model!r} and {table.model!r} hold joints between "
                f"{common[0]!r} and {link!r} differently, by {away[0] * 1e3:.0f} mm and "
                f"{math.degrees(away[1]):.1f} degrees: give both files the same [hold], or say "
                "where its base is",
            )
    return found


def _apart(one: Pose, other: Pose) -> tuple[float, float] | None:
    """Return the deviation of two bases, each in the other, from being inverse: m and rad; None:
    they are inverse."""
    closed = compose(one, other)
    away = norm(closed.position), norm(to_rotation_vector(closed.orientation))
    return away if away[0] > SAME_BASE_M or away[1] > SAME_BASE_RAD else None


def make_neighbor_bodies(config: SessionConfig) -> list[NeighborBodies]:
    """Make the bodies of the arms of ``[[neighbors]]``."""
    if not config.neighbors or config.arm is None:
        return []
    from cardan.gateway.arm.neighbors import NeighborBodies

    own: set[str] = set()
    if has_rigid_arm(config):
        own |= set(load_arm(config.arm.model, "arm.model").joint_names)
    heard = {own_topic(config, "joint_states"): ("this session's own arm", own)}
    found = []
    for index, table in enumerate(config.neighbors):
        key = f"neighbors.{index}.model"
        model = load_arm(table.model, key)
        joints = set(model.joint_names)
        if table.base_xyz_m is None and joints <= own:
            raise ConfigurationError(
                f"neighbors.{index}.base_xyz_m",
                f"is missing: the joints of {table.model!r} are this arm's own, not those of "
                "another arm of the same robot; say where its base is",
            )
        if table.base_xyz_m is None and joints & own:
            both = [name for name in model.joint_names if name in own]
            link = read_tree(model.urdf).joints[both[-1]].child
            raise ConfigurationError(
                key,
                f"{table.model!r} and this arm both move {', '.join(both)}, and each would know "
                f"where it is by its own session alone: let both hold it, with base = {link!r} in "
                "their .toml files",
            )
        topic = own_topic(config, table.topic)
        who, theirs = heard.setdefault(topic, (f"the neighbor {table.name!r}", joints))
        if theirs is not joints and joints <= theirs:
            raise ConfigurationError(
                f"neighbors.{index}.topic",
                f"{topic} is that of {who}, whose joints have the same names: name the topic on "
                f"which {table.name!r} alone is published",
            )
        if not config.arm.i_accept_links_without_bodies:
            model.require_bodies(key)
        made = NeighborBodies(
            table.name,
            model,
            _base_of(config, index),
            table.acceleration_share,
            one_robot=table.base_xyz_m is None,
        )
        if not made.shapes:
            raise ConfigurationError(key, f"no link of {table.model!r} that moves has a body")
        found.append(made)
    return found


def own_model(config: SessionConfig) -> ArmModel:
    """Model of a session's rigid arm, without the links of the same robot that a neighbor moves."""
    assert config.arm is not None
    model = load_arm(config.arm.model)
    for each in config.neighbors:
        if each.base_xyz_m is None:
            model = model.without(load_arm(each.model))
    return model


def make_collision_model(
    config: SessionConfig, arm: ArmKinematics, neighbors: Sequence[NeighborBodies]
) -> CollisionModel:
    """Make the collision model of a session's arm, its obstacles and its neighbors."""
    from cardan.gateway.kinematics.collision import CollisionModel

    ignored = set()
    for index, (table, each) in enumerate(zip(config.neighbors, neighbors, strict=True)):
        own = [shape.name for shape in arm.arm.shapes if shape.body > 0]
        theirs = [shape.name for shape in each.model.shapes]
        for pair in table.ignore:
            for name, known, what in zip(
                pair, (own, theirs), ("this arm that moves", f"{table.model!r}"), strict=True
            ):
                if name not in known:
                    raise ConfigurationError(
                        f"neighbors.{index}.ignore",
                        f"there is no body {name!r} of {what}; allowed: "
                        f"{', '.join(dict.fromkeys(known))}" + suggestion(name, known),
                    )
            ignored.add((each.label(pair[1]), pair[0]))
    return CollisionModel(
        arm,
        [make_obstacle(each) for each in config.obstacles],
        movers=[each.shapes for each in neighbors],
        ignored=ignored,
    )


def _check_count(collision: CollisionModel, neighbors: bool) -> None:
    for count, most, what in (
        (len(collision.solids), MAX_SHAPES, "bodies"),
        (len(collision.pairs), MAX_PAIRS, "pairs of bodies"),
    ):
        if neighbors and count > most:
            raise ConfigurationError(
                "neighbors",
                f"with them there are {count} {what} to keep apart, and at most {most} fit: set "
                'fit = "coarse" in [collision] of the arms\' .toml files, or leave some out',
            )


def _check_joints(config: SessionConfig, names: tuple[str, ...]) -> None:
    mapping = config.mapping
    for axis, joint in mapping.joints.items():
        if joint not in names:
            raise ConfigurationError(
                f"mapping.joints.{axis}",
                f"there is no joint {joint!r}; allowed: {', '.join(names)}"
                + suggestion(joint, names),
            )
        name = axis.removeprefix("-")
        if {name, f"-{name}"} & {*mapping.axes}:
            raise ConfigurationError(
                f"mapping.joints.{axis}",
                f'the axis drives {name} as well: put "fixed" in its place in mapping.axes',
            )


def _take_limits(kinematics: Kinematics, robot: RobotCapabilities) -> None:
    from cardan.common.arm_libraries import np

    limits = robot.limits
    if limits is None:
        return
    np.maximum(kinematics.lower, limits.lower, out=kinematics.lower)
    np.minimum(kinematics.upper, limits.upper, out=kinematics.upper)
    np.minimum(kinematics.velocity, limits.velocity, out=kinematics.velocity)
    np.minimum(kinematics.acceleration, limits.acceleration, out=kinematics.acceleration)


def make_obstacle(table: ObstacleTable) -> Obstacle:
    from cardan.gateway.kinematics.collision import HalfSpace, Obstacle

    if (solid := table.shape()) is not None:
        return Obstacle(table.name, solid)
    assert table.plane is not None
    normal = Vector3(*table.plane[0])
    unit = scale(normal, 1.0 / norm(normal))
    return Obstacle(table.name, HalfSpace(unit, table.plane[1]))
