"""3Dconnexion's six-axis devices (SpaceMouse, SpaceNavigator and kin) as operator devices."""

from cardan.drivers.spacemouse.core import SpaceMouseCore
from cardan.drivers.spacemouse.device import SpaceMouse, list_devices
from cardan.drivers.spacemouse.options import SpaceMouseOptions
from cardan.drivers.spacemouse.transports import HidCandidate

__all__ = [
    "HidCandidate",
    "SpaceMouse",
    "SpaceMouseCore",
    "SpaceMouseOptions",
    "list_devices",
]
