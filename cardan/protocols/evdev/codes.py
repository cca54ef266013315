"""Names of keys, buttons and axes: our labels for the kernel's numbers.

The numbers are those of linux/input-event-codes.h, the meaning of a pad's that of the kernel's
gamepad.rst: buttons by their position (south is A on an Xbox pad, the cross on a PlayStation's).
Keys are named after their caps on a US keyboard, whatever their print.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ = range(6)
ABS_THROTTLE, ABS_RUDDER, ABS_WHEEL, ABS_GAS, ABS_BRAKE = range(0x06, 0x0B)
ABS_HAT0X, ABS_HAT0Y = 0x10, 0x11
ABS_COUNT = 0x40
KEY_COUNT = 0x300
FF_COUNT = 0x80

FF_RUMBLE = 0x50
FF_GAIN = 0x60

BTN_JOYSTICK = 0x120
JOYSTICK_BUTTONS: Final = range(BTN_JOYSTICK, BTN_JOYSTICK + 16)
"""Numbers that the generic HID driver assigns to the buttons of a declared joystick."""
BTN_SOUTH, BTN_EAST, BTN_C, BTN_NORTH, BTN_WEST, BTN_Z = range(0x130, 0x136)
BTN_TL, BTN_TR, BTN_TL2, BTN_TR2 = 0x136, 0x137, 0x138, 0x139
BTN_SELECT, BTN_START, BTN_MODE, BTN_THUMBL, BTN_THUMBR = 0x13A, 0x13B, 0x13C, 0x13D, 0x13E
BTN_DPAD_UP, BTN_DPAD_DOWN, BTN_DPAD_LEFT, BTN_DPAD_RIGHT = 0x220, 0x221, 0x222, 0x223

PAD_BUTTONS: Mapping[int, str] = MappingProxyType(
    {
        BTN_SOUTH: "south",
        BTN_EAST: "east",
        BTN_NORTH: "north",
        BTN_WEST: "west",
        BTN_TL: "left-shoulder",
        BTN_TR: "right-shoulder",
        BTN_TL2: "left-trigger",
        BTN_TR2: "right-trigger",
        BTN_SELECT: "select",
        BTN_START: "start",
        BTN_MODE: "mode",
        BTN_THUMBL: "left-stick",
        BTN_THUMBR: "right-stick",
        BTN_DPAD_UP: "dpad-up",
        BTN_DPAD_DOWN: "dpad-down",
        BTN_DPAD_LEFT: "dpad-left",
        BTN_DPAD_RIGHT: "dpad-right",
    }
)
"""Labels of a gamepad's buttons."""

# Keys with consecutive codes, from 1 on.
_FROM_1 = (
    "esc", *"1234567890", "minus", "equal", "backspace", "tab",
    *"qwertyuiop", "left-brace", "right-brace", "enter", "left-ctrl",
    *"asdfghjkl", "semicolon", "apostrophe", "grave", "left-shift", "backslash",
    *"zxcvbnm", "comma", "dot", "slash", "right-shift", "kp-asterisk", "left-alt", "space",
    "caps-lock", *(f"f{number}" for number in range(1, 11)), "num-lock", "scroll-lock",
    "kp-7", "kp-8", "kp-9", "kp-minus", "kp-4", "kp-5", "kp-6", "kp-plus",
    "kp-1", "kp-2", "kp-3", "kp-0", "kp-dot",
)  # fmt: skip
_FROM_102 = (
    "home", "up", "page-up", "left", "right", "end", "down", "page-down", "insert", "delete",
)  # fmt: skip

KEYS: Mapping[int, str] = MappingProxyType(
    {
        **dict(enumerate(_FROM_1, 1)),
        **dict(enumerate(("102nd", "f11", "f12"), 86)),
        **dict(enumerate(("kp-enter", "right-ctrl", "kp-slash", "sysrq", "right-alt"), 96)),
        **dict(enumerate(_FROM_102, 102)),
        119: "pause",
        **dict(enumerate(("left-meta", "right-meta", "compose"), 125)),
    }
)
"""Labels of a keyboard's keys."""

KEY_CODES: Mapping[str, int] = MappingProxyType({label: code for code, label in KEYS.items()})
PAD_CODES: Mapping[str, int] = MappingProxyType(
    {label: code for code, label in PAD_BUTTONS.items()}
)

MICROSOFT = 0x045E
"""Vendor whose pads have two numbers exchanged, with any driver."""
XONE: Final = "xone-gip-gamepad"
_BY_CAPS: Final = frozenset({"xpad", XONE, "xpadneo", "hid-steam"})
"""Drivers that number buttons by their printed labels, for pads of any maker."""


def north_and_west_exchanged(vendor: int, kernel_driver: str) -> bool:
    """True if 0x133 is the west button and 0x134 the north one.

    These drivers give an Xbox pad's X (west) and Y (north) the numbers once called BTN_X and BTN_Y,
    which are those of north and west on every other pad.
    """
    return vendor == MICROSOFT or kernel_driver in _BY_CAPS


AxisPair = tuple[int, int]
"""Axes of the left and right trigger, or of a stick's motion right and down."""


class PadLayout(NamedTuple):
    """Numbers of a gamepad's sticks, triggers and buttons."""

    buttons: Mapping[int, str]
    """Labels by code."""
    right_stick: AxisPair | None = None
    triggers: AxisPair | None = None
    """Axes of the triggers; None: to be identified by their values at rest."""
    known: bool = True
    """False: the labels are guessed."""


def _counted(*labels: str) -> Mapping[int, str]:
    """Return the buttons in the order in which the generic HID driver has numbered them."""
    return MappingProxyType(dict(enumerate(labels, BTN_SOUTH)))


_SONY_COUNTED: Final = PadLayout(
    _counted(
        "west", "south", "east", "north", "left-shoulder", "right-shoulder", "left-trigger",
        "right-trigger", "select", "start", "left-stick", "right-stick", "mode", "touchpad", "mute",
    ),
    (ABS_Z, ABS_RZ),
    (ABS_RX, ABS_RY),
)  # fmt: skip
_XBOX_COUNTED: Final = PadLayout(
    _counted(
        "south", "east", "west", "north", "left-shoulder", "right-shoulder", "select", "start",
        "left-stick", "right-stick", "mode",
    ),
    (ABS_RX, ABS_RY),
    (ABS_Z, ABS_RZ),
)  # fmt: skip

SONY: Final = 0x054C
_COUNTED: Final[Mapping[tuple[int, int], PadLayout]] = {
    **{
        (SONY, product): _SONY_COUNTED
        # DualShock 4, first and second; its USB receiver; DualSense; DualSense Edge.
        for product in (0x05C4, 0x09CC, 0x0BA0, 0x0CE6, 0x0DF2)
    },
    # Xbox One S by Bluetooth with its first firmware.
    (MICROSOFT, 0x02E0): _XBOX_COUNTED,
}
"""Layouts by vendor and product. Source: SDL's table of gamepads, for Linux."""

PAD_LABELS: Final = tuple(dict.fromkeys((*PAD_BUTTONS.values(), *_SONY_COUNTED.buttons.values())))
"""Labels of the buttons that any gamepad may have."""

_OWN_DRIVERS: Final = frozenset({"xpad", XONE, "sony", "playstation", "nintendo"})
"""Drivers with the right stick as in the kernel's gamepad.rst, and triggers on Z and RZ."""


def pad_layout(vendor: int, product: int, kernel_driver: str, keys: Iterable[int]) -> PadLayout:
    """Return the layout of the pad that the kernel shows with these `keys`.

    No pad has a C and a Z button besides the others: if both are reported, the generic HID driver
    has numbered the buttons from BTN_SOUTH on, and their positions must be known for each pad.
    """
    counted = {BTN_C, BTN_Z} <= {*keys}
    if counted and (layout := _COUNTED.get((vendor, product))):
        return layout
    labels = dict(PAD_BUTTONS)
    if north_and_west_exchanged(vendor, kernel_driver):
        labels[BTN_NORTH], labels[BTN_WEST] = "west", "north"
    if not counted and kernel_driver in _OWN_DRIVERS:
        return PadLayout(labels, (ABS_RX, ABS_RY), (ABS_Z, ABS_RZ))
    return PadLayout(labels, known=not counted)
