"""Address of the page for people: a name of this computer, the token in the fragment (#), which
browsers do not send, and a QR code for a phone's camera."""

from __future__ import annotations

import contextlib
import fcntl
import io
import ipaddress
import socket
import struct
from collections.abc import Iterator
from typing import Final

from cardan.common.extras import missing_extra
from cardan.common.sockets import address_towards

_SIOCGIFADDR: Final = 0x8915
"""Request of Linux (netdevice(7)): the address of an interface."""

_ELSEWHERE: Final = ("192.0.2.1", 9)
"""Remote address for finding the outgoing route (RFC 5737): nothing is sent."""

_INET6: Final = "/proc/net/if_inet6"


def own_addresses() -> list[str]:
    """Return the addresses of this computer that others may use, that of the outgoing route
    first."""
    found = dict.fromkeys((*_way_out(), *_of_interfaces(), *_of_inet6()))
    return [each for each in found if _is_of_use(each)]


def own_names() -> list[str]:
    """Return names and addresses of this computer, for a certificate."""
    name = socket.gethostname().lower()
    names = [name, f"{name}.local"] if name and not name.endswith(".local") else [name]
    return [*filter(None, names), "localhost", *own_addresses(), "127.0.0.1", "::1"]


def _is_of_use(address: str) -> bool:
    found = ipaddress.ip_address(address)
    return not (found.is_loopback or found.is_unspecified or found.is_link_local)


def _way_out() -> Iterator[str]:
    with contextlib.suppress(OSError):
        yield address_towards(*_ELSEWHERE)


def _of_interfaces() -> Iterator[str]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):
                asked = struct.pack("256s", name.encode()[:15])
                yield socket.inet_ntoa(fcntl.ioctl(probe, _SIOCGIFADDR, asked)[20:24])


def _of_inet6() -> Iterator[str]:
    try:
        with open(_INET6, encoding="ascii") as file:
            lines = file.read().splitlines()
    except OSError:
        return
    for line in lines:
        with contextlib.suppress(ValueError, IndexError):
            yield str(ipaddress.ip_address(bytes.fromhex(line.split()[0])))


def reachable_host(host: str) -> str:
    """Return the address at which others reach a server that listens at `host`: for "all addresses"
    that of the outgoing route."""
    try:
        found = ipaddress.ip_address(host)
    except ValueError:
        return host
    if not found.is_unspecified:
        return host
    return next(iter(own_addresses()), socket.gethostname().lower() or "localhost")


def page_address(scheme: str, host: str, port: int, token: str) -> str:
    """Return the address for opening the page."""
    shown = f"[{host}]" if ":" in host else host
    fragment = f"#t={token}" if token else ""
    return f"{scheme}://{shown}:{port}/{fragment}"


def picture(address: str) -> str:
    """Return the address as a QR code for a terminal; without the package segno, how to install
    it."""
    try:
        import segno
    except ImportError as error:
        return str(missing_extra("a picture of the address", "segno", "console", error))
    out = io.StringIO()
    segno.make(address, error="l", micro=False).terminal(out=out, compact=True)
    return out.getvalue()
