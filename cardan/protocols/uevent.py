"""Linux's uevents: reports of added and removed devices by the kernel, and by udev after its rules.

The kernel's form is ``ACTION@DEVPATH`` followed by ``KEY=VALUE`` texts, each ended by a NUL (Linux,
lib/kobject_uevent.c); udev's is a binary header, "libudev" and a NUL first, with the offset of the
same texts (systemd, device-monitor.c).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

KERNEL_GROUP: Final = 1
UDEV_GROUP: Final = 2
"""Multicast groups of NETLINK_KOBJECT_UEVENT: the kernel's, sent as soon as a device exists, and
udev's, once it has set permissions and links."""

PROTOCOL: Final = 15
"""NETLINK_KOBJECT_UEVENT of <linux/netlink.h>."""

LARGEST: Final = 16 * 1024
"""Size of a read, bytes: the kernel's event has 2 kB, udev's some more."""

_UDEV_PREFIX: Final = b"libudev\0"
_UDEV_HEADER: Final = struct.Struct("=8sIIIIIIII")
_UDEV_MAGIC: Final = 0xFEEDCAFE.to_bytes(4, "big")


class Uevent(NamedTuple):
    """A device was added, removed or changed."""

    action: str
    """``add``, ``remove``, ``bind``, ``change``, ..."""
    subsystem: str
    """``hidraw``, ``input``, ``tty``, ``usb``, ..."""
    properties: Mapping[str, str]


def decode_uevent(data: bytes) -> Uevent | None:
    """Decode the event in a datagram; None if it is invalid."""
    if data.startswith(_UDEV_PREFIX):
        if len(data) < _UDEV_HEADER.size or data[8:12] != _UDEV_MAGIC:
            return None
        offset, length = _UDEV_HEADER.unpack_from(data)[3:5]
        texts = data[offset : offset + length]
    else:
        first, _, texts = data.partition(b"\0")
        if b"@" not in first:
            return None
    properties = {}
    for text in texts.split(b"\0"):
        key, equals, value = text.decode("utf-8", "replace").partition("=")
        if equals:
            properties[key] = value
    action = properties.get("ACTION", "")
    if not action:
        return None
    return Uevent(action, properties.get("SUBSYSTEM", ""), properties)
