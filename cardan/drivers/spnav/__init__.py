"""spacenavd's socket as an operator device: any six-axis device of the daemon."""

from cardan.drivers.spnav.core import (
    SpnavCore as SpnavCore,
)
from cardan.drivers.spnav.device import (
    Spnav as Spnav,
)
from cardan.drivers.spnav.options import (
    SpnavOptions as SpnavOptions,
)
