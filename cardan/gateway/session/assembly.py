"""Makes the parts of a session as its configuration has them; nothing is opened.

The configuration is compared with what devices, robots, filters and arms can do: errors name keys.
"""

from __future__ import annotations

import contextlib
import difflib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from cardan.common.options import suggestion
from cardan.common.places import in_file
from cardan.common.plugins import not_installed, reason
from cardan.common.tables import as_table, keys_of, read_table, read_toml, resolved
from cardan.drivers import registry
from cardan.drivers.base import Driver, OperatorDevice, RobotDriver
from cardan.drivers.haptic import HapticDevice
from cardan.errors import (
    ConfigurationError,
    ExtraMissingError,
    MotionRefusedError,
    below,
    together,
)
from cardan.gateway.arm.authority import Authority
from cardan.gateway.arm.body import Body, FreeBody
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.vocab import Action
from cardan.gateway.force.conditioning import Conditioner
from cardan.gateway.force.fixtures import FixtureSet
from cardan.gateway.force.input import ForceInput
from cardan.gateway.force.network import NetworkSource
from cardan.gateway.force.rendering import ForceRenderer
from cardan.gateway.force.service import RemoteSource
from cardan.gateway.force.sources import (
    ContactSource,
    ForceSource,
    MeasuredSource,
    SensorSource,
)
from cardan.gateway.force.stability import fixture_warning, loop_warning
from cardan.gateway.force.tables import (
    ContactForceTable,
    ForceTable,
    MeasuredForceTable,
    NetworkForceTable,
    NoForceTable,
    RemoteForceTable,
    SensorForceTable,
    StiffFixtureTable,
)
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.gateway.operator.input import OperatorInput
from cardan.gateway.operator.mapping import AXES, GripperOptions, MappingOptions, Mode, TwistMapping
from cardan.gateway.operator.position import mirrors, unfollowed
from cardan.gateway.servo.kernel_layout import MAX_PAIRS, MAX_SHAPES
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.status import SINGULAR
from cardan.gateway.session.config import (
    ArmTable,
    ForceConfig,
    HapticConfig,
    LimitsTable,
    NeighbourTable,
    ObstacleTable,
    SessionConfig,
    parse_config,
)
from cardan.robots import ArmModel, load_arm
from cardan.robots.urdf import ARM_BASE, read_tree
from cardan.spatial import compose, inverse, norm, scale, to_rotation_vector
from cardan.types import (
    IDENTITY_POSE,
    CommandKind,
    DeviceCapabilities,
    DeviceState,
    Pose,
    RobotCapabilities,
    Vector3,
)

if TYPE_CHECKING:
    from cardan.gateway.arm.arm_body import ArmBody
    from cardan.gateway.arm.neighbours import NeighbourBodies
    from cardan.gateway.arm.options import ControllerOptions
    from cardan.gateway.arm.verbs import ArmVerbs
    from cardan.gateway.bus.neighbours import ArmNeighbours
    from cardan.gateway.kinematics.arm import ArmKinematics
    from cardan.gateway.kinematics.base import Kinematics
    from cardan.gateway.kinematics.collision import CollisionModel, Obstacle
    from cardan.gateway.session.network import SessionNetwork

Part = TypeVar("Part")


ARM_COMMANDS = frozenset({CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE})
"""Commands of which a robot must take one for a session to drive it by the model of its arm."""

SHAPED_FORCES = (RemoteForceTable, NetworkForceTable)
"""Sources whose forces are scaled for the hand already."""

OWN_BODY_SHARE = 0.5
"""Share of the safety distance that a planned way keeps between parts of the arm itself: their
positions are known exactly, and a home position may have them near."""

SAME_BASE_M, SAME_BASE_RAD = 1e-3, 2e-3
"""Two sessions mean one place by bases that differ by less."""

FREE_JOINTS = 6
"""Joints of an arm without redundancy. One with more has a posture to choose: its home."""


def make_driver(table: registry.DriverTable, key: str) -> Driver:
    """The driver of a table, not opened yet; errors name `key`, which is "robot" for a robot's."""
    with below(key):
        driver = _driver_class(table.driver, RobotDriver if key == "robot" else OperatorDevice)
    with using_driver(table, key):
        made = driver(read_table(driver.Options, table.options, key))
        able: object = getattr(made, "capabilities", None)
    wrong = ""
    if not isinstance(able, (DeviceCapabilities, RobotCapabilities)):
        wrong = f"its capabilities are {able!r:.60}"
    elif table.driver not in registry.BUILT_IN:
        wrong = _breach(made)
    if wrong:
        raise ConfigurationError(
            f"{key}.driver", f"driver {table.driver!r} cannot be used: {wrong}"
        )
    return made


def using_driver(
    table: registry.DriverTable | None, key: str
) -> contextlib.AbstractContextManager[None]:
    """What another package's driver raises inside is an error of its table, which `key` names."""
    return (
        contextlib.nullcontext() if table is None else registry.using(table.driver, f"{key}.driver")
    )


def _breach(driver: Driver) -> str:
    """How a driver that is not open breaks its interface, in words; empty: not seen."""
    calls: list[tuple[Callable[[], object], Any]] = [
        (driver.diagnosis, Sequence),
        (driver.cautions, Sequence),
        (driver.endpoints, Sequence),
        (driver.metrics, Mapping),
        (driver.protocol_errors, Mapping),
    ]
    if isinstance(driver, OperatorDevice):
        calls += [(driver.state, DeviceState), (driver.button_events, Sequence)]
    for call, kind in calls:
        try:
            given = call()
        except Exception as error:
            return f"{call.__name__}() of one that is not open fails: {reason(error)}"
        if not isinstance(given, kind):
            word = {Sequence: "a sequence", Mapping: "a mapping"}.get(kind, "a DeviceState")
            return f"{call.__name__}() of one that is not open gives {given!r:.60}, not {word}"
    return ""


def _driver_class(name: str, side: type[Driver]) -> type[Driver]:
    """The class of a driver, which must be of this `side`: OperatorDevice or RobotDriver."""
    try:
        driver = registry.load(name)
    except ConfigurationError as error:
        if name in registry.names() or not_installed("driver", name):
            raise
        allowed = _drivers(side)
        near = suggestion(name, allowed) or suggestion(name, registry.names())
        raise ConfigurationError(
            error.key, f"there is no driver {name!r}; allowed: {', '.join(allowed)}{near}"
        ) from None
    if not issubclass(driver, side):
        words = "{0!r} is not an operator device: it drives a robot, and is for [robot]"
        if side is RobotDriver:
            words = "{0!r} is not a robot: it reads an operator device, and is for [device]"
        raise ConfigurationError(
            "driver", f"{words.format(name)}; allowed: {', '.join(_drivers(side))}"
        )
    return driver


def _drivers(side: type[Driver]) -> list[str]:
    found = registry.load_all().classes.items()
    return [name for name, driver in found if issubclass(driver, side)]


class WithDevice(Protocol):
    """What is read of a file with ``[device]``."""

    @property
    def device(self) -> registry.DriverTable | None: ...


def make_device(config: WithDevice) -> OperatorDevice:
    """The operator device that is configured, not opened yet."""
    if config.device is None:
        raise ConfigurationError("device", "is missing: which driver reads the operator device?")
    device = make_driver(config.device, "device")
    assert isinstance(device, OperatorDevice)
    return device


def check_buttons(config: SessionConfig, device: OperatorDevice) -> None:
    """Raise ConfigurationError for buttons that a device, as far as it knows its own, has not."""
    known, further = device.capabilities.buttons, device.capabilities.further_buttons
    mapping = config.mapping
    for key, button in (
        *(("mapping.deadman", button) for button in mapping.deadman_buttons),
        ("mapping.clutch", mapping.clutch),
        ("mapping.recapture", mapping.recapture),
        ("mapping.enable", mapping.enable),
        ("mapping.pass_on", mapping.pass_on),
        *((f"gripper.{each.value}", name) for name, each in config.gripper.buttons.items()),
    ):
        if button and known and button not in (*known, *further):
            raise ConfigurationError(
                key,
                f"the device has no button {button!r}; it has: {', '.join(known)}"
                + suggestion(button, known),
            )


def check_mode(mapping: MappingOptions, device: OperatorDevice) -> None:
    """Raise ConfigurationError when the device does not measure what the mapping wants."""
    able = device.capabilities
    if mapping.mode is Mode.RATE and not able.gives_axes:
        raise ConfigurationError(
            "mapping.mode", 'this device measures the hand\'s pose: set mode = "position"'
        )
    if mapping.mode is not Mode.RATE and not able.gives_pose:
        raise ConfigurationError(
            "mapping.mode", 'this device measures deflections: set mode = "rate"'
        )


def make_robot(config: SessionConfig) -> RobotDriver:
    """The robot of a session, not opened yet."""
    robot = make_driver(config.robot, "robot")
    assert isinstance(robot, RobotDriver)
    kinds = ", ".join(sorted(kind.value for kind in robot.capabilities.commands))
    if config.arm is None and CommandKind.POSE not in robot.capabilities.commands:
        raise ConfigurationError(
            "robot",
            f"as configured it takes {kinds}; without an [arm] table, which names the arm's model, "
            "a session needs it to take poses",
        )
    if config.arm is not None and not ARM_COMMANDS & robot.capabilities.commands:
        raise ConfigurationError(
            "robot",
            f"as configured it takes {kinds}; a session with an [arm] needs one of "
            + ", ".join(sorted(kind.value for kind in ARM_COMMANDS)),
        )
    _check_speeds(config.limits, robot.capabilities)
    return robot


def make_controller(config: SessionConfig, robot: RobotDriver) -> ArmController:
    """The controller of a session's arm, with its operator device where there is one."""
    limits, watchdogs = config.limits, config.watchdogs
    arm = make_arm(config, robot)
    body: Body = FreeBody(limits) if arm is None else arm
    hand = None
    if config.device is not None:
        mapping = TwistMapping(config.mapping, config.gripper)
        hand = OperatorInput(mapping, limits, make_filters(config), watchdogs.device_age_s)
    return ArmController(
        body,
        limits,
        watchdogs,
        hand,
        Authority(config.authority, "" if config.network is None else config.network.source),
        period_s=robot.capabilities.period_s,
        gate=None if arm is None else arm.gate_limits(robot.capabilities),
    )


def why_no_verbs(config: SessionConfig) -> str:
    """Why no verbs and streams can move a session's arm; empty where they can."""
    if config.arm is None:
        return "verbs and streams need an [arm], with the model of the arm; this session has none"
    from cardan.gateway.kinematics.soft_neck import SOFT_NECKS

    if config.arm.model in SOFT_NECKS:
        return f"verbs and streams need an arm of rigid links, which {config.arm.model} is not"
    return ""


def has_rigid_arm(config: SessionConfig) -> bool:
    """Whether a session has the model of an arm of rigid links."""
    return not why_no_verbs(config)


def make_verbs(
    config: SessionConfig,
    robot: RobotDriver,
    controller: ArmController,
    gripper: Callable[[Action], None] | None,
) -> ArmVerbs:
    """The verbs of a session's arm, on the controller that it has, within the session's limits.

    Takes tens of milliseconds. Raises MotionRefusedError where the session has no rigid arm.
    """
    if why := why_no_verbs(config):
        raise MotionRefusedError(why)
    from cardan.gateway.arm.arm_body import ArmBody
    from cardan.gateway.arm.verbs import ArmVerbs, narrowed
    from cardan.gateway.kinematics.arm import ArmKinematics

    table, body = config.arm, controller.body
    assert table is not None
    assert isinstance(body, ArmBody)
    model = narrowed(_own_model(config), robot.capabilities)
    joints = tuple(
        joint._replace(
            velocity=joint.velocity * table.speed_share,
            acceleration=joint.acceleration * table.acceleration_share,
        )
        for joint in model.joints
    )
    model = model._replace(joints=joints, shapes=model.shapes if table.collisions else ())
    body.keep_sent_as(ArmKinematics(model, table.tool()))
    return ArmVerbs(
        controller,
        body,
        model,
        robot.capabilities,
        make_verb_options(config),
        obstacles=[_obstacle(each) for each in config.obstacles],
        gripper=gripper if has_output(config.gripper, robot.capabilities) else None,
    )


def make_verb_options(config: SessionConfig) -> ControllerOptions:
    """The limits and options of the verbs of a session that has an ``[arm]``."""
    from cardan.gateway.arm.options import STREAM_LIMITS, ControllerOptions
    from cardan.gateway.arm.planner import Margins

    table, limits = config.arm, config.limits
    assert table is not None
    return ControllerOptions(
        limits=limits,
        streams=replace(
            limits,
            linear_jerk_m_s3=limits.linear_jerk_m_s3 or STREAM_LIMITS.linear_jerk_m_s3,
            angular_jerk_rad_s3=limits.angular_jerk_rad_s3 or STREAM_LIMITS.angular_jerk_rad_s3,
        ),
        stop_deceleration_m_s2=limits.linear_acceleration_m_s2,
        stop_deceleration_rad_s2=limits.angular_acceleration_rad_s2,
        margins=Margins(
            obstacle_m=table.safety_distance_m,
            own_body_m=OWN_BODY_SHARE * table.safety_distance_m,
        ),
        arrival=table,
    )


def make_network(
    config: SessionConfig,
    robot: RobotDriver,
    offer: Callable[[Any, Any, float], None],
    full: Callable[[], bool],
) -> SessionNetwork | None:
    """What shows the arm to the network, not open yet; None where none is configured."""
    options = config.network
    if options is None:
        return None
    from cardan.gateway.bus.arm_topics import ArmNames
    from cardan.gateway.session.network import SessionNetwork
    from cardan.gateway.session.scene import surroundings

    joints = tuple(f"joint_{number}" for number in range(1, robot.capabilities.joints + 1))
    description, tool = "", IDENTITY_POSE
    if config.arm is not None:
        tool = config.arm.tool()
        if has_rigid_arm(config):
            model = load_arm(config.arm.model)
            joints, description = model.joint_names, model.urdf
    names = ArmNames(joints, options.base_frame, options.flange_frame, options.tcp_frame)
    tables = as_table(config, from_file=False)
    around = surroundings(config, has_rigid_arm(config), make_neighbour_bodies(config))
    return SessionNetwork(options, names, description, tool, offer, full, tables, around)


def make_neighbours(
    config: SessionConfig, robot: RobotDriver, controller: ArmController
) -> ArmNeighbours | None:
    """What hears the neighbours of a session's arm, not open yet; None without any."""
    if not config.neighbours:
        return None
    from cardan.gateway.arm.arm_body import ArmBody
    from cardan.gateway.arm.neighbours import NeighbourWatch
    from cardan.gateway.bus.neighbours import ArmNeighbours

    body = controller.body
    assert isinstance(body, ArmBody)
    watches = [
        NeighbourWatch(each, table.topic, table.max_age_s)
        for table, each in zip(config.neighbours, body.neighbours, strict=True)
    ]
    return ArmNeighbours(watches, controller, robot.capabilities.period_s)


def has_output(table: GripperOptions, robot: RobotCapabilities) -> bool:
    """Whether the robot has the output that the gripper is on."""
    if isinstance(table.output, str):
        return robot.digital_outputs > 0
    return robot.analog_outputs > table.output


def make_filters(config: SessionConfig) -> tuple[TwistFilter, ...]:
    """The filters of a session in their order, not opened yet."""
    made = []
    for index, table in enumerate(config.filters):
        key = f"filters.{index}"
        with below(key):
            kind = filter_registry.load(table.filter)
        with filter_registry.using(table.filter, f"{key}.filter"):
            made.append(kind(read_table(kind.Options, table.options, key)))
        made[-1].name = table.filter
    return tuple(made)


def make_arm(config: SessionConfig, robot: RobotDriver) -> ArmBody | None:
    """The body of a session's arm; None without an ``[arm]`` table.

    Where the robot's driver has limits of its own, the stricter of both hold. Pinocchio is only
    imported here: sessions without an arm's model start without it.
    """
    table = config.arm
    if table is None:
        return None
    from cardan.common.arm_libraries import np
    from cardan.gateway.arm.arm_body import ArmBody
    from cardan.gateway.kinematics.arm import ArmKinematics
    from cardan.gateway.kinematics.soft_neck import SOFT_NECKS, SoftNeck, load_soft_neck
    from cardan.gateway.servo.choice import choose_servo

    kinematics: Kinematics
    arm, collision, posture = None, None, None
    neighbours = make_neighbour_bodies(config)
    try:
        if table.model in SOFT_NECKS:
            kinematics, weights = SoftNeck(load_soft_neck(table.model)), SoftNeck.TASK
            if table.tool() != IDENTITY_POSE or config.obstacles or neighbours:
                raise ConfigurationError(
                    "", f"{table.model} takes neither tool nor obstacles nor neighbours"
                )
        else:
            model = _own_model(config)
            kinematics = arm = ArmKinematics(model, table.tool())
            weights = model.task.weights
            if (config.obstacles or neighbours) and not table.i_accept_links_without_bodies:
                model.require_bodies("")
            if len(model.joints) > FREE_JOINTS:
                posture = np.array(model.home)
    except ConfigurationError as error:
        raise ConfigurationError("arm.model", str(error)) from None
    if arm is not None and table.collisions:
        collision = _collision(config, arm, neighbours)
        _check_count(collision, bool(neighbours))
    able = robot.capabilities
    if able.joints != kinematics.joints:
        raise ConfigurationError(
            "arm.model",
            f"{table.model!r} has {kinematics.joints} joints, the robot as configured "
            f"{able.joints}",
        )
    _check_joints(config, kinematics.names)
    _take_limits(kinematics, able)
    servo = choose_servo(kinematics, collision, _servo_options(table), weights)
    servo.posture = posture
    body = ArmBody(
        servo,
        able.commands,
        able.lag_s,
        tcp_tolerance_m=table.tcp_tolerance_m,
        neighbours=neighbours,
    )
    for index, each in enumerate(neighbours):
        body.place_neighbour(index, each.model.home, [0.0] * len(each.shapes))
    return body


def own_topic(config: SessionConfig, name: str) -> str:
    """The absolute name of a topic that a session's node calls `name`; empty without a network."""
    return "" if config.network is None else config.network.absolute(name)


def disagreements(sessions: Mapping[str, SessionConfig]) -> list[str]:
    """Where sessions of one daemon say of their neighbours what these do not say of themselves."""
    by_topic = {own_topic(each, "joint_states"): name for name, each in sessions.items()}
    found = []
    for name, config in sessions.items():
        for index, table in enumerate(config.neighbours):
            key = f"{name}: neighbours.{index}"
            topic = own_topic(config, table.topic)
            if topic not in by_topic:
                # It may be an arm that no session of ours moves.
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
                for number, each in enumerate(sessions[other].neighbours)
                if _is_of(sessions, other, each, name)
            ]
            if not back:
                found.append(
                    f"{key}: {who} has no neighbour for this arm, and may drive into it: add one"
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
    sessions: Mapping[str, SessionConfig], own: str, table: NeighbourTable, other: str
) -> bool:
    """Whether a neighbour of the session `own` is the arm of `other`."""
    return own_topic(sessions[own], table.topic) == own_topic(sessions[other], "joint_states")


def _base_of(config: SessionConfig, index: int) -> Pose:
    """Of the arm of ``[[neighbours]]`` number `index`, in the base of a session's arm."""
    table = config.neighbours[index]
    given = table.base()
    if given is not None or not has_rigid_arm(config):
        return given or IDENTITY_POSE
    assert config.arm is not None
    model = load_arm(config.arm.model, "arm.model")
    own, theirs = (read_tree(each.urdf).fixed_links() for each in (model, load_arm(table.model)))
    common = [link for link in own if link in theirs]
    common = [link for link in common if link.rstrip("_") != ARM_BASE] or common
    key = f"neighbours.{index}.base_xyz_m"
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
    """How far two bases, each in the other, are from being inverse: m and rad; None: they are."""
    closed = compose(one, other)
    away = norm(closed.position), norm(to_rotation_vector(closed.orientation))
    return away if away[0] > SAME_BASE_M or away[1] > SAME_BASE_RAD else None


def make_neighbour_bodies(config: SessionConfig) -> list[NeighbourBodies]:
    """The bodies of the arms of ``[[neighbours]]``."""
    if not config.neighbours or config.arm is None:
        return []
    from cardan.gateway.arm.neighbours import NeighbourBodies

    own: set[str] = set()
    if has_rigid_arm(config):
        own |= set(load_arm(config.arm.model, "arm.model").joint_names)
    heard = {own_topic(config, "joint_states"): ("this session's own arm", own)}
    found = []
    for index, table in enumerate(config.neighbours):
        key = f"neighbours.{index}.model"
        model = load_arm(table.model, key)
        joints = set(model.joint_names)
        if table.base_xyz_m is None and joints <= own:
            raise ConfigurationError(
                f"neighbours.{index}.base_xyz_m",
                f"is missing: the joints of {table.model!r} are this arm's own, so it is no other "
                "arm of the same robot; say where its base is",
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
        who, theirs = heard.setdefault(topic, (f"the neighbour {table.name!r}", joints))
        if theirs is not joints and joints <= theirs:
            raise ConfigurationError(
                f"neighbours.{index}.topic",
                f"{topic} is that of {who}, whose joints have the same names: name the topic on "
                f"which {table.name!r} alone is published",
            )
        if not config.arm.i_accept_links_without_bodies:
            model.require_bodies(key)
        made = NeighbourBodies(
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


def _own_model(config: SessionConfig) -> ArmModel:
    """Of a session's rigid arm, without the links of the same robot that a neighbour moves."""
    assert config.arm is not None
    model = load_arm(config.arm.model)
    for each in config.neighbours:
        if each.base_xyz_m is None:
            model = model.without(load_arm(each.model))
    return model


def _collision(
    config: SessionConfig, arm: ArmKinematics, neighbours: Sequence[NeighbourBodies]
) -> CollisionModel:
    """Of a session's arm, of the obstacles around it, and of its neighbours."""
    from cardan.gateway.kinematics.collision import CollisionModel

    ignored = set()
    for index, (table, each) in enumerate(zip(config.neighbours, neighbours, strict=True)):
        own = [shape.name for shape in arm.arm.shapes if shape.body > 0]
        theirs = [shape.name for shape in each.model.shapes]
        for pair in table.ignore:
            for name, known, what in zip(
                pair, (own, theirs), ("this arm that moves", f"{table.model!r}"), strict=True
            ):
                if name not in known:
                    raise ConfigurationError(
                        f"neighbours.{index}.ignore",
                        f"there is no body {name!r} of {what}; allowed: "
                        f"{', '.join(dict.fromkeys(known))}" + suggestion(name, known),
                    )
            ignored.add((each.label(pair[1]), pair[0]))
    return CollisionModel(
        arm,
        [_obstacle(each) for each in config.obstacles],
        movers=[each.shapes for each in neighbours],
        ignored=ignored,
    )


def _check_count(collision: CollisionModel, neighbours: bool) -> None:
    for count, most, what in (
        (len(collision.solids), MAX_SHAPES, "bodies"),
        (len(collision.pairs), MAX_PAIRS, "pairs of bodies"),
    ):
        if neighbours and count > most:
            raise ConfigurationError(
                "neighbours",
                f"with them there are {count} {what} to keep apart, and at most {most} can be: set "
                'fit = "coarse" in [collision] of the arms\' .toml files, or leave some out',
            )


def _servo_options(table: ArmTable) -> ServoOptions:
    return ServoOptions(
        policy=table.policy,
        speed_share=table.speed_share,
        acceleration_share=table.acceleration_share,
        safety_distance_m=table.safety_distance_m,
    )


def servo_in_words(config: SessionConfig) -> str:
    """Which servo moves a session's arm, and why it is not the compiled one; empty without an arm's
    model."""
    arm = make_arm(config, make_robot(config))
    if arm is None:
        return ""
    reason = arm.servo.not_compiled
    return f"in Python: {reason}" if reason else "compiled"


def _check_joints(config: SessionConfig, names: tuple[str, ...]) -> None:
    mapping = config.mapping
    for axis, joint in mapping.joints.items():
        if joint not in names:
            raise ConfigurationError(
                f"mapping.joints.{axis}",
                f"there is no joint {joint!r}; allowed: {', '.join(names)}"
                + suggestion(joint, names),
            )
        index = AXES.index(axis.removeprefix("-"))
        if any(source.removeprefix("-") == AXES[index] for source in mapping.axes):
            raise ConfigurationError(
                f"mapping.joints.{axis}",
                f"the axis drives {AXES[index]} as well: name it in mapping.axes no more, "
                'with "fixed" in its place',
            )


def make_source(table: ForceTable) -> ForceSource | None:
    """The source of a measured force, not opened yet; None where there is none."""
    if isinstance(table, MeasuredForceTable):
        return MeasuredSource(felt=table.sense == "felt")
    if isinstance(table, ContactForceTable):
        return ContactSource(table.contact)
    if isinstance(table, RemoteForceTable):
        return RemoteSource(table.socket, table.max_age_s)
    if isinstance(table, NetworkForceTable):
        return NetworkSource(table.max_age_s)
    if not isinstance(table, SensorForceTable):
        return None
    sensor = make_driver(table.sensor, "force.sensor")
    assert isinstance(sensor, OperatorDevice)
    if table.zero_sensor and not hasattr(sensor, "zero"):
        raise ConfigurationError(
            "force.zero_sensor", f"{table.sensor.driver!r} cannot be zeroed: leave it out"
        )
    return SensorSource(sensor, felt=table.sense == "felt", zero=table.zero_sensor)


def make_conditioner(table: ForceTable, source: ForceSource | None) -> Conditioner:
    """Turns the source's readings into a force for the hand."""
    if source is None:
        return Conditioner(table)
    return Conditioner(table, rests_at_zero=source.rests_at_zero, shaped=source.shaped)


def make_force(
    config: SessionConfig, device: OperatorDevice, robot: RobotDriver
) -> ForceRenderer | None:
    """The force feedback of a session, not opened yet; None for a device without force."""
    if not isinstance(device, HapticDevice):
        if config.gives_force:
            name = repr(config.device.driver if config.device else "no device")
            if getattr(device.options, "force", True) is False:
                name += " without force = true"  # Of a device on another computer.
            raise ConfigurationError(
                "fixtures" if config.fixtures else "force.source",
                f"{name} gives no force back to the hand; leave [force] and "
                "[[fixtures]] out, or choose a haptic device",
            )
        return None
    check_forces(config, device)
    table = config.force
    source = make_source(table)
    measured = None
    if source is not None:
        measured = ForceInput(
            source,
            make_conditioner(table, source),
            max_age_s=table.max_age_s,
            stiffness_n_m=table.stiffness_n_m,
            contact_target_n=table.contact_target_n,
        )
    return ForceRenderer(
        device,
        FixtureSet(config.fixtures),
        measured,
        rendering=config.gives_force,
        max_age_s=table.max_age_s,
        warnings=_force_warnings(config, device, robot),
    )


def check_forces(config: SessionConfig, device: OperatorDevice) -> None:
    """Raise ConfigurationError where forces could not be mapped back to the hand."""
    if not isinstance(device, HapticDevice):
        return
    if config.gives_force and mirrors(config.mapping):
        raise ConfigurationError(
            "mapping.axes",
            "these axes and signs are not a rotation (a mirror, or one axis twice): a force "
            "cannot be mapped back through them",
        )
    if config.gives_force and (still := unfollowed(config.mapping)):
        raise ConfigurationError(
            "mapping.scale" if "fixed" not in config.mapping.axes[:3] else "mapping.axes",
            f"the TCP's {' and '.join(still)} does not follow the hand: a force along it "
            "pushes the hand, and no motion of the hand ends it; let x, y and z follow, or leave "
            "[force] and [[fixtures]] out",
        )


def _force_warnings(
    config: SessionConfig, device: HapticDevice, robot: RobotDriver
) -> tuple[str, ...]:
    """Warnings about a force loop, from its numbers alone."""
    if not config.gives_force:
        return ()
    mapping, table, period_s = config.mapping, config.force, robot.capabilities.period_s
    factors = zip(mapping.axes[:3], mapping.scale[:3], strict=True)
    motion_scale = max(0.0 if axis == "fixed" else abs(factor) for axis, factor in factors)
    words = []
    hold_s = getattr(device.options, "hold_s", math.inf)
    if 2.0 * period_s > hold_s:
        words.append(
            f"the robot reports every {period_s * 1e3:g} ms, and the device lets go of the force "
            f"after {hold_s * 1e3:g} ms: set device.hold_s to two periods or more"
        )
    words += [
        fixture_warning(index, motion_scale, each.stiffness_n_m)
        for index, each in enumerate(config.fixtures)
        if isinstance(each, StiffFixtureTable)
    ]
    stiffness_n_m = table.environment_stiffness_n_m
    if not isinstance(table, NoForceTable) and stiffness_n_m is not None:
        words.append(
            loop_warning(
                motion_scale=motion_scale,
                force_scale=1.0 if isinstance(table, SHAPED_FORCES) else table.scale,
                environment_stiffness_n_m=stiffness_n_m,
                device_damping_n_s_m=getattr(device.options, "damping_n_s_m", 0.0),
                period_s=period_s,
                delay_s=table.delay_s,
                cutoff_hz=table.cutoff_hz,
            )
        )
    return tuple(filter(None, words))


def _take_limits(kinematics: Kinematics, robot: RobotCapabilities) -> None:
    from cardan.common.arm_libraries import np

    limits = robot.limits
    if limits is None:
        return
    np.maximum(kinematics.lower, limits.lower, out=kinematics.lower)
    np.minimum(kinematics.upper, limits.upper, out=kinematics.upper)
    np.minimum(kinematics.velocity, limits.velocity, out=kinematics.velocity)
    np.minimum(kinematics.acceleration, limits.acceleration, out=kinematics.acceleration)


def _obstacle(table: ObstacleTable) -> Obstacle:
    from cardan.gateway.kinematics.collision import HalfSpace, Obstacle

    if (solid := table.shape()) is not None:
        return Obstacle(table.name, solid)
    assert table.plane is not None
    normal = Vector3(*table.plane[0])
    unit = scale(normal, 1.0 / norm(normal))
    return Obstacle(table.name, HalfSpace(unit, table.plane[1]))


def _check_speeds(limits: LimitsTable, robot: RobotCapabilities) -> None:
    """A reference that is faster than its robot runs into the leash; better to say so."""
    for name, asked, most in (
        ("linear_speed_m_s", limits.linear_speed_m_s, robot.linear_speed_m_s),
        ("angular_speed_rad_s", limits.angular_speed_rad_s, robot.angular_speed_rad_s),
    ):
        if most is not None and asked > most:
            raise ConfigurationError(
                f"limits.{name}",
                f"{asked:g} is more than the robot's driver allows ({most:g}): lower it, or "
                "raise the driver's own limit in [robot]",
            )


def load_haptic(path: Path) -> HapticConfig:
    """Read and check what ``cardan haptic`` needs of a file: ``[device]``, ``[network]`` and the
    age of ``[force]``."""
    with in_file(path):
        config = read_part(HapticConfig, path)
        device = make_device(config)
        if not isinstance(device, HapticDevice):
            raise ConfigurationError(
                "device.driver", f"{config.device.driver!r} gives no force back to the hand"
            )
    return config


def load_force(path: Path) -> ForceConfig:
    """Read and check what ``cardan force`` needs of a file: ``[force]`` and ``[[fixtures]]``."""
    with in_file(path):
        config = read_part(ForceConfig, path)
        make_source(config.force)
    return config


def read_part(kind: type[Part], path: Path) -> Part:
    """The tables of a file that `kind` has; all others may be anything."""
    keys = keys_of(kind)
    with in_file(path):
        tables = {key: each for key, each in read_toml(path).items() if key in keys}
        return read_table(kind, resolved(kind, tables, path))


def cautions(config: SessionConfig) -> list[str]:
    """What is allowed and rarely should be: what the drivers say of their options, bodies that
    nothing keeps apart or that are in each other at home, and a home that is singular."""
    drivers = {"robot": config.robot, "device": config.device}
    found = [
        f"{key}: {words}"
        for key, table in drivers.items()
        if table is not None
        for words in make_driver(table, key).cautions()
    ]
    if config.device is not None:
        # Of a device on another computer.
        given_s = config.device.options.get("max_age_s", 0.0)
        least_s = config.watchdogs.device_age_s
        if given_s > least_s:
            found.append(
                f"device: max_age_s is {given_s:g} s, but what is older than {least_s:g} s moves "
                "no arm: set device_age_s under [watchdogs], too"
            )
    if config.arm is not None and has_rigid_arm(config):
        load_arm(config.arm.model, "arm.model")
        model = _own_model(config)
        obstacles = [_obstacle(each) for each in config.obstacles]
        words = arm_cautions(model, obstacles, config.arm.collisions)
        found += [f"arm: {each}" for each in words]
        found += _touching_neighbours(config, model)
    return found


def arm_cautions(
    model: ArmModel, obstacles: Sequence[Obstacle] = (), collisions: bool = True
) -> list[str]:
    """Those of an arm; not `collisions`: bodies are never kept apart."""
    found = []
    if collisions:
        if bare := model.links_without_body():
            found.append(f"{bare}; neither obstacles nor the arm itself stop them")
        if held := model.held_words():
            found.append(held)
        found += _touching(model, obstacles)
    return found + _unbent(model)


def _touching(model: ArmModel, obstacles: Sequence[Obstacle]) -> list[str]:
    """Pairs of bodies that are left out, and those that overlap at home."""
    from cardan.common.arm_libraries import np
    from cardan.gateway.kinematics.arm import ArmKinematics
    from cardan.gateway.kinematics.collision import CollisionModel

    found = []
    if pairs := model.touching_names():
        named = ", ".join(" and ".join(pair) for pair in pairs)
        found.append(f"touch in every posture, and are not kept apart: {named}")
    bodies = CollisionModel(ArmKinematics(model), obstacles)
    overlaps: dict[tuple[str, str], tuple[float, bool]] = {}
    for names, distance, outside in zip(
        bodies.pairs, bodies.at(np.array(model.home)), bodies.with_obstacle, strict=True
    ):
        if distance < min(0.0, overlaps.get(names, (0.0, False))[0]):
            overlaps[names] = distance, bool(outside)
    for (first, second), (distance, outside) in overlaps.items():
        remedy = (
            f'ignore = [["{first}", "{second}"]] in [collision] of the arm\'s .toml if they do so '
            "in every posture"
        )
        if outside:
            remedy = "move the obstacle"
        found.append(
            f"at home {first} and {second} overlap by {distance * -1e3:.1f} mm, which ends "
            f"motions there: {remedy}, or give another home_deg"
        )
    return found


def _touching_neighbours(config: SessionConfig, model: ArmModel) -> list[str]:
    """Bodies of neighbours that overlap with the arm's where both arms are at home."""
    if not config.neighbours:
        return []
    from cardan.common.arm_libraries import np
    from cardan.gateway.kinematics.arm import ArmKinematics

    neighbours = make_neighbour_bodies(config)
    bodies, first = _collision(config, ArmKinematics(model), neighbours), 0
    for each in neighbours:
        bodies.move(first, each.frames(each.model.home), [0.0] * len(each.shapes))
        first += len(each.shapes)
    least: dict[tuple[str, str], float] = {}
    for names, (one, _), distance in zip(
        bodies.pairs, bodies.pair_solids, bodies.at(np.array(model.home)), strict=True
    ):
        if one >= bodies.first_mover and distance < min(0.0, least.get(names, 0.0)):
            least[names] = distance
    return [
        f"neighbours: at home {theirs} and {own} overlap by {distance * -1e3:.1f} mm, which ends "
        "motions there: check base_xyz_m, or name the two in `ignore` if they do so in every "
        "posture"
        for (theirs, own), distance in least.items()
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


def load_config(path: Path) -> SessionConfig:
    """Read and check a configuration file, the options of drivers and filters included."""
    with in_file(path):
        return checked_config(resolved(SessionConfig, read_toml(path), path))


def checked_config(tables: Mapping[str, Any]) -> SessionConfig:
    """A configuration already read, the options of drivers and filters included. ConfigurationError
    says what is wrong in it."""
    try:
        config = parse_config(tables)
    except ConfigurationError as error:
        raise together((error, *_wrong_options(tables))) from None
    check_parts(config)
    return config


def _wrong_options(tables: Mapping[str, Any]) -> Iterator[ConfigurationError]:
    """What is wrong in the tables of device and robot, read or not."""
    for key in ("device", "robot"):
        if (table := tables.get(key)) is None:
            continue
        try:
            if not isinstance(table, registry.DriverTable):
                table = read_table(registry.DriverTable, table, key)
            make_driver(table, key)
        except ConfigurationError as error:
            yield error
        except ExtraMissingError:
            pass  # Its options are not known.


def check_parts(config: SessionConfig) -> None:
    """Check the options of drivers and filters, and what device, robot and arm can do. Raises
    ConfigurationError; nothing is opened."""
    if wrong := tuple(_wrong_options({"device": config.device, "robot": config.robot})):
        raise together(wrong)
    robot = make_robot(config)
    make_controller(config, robot)
    if config.device is not None:
        device = make_device(config)
        check_mode(config.mapping, device)
        check_buttons(config, device)
        make_force(config, device, robot)
