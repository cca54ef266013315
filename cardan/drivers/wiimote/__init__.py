"""Nintendo's Wii Remote as an operator device."""

from cardan.drivers.wiimote.core import Identity, WiimoteCore
from cardan.drivers.wiimote.device import Wiimote
from cardan.drivers.wiimote.options import WiimoteOptions

__all__ = ["Identity", "Wiimote", "WiimoteCore", "WiimoteOptions"]
