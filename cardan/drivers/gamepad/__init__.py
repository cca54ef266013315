"""Gamepads that Linux knows (Xbox, PlayStation, Switch and the like) as operator devices."""

from cardan.drivers.gamepad.core import GamepadCore
from cardan.drivers.gamepad.device import Gamepad
from cardan.drivers.gamepad.options import GamepadOptions

__all__ = ["Gamepad", "GamepadCore", "GamepadOptions"]
