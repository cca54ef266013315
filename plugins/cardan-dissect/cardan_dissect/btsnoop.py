"""Packets of btsnoop logs (Android's btsnoop_hci.log, btmon -w) in the format of HCI captures.

The layout is that of the snoop format (RFC 1761) with other time stamps and flags; the numbers are
those of BlueZ's btsnoop(7). All values are big-endian.
"""

from __future__ import annotations

import struct

MAGIC = b"btsnoop\0"
HEAD = struct.Struct(">II")
"""After the magic: version, datalink type."""
RECORD = struct.Struct(">IIIIq")
"""Length on the wire, length here, flags, packets lost until then, time stamp."""
VERSION = 1
H1, H4, MONITOR = 1001, 1002, 2001
"""Datalink types: HCI without and with the byte of a packet's type, and the Linux kernel's monitor
of all adapters."""
EPOCH_US = 0x00DCDDB30F2F8000
"""Time stamps are microseconds; this is the one of 1970. The format's description counts them from
the year 0, and gives that of 2000, which is 12 days beyond the Gregorian calendar's."""
RECEIVED, COMMAND_OR_EVENT = 1, 2
"""Flags: received by the host; not a data packet."""
LINK_H4_WITH_DIRECTION, LINK_MONITOR = 201, 254
COMMAND, ACL, SCO, EVENT, ISO = range(1, 6)
MONITORED = {
    2: (COMMAND, False),
    3: (EVENT, True),
    4: (ACL, False),
    5: (ACL, True),
    6: (SCO, False),
    7: (SCO, True),
    18: (ISO, False),
    19: (ISO, True),
}
"""HCI type of a packet of the monitor, and whether the host received it, by the lower half of its
flags; the upper half is the adapter's number."""


def link_packet(datalink: int, flags: int, data: bytes) -> tuple[int, bytes, int]:
    """Return a packet's link type (LINKTYPE_ of libpcap), its bytes in that, and the adapter.
    Events of the monitor ("adapter 0 was opened") have the monitor's link type."""
    if datalink == MONITOR:
        kind, received = MONITORED.get(flags & 0xFFFF, (0, False))
        if not kind:
            return LINK_MONITOR, data, flags >> 16
        return LINK_H4_WITH_DIRECTION, struct.pack(">IB", received, kind) + data, flags >> 16
    received = bool(flags & RECEIVED)
    head = struct.pack(">I", received)
    if datalink == H1:
        kind = ACL if not flags & COMMAND_OR_EVENT else EVENT if received else COMMAND
        head += bytes((kind,))
    return LINK_H4_WITH_DIRECTION, head + data, 0
