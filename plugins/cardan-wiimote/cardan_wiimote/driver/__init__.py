"""Nintendo's Wii Remote as an operator device."""

from cardan_wiimote.driver.core import (
    Identity as Identity,
    WiimoteCore as WiimoteCore,
)
from cardan_wiimote.driver.device import (
    Wiimote as Wiimote,
)
from cardan_wiimote.driver.options import (
    WiimoteOptions as WiimoteOptions,
)
