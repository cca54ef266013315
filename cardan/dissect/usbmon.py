"""USB request blocks as Linux usbmon writes them into a capture.

Layout of ``struct usbmon_packet`` in the kernel's Documentation/usb/usbmon.rst, in the byte order
of the capturing machine: 48 bytes (link type 189) or 64 bytes (220), then the data.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from cardan.dissect.capture import CapturedPacket

HEADER_BYTES = {189: 48, 220: 64}
"""By link type: LINKTYPE_USB_LINUX, LINKTYPE_USB_LINUX_MMAPPED."""
ISO, INTERRUPT, CONTROL, BULK = range(4)


class Urb(NamedTuple):
    """One event of a USB request block: "S" submitted, "C" completed, "E" submission failed."""

    id: int
    event: str
    transfer: int
    endpoint: int
    to_host: bool
    device: int
    bus: int
    status: int  # 0, or a negative errno on completion
    setup: bytes | None  # of a control submission
    data: bytes
    cut: bool


def parse(frame: CapturedPacket) -> Urb | None:
    """The request block in a frame; None where there is none or its header is cut."""
    header_bytes = HEADER_BYTES.get(frame.link_type)
    if header_bytes is None or len(frame.data) < header_bytes:
        return None
    urb_id, event, transfer, endpoint, device, bus, no_setup, no_data = struct.unpack_from(
        f"{frame.byte_order}QcBBBHBB", frame.data
    )
    status, _, captured = struct.unpack_from(f"{frame.byte_order}iII", frame.data, 28)
    data = b"" if no_data else frame.data[header_bytes : header_bytes + captured]
    return Urb(
        urb_id,
        event.decode("latin-1"),
        transfer,
        endpoint & 0x7F,
        bool(endpoint & 0x80),
        device,
        bus,
        status,
        None if no_setup else frame.data[40:48],
        data,
        not no_data and (frame.cut or len(data) < captured),
    )
