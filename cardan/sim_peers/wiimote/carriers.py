"""What carries the simulated remote's packets: Unix sockets, Bluetooth, or the kernel's uhid.

A carrier opens channels and passes packets on; what they mean is the remote's affair.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import select
import selectors
import socket
import struct
import time
from abc import ABC, abstractmethod
from typing import Protocol

from cardan.bounds import BLUETOOTH_ADDRESS
from cardan.errors import AddressError
from cardan.options import require
from cardan.protocols.wiimote import (
    CONTROL_PSM,
    INPUT_HEADER,
    INTERRUPT_PSM,
    NINTENDO,
    Model,
    report_descriptor,
)
from cardan.sim_peers.uhid import (
    BUS_BLUETOOTH,
    OUTPUT_REPORT,
    GetReport,
    HidIdentity,
    Output,
    SetReport,
    UhidDevice,
)
from cardan.sim_peers.unix_socket import Advice, PacketSocket

AF_BLUETOOTH = 31
"""Linux's number; a Python built without Bluetooth headers has no name for it."""
RECONNECT_S = 1.0
"""How long a remote that a host once paired takes to connect again, by itself."""
_ADVICE = Advice(
    no_socket="give another directory",
    served="end it or give another one",
    refused="give a short path that can be written",
)
_PACKET_ROOM = 4096
_BACKLOG = 8
_UCRED = struct.Struct("=3i")
_SOCKADDR_L2 = struct.Struct("<HH6sHBx")


class Remote(Protocol):
    """What a carrier tells."""

    def connected(self) -> bool:
        """A host has opened both channels. False: the remote does not answer."""

    def disconnected(self) -> None:
        """The host has closed a channel."""

    def interrupt(self, packet: bytes) -> None:
        """A packet on the interrupt channel, header first."""

    def control(self, packet: bytes) -> bytes:
        """A packet on the control channel, header first; the answer there, if any."""

    def output(self, report: bytes) -> None:
        """An output report, id first, from a carrier without channels."""

    def set_report(self, report: bytes) -> bool:
        """The same, as if on the control channel; False: refused."""


class Carrier(ABC):
    """One way to reach the remote. `control_up` and `interrupt_up`: that channel is open."""

    control_up = False
    interrupt_up = False
    lost_reports = 0
    """Reports that the host had no room for."""

    @property
    @abstractmethod
    def endpoint(self) -> str:
        """What hosts connect to."""

    @abstractmethod
    def open(self, selector: selectors.BaseSelector, remote: Remote) -> None:
        """Take what is needed. Raises AddressError or DeviceAccessError."""

    @abstractmethod
    def appear(self) -> None:
        """The remote can be reached from now on; again is fine."""

    @abstractmethod
    def vanish(self) -> None:
        """It cannot be reached any more; channels that are open stay so."""

    @abstractmethod
    def send(self, report: bytes) -> None:
        """Send an input report, id first."""

    @abstractmethod
    def hang_up(self, *, control: bool, interrupt: bool) -> None:
        """Close these channels."""

    @abstractmethod
    def close(self) -> None:
        """Let go of everything. Never raises."""


class ChannelCarrier(Carrier):
    """Two listening sockets with packets; control first, as a host does."""

    def __init__(self) -> None:
        self._selector: selectors.BaseSelector | None = None
        self._remote: Remote | None = None
        self._listeners: dict[int, socket.socket] = {}
        self._channels: dict[int, socket.socket] = {}

    @property
    def control_up(self) -> bool:  # type: ignore[override]
        return CONTROL_PSM in self._channels

    @property
    def interrupt_up(self) -> bool:  # type: ignore[override]
        return INTERRUPT_PSM in self._channels

    @abstractmethod
    def _bind(self, psm: int) -> socket.socket:
        """A bound socket for this channel. Raises AddressError."""

    def _unbind(self, psm: int) -> None:
        """The socket of this channel was closed."""

    def open(self, selector: selectors.BaseSelector, remote: Remote) -> None:
        self._selector, self._remote = selector, remote

    def appear(self) -> None:
        if self._listeners:
            return
        assert self._selector is not None
        try:
            for psm in (CONTROL_PSM, INTERRUPT_PSM):
                listener = self._listeners[psm] = self._bind(psm)
                listener.setblocking(False)
                listener.listen(_BACKLOG)
                self._selector.register(listener, selectors.EVENT_READ, self._accept)
        except BaseException:
            self.vanish()
            raise

    def vanish(self) -> None:
        for psm, listener in tuple(self._listeners.items()):
            self._forget(listener)
            self._unbind(psm)
        self._listeners.clear()

    def send(self, report: bytes) -> None:
        channel = self._channels.get(INTERRUPT_PSM)
        if channel is None:
            return
        try:
            channel.send(bytes((INPUT_HEADER,)) + report)
        except BlockingIOError:
            self.lost_reports += 1
        except OSError:
            self._lose()

    def hang_up(self, *, control: bool, interrupt: bool) -> None:
        for psm, wanted in ((INTERRUPT_PSM, interrupt), (CONTROL_PSM, control)):
            channel = self._channels.pop(psm, None) if wanted else None
            if channel is not None:
                self._forget(channel)

    def close(self) -> None:
        self.hang_up(control=True, interrupt=True)
        self.vanish()

    def _accept(self) -> None:
        """Somebody connects.

        Several hosts may have come and gone since the last time. An interrupt channel is taken
        out before the control channels: its own is then among those that have come.
        """
        assert self._remote is not None
        interrupts = self._waiting(INTERRUPT_PSM, 1)
        controls = self._waiting(CONTROL_PSM, _BACKLOG)
        self._settle()
        if not self.interrupt_up:
            if controls:
                # A host that opened no more than this channel gives way to the next one.
                self.hang_up(control=True, interrupt=False)
                own = [c for c in controls if interrupts and _host(c) == _host(interrupts[0])]
                newest = (own or controls)[-1]
                controls.remove(newest)
                self._take(CONTROL_PSM, newest)
            if interrupts and self.control_up:
                self._take(INTERRUPT_PSM, interrupts.pop())
                if not self._remote.connected():
                    self.hang_up(control=True, interrupt=True)
        for channel in (*controls, *interrupts):
            channel.close()  # it has a host, or the order is wrong

    def _next(self, listener: socket.socket) -> socket.socket:
        """A channel that waits to be accepted. Raises OSError when none does."""
        return listener.accept()[0]

    def _waiting(self, psm: int, most: int) -> list[socket.socket]:
        """Channels that wait to be accepted and have not been closed again."""
        channels: list[socket.socket] = []
        with contextlib.suppress(OSError):
            while psm in self._listeners and len(channels) < most:
                channel = self._next(self._listeners[psm])
                if _hung_up(channel):
                    channel.close()
                else:
                    channels.append(channel)
        return channels

    def _take(self, psm: int, channel: socket.socket) -> None:
        assert self._selector is not None
        channel.setblocking(False)
        self._channels[psm] = channel
        self._selector.register(channel, selectors.EVENT_READ, lambda: self._receive(psm, channel))

    def _receive(self, psm: int, channel: socket.socket) -> None:
        assert self._remote is not None
        if self._channels.get(psm) is not channel:
            return
        try:
            packet = channel.recv(_PACKET_ROOM)
        except BlockingIOError:
            return
        except OSError:
            packet = b""
        if not packet:
            self._lose()
        elif psm == INTERRUPT_PSM:
            self._remote.interrupt(packet)
        elif answer := self._remote.control(packet):
            with contextlib.suppress(OSError):
                channel.send(answer)

    def _settle(self) -> None:
        """Serve a host that has hung up to its end, so that the next one finds the line free."""
        for psm, channel in tuple(self._channels.items()):
            while self.interrupt_up and self._channels.get(psm) is channel and _hung_up(channel):
                self._receive(psm, channel)

    def _lose(self) -> None:
        """The host closed a channel, which ends both."""
        assert self._remote is not None
        self._hear_out()
        self.hang_up(control=True, interrupt=True)
        self._remote.disconnected()

    def _hear_out(self) -> None:
        """Take what the host sent before it closed: its last words stop the motor."""
        assert self._remote is not None
        channel = self._channels.get(INTERRUPT_PSM)
        with contextlib.suppress(OSError):
            while channel is not None and (packet := channel.recv(_PACKET_ROOM)):
                self._remote.interrupt(packet)

    def _forget(self, sock: socket.socket) -> None:
        if self._selector is not None and sock in self._selector.get_map():
            self._selector.unregister(sock)
        sock.close()


class UnixChannels(ChannelCarrier):
    """Sockets (AF_UNIX, SOCK_SEQPACKET) `psm11` and `psm13` in a directory."""

    def __init__(self, directory: str) -> None:
        super().__init__()
        self._directory = directory
        self._made_directory = False
        self._sockets: dict[int, PacketSocket] = {}

    @property
    def endpoint(self) -> str:
        return self._directory

    def open(self, selector: selectors.BaseSelector, remote: Remote) -> None:
        super().open(selector, remote)
        try:
            os.mkdir(self._directory)
            self._made_directory = True
        except FileExistsError:
            if not os.path.isdir(self._directory):
                raise AddressError(
                    f"{self._directory!r} exists and is not a directory; give another one"
                ) from None
        except OSError as error:
            raise AddressError(
                f"cannot make the directory {self._directory!r}: {error.strerror or error}"
            ) from None

    def _bind(self, psm: int) -> socket.socket:
        path = os.path.join(self._directory, f"psm{psm:x}")
        self._sockets[psm] = PacketSocket(path, _ADVICE)
        return self._sockets[psm].sock

    def _unbind(self, psm: int) -> None:
        self._sockets.pop(psm).close()

    def close(self) -> None:
        super().close()
        if self._made_directory:
            self._made_directory = False
            with contextlib.suppress(OSError):
                os.rmdir(self._directory)


class BluetoothChannels(ChannelCarrier):
    """L2CAP sockets of a Bluetooth adapter, given by its address; all zeros: any."""

    def __init__(self, adapter: str) -> None:
        super().__init__()
        self._adapter = adapter
        self._bdaddr = parse_address(adapter)

    @property
    def endpoint(self) -> str:
        return f"bluetooth {self._adapter}"

    def _bind(self, psm: int) -> socket.socket:
        try:
            listener = socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, 0)
        except OSError as error:
            raise AddressError(f"this system has no Bluetooth: {error.strerror or error}") from None
        # By libc: Python knows how to write these addresses only if it was built with Bluetooth.
        libc = ctypes.CDLL(None, use_errno=True)
        address = sockaddr_l2(self._bdaddr, psm)
        if libc.bind(listener.fileno(), address, len(address)) != 0:
            number = ctypes.get_errno()
            listener.close()
            hint = {
                errno.EACCES: "; run this as root",
                errno.EADDRINUSE: "; bluetoothd holds it: start that with --noplugin=input",
                errno.EADDRNOTAVAIL: "; `hciconfig` lists the adapters and their addresses",
            }.get(number, "")
            raise AddressError(
                f"cannot take PSM {psm:#x} of the adapter {self._adapter}: "
                f"{os.strerror(number)}{hint}"
            )
        return listener

    def _next(self, listener: socket.socket) -> socket.socket:
        # By libc, too: a Python without Bluetooth refuses the address that accept() gives.
        libc = ctypes.CDLL(None, use_errno=True)
        number = libc.accept4(listener.fileno(), None, None, socket.SOCK_CLOEXEC)
        if number < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        return socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, 0, number)


class UhidCarrier(Carrier):
    """A HID device that the Linux kernel takes for a remote connected over Bluetooth."""

    def __init__(self, model: Model, address: str, device: UhidDevice | None = None) -> None:
        parse_address(address)
        self._identity = HidIdentity(
            name=model.bluetooth_name,
            bus=BUS_BLUETOOTH,
            vendor_id=NINTENDO,
            product_id=model.product_id,
            descriptor=report_descriptor(),
            serial=address.lower(),
        )
        self._address = address
        self._device = device or UhidDevice()
        self._again_s = 0.0
        self._selector: selectors.BaseSelector | None = None
        self._remote: Remote | None = None

    @property
    def endpoint(self) -> str:
        return f"uhid {self._address}"

    def open(self, selector: selectors.BaseSelector, remote: Remote) -> None:
        self._device.open()
        self._selector, self._remote = selector, remote
        selector.register(self._device.fileno(), selectors.EVENT_READ, self._receive)

    def appear(self) -> None:
        # No host need do anything: the kernel is the host, and the link is up with the device.
        assert self._remote is not None
        if self.interrupt_up or time.monotonic() < self._again_s:
            return
        if self._remote.connected():
            self._device.plug(self._identity)
            self.control_up = self.interrupt_up = True

    def vanish(self) -> None:
        """Whether it can be reached matters only for the next device."""

    def send(self, report: bytes) -> None:
        if self.interrupt_up:
            self._device.send(report)

    def hang_up(self, *, control: bool, interrupt: bool) -> None:
        # The kernel drops a HID device when either channel closes.
        if self.interrupt_up and (control or interrupt):
            self.control_up = self.interrupt_up = False
            self._again_s = time.monotonic() + RECONNECT_S
            with contextlib.suppress(OSError):
                self._device.unplug()
            assert self._remote is not None
            self._remote.disconnected()

    def close(self) -> None:
        if self._selector is not None:
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(self._device.fileno())
        self.control_up = self.interrupt_up = False
        self._device.close()

    def _receive(self) -> None:
        assert self._remote is not None
        while (event := self._device.read()) is not None:
            if isinstance(event, Output):
                self._remote.output(event.data)
            elif isinstance(event, SetReport):
                taken = event.report_type == OUTPUT_REPORT and self._remote.set_report(event.data)
                self._device.reply_to(event, 0 if taken else errno.EIO)
            elif isinstance(event, GetReport):
                self._device.reply_to(event, errno.EIO)


def _host(channel: socket.socket) -> object:
    """Tells hosts apart: by process on Unix sockets, by address on others."""
    if channel.family == socket.AF_UNIX and hasattr(socket, "SO_PEERCRED"):
        return channel.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)[:4]
    try:
        return channel.getpeername()
    except OSError:
        return None


def _hung_up(channel: socket.socket) -> bool:
    poller = select.poll()
    poller.register(channel, select.POLLIN)
    return any(event & (select.POLLHUP | select.POLLERR) for _, event in poller.poll(0))


def parse_address(text: str) -> bytes:
    """A Bluetooth address as it is on the wire: last printed octet first. Raises OptionError."""
    require(text in BLUETOOTH_ADDRESS, "address", text, str(BLUETOOTH_ADDRESS))
    return bytes.fromhex(text.replace(":", ""))[::-1]


def sockaddr_l2(bdaddr: bytes, psm: int) -> bytes:
    """Linux's struct sockaddr_l2 for a wire-order address."""
    family = struct.pack("=H", AF_BLUETOOTH)
    return family + _SOCKADDR_L2.pack(0, psm, bdaddr, 0, 0)[2:]
