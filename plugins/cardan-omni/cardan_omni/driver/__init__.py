"""The Phantom Omni, Geomagic and 3D Systems Touch as operator devices that give force back."""

from cardan.drivers.omni.core import (
    BUTTONS as BUTTONS,
    Identity as Identity,
    OmniCore as OmniCore,
)
from cardan.drivers.omni.device import (
    Omni as Omni,
)
from cardan.drivers.omni.options import (
    OmniOptions as OmniOptions,
)
from cardan.drivers.omni.values import (
    TickDetails as TickDetails,
)
