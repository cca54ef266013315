"""Yaskawa Motoman controllers that run MotoROS: simple message over TCP."""

from cardan.drivers.motoros.driver import Motoros
from cardan.drivers.motoros.io_client import IoClient
from cardan.drivers.motoros.motion_control import Phase
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession

__all__ = ["IoClient", "Motoros", "MotorosOptions", "MotorosSession", "Phase"]
