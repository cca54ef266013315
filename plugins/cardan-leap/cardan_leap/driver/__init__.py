"""The Leap Motion Controller as an operator device, by its service's WebSocket, without an SDK."""

from cardan.drivers.leap.core import (
    BUTTONS as BUTTONS,
    LeapCore as LeapCore,
)
from cardan.drivers.leap.device import (
    Leap as Leap,
)
from cardan.drivers.leap.options import (
    LeapOptions as LeapOptions,
)
