"""USB request blocks in captures of Linux usbmon.

Layout of ``struct usbmon_packet`` in the kernel's Documentation/usb/usbmon.rst, in the byte order
of the capturing machine: 48 bytes (link type 189) or 64 bytes (220), then the data.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from cardan_dissect.capture import CapturedPacket, Direction

HEADER_BYTES = {189: 48, 220: 64}
"""By link type: LINKTYPE_USB_LINUX, LINKTYPE_USB_LINUX_MMAPPED."""
LINK_TYPES = frozenset(HEADER_BYTES)
ISO, INTERRUPT, CONTROL, BULK = range(4)


class Urb(NamedTuple):
    """An event of a USB request block: "S" submitted, "C" completed, "E" submission failed."""

    id: int
    event: str
    transfer: int
    endpoint: int
    direction: Direction
    device: int
    bus: int
    status: int  # 0, or a negative errno on completion.
    setup: bytes | None  # For a control submission.
    data: bytes
    cut: bool


def parse(packet: CapturedPacket) -> Urb | None:
    """Return the request block in a packet; None if there is none or its header is cut."""
    header_bytes = HEADER_BYTES.get(packet.link_type)
    if header_bytes is None or len(packet.data) < header_bytes:
        return None
    urb_id, event, transfer, endpoint, device, bus, no_setup, no_data = struct.unpack_from(
        f"{packet.byte_order}QcBBBHBB", packet.data
    )
    status, _, captured = struct.unpack_from(f"{packet.byte_order}iII", packet.data, 28)
    data = b"" if no_data else packet.data[header_bytes : header_bytes + captured]
    return Urb(
        urb_id,
        event.decode("latin-1"),
        transfer,
        endpoint & 0x7F,
        Direction.FROM_DEVICE if endpoint & 0x80 else Direction.TO_DEVICE,
        device,
        bus,
        status,
        None if no_setup else packet.data[40:48],
        data,
        not no_data and (packet.cut or len(data) < captured),
    )
