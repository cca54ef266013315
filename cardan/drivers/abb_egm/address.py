"""Binding of the UDP port for EGM datagrams, with errors that say what to do."""

from __future__ import annotations

import errno
import os
import socket
from pathlib import Path

from cardan.common.sockets import opened, refuse_shared
from cardan.errors import AddressError

_FIRST_UNPRIVILEGED_PORT = 1024


def bind_udp(host: str, port: int) -> socket.socket:
    """Bind a blocking UDP socket to an IPv4 `host` and `port`. Raises AddressError with advice."""
    sock = opened(
        host, port, socket.SOCK_DGRAM, socket.socket.bind, lambda error: _explain(host, port, error)
    )
    sock.setblocking(True)
    return sock


def resolve(host: str) -> str:
    """Return the IPv4 address of `host`. Raises AddressError."""
    try:
        found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise AddressError(
            f"controller_host {host!r} has no IPv4 address ({error}); "
            "give the controller's address itself"
        ) from error
    address = str(found[0][4][0])
    refuse_shared(f"controller_host {host!r}", address, listens=False)
    return address


def _explain(host: str, port: int, error: OSError) -> str:
    where = f"UDP port {port} on {host}"
    if error.errno == errno.EADDRINUSE:
        holder = _holder(port) or "another program"
        return (
            f"{where} is in use by {holder}; stop that program or choose another listen_port "
            "(and the same Remote Port Number in the controller's UdpUc device)"
        )
    if error.errno == errno.EACCES and port < _FIRST_UNPRIVILEGED_PORT:
        return (
            f"{where} is reserved for privileged programs; choose a listen_port from "
            f"{_FIRST_UNPRIVILEGED_PORT} on (EGM commonly uses 6510 or 6511)"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return (
            f"{host} is not an address of this computer; set listen_host to its address on the "
            "robot's network, 127.0.0.1 for a controller simulated here, or 0.0.0.0 for any"
        )
    if isinstance(error, socket.gaierror):
        return f"listen_host {host!r} is not a known IPv4 address ({error.strerror}); give a number"
    return f"{where} cannot be used: {error.strerror or error}"


def _holder(port: int) -> str:
    """Program that holds a UDP port; empty if Linux does not show it."""
    try:
        lines = Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]
        inodes = {
            f"socket:[{columns[9]}]"
            for columns in map(str.split, lines)
            if int(columns[1].rpartition(":")[2], 16) == port
        }
        for process in Path("/proc").iterdir():
            if process.name.isdigit() and _has_open(process, inodes):
                name = (process / "comm").read_text(encoding="utf-8").strip()
                own = " (this program itself)" if process.name == str(os.getpid()) else ""
                return f"{name}, process {process.name}{own}"
    except (OSError, ValueError, IndexError):
        pass
    return ""


def _has_open(process: Path, links: set[str]) -> bool:
    try:
        return any(os.readlink(entry) in links for entry in (process / "fd").iterdir())
    except OSError:
        return False
