"""An operator device that `cardan devices share` publishes on another computer."""

from cardan.drivers.remote.device import Remote as Remote
from cardan.drivers.remote.options import RemoteOptions as RemoteOptions
