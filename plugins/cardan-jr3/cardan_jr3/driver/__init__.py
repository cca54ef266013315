"""A JR3 force-torque sensor on a CAN bus (uc3m's mbed board) as an operator device."""

from cardan.drivers.jr3_can.bus import (
    can_interfaces as can_interfaces,
)
from cardan.drivers.jr3_can.core import (
    Jr3Core as Jr3Core,
)
from cardan.drivers.jr3_can.device import (
    Jr3 as Jr3,
)
from cardan.drivers.jr3_can.options import (
    Jr3Options as Jr3Options,
)
