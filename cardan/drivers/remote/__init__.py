"""Operator device on another computer, published by `cardan devices share`."""

from cardan.drivers.remote.device import Remote as Remote
from cardan.drivers.remote.options import RemoteOptions as RemoteOptions
