"""The numbers that spacenavd gives to the buttons of USB devices.

Most devices keep the numbers of their reports. Devices with gaps, for missing keys of the vendor's
numbering, get numbers without gaps, keys with figures first.

Source: spacenavd's table of devices, with the Pro Wireless Bluetooth Edition, which spacenavd has
after 1.3.1. 1.0 and older have no such table, nor has 1.1 to 1.3.1 for the Bluetooth Edition: there
the numbers are those of the reports.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

_PRO = (
    *(12, 13, 14, 15),  # 1 to 4
    *(0, 1, 2, 4, 5, 8, 26),  # menu, fit, top, right, front, roll, rotate lock
    *(22, 23, 24, 25),  # esc, alt, shift, ctrl
)
_ENTERPRISE = (
    *(12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 76, 77),  # 1 to 12
    *(0, 1, 2, 4, 5, 8),  # menu, fit, top, right, front, roll
    *(22, 23, 24, 25, 26),  # esc, alt, shift, ctrl, rotate lock
    *(35, 36, 174, 175),  # enter, delete, tab, space
    *(102, 103, 104, 10),  # v1 to v3, iso
)
"""Bits in the order of their numbers."""

_RENUMBERED: Mapping[tuple[int, int], tuple[int, ...]] = MappingProxyType(
    {
        (0x046D, 0xC62B): _PRO,
        (0x256F, 0xC631): _PRO,
        (0x256F, 0xC632): _PRO,
        (0x256F, 0xC633): _ENTERPRISE,
        (0x256F, 0xC638): _PRO,
    }
)
"""By USB vendor and product."""


def button_number(vendor_id: int, product_id: int, bit: int) -> int | None:
    """Return spacenavd's number of the button in `bit` of HID report 3, the vendor's key bit + 1.

    None: spacenavd knows no such key of this device.
    """
    bits = _RENUMBERED.get((vendor_id, product_id))
    if bits is None:
        return bit
    return bits.index(bit) if bit in bits else None
