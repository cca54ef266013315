"""The driver ``spacemouse_serial``."""

from cardan_serial_mice.driver.core import (
    SerialMouseCore as SerialMouseCore,
)
from cardan_serial_mice.driver.device import (
    SpaceMouseSerial as SpaceMouseSerial,
)
from cardan_serial_mice.driver.options import (
    SpaceMouseSerialOptions as SpaceMouseSerialOptions,
)
