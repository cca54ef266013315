"""Transports of a remote's reports: hidapi, Bluetooth channels, and sockets for simulated
remotes."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import select
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from cardan.common.sockets import connected, hang_up
from cardan.drivers.access import obstacle
from cardan.drivers.hid import REPORT_ROOM, HidDevice, load_hid
from cardan.drivers.packet_socket import TIMEOUT_S, require_unix_sockets
from cardan.errors import DeviceAccessError, DriverError
from cardan_wiimote.protocol import (
    CONTROL_PSM,
    INPUT_HEADER,
    INTERRUPT_PSM,
    NINTENDO,
    OUTPUT_HEADER,
    PRODUCT_IDS,
    WIIMOTE,
    WIIMOTE_TR,
    model_of,
)

if sys.platform == "linux":
    import fcntl

WRITE_TIMEOUT_S = 0.2
"""Time without accepting a report after which a remote is lost."""

CONNECT_TIMEOUT_S = 10.0
"""Longer than a Bluetooth adapter pages a remote."""

_SLICE_S = 0.05


class Found(NamedTuple):
    """Remote that can be opened."""

    name: str
    transport: str
    path: str
    address: str = ""
    late_model: bool = False
    """A -TR remote."""
    kernel_driver: bool = False
    """True if the kernel's driver hid-wiimote is bound to it."""
    obstacle: str = ""


class Link(ABC):
    """Open remote. All methods but close() raise OSError once it is gone."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes | None:
        """Return the next report, id first, waiting up to `timeout_s`; None: no report."""

    @abstractmethod
    def write(self, report: bytes) -> None:
        """Send an output report."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection to the remote. Never raises; may be called twice."""


class Transport(ABC):
    """Finds and opens remotes."""

    name: str

    @abstractmethod
    def find(self) -> list[Found]:
        """Find the present remotes. Raises DriverError if this transport is unavailable."""

    @abstractmethod
    def open(self, remote: Found, given_up: Callable[[], bool]) -> Link:
        """Open a remote from find(); stop waiting once `given_up`.

        Raises DeviceAccessError that says what to do.
        """


# ---------------------------------------------------------------------------------------------
# hidapi


class HidrawTransport(Transport):
    """Remotes that the system has connected, over hidapi's hidraw back end."""

    name = "hidraw"

    def __init__(self, *, root: Path = Path("/")) -> None:
        self._root = root
        """Parent folder of /sys."""

    def find(self) -> list[Found]:
        """Return the remotes in the order of the system, without balance boards and other pads."""
        found = []
        for info in _hidraw().enumerate(NINTENDO, 0):
            product_id, name = info["product_id"], info.get("product_string") or ""
            if product_id not in PRODUCT_IDS:
                continue
            model = model_of(name, product_id)
            if model not in (WIIMOTE, WIIMOTE_TR):
                continue
            path = os.fsdecode(info["path"])
            found.append(
                Found(
                    name or model.bluetooth_name,
                    self.name,
                    path,
                    (info.get("serial_number") or "").upper(),
                    model is WIIMOTE_TR,
                    kernel_driver_bound(path, root=self._root),
                    obstacle(path),
                )
            )
        return found

    def open(self, remote: Found, given_up: Callable[[], bool]) -> Link:
        """Open a remote by its path, unless another driver of this kind has it."""
        claim = _claim(remote)
        try:
            return _HidLink(_hidraw(), remote.path, claim)
        except (OSError, ValueError, DriverError) as error:
            _let_go(claim)
            if isinstance(error, DriverError):
                raise
            words = obstacle(remote.path) or f"{remote.path}: {error}"
            raise DeviceAccessError(f"cannot open {remote.name}: {words}") from None


class _HidLink(HidDevice, Link):
    """Open HID device as a link."""

    def __init__(self, module: ModuleType, path: str, claim: int | None) -> None:
        super().__init__(module, path)
        self._claim = claim

    def close(self) -> None:
        """Release the device, and the claim on it."""
        super().close()
        _let_go(self._claim)
        self._claim = None


def _claim(remote: Found) -> int | None:
    """Claim a remote's node among drivers of this kind: hidraw lets any number open it.

    Return the open file that holds the claim; None if there is nothing to claim. Raises
    DeviceAccessError if another driver has it.
    """
    if sys.platform != "linux":
        return None
    try:
        node = os.open(remote.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:  # hidapi gets the same error, and reports it.
        return None
    try:
        fcntl.flock(node, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(node)
        raise DeviceAccessError(
            f"cannot open {remote.name}: another session has {remote.path}; give each session a "
            "remote of its own by address or path"
        ) from None
    except OSError:  # The file system has no locks.
        os.close(node)
        return None
    return node


def _let_go(claim: int | None) -> None:
    if claim is not None:
        os.close(claim)


def _hidraw() -> Any:
    """hidapi's hidraw back end: the wheels for Linux call it `hidraw`, other builds `hid`.

    Without either the error is that of `hidraw`, as other drivers have it.
    """
    if sys.platform != "linux":
        return load_hid("hid")
    try:
        return load_hid("hidraw")
    except DriverError as error:
        missing = error
    try:
        return load_hid("hid")
    except DriverError:
        raise missing from None


def kernel_driver_bound(path: str, *, root: Path = Path("/")) -> bool:
    """Return True if the kernel's driver hid-wiimote is bound to the device of /dev/hidrawN."""
    driver = root / "sys/class/hidraw" / Path(path).name / "device/driver"
    with contextlib.suppress(OSError):
        return Path(os.readlink(driver)).name == "wiimote"
    return False


# ---------------------------------------------------------------------------------------------
# Channels: L2CAP, or Unix sockets that stand for it


class ChannelLink(Link):
    """Both connected channels of a remote; reports use the interrupt channel both ways."""

    def __init__(self, control: socket.socket, interrupt: socket.socket) -> None:
        self._control, self._interrupt = control, interrupt
        control.setblocking(False)
        interrupt.settimeout(WRITE_TIMEOUT_S)
        self._poll = select.poll()
        self._poll.register(control, select.POLLIN)
        self._poll.register(interrupt, select.POLLIN)
        self._interrupt_number = interrupt.fileno()

    def read(self, timeout_s: float) -> bytes | None:
        """Return a report; empty for another packet; None on a time-out."""
        for number, _ in self._poll.poll(1000.0 * timeout_s):
            if number == self._interrupt_number:
                packet = self._interrupt.recv(REPORT_ROOM)
                if not packet:
                    raise OSError(errno.ENOTCONN, "the remote closed its interrupt channel")
                return packet[1:] if packet[0] == INPUT_HEADER else b""
            if not self._control.recv(REPORT_ROOM):  # Otherwise a handshake, which is ignored.
                raise OSError(errno.ENOTCONN, "the remote closed its control channel")
        return None

    def write(self, report: bytes) -> None:
        """Send one report."""
        self._interrupt.send(bytes((OUTPUT_HEADER,)) + report)

    def close(self) -> None:
        """Close both channels."""
        hang_up(self._interrupt)
        hang_up(self._control)


class SocketTransport(Transport):
    """Folder of two Unix sockets, psm11 and psm13, in place of the channels of a remote."""

    name = "socket"

    def __init__(self, folder: str) -> None:
        self._folder = folder

    def find(self) -> list[Found]:
        """Return the one remote, if its sockets exist."""
        if not all(os.path.exists(self._socket(psm)) for psm in (CONTROL_PSM, INTERRUPT_PSM)):
            return []
        return [Found("simulated remote", self.name, self._folder)]

    def open(self, remote: Found, given_up: Callable[[], bool]) -> Link:
        """Connect to both sockets."""
        require_unix_sockets()
        hint = "is it running, and does no other program hold it?"
        name = f"the simulated remote in {self._folder!r}"

        def connect(psm: int) -> socket.socket:
            return connected(self._socket(psm), socket.SOCK_SEQPACKET, TIMEOUT_S)

        return _connect_both(name, connect, hint)

    def _socket(self, psm: int) -> str:
        return os.path.join(self._folder, f"psm{psm:02x}")


class L2capTransport(Transport):
    """Remote over Bluetooth channels that the driver itself opens."""

    name = "l2cap"

    def __init__(self, address: str) -> None:
        self._address = address

    def find(self) -> list[Found]:
        """Return the one remote, which may be out of reach: only a connection shows."""
        return [Found("Wii Remote", self.name, self._address, self._address.upper())]

    def open(self, remote: Found, given_up: Callable[[], bool]) -> Link:
        """Connect both channels; takes as long as the remote is paged."""

        def connect(psm: int) -> socket.socket:
            channel = socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, _BTPROTO_L2CAP)
            try:
                connect_by_bytes(
                    channel, l2cap_address(self._address, psm), CONNECT_TIMEOUT_S, given_up
                )
            except OSError:
                channel.close()
                raise
            return channel

        hint = (
            "press a button of the remote if it is paired, else 1 and 2 together; it must not be "
            "connected by the system at the same time"
        )
        return _connect_both(f"the remote {self._address}", connect, hint)


def _connect_both(name: str, connect: Callable[[int], socket.socket], hint: str) -> ChannelLink:
    """Connect both channels in the order that remotes need: control, interrupt."""
    control = None
    try:
        control = connect(CONTROL_PSM)
        interrupt = connect(INTERRUPT_PSM)
    except OSError as error:
        if control is not None:
            control.close()
        words = f"cannot connect to {name}: {error.strerror or error}; {hint}"
        raise DeviceAccessError(words) from None
    return ChannelLink(control, interrupt)


AF_BLUETOOTH = 31
_BTPROTO_L2CAP = 0


def l2cap_address(address: str, psm: int) -> bytes:
    """Return the system's `sockaddr_l2` of a remote's channel."""
    return (
        AF_BLUETOOTH.to_bytes(2, sys.byteorder)
        + psm.to_bytes(2, "little")
        + bytes.fromhex(address.replace(":", ""))[::-1]
        + bytes(4)
    )


def connect_by_bytes(
    channel: socket.socket,
    address: bytes,
    timeout_s: float,
    given_up: Callable[[], bool],
) -> None:
    """Connect to a raw socket address. Raises OSError, also after `timeout_s` or once `given_up`.

    Python's own connect() supports Bluetooth addresses only if it was built with BlueZ's headers,
    as many builds are not; the C library's always does.
    """
    channel.setblocking(False)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.connect(channel.fileno(), address, len(address)) != 0:
        error = ctypes.get_errno()
        if error not in (errno.EINPROGRESS, errno.EAGAIN):
            raise OSError(error, os.strerror(error))
        _await_connection(channel, time.monotonic() + timeout_s, given_up)
    channel.setblocking(True)


def _await_connection(channel: socket.socket, until_s: float, given_up: Callable[[], bool]) -> None:
    waiting = select.poll()
    waiting.register(channel, select.POLLOUT)
    while not waiting.poll(1000.0 * _SLICE_S):
        if given_up():
            raise OSError(errno.ECANCELED, "given up")
        if time.monotonic() > until_s:
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
    error = channel.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if error:
        raise OSError(error, os.strerror(error))
