"""Values common to the remote's reports: buttons and error codes."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

BUTTON_MASK = 0x9F1F
"""Bits of a button mask that are buttons: the first report byte is the low one."""

BUTTONS: Mapping[int, str] = MappingProxyType(
    {
        0x0001: "left",
        0x0002: "right",
        0x0004: "down",
        0x0008: "up",
        0x0010: "plus",
        0x0100: "2",
        0x0200: "1",
        0x0400: "b",
        0x0800: "a",
        0x1000: "minus",
        0x8000: "home",
    }
)
"""Label by mask bit. The cross is named for the remote held upright, pointing at the screen."""


@lru_cache(maxsize=4096)
def button_labels(mask: int) -> tuple[str, ...]:
    """Return the labels of the pressed buttons in `mask`; other bits are ignored."""
    return tuple(label for bit, label in BUTTONS.items() if mask & bit)


def button_mask(labels: tuple[str, ...] | list[str] | frozenset[str]) -> int:
    """Return the mask of these buttons. Raises ValueError for an unknown label."""
    mask = 0
    for label in labels:
        if label not in _BITS:
            raise ValueError(f"there is no button {label!r}; there are: {', '.join(_BITS)}")
        mask |= _BITS[label]
    return mask


_BITS = {label: bit for bit, label in BUTTONS.items()}


class ErrorCode(enum.IntEnum):
    """Error codes of acknowledgments and answers to reads."""

    SUCCESS = 0
    GENERIC = 3
    BUSY = 4
    UNKNOWN = 5
    INVALID_SPACE = 6
    NO_DEVICE = 7
    """No device answers at the bus address, or it is write-only."""
    INVALID_ADDRESS = 8
