"""From a captured packet down to the UDP or TCP payload."""

from __future__ import annotations

import ipaddress
import struct
from typing import NamedTuple

from cardan.dissect.capture import CapturedPacket, Direction

NULL, ETHERNET, LOOP, RAW, LINUX_SLL, IPV4, IPV6, LINUX_SLL2 = 0, 1, 108, 101, 113, 228, 229, 276
RAW_OF_BSD = (12, 14)
LINK_TYPES = frozenset((NULL, ETHERNET, LOOP, RAW, LINUX_SLL, IPV4, IPV6, LINUX_SLL2, *RAW_OF_BSD))
"""Link types of captures that can hold IP."""
ETHERTYPE_IPV4, ETHERTYPE_IPV6 = 0x0800, 0x86DD
VLAN_TAGS = (0x8100, 0x88A8, 0x9100)
ETHERTYPE_NAMES = {0x0806: "ARP", 0x88CC: "LLDP", 0x8892: "PROFINET", 0x88A4: "EtherCAT"}
TCP, UDP, ICMP, IGMP, ICMP6 = 6, 17, 1, 2, 58
TCP_FIN, TCP_SYN, TCP_RST, TCP_ACK = 1, 2, 4, 16
PROTOCOL_NAMES = {ICMP: "ICMP", IGMP: "IGMP", ICMP6: "ICMPv6"}
LINK_NAMES = {
    **dict.fromkeys((189, 220, 249), "USB"),
    **dict.fromkeys((187, 201), "Bluetooth"),
    227: "CAN",
}
SKIPPED_IPV6_HEADERS = (0, 43, 60)  # hop-by-hop, routing, destination options
IPV6_FRAGMENT = 44


class Endpoint(NamedTuple):
    """An address and a port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


class Segment(NamedTuple):
    """The payload of one UDP datagram or TCP segment; `cut` when the capture lacks a part of it.

    `sequence` is the TCP sequence number as it is sent (that of the SYN, where there is one, and of
    the first byte of the payload where there is none); `flags` are the TCP flags.
    """

    protocol: str  # "UDP" or "TCP"
    source: Endpoint
    destination: Endpoint
    payload: bytes
    cut: bool
    sequence: int = 0
    flags: int = 0

    def __str__(self) -> str:
        low, high = sorted((self.source.port, self.destination.port))
        return f"{self.protocol} {low}/{high}"

    def ends(self, direction: Direction) -> tuple[Endpoint, Endpoint]:
        """The device's end and the client's, of a segment that goes this way."""
        if direction is Direction.FROM_DEVICE:
            return self.source, self.destination
        return self.destination, self.source


def parse(packet: CapturedPacket) -> Segment | str:
    """The segment in a packet; of a packet without one its name ("ARP", "USB", "CAN"...)."""
    try:
        found = _link(packet)
    except (struct.error, IndexError):
        return "cut or broken packet"
    return found._replace(cut=found.cut or packet.cut) if isinstance(found, Segment) else found


def _link(packet: CapturedPacket) -> Segment | str:
    data, link_type = packet.data, packet.link_type
    if link_type in (RAW, IPV4, IPV6, *RAW_OF_BSD):
        return _ip(data)
    if link_type in (NULL, LOOP):
        return _ip(data[4:])  # the address family differs between systems; IP has its version
    if link_type == ETHERNET:
        at = 12
    elif link_type == LINUX_SLL:
        at = 14
    elif link_type == LINUX_SLL2:
        return _ethertype(struct.unpack_from("!H", data)[0], data[20:])
    else:
        return LINK_NAMES.get(link_type, f"link type {link_type}")
    (ethertype,) = struct.unpack_from("!H", data, at)
    while ethertype in VLAN_TAGS:
        at += 4
        (ethertype,) = struct.unpack_from("!H", data, at)
    return _ethertype(ethertype, data[at + 2 :])


def _ethertype(ethertype: int, data: bytes) -> Segment | str:
    if ethertype in (ETHERTYPE_IPV4, ETHERTYPE_IPV6):
        return _ip(data)
    if ethertype < 0x600:
        return "IEEE 802.2"
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
    body = data[(data[0] & 15) * 4 : total or None]  # 0: the network card was to fill it in
    found = _segment(protocol, source, destination, body)
    more = bool(fragment & 0x2000)
    return found._replace(cut=found.cut or more) if isinstance(found, Segment) else found


def _ipv6(data: bytes) -> Segment | str:
    size, header, source, destination = struct.unpack_from("!4xHBx16s16s", data)
    body = data[40 : 40 + size]
    while header in SKIPPED_IPV6_HEADERS:
        header, body = body[0], body[8 + body[1] * 8 :]
    if header == IPV6_FRAGMENT:
        return "IP fragment"
    return _segment(header, source, destination, body)


def _segment(protocol: int, source: bytes, destination: bytes, body: bytes) -> Segment | str:
    if protocol not in (TCP, UDP):
        return PROTOCOL_NAMES.get(protocol, f"IP protocol {protocol}")
    source_port, destination_port = struct.unpack_from("!HH", body)
    sender = Endpoint(str(ipaddress.ip_address(source)), source_port)
    receiver = Endpoint(str(ipaddress.ip_address(destination)), destination_port)
    if protocol == TCP:
        (sequence,) = struct.unpack_from("!4xI", body)
        payload = body[(body[12] >> 4) * 4 :]
        return Segment("TCP", sender, receiver, payload, False, sequence, body[13])
    (size,) = struct.unpack_from("!4xH", body)
    payload = body[8:size]
    return Segment("UDP", sender, receiver, payload, len(payload) != size - 8)
