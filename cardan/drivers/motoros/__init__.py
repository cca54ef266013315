"""Yaskawa Motoman controllers that run MotoROS: simple message over TCP."""

from cardan.drivers.motoros.driver import Motoros as Motoros
from cardan.drivers.motoros.errors import (
    IoConnectionError as IoConnectionError,
    IoRefusedError as IoRefusedError,
)
from cardan.drivers.motoros.options import MotorosOptions as MotorosOptions
