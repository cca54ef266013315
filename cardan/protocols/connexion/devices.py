"""3Dconnexion's six-axis devices: ids, report families, buttons and their labels.

Source: the device tables of FreeSpacenav spacenavd (src/dev.c), Blender (GHOST_NDOFManager) and
PySpaceMouse, and the vendor's V3DK key numbers.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

LOGITECH = 0x046D
"""Vendor id of the devices up to about 2013; it has many other products."""
CONNEXION = 0x256F

DEFAULT_FULL_SCALE = 350
"""Counts at the mechanical stop, as the report descriptors declare; some devices pass 400."""

MULTI_AXIS_CONTROLLER = (0x01, 0x08)
"""Usage page and usage of the HID collection that carries the motion."""


class Family(enum.Enum):
    """Form in which a device reports its motion."""

    SPLIT = "split"
    """Report 1 holds the translation, report 2 the rotation (wired, 8-byte packets)."""
    ONE = "one"
    """Report 1 holds all six axes."""


class Model(NamedTuple):
    """Model of a device, by vendor and product id."""

    vendor_id: int
    product_id: int
    name: str
    key: str
    """Name for command lines and configuration files."""
    family: Family
    """Report family by specification; a driver detects the actual one."""
    buttons: Mapping[int, str]
    """Label by bit of report 3, lowest first. Key-array reports carry the bit number plus 1."""
    key_array: bool = False
    """True: reports its keys as an array of V3DK codes, too (report 0x1C); report 3 lacks some."""
    led: bool = False
    battery: bool = False
    full_scale: int = DEFAULT_FULL_SCALE
    button_report_bytes: int = 3
    """Length of report 3, its id included; 0: no such report."""
    receiver: bool = False
    """True: a receiver for any puck; the paired device determines buttons and reporting
    interface."""
    serial_axes: bool = False
    """True: reports its axes as right, up, away (left-handed), not in the usual raw frame."""


_V3DK_FROM_1 = (
    "menu", "fit", "top", "left", "right", "front", "bottom", "back", "roll-cw", "roll-ccw",
    "iso1", "iso2", *(str(number) for number in range(1, 11)),
    "esc", "alt", "shift", "ctrl", "rotate-lock", "panzoom", "dominant", "plus", "minus",
    "spin-cw", "spin-ccw", "tilt-cw", "tilt-ccw", "enter", "delete",
)  # fmt: skip

V3DK: Mapping[int, str] = MappingProxyType(
    {
        **dict(enumerate(_V3DK_FROM_1, 1)),
        **{40 + number: f"f{number}" for number in range(1, 13)},
        **dict(enumerate(("11", "12"), 77)),
        **{102 + number: f"v{number}" for number in range(1, 4)},
        **{138 + number: f"save-v{number}" for number in range(1, 4)},
        **dict(enumerate(("tab", "space"), 175)),
        **{228 + number: f"numpad-f{number}" for number in range(1, 5)},
    }
)
"""The vendor's key numbers, which all newer devices share, and our labels for them."""

LONG_PRESS: Mapping[int, int] = MappingProxyType(
    {3: 7, 5: 4, 6: 8, 9: 10, 11: 12, 32: 33, 34: 35, 103: 139, 104: 140, 105: 141}
)
"""V3DK code of a long press, by the key's own code; other keys keep theirs."""

TWO_BUTTONS: Mapping[int, str] = MappingProxyType({0: "left", 1: "right"})


def _labels(*labels: str) -> Mapping[int, str]:
    return MappingProxyType(dict(enumerate(labels)))


def _v3dk(*bits: int) -> Mapping[int, str]:
    return MappingProxyType({bit: V3DK[bit + 1] for bit in bits})


NO_BUTTONS = _labels()
PRO_BUTTONS = _v3dk(0, 1, 2, 4, 5, 8, 12, 13, 14, 15, 22, 23, 24, 25, 26)
_ENTERPRISE_BUTTONS = _v3dk(
    0, 1, 2, 4, 5, 8, 10, *range(12, 27), 35, 36, 76, 77, 102, 103, 104, 174, 175
)
_EXPLORER_BUTTONS = _labels(
    "1", "2", "top", "left", "right", "front", "esc", "alt", "shift", "ctrl", "fit", "panel",
    "plus", "minus", "2d",
)  # fmt: skip
_PILOT_BUTTONS = _labels(
    "1", "2", "3", "4", "5", "6", "top", "left", "right", "front", "esc", "alt", "shift", "ctrl",
    "fit", "panel", "plus", "minus", "dominant", "3d-lock", "config",
)  # fmt: skip
_SPACEBALL_BUTTONS = _labels("1", "2", "3", "4", "5", "6", "7", "8", "9", "a", "b", "c")


def _numbered(count: int) -> Mapping[int, str]:
    return _labels(*(str(number) for number in range(1, count + 1)))


_SPLIT, _ONE = Family.SPLIT, Family.ONE

MODELS: tuple[Model, ...] = (
    Model(0x046D, 0xC603, "SpaceMouse Plus XT", "spacemouse-plus-xt", _SPLIT, _numbered(11),
          serial_axes=True),
    Model(0x046D, 0xC605, "CADman", "cadman", _SPLIT, _numbered(4)),
    Model(0x046D, 0xC606, "SpaceMouse Classic", "spacemouse-classic", _SPLIT, _numbered(11),
          serial_axes=True),
    Model(0x046D, 0xC621, "Spaceball 5000", "spaceball-5000", _SPLIT, _SPACEBALL_BUTTONS),
    Model(0x046D, 0xC623, "SpaceTraveler", "spacetraveler", _SPLIT, _numbered(8), led=True),
    Model(0x046D, 0xC625, "SpacePilot", "spacepilot", _SPLIT, _PILOT_BUTTONS,
          button_report_bytes=4),
    Model(0x046D, 0xC626, "SpaceNavigator", "spacenavigator", _SPLIT, TWO_BUTTONS, led=True),
    Model(0x046D, 0xC627, "SpaceExplorer", "spaceexplorer", _SPLIT, _EXPLORER_BUTTONS, led=True),
    Model(0x046D, 0xC628, "SpaceNavigator for Notebooks", "spacenavigator-notebooks", _SPLIT,
          TWO_BUTTONS, led=True),
    Model(0x046D, 0xC629, "SpacePilot Pro", "spacepilot-pro", _SPLIT, _v3dk(*range(31)),
          led=True, button_report_bytes=5),
    Model(0x046D, 0xC62B, "SpaceMouse Pro", "spacemouse-pro", _SPLIT, PRO_BUTTONS,
          led=True, button_report_bytes=7),
    Model(0x256F, 0xC62C, "LIPARI", "lipari", _ONE, _v3dk(*range(22)), button_report_bytes=4),
    Model(0x256F, 0xC62E, "SpaceMouse Wireless", "spacemouse-wireless", _ONE, TWO_BUTTONS,
          led=True, battery=True),
    Model(0x256F, 0xC62F, "SpaceMouse Wireless receiver", "spacemouse-wireless-receiver", _ONE,
          TWO_BUTTONS, led=True, battery=True),
    Model(0x256F, 0xC631, "SpaceMouse Pro Wireless", "spacemouse-pro-wireless", _ONE, PRO_BUTTONS,
          led=True, battery=True, button_report_bytes=7),
    Model(0x256F, 0xC632, "SpaceMouse Pro Wireless receiver", "spacemouse-pro-wireless-receiver",
          _ONE, PRO_BUTTONS, led=True, battery=True, button_report_bytes=7),
    Model(0x256F, 0xC633, "SpaceMouse Enterprise", "spacemouse-enterprise", _ONE,
          _ENTERPRISE_BUTTONS, key_array=True, led=True, button_report_bytes=5),
    Model(0x256F, 0xC635, "SpaceMouse Compact", "spacemouse-compact", _SPLIT, TWO_BUTTONS,
          led=True),
    Model(0x256F, 0xC636, "SpaceMouse Module", "spacemouse-module", _SPLIT, TWO_BUTTONS),
    Model(0x256F, 0xC638, "SpaceMouse Pro Wireless Bluetooth Edition",
          "spacemouse-pro-wireless-bt", _ONE, PRO_BUTTONS,
          led=True, battery=True, button_report_bytes=7),
    Model(0x256F, 0xC63A, "SpaceMouse Wireless Bluetooth Edition", "spacemouse-wireless-bt", _ONE,
          TWO_BUTTONS, led=True, battery=True),
    Model(0x256F, 0xC641, "SpaceMouse USB", "spacemouse-usb", _SPLIT, NO_BUTTONS,
          button_report_bytes=0),
    Model(0x256F, 0xC652, "Universal Receiver", "universal-receiver", _ONE, PRO_BUTTONS,
          led=True, battery=True, button_report_bytes=7, receiver=True),
    Model(0x256F, 0xC65A, "Universal Receiver 2", "universal-receiver-2", _ONE, PRO_BUTTONS,
          led=True, battery=True, button_report_bytes=7, receiver=True),
    Model(0x256F, 0xC65C, "Universal Receiver 2 (c65c)", "universal-receiver-2-c65c", _ONE,
          PRO_BUTTONS, led=True, battery=True, button_report_bytes=7, receiver=True),
)  # fmt: skip
"""Every model with known reports. Sources differ on whether c62c, c636, c641, c65a and c65c exist
as sold products and on their families."""

NEVER_OPEN: frozenset[tuple[int, int]] = frozenset(
    {
        (LOGITECH, 0xC640),  # NuLOOQ: not a six-axis device
        *(
            (CONNEXION, product_id)
            for product_id in (
                *(0xC650, 0xC651, 0xC654, 0xC655, 0xC656, 0xC657, 0xC658),  # CadMouse
                *(0xC664, 0xC665, 0xC668),  # keyboards and number pads
                0xC671,  # the virtual mouse of the vendor's macOS driver
            )
        ),
    }
)
"""(vendor id, product id) of the vendor's mice, keyboards and the like."""

_BY_ID = {(model.vendor_id, model.product_id): model for model in MODELS}
_BY_KEY = {model.key: model for model in MODELS}


def find_model(vendor_id: int, product_id: int) -> Model | None:
    """Return the model with these ids; None if it is not in the table."""
    return _BY_ID.get((vendor_id, product_id))


def model_by_key(key: str) -> Model:
    """Return the model called `key`. Raises KeyError if there is none."""
    return _BY_KEY[key]


def is_candidate(vendor_id: int, product_id: int, usage_page: int, usage: int) -> bool:
    """True if a HID collection can be the motion of a six-axis device.

    New products of the vendor count by their usage alone; if the system reports no usage (0, 0),
    only models of the table count.
    """
    ids = (vendor_id, product_id)
    if ids in NEVER_OPEN or (ids not in _BY_ID and vendor_id != CONNEXION):
        return False
    return (usage_page, usage) == MULTI_AXIS_CONTROLLER or (
        (usage_page, usage) == (0, 0) and ids in _BY_ID
    )
