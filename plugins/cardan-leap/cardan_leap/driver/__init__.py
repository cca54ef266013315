"""The Leap Motion Controller as an operator device, by its service's WebSocket, without an SDK."""

from cardan_leap.driver.core import (
    BUTTONS as BUTTONS,
    LeapCore as LeapCore,
)
from cardan_leap.driver.device import (
    Leap as Leap,
)
from cardan_leap.driver.options import (
    LeapOptions as LeapOptions,
)
