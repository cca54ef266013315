"""Registry of drivers by name: the built-in table, then entry points of installed packages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cardan.common.options import OTHER_KEYS, Options, require
from cardan.common.plugins import Finder, entry_points
from cardan.drivers.base import Driver

ENTRY_POINT_GROUP = "cardan.drivers"

BUILT_IN = {
    "spacemouse": "cardan.drivers.spacemouse:SpaceMouse",
    "spnav": "cardan.drivers.spnav:Spnav",
    "gamepad": "cardan.drivers.gamepad:Gamepad",
    "keyboard": "cardan.drivers.keyboard:Keyboard",
    "ros2_spacenav": "cardan.drivers.bus_devices:Ros2Spacenav",
    "ros2_joy": "cardan.drivers.bus_devices:Ros2Joy",
    "remote": "cardan.drivers.remote:Remote",
    "phone": "cardan.drivers.bus_devices:Phone",
    "xr": "cardan.drivers.bus_devices:Xr",
    "abb_egm": "cardan.drivers.abb_egm:AbbEgm",
    "motoros": "cardan.drivers.motoros:Motoros",
    "ur_rtde": "cardan.drivers.ur_rtde:UrRtde",
    "ros2": "cardan.drivers.ros2_arm:Ros2Arm",
    "sim_arm": "cardan.drivers.sim_arm:SimArm",
}
"""Cardan's own drivers. Other packages add theirs by entry points of the same form."""


@dataclass(frozen=True)
class DriverTable(Options):
    """Table with a driver's name; all other keys are that driver's options."""

    driver: str
    options: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)

    @classmethod
    def kind_of_others(cls, table: Mapping[str, Any]) -> Any:
        """Options class of the table's driver; None if the driver cannot be loaded."""
        return FINDER.options_of(table.get("driver", ""))


FINDER: Finder[Driver] = Finder(
    Driver,  # type: ignore[type-abstract]
    "driver",
    BUILT_IN,
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
names, packages, load_all, using = FINDER.names, FINDER.packages, FINDER.load_all, FINDER.using


def load(name: str) -> type[Driver]:
    """Return the driver class called `name`. Raises ConfigurationError with the known names."""
    if not isinstance(name, str):  # The installed drivers are read for the message only.
        require(False, "driver", name, f"one of {', '.join(names())}")
    return FINDER.load(name)
