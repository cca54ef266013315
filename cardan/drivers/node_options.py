"""Options that the drivers of ROS 2 nodes share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from cardan.bus.options import BusOptions
from cardan.common import bounds


@dataclass(frozen=True, kw_only=True)
class NodeOptions(BusOptions):
    """How a driver is on the bus."""

    port: Annotated[int, bounds.ANY_PORT] = 0
    """TCP port of the other node on this computer, which is then met without a router, as
    simulated ones are; 0: by `router`."""

    @property
    def bus(self) -> BusOptions:
        """How to be on the bus, the port taken into account."""
        if not self.port:
            return self
        return replace(self, port=0, router=f"tcp/127.0.0.1:{self.port}", mode="peer")


SIMULATED_LISTEN = BusOptions().listen
"""In a demo nobody else is let in."""
