"""A keyboard as an operator device: keys held down move the robot."""

from cardan.drivers.keyboard.core import (
    KeyboardCore as KeyboardCore,
)
from cardan.drivers.keyboard.device import (
    Keyboard as Keyboard,
)
from cardan.drivers.keyboard.options import (
    KeyboardOptions as KeyboardOptions,
)
