"""Yaskawa Motoman controllers that run MotoROS: simple message over TCP."""

from cardan.drivers.motoros.driver import Motoros as Motoros
from cardan.drivers.motoros.errors import (
    IoConnectionError as IoConnectionError,
    IoRefusedError as IoRefusedError,
)
from cardan.drivers.motoros.io_client import IoClient as IoClient
from cardan.drivers.motoros.motion_control import Phase as Phase
from cardan.drivers.motoros.options import MotorosOptions as MotorosOptions
from cardan.drivers.motoros.session import MotorosSession as MotorosSession
