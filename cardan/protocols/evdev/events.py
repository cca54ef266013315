"""Linux's struct input_event, read from and written to /dev/input/eventN.

The layout is the kernel's on this machine (native byte order and long). Source: the kernel's uapi
headers linux/input.h and linux/input-event-codes.h.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

_EVENT = struct.Struct("@llHHi")

EVENT_BYTES = _EVENT.size
"""Size of an event: 24 on 64-bit systems, 16 on 32-bit ones."""

EV_SYN, EV_KEY, EV_REL, EV_ABS, EV_MSC = 0x00, 0x01, 0x02, 0x03, 0x04
EV_MAX = 0x1F
"""Highest event type of the kernel."""
EV_LED, EV_SND, EV_REP, EV_FF = 0x11, 0x12, 0x14, 0x15
EV_UINPUT = 0x0101
"""Event type of uinput devices only: a request of the kernel to the device's program."""

SYN_REPORT = 0
"""End of a frame: its events happened together."""
SYN_DROPPED = 3
"""Report that the kernel dropped events that were not read in time: the known state is void."""
MSC_SCAN = 4

KEY_UP, KEY_DOWN, KEY_REPEAT = 0, 1, 2
"""Values of EV_KEY."""


class InputEvent(NamedTuple):
    """An event with the kernel's time (s and µs, wall clock unless set otherwise)."""

    sec: int
    usec: int
    type: int
    code: int
    value: int


class MalformedPacket(NamedTuple):
    """Bytes that are not events."""

    reason: str
    """One of a few fixed phrases, suitable for counting."""
    size: int


EMPTY = "empty"
CUT = "cut in the middle of an event"
NO_CALL = "neither events nor the answer that was asked for"


def decode_events(data: bytes) -> list[InputEvent] | MalformedPacket:
    """Decode the events of one read; none of a truncated read. Never raises."""
    if not data:
        return MalformedPacket(EMPTY, 0)
    if len(data) % EVENT_BYTES:
        return MalformedPacket(CUT, len(data))
    return [*map(InputEvent._make, _EVENT.iter_unpack(data))]


def encode_events(events: Iterable[InputEvent]) -> bytes:
    """Encode events. Raises ValueError for a value that does not fit its field."""
    try:
        return b"".join(_EVENT.pack(*event) for event in events)
    except struct.error as error:
        raise ValueError(f"cannot encode an event: {error}") from None
