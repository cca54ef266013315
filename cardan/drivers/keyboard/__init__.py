"""A keyboard as an operator device: keys held down move the robot."""

from cardan.drivers.keyboard.core import KeyboardCore
from cardan.drivers.keyboard.device import Keyboard
from cardan.drivers.keyboard.options import KeyboardOptions

__all__ = ["Keyboard", "KeyboardCore", "KeyboardOptions"]
