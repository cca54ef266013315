"""A JR3 force-torque sensor on a CAN bus (uc3m's mbed board) as an operator device."""

from cardan_jr3.driver.bus import (
    can_interfaces as can_interfaces,
)
from cardan_jr3.driver.core import (
    Jr3Core as Jr3Core,
)
from cardan_jr3.driver.device import (
    Jr3 as Jr3,
)
from cardan_jr3.driver.options import (
    Jr3Options as Jr3Options,
)
