"""Identity of the served device for programs: name, type and USB id of its model."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, Protocol, runtime_checkable

from cardan.drivers.base import OperatorDevice
from cardan.drivers.spacemouse import SpaceMouse
from cardan.drivers.spnav.core import usual_full_scales
from cardan.protocols.spnav.codes import UNKNOWN_DEVICE
from cardan_spnav_server.buttons import button_number

DEFAULT_NAME = "Cardan"
"""Name of a device whose model is unknown."""


class DeviceIdentity(NamedTuple):
    """Identity of the device for programs."""

    name: str = DEFAULT_NAME
    path: str = ""
    device_type: int = UNKNOWN_DEVICE
    """One of `cardan.protocols.spnav.DEVICE_TYPES`."""
    vendor_id: int = 0
    product_id: int = 0
    """0, 0: not a USB device, or unknown."""
    button_numbers: Mapping[str, int] = MappingProxyType({})
    """spacenavd's numbers of its buttons by label; other buttons may have any number."""

    @property
    def full_scales(self) -> tuple[float, float]:
        """Counts that programs expect for a full deflection: translation, rotation."""
        return usual_full_scales(self.device_type, self.vendor_id, self.product_id)


@runtime_checkable
class KnownModel(Protocol):
    """Model of a six-axis device in a driver's attribute `model`."""

    @property
    def name(self) -> str: ...
    @property
    def key(self) -> str: ...
    @property
    def vendor_id(self) -> int: ...
    @property
    def product_id(self) -> int: ...
    @property
    def buttons(self) -> Mapping[int, str]:
        """Label by bit of HID report 3, or of its equivalent in a serial device."""

    @property
    def receiver(self) -> bool:
        """True if its buttons are those of a paired puck, and unknown."""


def identity_of(device: OperatorDevice, name: str = "") -> DeviceIdentity:
    """Return the identity of `device`, with `name` unless that is empty.

    A driver that knows the model of a 3Dconnexion device has it in `model` once it is open; all
    other devices have only a name.
    """
    model = getattr(device, "model", None)
    if not isinstance(model, KnownModel):
        return DeviceIdentity(name or DEFAULT_NAME)
    usb_id = (model.vendor_id, model.product_id)
    serial = usb_id == (0, 0)
    return DeviceIdentity(
        name=name or model.name,
        device_type=(
            _SERIAL_TYPES.get(model.key, UNKNOWN_DEVICE)
            if serial
            else _USB_TYPES.get(usb_id, UNKNOWN_DEVICE)
        ),
        vendor_id=model.vendor_id,
        product_id=model.product_id,
        button_numbers=_button_numbers(model),
    )


def identity_behind_bus(model: str, name: str = "") -> DeviceIdentity:
    """Return the identity of the 3Dconnexion device with that key, which its session publishes on
    the bus with buttons "button-0" and so on, in the order of its driver's list."""
    mouse = SpaceMouse(model=model)
    identity = identity_of(mouse, name)
    known = identity.button_numbers
    numbers = {
        f"button-{place}": known[label]
        for place, label in enumerate(mouse.capabilities.buttons)
        if label in known
    }
    return identity._replace(button_numbers=MappingProxyType({**known, **numbers}))


def _button_numbers(model: KnownModel) -> Mapping[str, int]:
    """Return spacenavd's numbers by label.

    With a receiver "right" is that of a puck with two buttons, although a larger one has such a
    key.
    """
    numbers = {
        label: number
        for bit, label in model.buttons.items()
        if (number := button_number(model.vendor_id, model.product_id, bit)) is not None
    }
    return MappingProxyType({**numbers, **_OF_TWO} if model.receiver else numbers)


_OF_TWO: Mapping[str, int] = MappingProxyType({"left": 0, "right": 1})

_USB_TYPES: Mapping[tuple[int, int], int] = MappingProxyType(
    {
        (0x046D, 0xC603): 0x200,
        (0x046D, 0xC605): 0x201,
        (0x046D, 0xC606): 0x202,
        (0x046D, 0xC621): 0x203,
        (0x046D, 0xC623): 0x204,
        (0x046D, 0xC625): 0x205,
        (0x046D, 0xC626): 0x206,
        (0x046D, 0xC627): 0x207,
        (0x046D, 0xC628): 0x208,
        (0x046D, 0xC629): 0x209,
        (0x046D, 0xC62B): 0x20A,
        (0x256F, 0xC62E): 0x20C,
        (0x256F, 0xC62F): 0x20C,
        (0x256F, 0xC631): 0x20D,
        (0x256F, 0xC632): 0x20D,
        (0x256F, 0xC633): 0x20E,
        (0x256F, 0xC635): 0x20F,
        (0x256F, 0xC636): 0x210,
        (0x256F, 0xC638): 0x20D,
        (0x256F, 0xC63A): 0x20C,
    }
)
"""Device types by USB id. A Universal Receiver has the type of its puck, which is unknown."""

_SERIAL_TYPES: Mapping[str, int] = MappingProxyType(
    {
        "spaceball-2003": 0x100,
        "spaceball-3003": 0x101,
        "spaceball-4000": 0x102,
        "magellan": 0x103,
        "spaceball-5000": 0x104,
    }
)
"""Device types by model. spacenavd does not know the SpaceOrb."""
