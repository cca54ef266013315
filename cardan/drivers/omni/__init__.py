"""The Phantom Omni, Geomagic and 3D Systems Touch as operator devices that give force back."""

from cardan.drivers.omni.core import BUTTONS, Identity, OmniCore
from cardan.drivers.omni.device import Omni
from cardan.drivers.omni.options import OmniOptions
from cardan.drivers.omni.values import TickDetails

__all__ = ["BUTTONS", "Identity", "Omni", "OmniCore", "OmniOptions", "TickDetails"]
