"""Public interface: the names that ``import cardan`` provides. Drivers are imported on first
use."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, overload

from cardan.common.plugins import reason
from cardan.drivers import registry
from cardan.drivers.base import (
    Driver as Driver,
    FoundDevice as FoundDevice,
    OperatorDevice as OperatorDevice,
    RobotDriver as RobotDriver,
)
from cardan.drivers.registry import BUILT_IN
from cardan.errors import (
    AddressError as AddressError,
    CardanError as CardanError,
    CollisionError as CollisionError,
    CommandError as CommandError,
    ConfigurationError as ConfigurationError,
    DeviceAccessError as DeviceAccessError,
    DeviceNotFoundError as DeviceNotFoundError,
    DriverError as DriverError,
    ExtraMissingError as ExtraMissingError,
    JointLimitError as JointLimitError,
    MotionLoopError as MotionLoopError,
    MotionRefusedError as MotionRefusedError,
    NotOpenError as NotOpenError,
    OptionError as OptionError,
    OutOfReachError as OutOfReachError,
    ScriptError as ScriptError,
)
from cardan.types import (
    Axes as Axes,
    ButtonEvent as ButtonEvent,
    CommandKind as CommandKind,
    DeviceCapabilities as DeviceCapabilities,
    DeviceFeedback as DeviceFeedback,
    DeviceLink as DeviceLink,
    DeviceState as DeviceState,
    Frame as Frame,
    HoldCommand as HoldCommand,
    Inertia as Inertia,
    JointCommand as JointCommand,
    JointLimits as JointLimits,
    JointVelocityCommand as JointVelocityCommand,
    PathCorrectionCommand as PathCorrectionCommand,
    Pose as Pose,
    PoseCommand as PoseCommand,
    Quaternion as Quaternion,
    RobotCapabilities as RobotCapabilities,
    RobotCommand as RobotCommand,
    RobotLink as RobotLink,
    RobotState as RobotState,
    TorqueCommand as TorqueCommand,
    Twist as Twist,
    TwistCommand as TwistCommand,
    Vector3 as Vector3,
    Wrench as Wrench,
)

if TYPE_CHECKING:
    from cardan.common.value_json import from_json as from_json, to_json as to_json
    from cardan.drivers.abb_egm import AbbEgm as AbbEgm
    from cardan.drivers.bus_devices import (
        Phone as Phone,
        Ros2Joy as Ros2Joy,
        Ros2Spacenav as Ros2Spacenav,
        Xr as Xr,
    )
    from cardan.drivers.gamepad import Gamepad as Gamepad
    from cardan.drivers.keyboard import Keyboard as Keyboard
    from cardan.drivers.motoros import Motoros as Motoros
    from cardan.drivers.remote import Remote as Remote
    from cardan.drivers.ros2_arm import Ros2Arm as Ros2Arm
    from cardan.drivers.sim_arm import SimArm as SimArm
    from cardan.drivers.spacemouse import SpaceMouse as SpaceMouse
    from cardan.drivers.spnav import Spnav as Spnav
    from cardan.drivers.ur_rtde import UrRtde as UrRtde
    from cardan.gateway.arm import CartesianDevice as CartesianDevice
    from cardan.gateway.bus.remote import network_arm as network_arm


@overload
def open_device(
    driver: Literal["spacemouse"], /, options: Any = None, **keywords: Any
) -> SpaceMouse: ...
@overload
def open_device(driver: Literal["spnav"], /, options: Any = None, **keywords: Any) -> Spnav: ...
@overload
def open_device(driver: Literal["gamepad"], /, options: Any = None, **keywords: Any) -> Gamepad: ...
@overload
def open_device(
    driver: Literal["keyboard"], /, options: Any = None, **keywords: Any
) -> Keyboard: ...
@overload
def open_device(
    driver: Literal["ros2_spacenav"], /, options: Any = None, **keywords: Any
) -> Ros2Spacenav: ...
@overload
def open_device(
    driver: Literal["ros2_joy"], /, options: Any = None, **keywords: Any
) -> Ros2Joy: ...
@overload
def open_device(driver: Literal["remote"], /, options: Any = None, **keywords: Any) -> Remote: ...
@overload
def open_device(driver: Literal["phone"], /, options: Any = None, **keywords: Any) -> Phone: ...
@overload
def open_device(driver: Literal["xr"], /, options: Any = None, **keywords: Any) -> Xr: ...
@overload
def open_device(driver: str, /, options: Any = None, **keywords: Any) -> OperatorDevice: ...
def open_device(driver: str, /, options: Any = None, **keywords: Any) -> OperatorDevice:
    """Open the operator device that `driver` names ("spacemouse") and its options choose.

    The options are an `Options` object of the driver, or its fields as keywords. Close the device,
    or use it in ``with``. Raises ConfigurationError for a wrong name or option, DeviceNotFoundError
    or DeviceAccessError if it cannot be opened.
    """
    kind = registry.load(driver)
    if not issubclass(kind, OperatorDevice):
        raise ConfigurationError("driver", f"{driver!r} drives a robot: use open_robot()")
    device = kind(kind.make_options(options, keywords))
    device.open()
    return device


@overload
def open_robot(driver: Literal["abb_egm"], /, options: Any = None, **keywords: Any) -> AbbEgm: ...
@overload
def open_robot(driver: Literal["motoros"], /, options: Any = None, **keywords: Any) -> Motoros: ...
@overload
def open_robot(driver: Literal["ros2"], /, options: Any = None, **keywords: Any) -> Ros2Arm: ...
@overload
def open_robot(driver: Literal["sim_arm"], /, options: Any = None, **keywords: Any) -> SimArm: ...
@overload
def open_robot(driver: Literal["ur_rtde"], /, options: Any = None, **keywords: Any) -> UrRtde: ...
@overload
def open_robot(driver: str, /, options: Any = None, **keywords: Any) -> RobotDriver: ...
def open_robot(driver: str, /, options: Any = None, **keywords: Any) -> RobotDriver:
    """Open the robot's controller that `driver` names ("abb_egm"), as :func:`open_device` does.

    A silent robot raises nothing here: its cycles report it. Raises ConfigurationError,
    DriverError.
    """
    kind = registry.load(driver)
    if not issubclass(kind, RobotDriver):
        raise ConfigurationError("driver", f"{driver!r} reads a device: use open_device()")
    robot = kind(kind.make_options(options, keywords))
    robot.open()
    return robot


def devices() -> list[FoundDevice]:
    """List the plugged-in operator devices, each with its driver and any obstacle to opening it.

    Serial, CAN and network devices are not detected. Devices are opened only to identify them. A
    driver that cannot be loaded, or whose search fails, is listed with that as its obstacle.
    """
    loaded = registry.load_all()
    found = [FoundDevice(name, "", "", "", why, name) for name, why in loaded.refused.items()]
    for name, driver in loaded.classes.items():
        if not issubclass(driver, OperatorDevice):
            continue
        try:
            with registry.using(name, "driver"):
                found += [each._replace(driver=name) for each in driver.find()]
        except ConfigurationError as error:
            found.append(FoundDevice(name, "", "", "", reason(error), name))
    return found


_HOMES = {
    "CartesianDevice": "cardan.gateway.arm",
    "from_json": "cardan.common.value_json",
    "to_json": "cardan.common.value_json",
    "network_arm": "cardan.gateway.bus.remote",
    **{name: module for module, _, name in (each.partition(":") for each in BUILT_IN.values())},
}
_INNER = {
    *("Any", "BUILT_IN", "Literal", "TYPE_CHECKING", "annotations", "import_module", "overload"),
    *("reason", "registry"),
}


def _names() -> set[str]:
    """The names of the public interface."""
    return {name for name in globals() if name[0] != "_"} - _INNER | _HOMES.keys()


def _there() -> set[str]:
    """Names whose packages are installed; importing a driver needs no optional package."""
    found = _names()
    for name in _HOMES.keys() - {each.rpartition(":")[2] for each in BUILT_IN.values()}:
        try:
            __getattr__(name)
        except ExtraMissingError:
            found.remove(name)
    return found


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
