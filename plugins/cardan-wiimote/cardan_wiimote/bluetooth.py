"""Decoder of captured HCI packets up to the L2CAP payload of a classic Bluetooth link.

Captures have link type 187 (H4) or 201 (H4 with a direction word before it). The layouts of H4,
ACL data packets, events and L2CAP signaling are those of the Bluetooth core specification; all
values are little-endian but the direction word.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from cardan_dissect.capture import CapturedPacket, Direction

H4, H4_WITH_DIRECTION = 187, 201
LINK_TYPES = frozenset((H4, H4_WITH_DIRECTION))
ACL, EVENT = 2, 4
CONNECTION_COMPLETE, DISCONNECTION_COMPLETE, REMOTE_NAME = 0x03, 0x05, 0x07
CONTINUED = 1
"""Packet boundary flag of a fragment that is not the first."""
SIGNALING_CID, FIRST_DYNAMIC_CID = 0x0001, 0x0040
CONNECTION_REQUEST, CONNECTION_RESPONSE = 0x02, 0x03
DISCONNECTION_REQUEST = 0x06
ACCEPTED = 0
MOST_BYTES = 2**16 + 4
"""Most bytes of an L2CAP packet with its header."""


class Payload(NamedTuple):
    """The payload of one L2CAP packet on a dynamic channel.

    `direction` is None if the capture does not have it; `psm` if the channel's set-up is not
    captured.
    """

    handle: int
    direction: Direction | None
    cid: int
    psm: int | None
    data: bytes
    cut: bool


class _Link:
    """Connection with its fragments and channels. Each side numbers the channels it receives on; if
    directions are unknown, both share a table."""

    def __init__(self) -> None:
        self.address: str | None = None
        self.fragments: dict[Direction | None, bytes] = {}
        self.psms: dict[tuple[Direction | None, int], int | None] = {}  # None: of two channels
        self.asked: dict[tuple[Direction | None, int], int] = {}

    def open(self, direction: Direction | None, cid: int, psm: int) -> None:
        """Record that a channel of this number, to the side of `direction`, is for this PSM."""
        key = direction, cid
        shared = direction is None and self.psms.get(key, psm) != psm
        self.psms[key] = None if shared else psm


class Links:
    """Follows the connections of a capture."""

    def __init__(self) -> None:
        self._links: dict[int, _Link] = {}
        self._names: dict[str, str] = {}

    def name(self, handle: int) -> str:
        """Return the remote device's address if the capture has it, else the handle."""
        link = self._links.get(handle)
        return f"handle 0x{handle:04x}" if link is None or not link.address else link.address

    def device_name(self, handle: int) -> str | None:
        """Return the remote device's name if the capture has it."""
        return self.device_name_of(self.name(handle))

    def device_name_of(self, address: str) -> str | None:
        """Return the name of the device of an address, if the capture has it."""
        return self._names.get(address)

    def feed(self, packet: CapturedPacket) -> Iterator[Payload | int]:
        """Yield the payloads that the packet completes, and the handle of a connection that begins
        or ends."""
        data = packet.data
        direction: Direction | None = None
        if packet.link_type == H4_WITH_DIRECTION:
            if len(data) < 4:
                return
            direction = Direction.FROM_DEVICE if data[3] & 1 else Direction.TO_DEVICE
            data = data[4:]
        if not data:
            return
        if data[0] == EVENT:
            yield from self._event(data[1:])
        elif data[0] == ACL and len(data) >= 5:
            yield from self._acl(data[1:], direction, packet.cut)

    def _event(self, event: bytes) -> Iterator[int]:
        if len(event) < 3 or event[2]:  # Every event used here begins with a status.
            return
        code, values = event[0], event[3:]
        if code == CONNECTION_COMPLETE and len(values) >= 8:
            handle = struct.unpack_from("<H", values)[0] & 0xFFF
            self._links[handle] = link = _Link()
            link.address = _address(values[2:8])
            yield handle
        elif code == DISCONNECTION_COMPLETE and len(values) >= 2:
            handle = struct.unpack_from("<H", values)[0] & 0xFFF
            self._links.pop(handle, None)
            yield handle
        elif code == REMOTE_NAME and len(values) >= 6:
            name = values[6:].split(b"\0")[0]
            self._names[_address(values[:6])] = name.decode("utf-8", "replace")

    def _acl(self, data: bytes, direction: Direction | None, cut: bool) -> Iterator[Payload]:
        head, size = struct.unpack_from("<HH", data)
        handle, boundary = head & 0xFFF, head >> 12 & 3
        link = self._links.setdefault(handle, _Link())
        packet = data[4 : 4 + size]
        if boundary == CONTINUED:
            if direction not in link.fragments:
                return  # Its beginning is not in the capture.
            packet = link.fragments.pop(direction) + packet
        else:
            link.fragments.pop(direction, None)
        if len(packet) < 4:
            if not cut:
                link.fragments[direction] = packet
            return
        size, cid = struct.unpack_from("<HH", packet)
        if len(packet) < 4 + size and not cut:
            if len(packet) < MOST_BYTES:
                link.fragments[direction] = packet
            return
        payload = packet[4 : 4 + size]
        if cid == SIGNALING_CID:
            self._signals(link, direction, payload)
        elif cid >= FIRST_DYNAMIC_CID:
            psm = link.psms.get((direction, cid))
            yield Payload(handle, direction, cid, psm, payload, cut)

    def _signals(self, link: _Link, direction: Direction | None, data: bytes) -> None:
        back = None if direction is None else direction.opposite
        at = 0
        while at + 4 <= len(data):
            code, _, size = struct.unpack_from("<BBH", data, at)
            values = data[at + 4 : at + 4 + size]
            at += 4 + size
            if code == CONNECTION_REQUEST and len(values) >= 4:
                psm, asker_cid = struct.unpack_from("<HH", values)
                link.asked[back, asker_cid] = psm
            elif code == CONNECTION_RESPONSE and len(values) >= 8:
                answerer_cid, asker_cid, result = struct.unpack_from("<HHH", values)
                psm = link.asked.get((direction, asker_cid))
                if psm is not None and result == ACCEPTED:
                    del link.asked[direction, asker_cid]
                    # The response goes to the requester, which will receive on its own number.
                    link.open(direction, asker_cid, psm)
                    link.open(back, answerer_cid, psm)
            elif code == DISCONNECTION_REQUEST and len(values) >= 4:
                receiver_cid, sender_cid = struct.unpack_from("<HH", values)
                link.psms.pop((direction, receiver_cid), None)
                link.psms.pop((back, sender_cid), None)


def _address(octets: bytes) -> str:
    return octets[::-1].hex(":")
