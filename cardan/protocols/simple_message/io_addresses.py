"""Addresses of inputs, outputs and registers in MotoROS's I/O server (IoServer.c)."""

from __future__ import annotations

from typing import Final, NamedTuple


class AddressRange(NamedTuple):
    """Bit addresses from `first` to `last`, both included; the last digit is 0 to 7."""

    name: str
    first: int
    last: int
    writable: bool = False
    """True if clients may write."""


ADDRESS_RANGES: Final = (
    AddressRange("general inputs", 10, 5127),
    AddressRange("general outputs", 10010, 15127, True),
    AddressRange("external inputs", 20010, 25127),
    AddressRange("network inputs", 27010, 29567, True),
    AddressRange("external outputs", 30010, 35127),
    AddressRange("network outputs", 37010, 39567),
    AddressRange("specific inputs", 40010, 42567),
    AddressRange("specific outputs", 50010, 55127),
    AddressRange("interface panel", 60010, 60647, True),
    AddressRange("auxiliary relays", 70010, 79997),
    AddressRange("control status", 80010, 85127),
    AddressRange("pseudo inputs", 87010, 87207),
)
"""Ranges of a YRC1000, which has the most."""

READABLE_REGISTERS: Final = 1000
WRITABLE_REGISTERS: Final = 560
