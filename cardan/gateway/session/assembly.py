"""Assembly of a session's parts from its configuration; nothing is opened. The configuration is
compared with the abilities of devices, robots, filters and arms: errors name keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cardan.common.options import suggestion
from cardan.common.places import in_file
from cardan.common.tables import as_table, read_table, read_toml, resolved
from cardan.drivers import registry
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.errors import ConfigurationError, ExtraMissingError, MotionRefusedError, below, together
from cardan.gateway.arm.commanded_arm import CommandedArm, TaskSpaceArm
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.states import Authority
from cardan.gateway.arm.vocab import Action
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.gateway.operator.input import OperatorInput
from cardan.gateway.operator.mapping import GripperOptions, MappingOptions, Mode, TwistMapping
from cardan.gateway.session.arm_assembly import (
    has_rigid_arm,
    make_arm,
    make_obstacle,
    own_model,
    why_no_verbs,
)
from cardan.gateway.session.config import LimitsTable, SessionConfig, parse_config
from cardan.gateway.session.driver_assembly import make_device, make_driver
from cardan.gateway.session.force_assembly import make_force
from cardan.robots import load_arm
from cardan.types import IDENTITY_POSE, CommandKind, RobotCapabilities

if TYPE_CHECKING:
    from cardan.gateway.arm.options import ControllerOptions
    from cardan.gateway.arm.verb_methods import ArmVerbs
    from cardan.gateway.session.network import SessionNetwork

ARM_COMMANDS = frozenset({CommandKind.JOINT, CommandKind.JOINT_VELOCITY, CommandKind.POSE})
"""Commands of which a robot must take at least one if its session has the model of its arm."""

OWN_BODY_SHARE = 0.5
"""Share of the safety distance that a planned motion keeps between parts of the arm itself: their
positions are known exactly, and a home position may have them near."""


def check_buttons(config: SessionConfig, device: OperatorDevice) -> None:
    """Raise ConfigurationError for buttons that a device, as far as it knows, does not have."""
    known, further = device.capabilities.buttons, device.capabilities.further_buttons
    for key, button in config.buttons():
        if known and button not in (*known, *further):
            raise ConfigurationError(
                key,
                f"the device has no button {button!r}; it has: {', '.join(known)}"
                + suggestion(button, known),
            )


def check_mode(mapping: MappingOptions, device: OperatorDevice) -> None:
    """Raise ConfigurationError if the device does not measure a quantity that the mapping needs."""
    able = device.capabilities
    if mapping.mode is Mode.RATE and not able.gives_axes:
        raise ConfigurationError(
            "mapping.mode", 'this device measures a pose: set mode = "position"'
        )
    if mapping.mode is not Mode.RATE and not able.gives_pose:
        raise ConfigurationError(
            "mapping.mode", 'this device measures deflections: set mode = "rate"'
        )


def make_robot(config: SessionConfig) -> RobotDriver:
    """Make the robot of a session, not opened yet."""
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
    """Make the controller of a session's arm, with its operator device, if there is one."""
    limits, watchdogs = config.limits, config.watchdogs
    arm = make_arm(config, robot)
    body: CommandedArm = TaskSpaceArm(limits) if arm is None else arm
    operator = None
    if config.device is not None:
        mapping = TwistMapping(config.mapping, config.gripper)
        operator = OperatorInput(mapping, limits, make_filters(config), watchdogs.device_age_s)
    return ArmController(
        body,
        limits,
        watchdogs,
        operator,
        Authority(config.authority, "" if config.network is None else config.network.source),
        period_s=robot.capabilities.period_s,
        output_limits=None if arm is None else arm.output_limits(robot.capabilities),
    )


def make_verbs(
    config: SessionConfig,
    robot: RobotDriver,
    controller: ArmController,
    gripper: Callable[[Action], None] | None,
) -> ArmVerbs:
    """Make the verbs of a session's arm, on its controller, within the session's limits. Takes tens
    of milliseconds. Raises MotionRefusedError if the session has no rigid arm."""
    if why := why_no_verbs(config):
        raise MotionRefusedError(why)
    from cardan.gateway.arm.joint_space_arm import JointSpaceArm
    from cardan.gateway.arm.verb_methods import ArmVerbs, narrowed
    from cardan.gateway.kinematics.arm import ArmKinematics

    table, body = config.arm, controller.commanded
    assert table is not None
    assert isinstance(body, JointSpaceArm)
    model = narrowed(own_model(config), robot.capabilities)
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
        obstacles=[make_obstacle(each) for each in config.obstacles],
        gripper=gripper if has_output(config.gripper, robot.capabilities) else None,
    )


def make_verb_options(config: SessionConfig) -> ControllerOptions:
    """Make the limits and options of the verbs of a session that has an ``[arm]``."""
    from cardan.gateway.arm.options import STREAM_LIMITS, ControllerOptions
    from cardan.gateway.motion.planner import Margins

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
    """Make the network interface of the arm, not open yet; None if none is configured."""
    options = config.network
    if options is None:
        return None
    from cardan.gateway.bus.arm_topics import ArmNames
    from cardan.gateway.session.network import SessionNetwork
    from cardan.gateway.session.scene import scene_of

    joints = tuple(f"joint_{number}" for number in range(1, robot.capabilities.joints + 1))
    description, tool = "", IDENTITY_POSE
    if config.arm is not None:
        tool = config.arm.tool()
        if has_rigid_arm(config):
            model = load_arm(config.arm.model)
            joints, description = model.joint_names, model.urdf
    names = ArmNames(joints, options.base_frame, options.flange_frame, options.tcp_frame)
    tables = as_table(config, from_file=False)
    return SessionNetwork(options, names, description, tool, offer, full, tables, scene_of(config))


def has_output(table: GripperOptions, robot: RobotCapabilities) -> bool:
    """Return whether the robot has the output that the gripper is on."""
    if isinstance(table.output, str):
        return robot.digital_outputs > 0
    return robot.analog_outputs > table.output


def make_filters(config: SessionConfig) -> tuple[TwistFilter, ...]:
    """Make the filters of a session in their order, not opened yet."""
    made = []
    for index, table in enumerate(config.filters):
        key = f"filters.{index}"
        with below(key):
            kind = filter_registry.load(table.filter)
        with filter_registry.using(table.filter, f"{key}.filter"):
            made.append(kind(read_table(kind.Options, table.options, key)))
        made[-1].name = table.filter
    return tuple(made)


def servo_in_words(config: SessionConfig) -> str:
    """Return the servo of a session's arm, and why it is not the compiled one; empty without an
    arm's model."""
    arm = make_arm(config, make_robot(config))
    if arm is None:
        return ""
    reason = arm.servo.not_compiled
    return f"in Python: {reason}" if reason else "compiled"


def _check_speeds(limits: LimitsTable, robot: RobotCapabilities) -> None:
    """Refuse a reference faster than its robot, which would run into the maximum lead."""
    for name in ("linear_speed_m_s", "angular_speed_rad_s"):
        asked, most = getattr(limits, name), getattr(robot, name)
        if most is not None and asked > most:
            raise ConfigurationError(
                f"limits.{name}",
                f"{asked:g} is more than the robot's driver allows ({most:g}): lower it, or "
                "raise the driver's own limit in [robot]",
            )


def load_config(path: Path) -> SessionConfig:
    """Read and check a configuration file, the options of drivers and filters included."""
    with in_file(path):
        return checked_config(resolved(SessionConfig, read_toml(path), path))


def checked_config(tables: Mapping[str, Any]) -> SessionConfig:
    """Check a configuration already read, the options of drivers and filters included.
    ConfigurationError names its fault."""
    try:
        config = parse_config(tables)
    except ConfigurationError as error:
        raise together((error, *_wrong_options(tables))) from None
    check_parts(config)
    return config


def _wrong_options(tables: Mapping[str, Any]) -> Iterator[ConfigurationError]:
    """Yield the errors in the tables of device and robot, read or not."""
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
    """Check the options of drivers and filters, and the abilities of device, robot and arm. Raises
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
