"""CAN bus of the JR3 driver by python-can, with errors that advise the user. python-can is LGPL and
therefore an extra: it is imported only when a bus is opened."""

from __future__ import annotations

import contextlib
import errno
import importlib.util
import logging
import os
import secrets
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cardan.common.extras import missing_extra
from cardan.drivers.base import FoundDevice
from cardan.errors import DeviceAccessError, DeviceNotFoundError, DriverError, ExtraMissingError
from cardan_jr3.driver.options import Jr3Options
from cardan_jr3.protocol import NODE_MASK, CanFrame

if TYPE_CHECKING:
    import can

PACKAGE = "a CAN bus", "python-can", "can"
"""The feature that needs python-can, the package's name, and the extra that installs it."""
SEND_TIMEOUT_S = 0.05
CONNECT_TIMEOUT_S = 1.0
GREETING = b"< hi >"
"""First bytes that socketcand sends to a client."""
GARBLED_AT_MOST = 50
"""Unreadable frames in a row after which the interface is reopened."""
ARPHRD_CAN = "280"
_IFF_UP = 0x1
_NO_ROUTE = (errno.ENODEV, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EADDRNOTAVAIL)
_NO_NETWORK = (errno.ENODEV, errno.ENETUNREACH, errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)


class Unusable(NamedTuple):
    """Received frame other than a data frame with an 11-bit identifier."""

    kind: str
    """Name of the core's counter for it."""


class CanBus:
    """Open bus. Its methods raise OSError once it is gone. A bus that `echoes` also returns sent
    frames, as udp_multicast does regardless of python-can's options.
    """

    def __init__(self, bus: can.BusABC, *, echoes: bool = False) -> None:
        import can

        self._bus = bus
        # python-can reads the end of socketcand's stream as "no frame yet", and spins.
        self._stream: socket.socket | None = getattr(bus, "_SocketCanDaemonBus__socket", None)
        self._message = can.Message
        self._error = can.CanError
        self._garbled = 0
        self._mark = secrets.token_hex(8) if echoes else None
        """Channel number that python-can adds to our frames and that no board uses."""

    def receive(self, timeout_s: float) -> CanFrame | Unusable | None:
        """Return the next frame of another node, waiting `timeout_s` at most; None: there was
        none."""
        try:
            if self._stream is not None:
                _look_for_end(self._stream)
            message = self._bus.recv(timeout_s)
            while message is not None and self._is_own(message):
                message = self._bus.recv(0.0)
        except self._error as error:
            return self._unreadable(error)
        except (ValueError, TypeError) as error:  # of a socket that was closed
            raise OSError(str(error)) from None
        if message is None:
            return None
        self._garbled = 0
        if message.is_error_frame:
            return Unusable("bus_errors")
        if message.is_extended_id or message.is_remote_frame or message.is_fd:
            return Unusable("foreign_frames")
        return CanFrame(message.arbitration_id, bytes(message.data))

    def send(self, frame: CanFrame) -> None:
        """Send `frame`."""
        arbitration_id, data = frame
        message = self._message(
            arbitration_id=arbitration_id, data=data, is_extended_id=False, channel=self._mark
        )
        try:
            self._bus.send(message, SEND_TIMEOUT_S)
        except self._error as error:
            raise _os_error(error) from None

    def close(self) -> None:
        """Close the bus; never raises."""
        with contextlib.suppress(Exception):
            self._bus.shutdown()

    def _is_own(self, message: can.Message) -> bool:
        return not message.is_rx or (self._mark is not None and message.channel == self._mark)

    def _unreadable(self, error: can.CanError) -> Unusable:
        """Classify a read error of python-can: of a single frame, or of the whole bus (OSError)."""
        self._garbled += 1
        of_a_frame = error.__cause__ is not None and not isinstance(error.__cause__, OSError)
        if of_a_frame and self._garbled <= GARBLED_AT_MOST:
            return Unusable("garbled_frames")
        raise _os_error(error) from None


def open_bus(options: Jr3Options) -> CanBus:
    """Open the bus that `options` name, for frames of their node only. Raises DriverError with
    advice.
    """
    _silence_warnings()
    try:
        import can
    except ImportError as error:
        raise missing_extra(*PACKAGE, error) from error
    interface, channel = options.interface, options.channel
    extra: dict[str, Any] = {}
    if interface == "udp_multicast":
        extra = {"port": options.full_port, "hop_limit": options.hop_limit}
    elif interface == "socketcand":
        extra = {"host": options.host, "port": options.full_port, "tcp_tune": True}
        _look_for_server(options.host, options.full_port)
    elif interface not in ("socketcan", "virtual"):
        extra = {"bitrate": options.bitrate}
    filters = [{"can_id": options.node_id, "can_mask": NODE_MASK, "extended": False}]
    where = f"the CAN bus {channel!r} by {interface}"
    try:
        bus = can.Bus(
            channel=channel,
            interface=interface,
            ignore_config=True,
            can_filters=filters,
            **extra,
        )
    except NotImplementedError as error:
        if "msgpack" in str(error):
            raise missing_extra(where, "msgpack", "can", error) from error
        raise DriverError(f"cannot open {where}: {error}") from None
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        raise _refusal(interface, channel, where, error) from None
    except Exception as error:  # such as a NameError if the vendor's library is missing
        raise DriverError(
            f"cannot open {where}: python-can fails with {error!r}; "
            "are the interface's driver and library installed?"
        ) from None
    return CanBus(bus, echoes=interface == "udp_multicast")


def in_use(options: Jr3Options, error: OSError) -> DriverError:
    """Return the error for an open bus that cannot be used."""
    words = (
        f"cannot use the CAN bus {options.channel!r} by {options.interface}: "
        f"{error.strerror or error}"
    )
    if error.errno == errno.ENETDOWN:
        words += f"; {_down(options.channel)}"
    elif error.errno == errno.ENOBUFS:
        words += "; no node on the bus acknowledges: check cable, terminators, bit rate and power"
    return DeviceAccessError(words)


def can_interfaces(root: Path = Path("/")) -> list[FoundDevice]:
    """Return the network interfaces of this computer that are CAN buses; `root` is the path of
    /sys."""
    found = []
    for node in sorted((root / "sys/class/net").glob("*/type")):
        try:
            if node.read_text().strip() != ARPHRD_CAN:
                continue
            up = int((node.parent / "flags").read_text(), 16) & _IFF_UP
        except (OSError, ValueError):
            continue
        name = node.parent.name
        found.append(FoundDevice("CAN bus", "", "socketcan", name, _obstacle(name, bool(up))))
    return found


def _obstacle(name: str, up: bool) -> str:
    if not up:
        return _down(name)
    if importlib.util.find_spec("can"):
        return ""
    return str(ExtraMissingError(*PACKAGE, "it is not installed"))


def _down(name: str) -> str:
    return f"{name} is down: sudo ip link set {name} up type can bitrate 1000000"


def _os_error(error: can.CanError) -> OSError:
    """Return python-can's error as OSError, with its number if known."""
    cause = error.__cause__
    if isinstance(cause, OSError) and cause.errno is not None:
        return OSError(cause.errno, cause.strerror)
    if error.error_code is not None:
        return OSError(error.error_code, os.strerror(error.error_code))
    return OSError(str(cause or error))


def _refusal(interface: str, channel: str, where: str, error: BaseException) -> DriverError:
    """Return the error for a bus that cannot be opened."""
    cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
    number = cause.errno if isinstance(cause, OSError) else None
    words = f"cannot open {where}: {getattr(cause, 'strerror', None) or error}"
    if interface == "socketcan" and number in _NO_NETWORK:
        if number == errno.EAFNOSUPPORT:
            return DriverError(f"{words}; this kernel has no CAN")
        return DeviceNotFoundError(f"{words}; `ip link` lists the available interfaces")
    if interface == "socketcan" and number == errno.ENETDOWN:
        return DeviceAccessError(f"{words}; {_down(channel)}")
    if interface == "udp_multicast" and number in _NO_ROUTE:
        return DeviceNotFoundError(
            f"{words}; this computer may have no route for multicast: "
            "sudo ip route add 239.0.0.0/8 dev lo, or use socketcand"
        )
    if interface == "udp_multicast":
        return DeviceNotFoundError(
            f"{words}; channel is the address of a multicast group, such as 239.74.163.2"
        )
    if number in (errno.EACCES, errno.EPERM, errno.EBUSY):
        return DeviceAccessError(words)
    return DeviceNotFoundError(words)


def _look_for_server(host: str, port: int) -> None:
    """Raise unless socketcand answers with its greeting: python-can would busily retry for ten
    seconds, or wait for the greeting forever."""
    try:
        with socket.create_connection((host, port), CONNECT_TIMEOUT_S) as probe:
            greeting = probe.recv(len(GREETING))
    except OSError as error:
        raise DeviceNotFoundError(
            f"no socketcand at {host}:{port}: {error.strerror or error}; start it, or "
            "`cardan sim jr3 --serve-socketcand`"
        ) from None
    if greeting != GREETING:
        raise DeviceNotFoundError(f"no socketcand at {host}:{port}: another program answers there")


def _look_for_end(stream: socket.socket) -> None:
    """Raise OSError when the server has closed the connection."""
    if sys.platform == "win32":
        return
    try:
        ahead = stream.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return
    if not ahead:
        raise OSError(errno.ECONNRESET, "the server has closed the connection")


class _Fragments(logging.Filter):
    """Log filter that drops the warning about a message in two parts of the stream, which is normal
    for TCP."""

    def filter(self, record: logging.LogRecord) -> bool:
        return not record.getMessage().startswith("Got incomplete message")


_FRAGMENTS = _Fragments()
_NOWHERE = logging.NullHandler()


def _silence_warnings() -> None:
    """Keep python-can's warnings off the terminal, unless the program has configured logging: the
    driver has its own messages. May be called repeatedly."""
    logging.getLogger("can").addHandler(_NOWHERE)
    logging.getLogger("can.interfaces.socketcand.socketcand").addFilter(_FRAGMENTS)
