"""Checks of ports that sessions and servers listen at: free, or held by a program."""

from __future__ import annotations

import binascii
import ipaddress
import socket
import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from cardan.doctor.base import (
    Check,
    Finding,
    Subject,
    failure,
    good,
    server_defaults,
    server_option,
)
from cardan.doctor.processes import Holder, holders

GROUP = "ports"

_TABLES: Final = {"tcp": ("tcp", "tcp6"), "udp": ("udp", "udp6")}
_LISTENS: Final = "0A"
"""State of a listening TCP socket (linux/tcp_states.h). UDP sockets always accept datagrams."""


class Wanted(NamedTuple):
    """Port that a session or server of the files will listen at."""

    transport: str
    host: str
    port: int
    who: str
    """ "robot of gofa", "server office"."""

    def __str__(self) -> str:
        return f"{self.transport.upper()} port {self.port}"


class Bound(NamedTuple):
    """Socket that is bound on this computer."""

    transport: str
    address: str
    port: int
    inode: int


def read_bound(table: str, transport: str) -> Iterator[Bound]:
    """Yield the listening sockets of /proc/net/tcp, tcp6, udp or udp6; lines of another form are
    skipped."""
    for line in table.splitlines()[1:]:
        words = line.split()
        try:
            address, port = words[1].split(":")
            if transport == "tcp" and words[3] != _LISTENS:
                continue
            yield Bound(transport, _address(address), int(port, 16), int(words[9]))
        except (IndexError, ValueError, struct.error):
            continue


def _address(text: str) -> str:
    """Decode an address of /proc/net: 32-bit words in this computer's byte order."""
    data = binascii.unhexlify(text)
    words = struct.unpack(f">{len(data) // 4}I", data)
    packed = struct.pack(f"={len(words)}I", *words)
    found = ipaddress.ip_address(packed)
    mapped = found.ipv4_mapped if isinstance(found, ipaddress.IPv6Address) else None
    return str(mapped or found)


def collide(one: str, other: str) -> bool:
    """Return True if two sockets at these addresses cannot have the same port."""
    a, b = ipaddress.ip_address(one), ipaddress.ip_address(other)
    # A socket that listens at :: has the IPv4 port too, unless IPV6_V6ONLY is set.
    if a.is_unspecified or b.is_unspecified:
        wide, narrow = (a, b) if a.is_unspecified else (b, a)
        return wide.version == narrow.version or wide.version == 6
    return a == b


def check_ports(
    wanted: Iterable[Wanted], bound: Iterable[Bound], held: Mapping[int, Holder]
) -> Iterator[Finding]:
    """Check that each port is free. `held`: owners of the sockets by inode; those of other users
    are unknown."""
    bound = list(bound)
    taken: dict[tuple[str, int], Wanted] = {}
    for each in wanted:
        if not each.port:
            continue
        first = taken.setdefault((each.transport, each.port), each)
        if first is not each and collide(first.host, each.host):
            yield failure(
                "port-twice",
                f"{each} is used by {first.who} and by {each.who}",
                "only one of them can run at a time",
                f"edit the port of one: {each.who}",
            )
            continue
        other = next(
            (
                one
                for one in bound
                if (one.transport, one.port) == (each.transport, each.port)
                and collide(one.address, each.host)
            ),
            None,
        )
        if other is None:
            yield good("port", f"{each} of {each.who} is free")
            continue
        holder = held.get(other.inode)
        if holder is not None and holder.is_ours:
            yield good("port", f"{each} of {each.who}: Cardan has it already, {holder}")
            continue
        yield failure(
            "port",
            f"{each} of {each.who} is in use by {holder or 'a program of another user'}",
            f"{each.who} cannot listen there",
            f"kill {holder.pid}"
            if holder
            else f"sudo ss -lntup 'sport = :{each.port}' names it; then sudo kill its pid",
        )


def wanted_ports(subject: Subject) -> Iterator[Wanted]:
    """Yield the ports that the files' drivers and servers listen at."""
    for used in subject.used():
        for each in used.driver.endpoints():
            if each.listens and (host := numeric(each.host)):
                yield Wanted(each.transport, host, each.port, f"{used.key} of {used.session}")
    for name, entry in subject.servers.items():
        defaults = server_defaults(entry)
        if "port" not in defaults:
            continue
        port = server_option(entry, "port", defaults["port"])
        host = numeric(server_option(entry, "host", defaults.get("host", "127.0.0.1")))
        if host and port.isdecimal():
            yield Wanted("tcp", host, int(port), f"server {name}")


def numeric(host: str) -> str:
    """Return the address of a host name; empty if it has none."""
    try:
        return str(socket.getaddrinfo(host, None)[0][4][0]).partition("%")[0]
    except (OSError, UnicodeError):
        return ""


def bound_sockets(subject: Subject) -> list[Bound]:
    """Return all listening sockets of this computer."""
    return [
        each
        for transport, tables in _TABLES.items()
        for table in tables
        for each in read_bound(subject.read(f"proc/net/{table}"), transport)
    ]


class Ports(Check):
    """Ports of the files' robots and servers."""

    group, tells = GROUP, ("port", "port-twice")

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        wanted = list(wanted_ports(subject))
        numbers = {each.port for each in wanted}
        bound = [each for each in bound_sockets(subject) if each.port in numbers]
        held = holders((f"socket:[{each.inode}]" for each in bound), subject.root)
        by_inode = {
            each.inode: held[name] for each in bound if (name := f"socket:[{each.inode}]") in held
        }
        return check_ports(wanted, bound, by_inode)
