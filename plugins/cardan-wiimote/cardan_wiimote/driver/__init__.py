"""Nintendo's Wii Remote as an operator device."""

from cardan.drivers.wiimote.core import (
    Identity as Identity,
    WiimoteCore as WiimoteCore,
)
from cardan.drivers.wiimote.device import (
    Wiimote as Wiimote,
)
from cardan.drivers.wiimote.options import (
    WiimoteOptions as WiimoteOptions,
)
