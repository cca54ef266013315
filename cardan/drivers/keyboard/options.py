"""Options of the keyboard driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.common import bounds
from cardan.drivers.evdev.device import check_way
from cardan.drivers.shaping import ShapingOptions

RAMP_S = bounds.Range(0.0, 5.0, "s", "a key that takes longer seems dead")


@dataclass(frozen=True, kw_only=True)
class KeyboardOptions(ShapingOptions):
    """Options of :class:`Keyboard`. Raises OptionError for a value that is not allowed."""

    transport: Literal["evdev", "socket"] = "evdev"
    """evdev: a node of /dev/input. socket: a simulated keyboard."""
    path: Annotated[str, bounds.MEETING] = ""
    """The node's path as ``cardan devices`` lists it, or the socket's; empty: the first found."""
    name: str = ""
    """Part of the keyboard's name, if several are plugged in; empty: any."""
    layout: Literal["letters", "arrows"] = "letters"
    """letters: a z, s x, d c along x, y, z; f v, g b, h n about them. arrows: the arrow keys and
    page up and down along, the number pad about them."""
    ramp_s: Annotated[float, RAMP_S] = 0.3
    """Time from pressing a key to full deflection; a release acts at once."""
    grab: bool = False
    """True: other programs get no keys while the keyboard is read; Esc gives it back, F12 takes it
    again."""
    dead_zone: Annotated[float, bounds.DEAD_ZONE] = 0.0
    """Share of the full scale that counts as rest, 0 to below 1; the rest is rescaled to 0..1."""
    wait_for_device: bool = False
    """open() succeeds without a keyboard, which is picked up once it is plugged in."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_way(self.transport, self.path)
