"""Virtual USB devices of the Linux kernel, over USB/IP.

A server exports devices over TCP; the kernel's vhci-hcd imports them (``usbip attach``), and from
then on requests transfers as from a host controller: control transfers on endpoint 0, and reads of
interrupt endpoints which wait until the device has something. A :class:`UsbipSession` is one
connection without I/O, bytes in and bytes out; :class:`UsbipBackend` listens. All numbers are
big-endian but those of USB itself. Source: Linux, Documentation/usb/usbip_protocol.rst;
tools/usb/usbip/src.
"""

from __future__ import annotations

import enum
import errno
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from cardan.sim_peers.backends.base import DeviceBackend, Shell
from cardan.sim_peers.backends.server import DeviceServer, StreamClient, bound_to

VERSION = 0x0111

REQUEST_DEVLIST, REPLY_DEVLIST = 0x8005, 0x0005
REQUEST_IMPORT, REPLY_IMPORT = 0x8003, 0x0003
CMD_SUBMIT, CMD_UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4

STATUS_OK, STATUS_BUSY, STATUS_NO_DEVICE = 0, 2, 4

MAX_CONNECTIONS = 8

MAX_TRANSFER_BYTES = 1 << 16
"""No transfer of a HID device is as long; a longer one is not USB/IP."""

MAX_CANCELED = 64
"""Most transfers that are canceled before they are submitted: a host has few pending."""

ENDPOINT_REPORTS = 4
"""Most reports kept for an endpoint that is not read; beyond it the oldest are dropped."""

_OP = struct.Struct(">HHI")
_BUS_ID_BYTES = 32
_DEVICE = struct.Struct(">256s32sIIIHHHBBBBBB")
_INTERFACE = struct.Struct(">BBBx")
_SUBMIT = struct.Struct(">IIIIIIiiii8s")
_UNLINK = struct.Struct(">IIIIII24x")
_RET_SUBMIT = struct.Struct(">IIIIIiiiii8x")
_RET_UNLINK = struct.Struct(">IIIIIi24x")
COMMAND_BYTES = _SUBMIT.size
_SEQUENCES = 1 << 32
"""Sequence numbers wrap at this number."""

_SETUP = struct.Struct("<BBHHH")


class Speed(enum.IntEnum):
    """Speeds of a USB device, as the kernel numbers them."""

    LOW = 1
    FULL = 2
    HIGH = 3


class SetupPacket(NamedTuple):
    """A control request."""

    request_type: int
    """Bit 7: to the host; bits 5-6: standard 0, class 1; bits 0-4: device 0, interface 1, ..."""
    request: int
    value: int
    target: int
    """wIndex: the interface or endpoint, if the request concerns one."""
    length: int


class UsbInterface(NamedTuple):
    """Class, subclass and protocol of an interface."""

    interface_class: int
    subclass: int
    protocol: int


class UsbIdentity(NamedTuple):
    """USB device description before configuration."""

    vendor_id: int
    product_id: int
    release: int
    """Binary coded decimal."""
    speed: Speed
    interfaces: tuple[UsbInterface, ...]


class UsbFunction(ABC):
    """USB function of a simulated device, behind the transfers."""

    identity: UsbIdentity
    endpoint: int
    """Number of the interrupt endpoint that carries the reports."""

    @abstractmethod
    def control(self, setup: SetupPacket, data: bytes) -> bytes | None:
        """Execute a control request; `data` is the host's.

        Return the data for the host (at most `setup.length` bytes are sent); None: not supported,
        the endpoint stalls.
        """


class UsbipSession:
    """Connection of a host to a server that exports one device as `bus_id`.

    Pass received bytes to `receive` and reports of interrupt endpoints to `push`; `take_output`
    returns the bytes to send. A session that `failed` has to be closed.
    """

    def __init__(self, function: UsbFunction, bus_id: str = "1-1") -> None:
        self.bus_id = bus_id
        self.present = True
        """False: the device is unplugged."""
        self.available = True
        """False: an import is refused, as the device is in use."""
        self.imported = False
        self.failed = ""
        """Reason of the failure."""
        self.polled = False
        """The host has read an interrupt endpoint: a driver has opened the device."""
        self._function = function
        self._in = bytearray()
        self._out = bytearray()
        self._waiting: dict[int, deque[tuple[int, int]]] = {}
        self._reports: dict[int, deque[bytes]] = {}
        self._newest = 0
        """Sequence number of the newest submitted transfer."""
        self._canceled: dict[int, int] = {}
        """Transfers that were canceled before they were submitted, with the canceling command."""

    def take_output(self) -> bytes:
        """Take the bytes to send now."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def receive(self, data: bytes) -> None:
        """Receive bytes from the host. Never raises."""
        self._in += data
        while not self.failed and self._next():
            pass

    def push(self, endpoint: int, report: bytes) -> None:
        """Queue the device's `report` for interrupt endpoint `endpoint` (1..15)."""
        reports = self._reports.setdefault(endpoint, deque(maxlen=ENDPOINT_REPORTS))
        reports.append(report)
        self._match(endpoint)

    # -- inside --------------------------------------------------------------------------------

    def _next(self) -> bool:
        """Execute one request, if a whole one has arrived."""
        return self._command() if self.imported else self._operation()

    def _operation(self) -> bool:
        if len(self._in) < _OP.size:
            return False
        version, code, _ = _OP.unpack_from(self._in)
        if version >> 8 != VERSION >> 8:
            self.failed = f"version {version:#06x}, not {VERSION:#06x}"
        elif code == REQUEST_DEVLIST:
            del self._in[: _OP.size]
            self._out += _OP.pack(VERSION, REPLY_DEVLIST, STATUS_OK)
            devices = int(self.present and self.available)
            self._out += devices.to_bytes(4, "big")
            if devices:
                self._out += self._device()
                for interface in self._function.identity.interfaces:
                    self._out += _INTERFACE.pack(*interface)
        elif code == REQUEST_IMPORT:
            if len(self._in) < _OP.size + _BUS_ID_BYTES:
                return False
            bus_id = bytes(self._in[_OP.size : _OP.size + _BUS_ID_BYTES]).rstrip(b"\0")
            del self._in[: _OP.size + _BUS_ID_BYTES]
            if bus_id != self.bus_id.encode() or not self.present:
                self._out += _OP.pack(VERSION, REPLY_IMPORT, STATUS_NO_DEVICE)
            elif not self.available:
                self._out += _OP.pack(VERSION, REPLY_IMPORT, STATUS_BUSY)
            else:
                self._out += _OP.pack(VERSION, REPLY_IMPORT, STATUS_OK) + self._device()
                self.imported = True
        else:
            self.failed = f"operation {code:#06x} is unknown"
        return not self.failed

    def _device(self) -> bytes:
        identity = self._function.identity
        path = f"/sys/devices/simulated/{self.bus_id}"
        return _DEVICE.pack(
            path.encode(), self.bus_id.encode(), 1, 2, identity.speed,
            identity.vendor_id, identity.product_id, identity.release,
            0, 0, 0, 1, 1, len(identity.interfaces),
        )  # fmt: skip

    def _command(self) -> bool:
        if len(self._in) < COMMAND_BYTES:
            return False
        (command,) = struct.unpack_from(">I", self._in)
        if command == CMD_UNLINK:
            _, sequence, _, _, _, victim = _UNLINK.unpack_from(self._in)
            del self._in[:COMMAND_BYTES]
            self._unlink(sequence, victim)
            return True
        if command != CMD_SUBMIT:
            self.failed = f"command {command:#x} is unknown"
            return False
        (_, sequence, _, to_host, endpoint, _, length, _, _, _, setup) = _SUBMIT.unpack_from(
            self._in
        )
        if not 0 <= length <= MAX_TRANSFER_BYTES or endpoint > 15:
            self.failed = f"a transfer of {length} bytes on endpoint {endpoint}"
            return False
        size = COMMAND_BYTES + (0 if to_host else length)
        if len(self._in) < size:
            return False
        data = bytes(self._in[COMMAND_BYTES:size])
        del self._in[:size]
        self._newest = sequence
        if sequence in self._canceled:
            self._unlinked(self._canceled.pop(sequence), -errno.ECONNRESET)
        elif endpoint == 0:
            self._control(sequence, SetupPacket(*_SETUP.unpack(setup)), data, length, bool(to_host))
        elif to_host:
            self.polled = True
            self._waiting.setdefault(endpoint, deque()).append((sequence, length))
            self._match(endpoint)
        else:
            self._return(sequence, -errno.EPIPE)
        return True

    def _control(
        self, sequence: int, setup: SetupPacket, data: bytes, room: int, to_host: bool
    ) -> None:
        answer = self._function.control(setup, data)
        if answer is None:
            self._return(sequence, -errno.EPIPE)
        elif to_host:
            self._return(sequence, 0, answer[: min(setup.length, room)])
        else:
            self._return(sequence, 0, sent=len(data))

    def _match(self, endpoint: int) -> None:
        """Complete the waiting reads of `endpoint` with the waiting reports."""
        waiting = self._waiting.get(endpoint)
        reports = self._reports.get(endpoint)
        while waiting and reports:
            sequence, room = waiting.popleft()
            report = reports.popleft()
            if len(report) > room:
                self._return(sequence, -errno.EOVERFLOW)
            else:
                self._return(sequence, 0, report)

    def _unlink(self, sequence: int, victim: int) -> None:
        """Cancel a waiting read; an answered one needs no action.

        If both are close together, Linux's vhci-hcd may send the cancellation before the transfer.
        A reply to the cancellation before the transfer was sent sometimes makes the transfer's own
        reply an error that detaches the device; thus the cancellation is answered once the transfer
        has arrived.
        """
        if 0 < (victim - self._newest) % _SEQUENCES < _SEQUENCES // 2:
            if len(self._canceled) < MAX_CANCELED:
                self._canceled[victim] = sequence
            return
        status = 0
        for waiting in self._waiting.values():
            for entry in waiting:
                if entry[0] == victim:
                    waiting.remove(entry)
                    status = -errno.ECONNRESET
                    break
        self._unlinked(sequence, status)

    def _unlinked(self, sequence: int, status: int) -> None:
        self._out += _RET_UNLINK.pack(RET_UNLINK, sequence, 0, 0, 0, status)

    def _return(self, sequence: int, status: int, data: bytes = b"", sent: int = 0) -> None:
        actual = len(data) or sent
        self._out += _RET_SUBMIT.pack(RET_SUBMIT, sequence, 0, 0, 0, status, actual, 0, 0, 0)
        self._out += data


class _Connection(StreamClient):
    def __init__(self, sock: socket.socket, session: UsbipSession) -> None:
        super().__init__(sock)
        self.session = session


class UsbipBackend(DeviceBackend[bytes]):
    """A USB device on a TCP port, which one host at a time can attach. To attach it, as root::

    modprobe vhci-hcd
        usbip attach -r HOST -b 1-1

    Unplugging detaches it; after plugging in it has to be attached again. While the device refuses
    to be opened, hosts see it as busy.
    """

    tells_refusal = True

    def __init__(self, function: UsbFunction, host: str, port: int, bus_id: str) -> None:
        self._usb = function
        self._bus_id = bus_id
        self._plugged = False
        self.address = (host, port)
        """Listening address; port 0 until it is known."""

    @property
    def endpoint(self) -> str:
        """HOST:PORT and the bus id."""
        return f"{self.address[0]}:{self.address[1]} {self._bus_id}"

    @property
    def there(self) -> bool:
        """True if a host can see the device."""
        return self._plugged

    @property
    def attached(self) -> bool:
        """True if a host has imported the device."""
        return any(client.session.imported for client in self._server.clients)

    def open(self, shell: Shell) -> None:
        """Listen. Raises AddressError."""
        super().open(shell)
        self._server: DeviceServer[_Connection] = DeviceServer(
            shell.selector,
            MAX_CONNECTIONS,
            meet=lambda sock: _Connection(sock, UsbipSession(self._usb, self._bus_id)),
            take=self._take,
            part=lambda client: None,
        )
        listener = bound_to(
            *self.address,
            "listen",
            "; give another port, or end what uses it (usbipd)",
            socket.AF_INET,
        )
        self._server.listen_on(listener)
        self.address = listener.getsockname()[:2]

    def appear(self) -> None:
        """Let hosts see the device."""
        self._plugged = True

    def vanish(self) -> None:
        """Detach the device."""
        self._plugged = False
        for client in tuple(self._server.clients):
            if client.session.imported:
                self._server.drop(client)

    def run_due(self, now_s: float) -> None:
        """Set for every connection whether the device is present and may be imported."""
        free = not self.attached and now_s >= self.shell.refused_until_s
        for client in self._server.clients:
            client.session.present = self._plugged
            client.session.available = free

    def send(self, messages: Sequence[bytes]) -> None:
        """Send the reports to the host that has the device."""
        for client in tuple(self._server.clients):
            if client.session.imported:
                for report in messages:
                    client.session.push(self._usb.endpoint, report)
                self._flush(client)

    def close(self) -> None:
        """Detach the device, close all connections."""
        self._plugged = False
        self._server.close()

    def _take(self, client: _Connection, data: bytes) -> None:
        self.run_due(time.monotonic())
        client.session.receive(data)
        self._flush(client)
        if client.session.failed:
            self._server.drop(client)
        elif client.session.polled:
            self.shell.begin()

    def _flush(self, client: _Connection) -> None:
        client.unsent += client.session.take_output()
        self._server.flush(client)
