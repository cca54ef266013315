"""Construction of a session's force feedback from its configuration; nothing is opened."""

from __future__ import annotations

import math
from pathlib import Path

from cardan.common.places import in_file
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.drivers.haptic import HapticDevice
from cardan.errors import ConfigurationError
from cardan.gateway.force.conditioning import Conditioner
from cardan.gateway.force.fixtures import FixtureSet
from cardan.gateway.force.input import ForceInput
from cardan.gateway.force.network import NetworkSource
from cardan.gateway.force.rendering import ForceRenderer
from cardan.gateway.force.service import RemoteSource
from cardan.gateway.force.sources import ContactSource, ForceSource, MeasuredSource, SensorSource
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
from cardan.gateway.operator.position import mirrors, unfollowed
from cardan.gateway.session.config import ForceConfig, HapticConfig, SessionConfig, read_part
from cardan.gateway.session.driver_assembly import make_device, make_driver

SHAPED_FORCES = (RemoteForceTable, NetworkForceTable)
"""Sources whose forces are scaled for the hand already."""


def make_source(table: ForceTable) -> ForceSource | None:
    """Make the source of a measured force, not opened yet; None if there is none."""
    if isinstance(table, MeasuredForceTable):
        return MeasuredSource(reaction=table.sense == "reaction")
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
    return SensorSource(sensor, reaction=table.sense == "reaction", zero=table.zero_sensor)


def make_conditioner(table: ForceTable, source: ForceSource | None) -> Conditioner:
    """Make the conditioner that turns the source's readings into a force for the hand."""
    if source is None:
        return Conditioner(table)
    return Conditioner(table, rests_at_zero=source.rests_at_zero, shaped=source.shaped)


def make_force(
    config: SessionConfig, device: OperatorDevice, robot: RobotDriver
) -> ForceRenderer | None:
    """Make the force feedback of a session, not opened yet; None for a device without force."""
    if not isinstance(device, HapticDevice):
        if config.gives_force:
            name = repr(config.device.driver if config.device else "no device")
            if getattr(device.options, "force", True) is False:
                name += " without force = true"  # The device is on another computer.
            raise ConfigurationError(
                "fixtures" if config.fixtures else "force.source",
                f"{name} gives no force back to the hand; leave [force] and "
                "[[fixtures]] out, or choose a haptic device",
            )
        return None
    _check_forces(config)
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


def _check_forces(config: SessionConfig) -> None:
    """Raise ConfigurationError if forces could not be mapped back to the hand."""
    if not config.gives_force:
        return
    if mirrors(config.mapping):
        raise ConfigurationError(
            "mapping.axes",
            "these axes and signs are not a rotation (a mirror, or one axis twice): a force "
            "cannot be mapped back through them",
        )
    if still := unfollowed(config.mapping):
        raise ConfigurationError(
            "mapping.scale" if "fixed" not in config.mapping.axes[:3] else "mapping.axes",
            f"the TCP's {' and '.join(still)} does not follow the hand: a force along it "
            "pushes the hand, and no motion of the hand ends it; let x, y and z follow, or leave "
            "[force] and [[fixtures]] out",
        )


def _force_warnings(
    config: SessionConfig, device: HapticDevice, robot: RobotDriver
) -> tuple[str, ...]:
    """Return warnings about a force loop, from its parameters alone."""
    if not config.gives_force:
        return ()
    mapping, table, period_s = config.mapping, config.force, robot.capabilities.period_s
    motion_scale = max(abs(gain) for _, gain in mapping.sources[:3])
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


def load_haptic(path: Path) -> HapticConfig:
    """Read and check the tables of a file for ``cardan devices haptic``: ``[device]``,
    ``[network]`` and the age of ``[force]``."""
    with in_file(path):
        config = read_part(HapticConfig, path)
        device = make_device(config)
        if not isinstance(device, HapticDevice):
            raise ConfigurationError(
                "device.driver", f"{config.device.driver!r} gives no force back to the hand"
            )
    return config


def load_force(path: Path) -> ForceConfig:
    """Read and check the tables of a file for ``cardan devices force``: ``[force]`` and
    ``[[fixtures]]``."""
    with in_file(path):
        config = read_part(ForceConfig, path)
        make_source(config.force)
    return config
