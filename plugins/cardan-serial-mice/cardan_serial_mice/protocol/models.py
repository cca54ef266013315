"""3Dconnexion's serial devices: protocol, buttons and full scale."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal, NamedTuple

from cardan_serial_mice.protocol.spaceball import SpaceballAdvancedKeys, SpaceballKeys

Protocol = Literal["magellan", "spaceball", "spaceorb"]
Counts = tuple[int, int, int, int, int, int]


class SerialModel(NamedTuple):
    """Description of a model of serial devices."""

    key: str
    """Name for command lines and configuration files."""
    name: str
    protocol: Protocol
    buttons: Mapping[int, str]
    """Label by bit of the mask that `button_mask` gives, lowest first."""
    full_scale: int
    """Counts of translation at full deflection, at the default sensitivity and period."""
    rotation_full_scale: int
    period_s: float
    """Period of packets while deflected."""
    versions: tuple[int, ...] = ()
    """Minor firmware numbers that identify a Spaceball."""


def _labels(*labels: str) -> Mapping[int, str]:
    return MappingProxyType(dict(enumerate(labels)))


_TWELVE = _labels("1", "2", "3", "4", "5", "6", "7", "8", "9", "a", "b", "c")

SERIAL_MODELS: tuple[SerialModel, ...] = (
    SerialModel("magellan", "Magellan SpaceMouse", "magellan",
                _labels("1", "2", "3", "4", "5", "6", "7", "8", "star", "plus", "minus"),
                400, 400, 0.06),
    SerialModel("spaceball-2003", "Spaceball 1003/2003", "spaceball",
                _labels("1", "2", "3", "4", "5", "6", "7", "pick", "rezero"),
                8000, 1600, 0.05, (2, 13, 15, 42)),
    SerialModel("spaceball-3003", "Spaceball 3003", "spaceball",
                _labels("left", "right", "rezero"), 8000, 1600, 0.05, (35, 62, 63)),
    SerialModel("spaceball-4000", "Spaceball 4000 FLX", "spaceball", _TWELVE,
                8000, 1600, 0.05, (43, 45)),
    SerialModel("spaceball-5000", "Spaceball 5000 (serial)", "magellan", _TWELVE,
                400, 400, 0.06),
    SerialModel("spaceorb", "SpaceOrb 360", "spaceorb",
                _labels("a", "b", "c", "d", "e", "f", "rezero"), 508, 508, 0.033),
)  # fmt: skip
"""Full scales are those of the Linux kernel's drivers; VRPN's authors observed up to 20000 counts
of a Spaceball. They are a starting point: measure a device's own by pushing its cap fully."""

_BY_KEY = {model.key: model for model in SERIAL_MODELS}
_FIRMWARE = re.compile(r"Firmware version\s*2\.(\d+)", re.IGNORECASE)


def serial_model_by_key(key: str) -> SerialModel:
    """Return the model with this key. Raises KeyError if there is none."""
    return _BY_KEY[key]


def model_of_version(text: str) -> SerialModel:
    """Return the device that replies `text` to a request for its version (Magellan's `v`)."""
    return _BY_KEY["spaceball-5000" if "SPACEBALL" in text else "magellan"]


def model_of_firmware(banner: str) -> SerialModel | None:
    """Return the Spaceball whose firmware `banner` names; None: it names no known one.

    2.42 is a 2003 or a 4000 FLX: a `.` packet distinguishes them.
    """
    found = _FIRMWARE.search(banner)
    if found is None:
        return None
    minor = int(found[1])
    return next((model for model in SERIAL_MODELS if minor in model.versions), None)


def button_mask(model: SerialModel, keys: SpaceballKeys | SpaceballAdvancedKeys) -> int:
    """Return the pressed buttons of a Spaceball, one bit each, by `model.buttons`."""
    high, low = keys
    if isinstance(keys, SpaceballAdvancedKeys):
        return low & 0x3F | (low & 0x80) >> 1 | (high & 0x1F) << 7
    if model.key == "spaceball-3003":
        return (low & 0x30) >> 4 | (high & 0x20) >> 3
    return low & 0x0F | (high & 0x07) << 4 | (high & 0x10) << 3 | (high & 0x08) << 5


def keys_of_mask(model: SerialModel, mask: int) -> SpaceballKeys | SpaceballAdvancedKeys:
    """Return the packet of a Spaceball of `model` with the buttons of `mask` pressed."""
    if model.key == "spaceball-4000":
        return SpaceballAdvancedKeys(0x20 | mask >> 7 & 0x1F, mask & 0x3F | (mask & 0x40) << 1)
    if model.key == "spaceball-3003":
        # The right key is wired to the pick of the 2003 too.
        return SpaceballKeys((mask & 4) << 3 | (mask & 2) << 3, (mask & 3) << 4)
    return SpaceballKeys(mask >> 4 & 0x07 | mask >> 3 & 0x10 | mask >> 5 & 0x08, mask & 0x0F)


# ---------------------------------------------------------------------------------------------
# Frames


def to_hid_counts(model: SerialModel, counts: Sequence[int]) -> Counts:
    """Convert counts of a serial device to the raw frame of the HID devices (+Y to the operator, +Z
    down).

    Magellan and SpaceOrb: X right, Y up, Z to the operator. Spaceball: X right, Y up, Z away.
    """
    x, y, z, a, b, c = counts
    if model.protocol == "spaceball":
        return (x, -z, -y, a, -c, -b)
    return (x, z, -y, a, c, -b)


def from_hid_counts(model: SerialModel, counts: Sequence[int]) -> Counts:
    """Inverse of `to_hid_counts`."""
    x, y, z, a, b, c = counts
    if model.protocol == "spaceball":
        return (x, -z, -y, a, -c, -b)
    return (x, -z, y, a, -c, b)
