"""Construction of devices and robots from their tables; nothing is opened."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from cardan.common.options import suggestion
from cardan.common.plugins import not_installed, reason
from cardan.common.tables import read_table
from cardan.drivers import registry
from cardan.drivers.base import Driver, OperatorDevice, RobotDriver
from cardan.errors import ConfigurationError, below
from cardan.types import DeviceCapabilities, DeviceState, RobotCapabilities


def make_driver(table: registry.DriverTable, key: str) -> Driver:
    """Make the driver of a table, not opened yet; errors name `key`, which is "robot" for a
    robot's."""
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
    """Turn errors of another package's driver into errors of its table, which `key` names."""
    return (
        contextlib.nullcontext() if table is None else registry.using(table.driver, f"{key}.driver")
    )


def _breach(driver: Driver) -> str:
    """Return how a driver that is not open breaks its interface; empty if no breach was found."""
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
            return f"{call.__name__}() of a driver that is not open fails: {reason(error)}"
        if not isinstance(given, kind):
            word = {Sequence: "a sequence", Mapping: "a mapping"}.get(kind, "a DeviceState")
            return (
                f"{call.__name__}() of a driver that is not open returns {given!r:.60}, not {word}"
            )
    return ""


def _driver_class(name: str, side: type[Driver]) -> type[Driver]:
    """Return the class of a driver, which must be of this `side`: OperatorDevice or RobotDriver."""
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
    """Configuration from a file with ``[device]``."""

    @property
    def device(self) -> registry.DriverTable | None: ...


def make_device(config: WithDevice) -> OperatorDevice:
    """Make the configured operator device, not opened yet."""
    if config.device is None:
        raise ConfigurationError("device", "is missing: which driver reads the operator device?")
    device = make_driver(config.device, "device")
    assert isinstance(device, OperatorDevice)
    return device
