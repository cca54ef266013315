"""3Dconnexion's six-axis devices (SpaceMouse, SpaceNavigator and kin) as operator devices."""

from cardan.drivers.spacemouse.core import (
    SpaceMouseCore as SpaceMouseCore,
)
from cardan.drivers.spacemouse.device import (
    SpaceMouse as SpaceMouse,
    list_devices as list_devices,
)
from cardan.drivers.spacemouse.options import (
    SpaceMouseOptions as SpaceMouseOptions,
)
