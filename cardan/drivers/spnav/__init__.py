"""spacenavd's socket as an operator device: whatever six-axis device the daemon has."""

from cardan.drivers.spnav.core import (
    SpnavCore as SpnavCore,
)
from cardan.drivers.spnav.device import (
    Spnav as Spnav,
)
from cardan.drivers.spnav.options import (
    SpnavOptions as SpnavOptions,
)
