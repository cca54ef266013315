"""What can be set about the SpaceMouse driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan import bounds
from cardan.drivers.shaping import ShapingOptions
from cardan.options import require
from cardan.protocols.connexion import MODELS
from cardan.protocols.connexion_serial import SERIAL_MODELS

_MODEL_KEYS = tuple(model.key for model in MODELS)
_SERIAL_MODEL_KEYS = tuple(model.key for model in SERIAL_MODELS)


@dataclass(frozen=True, kw_only=True)
class SpaceMouseOptions(ShapingOptions):
    """Options of :class:`SpaceMouse`. Raises OptionError for a value that is not allowed."""

    transport: Literal["auto", "hidraw", "libusb", "usb", "serial", "socket"] = "auto"
    """auto: hidraw, then libusb. usb: raw USB, where there is no HID. serial: a device at a serial
    port. socket: a simulated device, one raw HID report per packet."""
    path: str = ""
    """The device's path as ``cardan devices`` lists it, the serial port's or the socket's; empty:
    the first found."""
    model: str = ""
    """Key of the model to open ("spacemouse-compact"); for a socket, the simulated model, for the
    labels of its buttons and its full scale. Empty: any; at a serial port it is detected."""
    serial: str = ""
    """Serial number of the device to open; most have none. Empty: any."""
    port: str = ""
    """USB port of the device to open ("1-2.3", as in /sys/bus/usb/devices). Empty: any."""
    slot: Literal["", "0", "1", "2", "3", "4"] = ""
    """Interface of a receiver on which the device sends. Empty: the first that sends."""
    full_scale: Annotated[float, bounds.COUNTS] | None = None
    """Counts of a full deflection; None: from the report descriptor, else the model's."""
    led: Literal["keep", "on", "off"] = "keep"
    """What the LED shows from opening until the gateway says otherwise."""
    wait_for_device: bool = False
    """open() succeeds without a device, which is picked up once it is plugged in."""

    def __post_init__(self) -> None:
        super().__post_init__()
        keys = _SERIAL_MODEL_KEYS if self.transport == "serial" else _MODEL_KEYS
        good = not self.model or self.model in keys
        require(good, "model", self.model, f"empty or one of {', '.join(keys)}")
        if self.transport in ("serial", "socket"):
            way = f"for transport {self.transport!r}"
            what = "socket" if self.transport == "socket" else "serial port"
            require(self.path, "path", self.path, f"the path of the {what} {way}")
            for name in ("port", "slot"):
                value = getattr(self, name)
                require(not value, name, value, f"empty {way}: its path tells devices apart")
