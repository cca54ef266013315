"""Tables that ``cardan devices spnav`` reads from a file."""

from __future__ import annotations

from dataclasses import dataclass, field

from cardan.common.options import Options
from cardan.drivers.registry import DriverTable
from cardan_spnav_server.options import SpnavServerOptions


@dataclass(frozen=True, kw_only=True)
class ServedConfig(Options):
    """``[device]`` and ``[spnav]``: no robot is needed."""

    device: DriverTable
    spnav: SpnavServerOptions = field(default_factory=SpnavServerOptions)
