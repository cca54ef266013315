"""Set-up of a device or an arm from a session's file, or from a driver's name and its options."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from cardan.common.options import Options
from cardan.common.places import in_file
from cardan.common.tables import keys_of, read_table, read_toml, resolved
from cardan.drivers.base import OperatorDevice
from cardan.drivers.registry import DriverTable
from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.arm.interface import CartesianArm
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.force.tables import NoForceTable
from cardan.gateway.operator.mapping import GripperOptions, MappingOptions
from cardan.gateway.session.arm_assembly import why_no_verbs
from cardan.gateway.session.assembly import check_mode, check_parts, has_output, make_robot
from cardan.gateway.session.config import LimitsTable, SessionConfig, parse_config
from cardan.gateway.session.driver_assembly import make_driver
from cardan.robots import load_arm
from cardan.types import IDENTITY_POSE, Vector3
from cardan_learning.device_actions import DEVICE_ACTIONS, DeviceActions, EventButtons
from cardan_learning.features import ActionKind, action_kind, reference_of

Table = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class DeviceConfig(Options):
    """Tables of a session's file used by a source of actions."""

    device: DriverTable
    mapping: MappingOptions = field(default_factory=MappingOptions)
    gripper: GripperOptions = field(default_factory=GripperOptions)
    limits: LimitsTable = field(default_factory=LimitsTable)
    watchdogs: Watchdogs = field(default_factory=Watchdogs)


class ActionDevice(NamedTuple):
    """Operator device that is not open yet, and its actions."""

    device: OperatorDevice
    actions: DeviceActions


def make_device(
    *,
    session: str = "",
    driver: str = "",
    options: Table | None = None,
    mapping: Table | None = None,
    gripper: Table | None = None,
    action: str = "delta",
    buttons: EventButtons | None = None,
) -> ActionDevice:
    """Return the device of `session`, a session's file, or of `driver` with its `options`;
    `mapping` and `gripper` are tables as such a file has them, in place of its own. Raises
    ConfigurationError."""
    with _in_file(session):
        tables = _tables(session, driver, {"device": options}, DeviceConfig)
        config = read_table(DeviceConfig, {**tables, **_given(mapping=mapping, gripper=gripper)})
        device = make_driver(config.device, "device")
        assert isinstance(device, OperatorDevice)
        check_mode(config.mapping, device)
    kind = action_kind(action, DEVICE_ACTIONS)
    age_s = config.watchdogs.device_age_s
    return ActionDevice(
        device,
        DeviceActions(kind, config.mapping, config.gripper, config.limits, age_s, buttons),
    )


class Arm(NamedTuple):
    """Arm that is not open yet."""

    make: Callable[[], CartesianArm]
    """Factory of the arm, which is opened afterwards."""
    joints: tuple[str, ...]
    """Names of the joints, in kinematic order."""
    kind: ActionKind
    mapping: MappingOptions
    gripper: bool
    """True if the arm has a gripper."""
    reference: Vector3
    """Reference of its rotation vectors: :func:`~cardan_learning.features.reference_of`."""


def make_arm(
    *,
    session: str = "",
    driver: str = "",
    options: Table | None = None,
    model: str = "",
    mapping: Table | None = None,
    gripper: Table | None = None,
    limits: Table | None = None,
    address: str = "",
    network_gripper: bool = False,
    action: str = "delta",
) -> Arm:
    """Return the arm of `session`, a session's file, or of `driver` with its `options` and the
    `model` of its arm; or the arm of a running session at `address`, with its `model`.

    `mapping`, `gripper` and `limits` are tables in the form of a session's file, in place of its
    own; the file's operator device and its feedback are left out. Raises ConfigurationError.
    """
    kind = action_kind(action, tuple(ActionKind))
    if address:
        if session or driver:
            raise ConfigurationError("address", "give it alone, or a session, or a driver")
        if not model:
            raise OptionError("model", model, "the model of the arm at `address`, for its joints")
        if limits or gripper or options:
            raise ConfigurationError("address", "the arm's own session has its limits and gripper")
        named = load_arm(model)
        return Arm(
            lambda: _remote(address),
            named.joint_names,
            kind,
            read_table(MappingOptions, mapping or {}, "mapping"),
            network_gripper,
            reference_of(named, IDENTITY_POSE),
        )
    with _in_file(session):
        config = _arm_config(
            _tables(session, driver, {"robot": options}, SessionConfig),
            model,
            _given(mapping=mapping, gripper=gripper, limits=limits),
        )
    assert config.arm is not None
    loaded = load_arm(config.arm.model)
    return Arm(
        lambda: _session(config),
        loaded.joint_names,
        kind,
        config.mapping,
        has_output(config.gripper, make_robot(config).capabilities),
        reference_of(loaded, config.arm.tool()),
    )


def _arm_config(tables: dict[str, Any], model: str, given: dict[str, Table]) -> SessionConfig:
    """Return the configuration of an arm without operator, with its parts checked."""
    if model:
        tables["arm"] = {**tables.get("arm", {}), "model": model}
    config = dataclasses.replace(
        parse_config({**tables, **given}, from_file=True),
        device=None,
        filters=(),
        force=NoForceTable(),
        fixtures=(),
    )
    if why := why_no_verbs(config):
        raise ConfigurationError("arm", why)
    check_parts(config)
    return config


def _in_file(session: str) -> AbstractContextManager[None]:
    """Context in which errors of keys name their place in the session's file, if there is one."""
    return in_file(Path(session)) if session else nullcontext()


def _tables(
    session: str, driver: str, options: Mapping[str, Table | None], kind: type
) -> dict[str, Any]:
    """Return the tables of a file or of a single driver; `options`: name of the driver's table, and
    other contents."""
    ((key, given),) = options.items()
    if bool(session) is bool(driver):
        raise ConfigurationError(
            "session", "give either the file of a session, or a driver with its options"
        )
    if session:
        if given:
            raise ConfigurationError("options", "a session's file has those of its driver")
        path, keys = Path(session), keys_of(kind)
        tables = {name: table for name, table in read_toml(path).items() if name in keys}
        return dict(resolved(kind, tables, path))
    return {key: {"driver": driver, **(given or {})}}


def _given(**tables: Table | None) -> dict[str, Table]:
    return {name: table for name, table in tables.items() if table}


def _session(config: SessionConfig) -> CartesianArm:
    from cardan.gateway.session.remote import session_arm

    return session_arm(config, source=SOURCE)


def _remote(address: str) -> CartesianArm:
    from cardan.gateway.bus.remote import network_arm

    return network_arm(address, source=SOURCE)


SOURCE = "learning"
"""Name of the program as a source in the arm's authority."""
