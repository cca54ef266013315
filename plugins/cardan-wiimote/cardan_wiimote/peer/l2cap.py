"""The two L2CAP channels of a Bluetooth HID device, real ones or on Unix sockets.

A backend opens channels and forwards packets; the remote interprets them.
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
from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

from cardan.common.options import require
from cardan.common.sockets import OWNER_ONLY, Advice, UnixSocket
from cardan.errors import AddressError
from cardan.sim_peers.backends.base import DeviceBackend, Shell
from cardan_wiimote.address import BLUETOOTH_ADDRESS
from cardan_wiimote.protocol import CONTROL_PSM, INPUT_HEADER, INTERRUPT_PSM

AF_BLUETOOTH = 31
"""Linux's number; a Python built without Bluetooth headers has no constant for it."""
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
    """A simulated device with two channels; times are s from the script's start."""

    @property
    def connected(self) -> bool:
        """True if the remote is connected to a host."""

    @property
    def control_open(self) -> bool:
        """True if the remote keeps the control channel open."""

    @property
    def interrupt_open(self) -> bool:
        """True if the remote keeps the interrupt channel open."""

    def connect(self, now_s: float) -> bool:
        """Connect a host, which has opened both channels; return False if the remote does not
        answer."""

    def disconnect(self, now_s: float) -> None:
        """Handle a channel closed by the host."""

    def interrupt(self, packet: bytes, now_s: float) -> None:
        """Handle a packet of the interrupt channel, header first."""

    def control(self, packet: bytes, now_s: float) -> bytes:
        """Handle a packet of the control channel, header first; return the reply there, if any."""


class ChannelBackend(DeviceBackend[bytes]):
    """Two listening sockets with packets; a host opens the control channel first.

    Hosts are served one at a time. The reports that it sends are input reports, id first.
    """

    def __init__(self, remote: Remote) -> None:
        self._remote = remote
        self._listeners: dict[int, socket.socket] = {}
        self._channels: dict[int, socket.socket] = {}
        self.lost = 0
        """Number of reports dropped because the host had no room for them."""

    @property
    def there(self) -> bool:
        """True if hosts can connect."""
        return bool(self._listeners)

    @property
    def _control_up(self) -> bool:
        return CONTROL_PSM in self._channels

    @property
    def _interrupt_up(self) -> bool:
        return INTERRUPT_PSM in self._channels

    @abstractmethod
    def _bind(self, psm: int) -> socket.socket:
        """Return a bound socket for this channel. Raises AddressError."""

    def _unbind(self, psm: int) -> None:
        """Handle the closing of this channel's socket."""

    def appear(self) -> None:
        """Listen. Raises AddressError."""
        try:
            for psm in (CONTROL_PSM, INTERRUPT_PSM):
                listener = self._listeners[psm] = self._bind(psm)
                listener.setblocking(False)
                listener.listen(_BACKLOG)
                self.shell.selector.register(listener, selectors.EVENT_READ, self._accept)
        except BaseException:
            self.vanish()
            raise

    def vanish(self) -> None:
        """Stop listening; open channels stay open."""
        for psm, listener in tuple(self._listeners.items()):
            self._forget(listener)
            self._unbind(psm)
        self._listeners.clear()

    def send(self, messages: Sequence[bytes]) -> None:
        """Send input reports on the interrupt channel."""
        for report in messages:
            channel = self._channels.get(INTERRUPT_PSM)
            if channel is None:
                return
            try:
                channel.send(bytes((INPUT_HEADER,)) + report)
            except BlockingIOError:
                self.lost += 1
            except OSError:
                self._lose()

    def run_due(self, now_s: float) -> None:
        """Close channels as the remote does."""
        remote = self._remote
        if self._interrupt_up or (self._control_up and remote.connected):
            self._hang_up(control=not remote.control_open, interrupt=not remote.interrupt_open)
        if not (self.there or remote.connected):
            self._hang_up()

    def close(self) -> None:
        """Close every channel."""
        self._hang_up()
        self.vanish()
        self._remote.disconnect(self.shell.device_s())

    def _hang_up(self, *, control: bool = True, interrupt: bool = True) -> None:
        """Close these channels."""
        for psm, wanted in ((INTERRUPT_PSM, interrupt), (CONTROL_PSM, control)):
            channel = self._channels.pop(psm, None) if wanted else None
            if channel is not None:
                self._forget(channel)

    def _accept(self) -> None:
        """Accept a host.

        Several hosts may have connected and left since the last call. An interrupt channel is
        accepted before the control channels: its own is then among these, or its host has left
        since.
        """
        interrupts = self._waiting(INTERRUPT_PSM, 1)
        controls = self._waiting(CONTROL_PSM, _BACKLOG)
        if interrupts and _hung_up(interrupts[0]):
            interrupts.pop().close()
        self._settle()
        if not self._interrupt_up:
            if controls:
                # A host with only this channel yields to the next one.
                self._hang_up(interrupt=False)
                own = [c for c in controls if interrupts and _host(c) == _host(interrupts[0])]
                newest = (own or controls)[-1]
                controls.remove(newest)
                self._take(CONTROL_PSM, newest)
            if interrupts and self._control_up:
                self._take(INTERRUPT_PSM, interrupts.pop())
                self.shell.begin()
                if not self._remote.connect(self.shell.device_s()):
                    self._hang_up()
        for channel in (*controls, *interrupts):
            channel.close()  # It has a host, or the order is wrong.

    def _next(self, listener: socket.socket) -> socket.socket:
        """Return a channel that waits to be accepted. Raises OSError if none does."""
        return listener.accept()[0]

    def _waiting(self, psm: int, most: int) -> list[socket.socket]:
        """Return channels that wait to be accepted and have not been closed again."""
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
        channel.setblocking(False)
        self._channels[psm] = channel
        self.shell.selector.register(
            channel, selectors.EVENT_READ, lambda: self._receive(psm, channel)
        )

    def _receive(self, psm: int, channel: socket.socket) -> None:
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
            self._remote.interrupt(packet, self.shell.device_s())
        elif answer := self._remote.control(packet, self.shell.device_s()):
            with contextlib.suppress(OSError):
                channel.send(answer)

    def _settle(self) -> None:
        """Process all that a host sent before it hung up, so that the next one can connect."""
        for psm, channel in tuple(self._channels.items()):
            while self._interrupt_up and self._channels.get(psm) is channel and _hung_up(channel):
                self._receive(psm, channel)

    def _lose(self) -> None:
        """Handle a channel closed by the host, which ends both."""
        self._process_pending()
        self._hang_up()
        self._remote.disconnect(self.shell.device_s())

    def _process_pending(self) -> None:
        """Process the host's data from before it closed: its last command stops the motor."""
        channel = self._channels.get(INTERRUPT_PSM)
        with contextlib.suppress(OSError):
            while channel is not None and (packet := channel.recv(_PACKET_ROOM)):
                self._remote.interrupt(packet, self.shell.device_s())

    def _forget(self, sock: socket.socket) -> None:
        selector = self.shell.selector
        if sock in selector.get_map():
            selector.unregister(sock)
        sock.close()


class UnixChannels(ChannelBackend):
    """Unix sockets (SOCK_SEQPACKET) `psm11` and `psm13` in a directory."""

    def __init__(self, remote: Remote, directory: str, mode: int = OWNER_ONLY) -> None:
        super().__init__(remote)
        self._directory = directory
        self._mode = mode
        self._made_directory = False
        self._sockets: dict[int, UnixSocket] = {}

    @property
    def endpoint(self) -> str:
        """Directory of the sockets."""
        return self._directory

    def open(self, shell: Shell) -> None:
        """Make the directory. Raises AddressError."""
        super().open(shell)
        try:
            os.mkdir(self._directory, 0o700)
            self._made_directory = True
            if self._mode != OWNER_ONLY:
                os.chmod(self._directory, 0o755)
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
        self._sockets[psm] = UnixSocket(path, socket.SOCK_SEQPACKET, self._mode, _ADVICE)
        return self._sockets[psm].sock

    def _unbind(self, psm: int) -> None:
        self._sockets.pop(psm).close()

    def close(self) -> None:
        """Close every channel; remove the sockets, and their folder if it was made here."""
        super().close()
        if self._made_directory:
            self._made_directory = False
            with contextlib.suppress(OSError):
                os.rmdir(self._directory)


class BluetoothChannels(ChannelBackend):
    """L2CAP sockets of a Bluetooth adapter with this address; all zeros: any."""

    def __init__(self, remote: Remote, adapter: str) -> None:
        super().__init__(remote)
        self._adapter = adapter
        self._bdaddr = parse_address(adapter)

    @property
    def endpoint(self) -> str:
        """Address of the adapter."""
        return f"bluetooth {self._adapter}"

    def _bind(self, psm: int) -> socket.socket:
        try:
            listener = socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, 0)
        except OSError as error:
            raise AddressError(f"this system has no Bluetooth: {error.strerror or error}") from None
        # By libc: Python can encode these addresses only if it was built with Bluetooth.
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
        # By libc too: a Python without Bluetooth rejects the address from accept().
        libc = ctypes.CDLL(None, use_errno=True)
        number = libc.accept4(listener.fileno(), None, None, socket.SOCK_CLOEXEC)
        if number < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        return socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, 0, number)


def _host(channel: socket.socket) -> object:
    """Distinguish hosts: by process on Unix sockets, by address on others."""
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
    """Return a Bluetooth address in wire order: last printed octet first. Raises OptionError."""
    require(text in BLUETOOTH_ADDRESS, "address", text, str(BLUETOOTH_ADDRESS))
    return bytes.fromhex(text.replace(":", ""))[::-1]


def sockaddr_l2(bdaddr: bytes, psm: int) -> bytes:
    """Return Linux's struct sockaddr_l2 for a wire-order address."""
    family = struct.pack("=H", AF_BLUETOOTH)
    return family + _SOCKADDR_L2.pack(0, psm, bdaddr, 0, 0)[2:]
