"""Options of a device on another computer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common.bounds import Range
from cardan.common.options import require
from cardan.drivers.node_options import NodeOptions, require_name
from cardan.drivers.remote.shared import claim_topic, state_topic

MAX_AGE_S = Range(0.02, 0.5, "s", "a device that is gone moves the arm for so long")

PLAYOUT_MS = Range(
    0.0, 200.0, "ms", "the arm follows the device so much later", zero="played on arrival"
)


@dataclass(frozen=True, kw_only=True)
class RemoteOptions(NodeOptions):
    """Options of :class:`Remote`."""

    device: str = "spacemouse"
    """Name under which `cardan devices share` publishes it."""
    max_age_s: Annotated[float, MAX_AGE_S] = 0.15
    """Age of its newest state from which on the device counts as lost."""
    force: bool = False
    """True: the device is haptic, and the force of [force] and [[fixtures]] is sent back to it."""
    playout_ms: Annotated[float, PLAYOUT_MS] = 0.0
    """Longest time that motion waits for playout with its original timing, whatever the jitter."""
    mode: Literal["peer", "client"] = "client"
    """"client": all traffic goes through the router, as a router on another computer requires;
    "peer": programs on this computer connect directly."""
    name: str = "cardan_device_driver"
    """Name of this driver's node."""
    wait_for_device: bool = False
    """open() succeeds without the device, which is leased once it is shared and free."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.playout_ms < 1e3 * self.max_age_s,
            "playout_ms",
            self.playout_ms,
            f"less than max_age_s, {1e3 * self.max_age_s:g} ms: states age while they wait in "
            "the buffer",
        )
        require("/" not in self.device, "device", self.device, "a name without /")
        require_name("device", self.device, self.topic)
        require_name("name", self.name, f"/{self.name}")

    @property
    def topic(self) -> str:
        """Topic of cardan_msgs/SharedDevice."""
        return state_topic(self.device)

    @property
    def claim_topic(self) -> str:
        """Topic of cardan_msgs/DeviceClaim."""
        return claim_topic(self.device)
