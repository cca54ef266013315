"""Gamepads that Linux knows (Xbox, PlayStation, Switch and the like) as operator devices."""

from cardan.drivers.gamepad.core import (
    GamepadCore as GamepadCore,
)
from cardan.drivers.gamepad.device import (
    Gamepad as Gamepad,
)
from cardan.drivers.gamepad.options import (
    GamepadOptions as GamepadOptions,
)
