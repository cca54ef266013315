"""Models of simulated input devices, as presented by the kernel's drivers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from cardan.protocols.evdev.codes import (
    ABS_HAT0X,
    ABS_HAT0Y,
    ABS_RX,
    ABS_RY,
    ABS_RZ,
    ABS_X,
    ABS_Y,
    ABS_Z,
    BTN_JOYSTICK,
    BTN_NORTH,
    BTN_SOUTH,
    BTN_TL2,
    BTN_TR2,
    BTN_WEST,
    FF_GAIN,
    FF_RUMBLE,
    KEY_CODES,
    PAD_CODES,
    north_and_west_exchanged,
)
from cardan.protocols.evdev.requests import BUS_USB, AbsInfo, InputId

_MEMLESS_EFFECTS = frozenset({FF_RUMBLE, 0x51, 0x58, 0x59, 0x5A, FF_GAIN})
"""Effects that the kernel offers for two motors: rumble, and periodic ones that become rumble."""


class InputDeviceModel(NamedTuple):
    """Model of a simulated input device."""

    key: str
    name: str
    id: InputId
    codes: Mapping[str, int]
    """Key and button codes by label."""
    axes: Mapping[int, AbsInfo]
    """Their ranges; the values are those at rest."""
    effects: frozenset[int]
    period_s: float
    """Poll period of the hardware."""
    sticks: tuple[int, int, int, int] = (ABS_X, ABS_Y, ABS_RX, ABS_RY)
    """Axes of the left stick and of the right one."""
    triggers: tuple[int, ...] = (ABS_Z, ABS_RZ)
    """Axes of the left trigger and the right one; empty: the triggers are only buttons."""
    repeats: bool = False
    """The kernel repeats a key that is held."""

    @property
    def is_gamepad(self) -> bool:
        """True if it has sticks."""
        return ABS_X in self.axes


def _pad_codes(vendor: int, *, trigger_buttons: bool) -> Mapping[str, int]:
    """Codes by label; D-pads are hats and have none."""
    codes = {label: code for label, code in PAD_CODES.items() if not label.startswith("dpad")}
    if not trigger_buttons:
        codes = {label: code for label, code in codes.items() if code not in (BTN_TL2, BTN_TR2)}
    if north_and_west_exchanged(vendor, ""):
        codes["west"], codes["north"] = BTN_NORTH, BTN_WEST
    return MappingProxyType(codes)


def _counted_codes(first: int, *further: str) -> Mapping[str, int]:
    """Codes of a pad with the generic driver, counted from `first` in the reports' order."""
    labels = (
        "west", "south", "east", "north", "left-shoulder", "right-shoulder", "left-trigger",
        "right-trigger", "select", "start", "left-stick", "right-stick",
    )  # fmt: skip
    return MappingProxyType({label: first + at for at, label in enumerate((*labels, *further))})


_COUNTED_STICKS, _COUNTED_TRIGGERS = (ABS_X, ABS_Y, ABS_Z, ABS_RZ), (ABS_RX, ABS_RY)


def _pad_axes(
    stick: AbsInfo,
    trigger_most: int,
    sticks: tuple[int, ...] = (ABS_X, ABS_Y, ABS_RX, ABS_RY),
    triggers: tuple[int, ...] = (ABS_Z, ABS_RZ),
) -> Mapping[int, AbsInfo]:
    trigger, hat = AbsInfo(0, 0, trigger_most, 0, 0, 0), AbsInfo(0, -1, 1, 0, 0, 0)
    return MappingProxyType(
        {
            **dict.fromkeys(sticks, stick),
            **dict.fromkeys(triggers, trigger),
            **dict.fromkeys((ABS_HAT0X, ABS_HAT0Y), hat),
        }
    )


_XBOX_STICK = AbsInfo(0, -32768, 32767, 16, 128, 0)
_SONY_STICK = AbsInfo(128, 0, 255, 0, 0, 0)
# The generic driver declares a sixteenth of the range as flat.
_COUNTED_STICK = AbsInfo(128, 0, 255, 0, 15, 0)
_COUNTED_AXES = _pad_axes(_COUNTED_STICK, 255, _COUNTED_STICKS, _COUNTED_TRIGGERS)

MODELS = (
    InputDeviceModel(
        "xbox-360",
        "Microsoft X-Box 360 pad",
        InputId(BUS_USB, 0x045E, 0x028E, 0x0110),
        _pad_codes(0x045E, trigger_buttons=False),
        _pad_axes(_XBOX_STICK, 255),
        _MEMLESS_EFFECTS,
        0.004,
    ),
    InputDeviceModel(
        "xbox-one",
        "Microsoft Xbox One S pad",
        InputId(BUS_USB, 0x045E, 0x02EA, 0x0301),
        _pad_codes(0x045E, trigger_buttons=False),
        _pad_axes(_XBOX_STICK, 1023),
        _MEMLESS_EFFECTS,
        0.004,
    ),
    InputDeviceModel(
        "dualshock-4",
        "Sony Interactive Entertainment Wireless Controller",
        InputId(BUS_USB, 0x054C, 0x09CC, 0x8111),
        _pad_codes(0x054C, trigger_buttons=True),
        _pad_axes(_SONY_STICK, 255),
        _MEMLESS_EFFECTS,
        0.004,
    ),
    InputDeviceModel(
        "dualshock-4-generic",
        "Sony Interactive Entertainment Wireless Controller",
        InputId(BUS_USB, 0x054C, 0x09CC, 0x0111),
        _counted_codes(BTN_SOUTH, "mode", "touchpad"),
        _COUNTED_AXES,
        frozenset(),
        0.004,
        _COUNTED_STICKS,
        _COUNTED_TRIGGERS,
    ),
    InputDeviceModel(
        "dualsense-generic",
        "Sony Interactive Entertainment DualSense Wireless Controller",
        InputId(BUS_USB, 0x054C, 0x0CE6, 0x0111),
        _counted_codes(BTN_SOUTH, "mode", "touchpad", "mute"),
        _COUNTED_AXES,
        frozenset(),
        0.004,
        _COUNTED_STICKS,
        _COUNTED_TRIGGERS,
    ),
    InputDeviceModel(
        "logitech-f310-d",
        "Logitech Logitech Dual Action",
        InputId(BUS_USB, 0x046D, 0xC216, 0x0110),
        _counted_codes(BTN_JOYSTICK),
        _pad_axes(_COUNTED_STICK, 255, _COUNTED_STICKS, ()),
        frozenset(),
        0.004,
        _COUNTED_STICKS,
        (),
    ),
    InputDeviceModel(
        "keyboard",
        "AT Translated Set 2 keyboard",
        InputId(0x11, 0x0001, 0x0001, 0xAB41),
        KEY_CODES,
        MappingProxyType({}),
        frozenset(),
        0.008,
        repeats=True,
    ),
)
"""Models of each kind; the first is its default."""
