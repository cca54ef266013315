"""Options of the gamepad driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.common.options import require
from cardan.drivers.evdev.device import check_way
from cardan.drivers.shaping import ShapingOptions
from cardan.protocols.evdev.codes import PAD_CODES

STALE_AFTER_S = bounds.Range(0.0, 60.0, "s", "no held stick keeps still for longer", zero="off")


@dataclass(frozen=True, kw_only=True)
class GamepadOptions(ShapingOptions):
    """Options of :class:`Gamepad`. Raises OptionError for a value that is not allowed."""

    transport: Literal["evdev", "socket"] = "evdev"
    """evdev: a node of /dev/input. socket: a simulated gamepad."""
    path: Annotated[str, bounds.MEETING] = ""
    """The node's path as ``cardan devices`` lists it, or the socket's; empty: the first found."""
    name: str = ""
    """Part of the pad's name, if several are plugged in; empty: any."""
    layout: Literal["sticks", "swapped", "triggers"] = "sticks"
    """sticks: left stick x and y, right stick z and yaw. swapped: the sticks exchanged.
    triggers: left stick x and y, triggers z, right stick pitch and yaw."""
    shift: str = "right-shoulder"
    """Button to hold for the other rotations; empty: none."""
    dead_zone: Annotated[float, bounds.DEAD_ZONE] = 0.1
    """Share of the full scale that counts as rest, 0 to below 1; the rest is rescaled to 0..1."""
    stale_after_s: Annotated[float, STALE_AFTER_S] = 0.0
    """Silence of a deflected pad after which it counts as lost, s; 0: off. For pads whose held
    sticks always flutter."""
    wait_for_device: bool = False
    """open() succeeds without a pad, which is picked up once it is plugged in."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_way(self.transport, self.path)
        good = not self.shift or self.shift in PAD_CODES
        require(good, "shift", self.shift, f"empty or one of {', '.join(PAD_CODES)}")
