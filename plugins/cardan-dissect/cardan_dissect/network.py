"""Decoder from a captured packet to the UDP or TCP payload."""

from __future__ import annotations

import functools
import ipaddress
import struct
from typing import NamedTuple

from cardan_dissect.capture import LINK_CAN as CAN, CapturedPacket, Direction

NULL, ETHERNET, LOOP, RAW, LINUX_SLL, IPV4, IPV6, LINUX_SLL2 = 0, 1, 108, 101, 113, 228, 229, 276
RAW_OF_BSD = (12, 14)
LINK_TYPES = frozenset((NULL, ETHERNET, LOOP, RAW, LINUX_SLL, IPV4, IPV6, LINUX_SLL2, *RAW_OF_BSD))
"""Link types of captures that can contain IP."""
ETHERTYPE_IPV4, ETHERTYPE_IPV6 = 0x0800, 0x86DD
VLAN_TAGS = (0x8100, 0x88A8, 0x9100)
ETHERTYPE_NAMES = {0x0806: "ARP", 0x88CC: "LLDP", 0x8892: "PROFINET", 0x88A4: "EtherCAT"}
TCP, UDP, ICMP, IGMP, ICMP6 = 6, 17, 1, 2, 58
TCP_FIN, TCP_SYN, TCP_RST, TCP_ACK = 1, 2, 4, 16
LINUX_CAN = 0x000C
LINUX_NAMES = {0x0001: "IEEE 802.3", 0x0004: "IEEE 802.2", LINUX_CAN: "CAN", 0x000D: "CAN FD"}
"""Linux's values in place of an Ethernet type, in captures of any interface."""
SLL_BYTES, SLL2_BYTES = 16, 20
COOKED_BYTES = {LINUX_SLL: SLL_BYTES, LINUX_SLL2: SLL2_BYTES}
PROTOCOL_NAMES = {ICMP: "ICMP", IGMP: "IGMP", ICMP6: "ICMPv6"}
BROKEN = "cut or broken packet"
LINK_NAMES = {
    **dict.fromkeys((189, 220, 249), "USB"),
    **dict.fromkeys((187, 201), "Bluetooth"),
    254: "Bluetooth monitor",
    CAN: "CAN",
}
SKIPPED_IPV6_HEADERS = (0, 43, 60)  # Hop-by-hop, routing, destination options.
IPV6_FRAGMENT = 44
_new = tuple.__new__
_USUAL_BYTES = 42
_usual = struct.Struct("!12xHBxH2xHxB2x12sH2x").unpack_from
"""Headers of UDP in IPv4 without options on Ethernet: type, version, total length, fragment,
protocol, addresses and ports, length."""


class Endpoint(NamedTuple):
    """Address and port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


class Segment(NamedTuple):
    """The payload of one UDP datagram or TCP segment; `cut` when the capture lacks a part of it.

    `sequence` is the TCP sequence number as sent (that of the SYN, or else of the first byte of the
    payload); `flags` are the TCP flags.
    """

    protocol: str  # "UDP" or "TCP"
    source: Endpoint
    destination: Endpoint
    payload: bytes
    cut: bool
    sequence: int = 0
    flags: int = 0
    missing: int = 0
    """Number of last bytes of the payload that the capture lacks; 0 if unknown."""

    def __str__(self) -> str:
        return _ports(self.protocol, self.source.port, self.destination.port)

    def ends(self, direction: Direction) -> tuple[Endpoint, Endpoint]:
        """Return the device's end and the client's, for a segment in this direction."""
        if direction is Direction.FROM_DEVICE:
            return self.source, self.destination
        return self.destination, self.source


@functools.lru_cache(maxsize=1024)
def _ports(protocol: str, one: int, other: int) -> str:
    low, high = sorted((one, other))
    return f"{protocol} {low}/{high}"


def parse(packet: CapturedPacket) -> Segment | str:
    """Return the segment in a packet, or the name of another packet ("ARP", "USB", "CAN"...)."""
    data = packet.data
    if packet.link_type == ETHERNET and len(data) >= _USUAL_BYTES:
        ethertype, version, total, fragment, protocol, ends, size = _usual(data)
        if (
            protocol == UDP
            and ethertype == ETHERTYPE_IPV4
            and version == 0x45
            and not fragment & 0x3FFF
            and total >= 28
        ):
            end = 34 + size
            payload = data[_USUAL_BYTES : end if end <= 14 + total else 14 + total]
            source, destination = _ends(ends)
            cut = len(payload) != size - 8 or packet.wire_bytes > len(data)
            return _new(Segment, ("UDP", source, destination, payload, cut, 0, 0, 0))
    try:
        found = _link(packet)
    except (struct.error, IndexError):
        return BROKEN
    if not isinstance(found, Segment) or not packet.cut:
        return found
    return found._replace(cut=True)


def unwrapped(packet: CapturedPacket) -> CapturedPacket:
    """Convert a CAN frame from a capture of any Linux interface to the form of a CAN capture;
    return any other packet unchanged."""
    head_bytes = COOKED_BYTES.get(packet.link_type)
    if head_bytes is None or len(packet.data) < head_bytes:
        return packet
    at = 14 if packet.link_type == LINUX_SLL else 0
    if struct.unpack_from("!H", packet.data, at)[0] != LINUX_CAN:
        return packet
    return packet._replace(
        link_type=CAN, data=packet.data[head_bytes:], wire_bytes=packet.wire_bytes - head_bytes
    )


def interface(packet: CapturedPacket) -> int | None:
    """Return a number for the place where a packet was seen; None if the capture has none."""
    if packet.link_type == LINUX_SLL2 and len(packet.data) >= SLL2_BYTES:
        (index,) = struct.unpack_from("!I", packet.data, 4)
        return int(index)
    return packet.interface


@functools.lru_cache(maxsize=1024)
def _ends(data: bytes) -> tuple[Endpoint, Endpoint]:
    source, destination, source_port, destination_port = struct.unpack("!4s4sHH", data)
    return Endpoint(_host(source), source_port), Endpoint(_host(destination), destination_port)


def _link(packet: CapturedPacket) -> Segment | str:
    data, link_type = packet.data, packet.link_type
    if link_type in (RAW, IPV4, IPV6, *RAW_OF_BSD):
        return _ip(data)
    if link_type in (NULL, LOOP):
        return _ip(data[4:])  # The address family differs between systems; IP has its version.
    if link_type == ETHERNET:
        at = 12
    elif link_type == LINUX_SLL:
        at = 14
    elif link_type == LINUX_SLL2:
        (ethertype,) = struct.unpack_from("!H", data)
        at = SLL2_BYTES
        while ethertype in VLAN_TAGS:
            (ethertype,) = struct.unpack_from("!H", data, at + 2)
            at += 4
        return _ethertype(ethertype, data[at:], True)
    else:
        return LINK_NAMES.get(link_type, f"link type {link_type}")
    (ethertype,) = struct.unpack_from("!H", data, at)
    while ethertype in VLAN_TAGS:
        at += 4
        (ethertype,) = struct.unpack_from("!H", data, at)
    return _ethertype(ethertype, data[at + 2 :], link_type == LINUX_SLL)


def _ethertype(ethertype: int, data: bytes, cooked: bool) -> Segment | str:
    if ethertype in (ETHERTYPE_IPV4, ETHERTYPE_IPV6):
        return _ip(data)
    if ethertype < 0x600:
        return LINUX_NAMES.get(ethertype, "IEEE 802.2") if cooked else "IEEE 802.2"
    return ETHERTYPE_NAMES.get(ethertype, f"ethertype 0x{ethertype:04x}")


def _ip(data: bytes) -> Segment | str:
    version = data[0] >> 4
    if version == 4:
        return _ipv4(data)
    if version == 6:
        return _ipv6(data)
    return f"IP version {version}"


def _ipv4(data: bytes) -> Segment | str:
    total, fragment, protocol, source, destination = struct.unpack_from("!2xH2xHxB2x4s4s", data)
    if fragment & 0x1FFF:
        return "IP fragment"
    body = data[(data[0] & 15) * 4 : total or None]  # 0: to be filled in by the network card.
    missing = max(0, total - len(data))
    found = _segment(protocol, source, destination, body, missing)
    more = bool(fragment & 0x2000)
    return found._replace(cut=found.cut or more) if isinstance(found, Segment) else found


def _ipv6(data: bytes) -> Segment | str:
    size, header, source, destination = struct.unpack_from("!4xHBx16s16s", data)
    body = data[40 : 40 + size]
    missing = size - len(body)
    while header in SKIPPED_IPV6_HEADERS:
        header, body = body[0], body[8 + body[1] * 8 :]
    if header == IPV6_FRAGMENT:
        return "IP fragment"
    return _segment(header, source, destination, body, missing)


@functools.lru_cache(maxsize=1024)
def _host(address: bytes) -> str:
    return str(ipaddress.ip_address(address))


def _segment(
    protocol: int, source: bytes, destination: bytes, body: bytes, missing: int
) -> Segment | str:
    if protocol not in (TCP, UDP):
        return PROTOCOL_NAMES.get(protocol, f"IP protocol {protocol}")
    source_port, destination_port = struct.unpack_from("!HH", body)
    sender = Endpoint(_host(source), source_port)
    receiver = Endpoint(_host(destination), destination_port)
    if protocol == TCP:
        (sequence,) = struct.unpack_from("!4xI", body)
        payload = body[(body[12] >> 4) * 4 :]
        cut = missing > 0
        return Segment("TCP", sender, receiver, payload, cut, sequence, body[13], missing)
    (size,) = struct.unpack_from("!4xH", body)
    payload = body[8:size]
    return Segment("UDP", sender, receiver, payload, len(payload) != size - 8)
