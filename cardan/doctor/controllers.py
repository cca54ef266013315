"""Checks that controllers can be reached, or send; a server is queried in its own protocol."""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import socket
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from cardan.common.sockets import opened
from cardan.doctor.base import Check, Finding, Subject, caution, failure, good
from cardan.drivers.base import Endpoint
from cardan.errors import AddressError, shown

GROUP = "controllers"

LISTEN_S: Final = 2.0
"""Longest wait for a controller that sends first. It sends every 4 to 48 ms while its program runs,
and its program restarts within a second."""

CONNECT_S: Final = 2.0
"""Longest wait for a TCP connection: over a cable it takes a millisecond."""

_DATAGRAM_BYTES: Final = 2048


class Heard(NamedTuple):
    """Result of listening at a port, or of connecting."""

    sources: tuple[str, ...] = ()
    """Addresses of the senders."""
    said: bytes = b""
    """First bytes of a server that sends first, or a datagram of another protocol."""
    error: int = 0
    """errno of the failed attempt; 0: it succeeded."""


def listen(endpoints: Iterable[Endpoint], seconds: float = LISTEN_S) -> dict[Endpoint, Heard]:
    """Return the senders to these UDP ports within `seconds`, or until all have sent; send
    nothing."""
    other: dict[Endpoint, bytes] = {}
    heard: dict[Endpoint, set[str]] = {}
    failed: dict[Endpoint, Heard] = {}
    with selectors.DefaultSelector() as selector:
        for each in endpoints:
            try:
                sock = opened(each.host, each.port, socket.SOCK_DGRAM, socket.socket.bind, _number)
            except AddressError as error:
                words = str(error)
                # An address that many computers share raises an error in words: no server listens
                # there.
                failed[each] = Heard(error=int(words) if words.isdecimal() else errno.EADDRNOTAVAIL)
                continue
            heard[each] = set()
            selector.register(sock, selectors.EVENT_READ, each)
        end_s = time.monotonic() + seconds
        while not all(heard.values()) and (left_s := end_s - time.monotonic()) > 0.0:
            for key, _ in selector.select(left_s):
                try:
                    data, source = key.fileobj.recvfrom(_DATAGRAM_BYTES)  # type: ignore[union-attr]
                except OSError:
                    continue
                if key.data.speaks is None or key.data.speaks(data):
                    heard[key.data].add(str(source[0]))
                else:
                    other.setdefault(key.data, data)
        for key in list(selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
    return {
        **{
            each: Heard(tuple(sorted(found)), b"" if found else other.get(each, b""))
            for each, found in heard.items()
        },
        **failed,
    }


def _number(error: OSError) -> str:
    """Return an error as its errno: `opened` raises words only."""
    return str(error.errno if error.errno and error.errno > 0 else errno.EADDRNOTAVAIL)


def connect(endpoint: Endpoint, seconds: float = CONNECT_S) -> Heard:
    """Connect to a TCP server, read its greeting if it sends one, and close the connection."""
    try:
        with socket.create_connection((endpoint.host, endpoint.port), seconds) as sock:
            return Heard((str(sock.getpeername()[0]),), _first_words(sock, endpoint, seconds))
    except TimeoutError:
        return Heard(error=errno.ETIMEDOUT)
    except socket.gaierror:
        return Heard(error=errno.EHOSTUNREACH)
    except OSError as error:
        return Heard(error=error.errno or errno.EIO)


def _first_words(sock: socket.socket, endpoint: Endpoint, seconds: float) -> bytes:
    said, speaks = b"", endpoint.speaks
    if speaks is None:
        return said
    end_s = time.monotonic() + seconds
    with contextlib.suppress(OSError):
        if endpoint.request:
            sock.sendall(endpoint.request)
        while speaks(said) is None:
            sock.settimeout(max(end_s - time.monotonic(), 0.001))
            more = sock.recv(_DATAGRAM_BYTES)
            if not more:
                break
            said += more
    return said


def check_controllers(
    endpoints: Mapping[Endpoint, str], heard: Mapping[Endpoint, Heard]
) -> Iterator[Finding]:
    """Yield findings about each endpoint. `endpoints`: descriptions of the drivers that use it."""
    for each, who in endpoints.items():
        make = _check_listening if each.listens else _check_server
        yield make(each, who, heard[each])


def _check_listening(endpoint: Endpoint, who: str, heard: Heard) -> Finding:
    where = f"UDP port {endpoint.port}"
    if heard.error == errno.EADDRINUSE:
        return good("heard", f"{where} of {who} is in use: not checked")
    if heard.error == errno.EADDRNOTAVAIL:
        return failure(
            "listen-address",
            f"{endpoint.host} is not an address of this computer",
            f"{who} is to listen there",
            "ip -brief address lists this computer's addresses: set listen_host to that of the "
            "robot's "
            "network",
        )
    if heard.error:
        why = f"{who} is to listen there"
        return failure(
            "listen-address",
            f"{endpoint.host}, {where}: {_words(heard.error)}",
            why,
            "set listen_port to one above 1023, and the controller's to the same",
        )
    if heard.said:
        return failure(
            "other-server",
            f"{where} of {who} receives another protocol: {shown(heard.said[:40])}",
            "the session cannot start",
            f"find the sender: sudo tcpdump -ni any udp port {endpoint.port}",
        )
    if not heard.sources:
        return caution(
            "not-heard",
            f"no datagram came to {where} of {who} within {LISTEN_S:g} s",
            "the controller sends first: its program does not run, it sends elsewhere, or a "
            "firewall drops what it sends",
            "start its program; what a firewall drops: sudo nft list ruleset, or sudo iptables -L "
            f"-n; what arrives: sudo tcpdump -ni any udp port {endpoint.port}",
        )
    if endpoint.peer and (peer := _resolved(endpoint.peer)) not in heard.sources:
        return failure(
            "other-controller",
            f"{where} of {who} receives datagrams of {', '.join(heard.sources)}, not of {peer}",
            "the session accepts datagrams only from the controller in the file",
            f"set the controller's address: {heard.sources[0]}, or find out which device that is",
        )
    return good("heard", f"{where} of {who} receives datagrams of {', '.join(heard.sources)}")


def _check_server(endpoint: Endpoint, who: str, heard: Heard) -> Finding:
    where = f"{endpoint.host}, TCP port {endpoint.port},"
    if not heard.error:
        if endpoint.speaks is None or endpoint.speaks(heard.said):
            return good("reached", f"{where} of {who} answers")
        words = f"says {shown(heard.said[:40])}" if heard.said else "says nothing"
        return failure(
            "other-server",
            f"{where} of {who} accepts a connection and {words}: another program uses it",
            "the session cannot start",
            "set the port that the controller serves this protocol at",
        )
    if heard.error == errno.ECONNREFUSED:
        mend = "start the program on the controller that serves it"
    else:
        mend = f"ping -c 3 {endpoint.host}"
    return failure(
        "not-reached",
        f"{where} of {who} does not answer: {_words(heard.error)}",
        "the session cannot start",
        mend,
    )


def _words(number: int) -> str:
    return os.strerror(number).lower()


def _resolved(host: str) -> str:
    try:
        return socket.gethostbyname(host)
    except OSError:
        return host


class Controllers(Check):
    """Controllers of the files: connects to those that serve, listens to those that send."""

    group = GROUP
    tells = (
        "heard",
        "not-heard",
        "other-controller",
        "listen-address",
        "reached",
        "not-reached",
        "other-server",
    )

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        found: dict[Endpoint, str] = {}
        for used in subject.used():
            for each in used.driver.endpoints():
                if each.port:
                    found.setdefault(each, f"{used.key} of {used.session}")
        heard = listen(each for each in found if each.listens)
        heard.update({each: connect(each) for each in found if not each.listens})
        return check_controllers(found, heard)
