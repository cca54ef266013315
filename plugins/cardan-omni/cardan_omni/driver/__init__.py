"""The Phantom Omni, Geomagic and 3D Systems Touch as operator devices with force feedback."""

from cardan_omni.driver.core import (
    BUTTONS as BUTTONS,
    Identity as Identity,
    OmniCore as OmniCore,
)
from cardan_omni.driver.device import (
    Omni as Omni,
)
from cardan_omni.driver.options import (
    OmniOptions as OmniOptions,
)
from cardan_omni.driver.values import (
    TickDetails as TickDetails,
)
