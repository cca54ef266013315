"""The Leap Motion Controller as an operator device, by its service's WebSocket, without an SDK."""

from cardan.drivers.leap.core import BUTTONS, LeapCore
from cardan.drivers.leap.device import Leap
from cardan.drivers.leap.options import LeapOptions

__all__ = ["BUTTONS", "Leap", "LeapCore", "LeapOptions"]
