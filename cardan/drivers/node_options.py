"""Options that the drivers of ROS 2 nodes share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from cardan.bus.options import BusOptions
from cardan.common import bounds
from cardan.drivers.simulated import OWN, Way
from cardan.errors import OptionError
from cardan.protocols.ros2.names import RosNameError, checked_name


@dataclass(frozen=True, kw_only=True)
class NodeOptions(BusOptions):
    """Options of a driver's bus connection."""

    port: Annotated[int, bounds.ANY_PORT] = 0
    """TCP port of the other node on this computer, for a connection without a router, as with
    simulated ones; 0: by `router`."""

    @property
    def bus(self) -> BusOptions:
        """Options of the bus connection, with the port."""
        if not self.port:
            return self
        return replace(self, port=0, router=f"tcp/127.0.0.1:{self.port}", mode="peer")


def require_name(key: str, given: object, name: str) -> None:
    """Raise OptionError for the option `key` with the value `given` unless `name`, which is derived
    from it, is a valid ROS 2 name."""
    try:
        checked_name(name)
    except RosNameError as error:
        raise OptionError(key, given, f"a name of ROS 2 ({error})") from None


SIMULATED: tuple[Way, ...] = (
    {"port": OWN, "zenoh_config": ("",), "listen": (BusOptions().listen,)},
)
"""Requirement of demos: no other program has access."""
