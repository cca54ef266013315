"""Input devices of the system: search, description, and reasons of a failed open."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from cardan.common.files import text_or_empty
from cardan.drivers.evdev.links import EvdevLink
from cardan.protocols.evdev.codes import (
    ABS_BRAKE,
    ABS_GAS,
    ABS_RUDDER,
    ABS_THROTTLE,
    ABS_WHEEL,
    ABS_X,
    ABS_Y,
    BTN_SOUTH,
    JOYSTICK_BUTTONS,
    KEY_CODES,
)
from cardan.protocols.evdev.events import EV_ABS, EV_FF, EV_KEY
from cardan.protocols.evdev.requests import (
    EVIOCGID,
    EVIOCGKEY,
    EVIOCGNAME,
    AbsInfo,
    decode_absinfo,
    decode_bits,
    decode_id,
    eviocgabs,
    eviocgbit,
)

_LETTERS = frozenset(KEY_CODES[label] for label in ("q", "a", "z", "p", "l", "m", "space", "enter"))
"""Keys that distinguish a keyboard from a power button, a remote control or media keys."""

CONSOLE_HINT = (
    "log in at the console, or install the udev rules (`cardan devices udev` prints them) and "
    "plug it in again"
)
GROUP_HINT = (
    "add a rule for this keyboard (`cardan devices udev` prints one), or join the group input "
    "(sudo usermod -aG input $USER, and log in again): either lets your programs read all that "
    "is typed"
)


class Node(NamedTuple):
    """An input device, as /sys describes it without opening it."""

    path: str
    """Path of its node, /dev/input/eventN."""
    name: str
    identity: str
    """Vendor and product ("045e:028e")."""
    keys: frozenset[int]
    axes: frozenset[int]

    def is_of(self, name: str, identity: str) -> bool:
        """True if it belongs to a device with this name, vendor and product."""
        return self.identity == identity and self.name == (name.strip() or _number(self.path))


class EvdevDeviceInfo(NamedTuple):
    """Identity and capabilities of an open device."""

    name: str
    vendor: int
    product: int
    keys: frozenset[int]
    axes: dict[int, AbsInfo]
    effects: frozenset[int]
    kernel_driver: str = ""
    """Name of the kernel's driver ("xpad"); empty if unknown."""
    bustype: int = 0
    """Bus of its connection (`BUS_USB`, `BUS_BLUETOOTH` ...); 0 if unknown."""

    @property
    def identity(self) -> str:
        """Vendor and product, in the form of `Node`."""
        return f"{self.vendor:04x}:{self.product:04x}"


class EvdevState(NamedTuple):
    """Current values of an open device."""

    keys: frozenset[int]
    """Codes of pressed keys and buttons."""
    values: dict[int, int]
    """Values by axis code."""


def is_gamepad(keys: frozenset[int], axes: frozenset[int]) -> bool:
    """True for a gamepad by the kernel's rule: a south button, and a stick."""
    return BTN_SOUTH in keys and {ABS_X, ABS_Y} <= axes


_MODE_D: Final[Mapping[str, tuple[str, str]]] = {
    "046d:c216": ("F310", "Dual Action"),
    "046d:c218": ("F510", "RumblePad 2"),
    "046d:c219": ("F710", "Cordless RumblePad 2"),
}
"""Logitech pads in mode D, and older ones with the same ids."""


def pad_in_mode_d(identity: str) -> str:
    """Explain how to switch this Logitech pad to gamepad mode; empty if it is another device."""
    if identity not in _MODE_D:
        return ""
    pad, older = _MODE_D[identity]
    return (
        f"a Logitech {pad} in its mode D: set the switch on its back to X (an older {older} has no "
        "such switch, and cannot be used)"
    )


def joystick(identity: str, keys: frozenset[int], axes: frozenset[int]) -> str:
    """Explain a device with a joystick's buttons, with advice; empty if it has none."""
    if BTN_SOUTH in keys or not axes or keys.isdisjoint(JOYSTICK_BUTTONS):
        return ""
    if words := pad_in_mode_d(identity):
        return words
    if ABS_WHEEL in axes or {ABS_GAS, ABS_BRAKE} <= axes:
        return "a steering wheel, which cannot be used"
    if ABS_THROTTLE in axes or ABS_RUDDER in axes:
        return "a flight stick, which cannot be used"
    return (
        "its buttons are numbered as a joystick's, so that nothing says where they are: switch a "
        "pad to XInput (its X mode), if it has that; a stick or a wheel cannot be used"
    )


def is_keyboard(keys: frozenset[int], axes: frozenset[int]) -> bool:
    """True for a keyboard with letters."""
    return keys >= _LETTERS


def find_nodes(root: Path = Path("/")) -> list[Node]:
    """Return every input device of the system, by number. Never raises."""
    found: list[tuple[int, Node]] = []
    with contextlib.suppress(OSError):
        for entry in (root / "sys/class/input").iterdir():
            if match := re.fullmatch(r"event(\d+)", entry.name):
                device = entry / "device"
                vendor, product = (
                    text_or_empty(device / "id/vendor"),
                    text_or_empty(device / "id/product"),
                )
                node = Node(
                    path=f"/dev/input/{entry.name}",
                    name=text_or_empty(device / "name") or _number(entry.name),
                    identity=f"{vendor}:{product}" if vendor else "",
                    keys=_bits(text_or_empty(device / "capabilities/key")),
                    axes=_bits(text_or_empty(device / "capabilities/abs")),
                )
                found.append((int(match[1]), node))
    return [node for _, node in sorted(found)]


def kernel_driver(path: str, root: Path = Path("/")) -> str:
    """Name of the kernel's driver of the node at `path`; empty if there is none."""
    link = root / "sys/class/input" / os.path.basename(os.path.realpath(path)) / "device/device"
    try:
        return (link / "driver").resolve(strict=True).name
    except OSError:
        return ""


def describe(link: EvdevLink, driver: str = "") -> EvdevDeviceInfo:
    """Read the description of an open device. Raises OSError."""
    device_id = decode_id(link.call(EVIOCGID))
    name = link.call(EVIOCGNAME).split(b"\0", 1)[0].decode(errors="replace")
    types = decode_bits(link.call(eviocgbit(0)))
    keys, axes, effects = (
        decode_bits(link.call(eviocgbit(kind))) if kind in types else frozenset[int]()
        for kind in (EV_KEY, EV_ABS, EV_FF)
    )
    infos = {code: decode_absinfo(link.call(eviocgabs(code))) for code in sorted(axes)}
    return EvdevDeviceInfo(
        name, device_id.vendor, device_id.product, keys, infos, effects, driver, device_id.bustype
    )


def take_snapshot(link: EvdevLink, description: EvdevDeviceInfo) -> EvdevState:
    """Read the current values of an open device. Raises OSError."""
    keys = decode_bits(link.call(EVIOCGKEY)) if description.keys else frozenset[int]()
    values = {code: decode_absinfo(link.call(eviocgabs(code))).value for code in description.axes}
    return EvdevState(keys, values)


def _number(path: str) -> str:
    """Fallback name of a device without one ("event7")."""
    return os.path.basename(path)


def _bits(words: str) -> frozenset[int]:
    """Return the codes in a mask as /sys prints it: words of the size of a long, highest first."""
    width = sys.maxsize.bit_length() + 1
    mask = 0
    for word in words.split():
        try:
            mask = mask << width | int(word, 16)
        except ValueError:
            return frozenset()
    return frozenset(code for code in range(mask.bit_length()) if mask >> code & 1)
