"""Transports of a simulated input device's events: a Unix socket, or the kernel's uinput."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import selectors
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from cardan.common.sockets import OWNER_ONLY
from cardan.errors import AddressError
from cardan.protocols.evdev.events import (
    EV_ABS,
    EV_FF,
    EV_KEY,
    EV_MSC,
    EV_REP,
    EV_SYN,
    EV_UINPUT,
    EVENT_BYTES,
    MSC_SCAN,
    SYN_DROPPED,
    SYN_REPORT,
    InputEvent,
    MalformedPacket,
    decode_events,
    encode_events,
)
from cardan.protocols.evdev.requests import decode_call, encode_call
from cardan.protocols.evdev.uinput import (
    SYSNAME_BYTES,
    UI_ABS_SETUP,
    UI_BEGIN_FF_ERASE,
    UI_BEGIN_FF_UPLOAD,
    UI_DEV_CREATE,
    UI_DEV_DESTROY,
    UI_DEV_SETUP,
    UI_END_FF_ERASE,
    UI_END_FF_UPLOAD,
    UI_FF_ERASE,
    UI_FF_UPLOAD,
    UI_GET_SYSNAME,
    UI_SET_ABSBIT,
    UI_SET_EVBIT,
    UI_SET_FFBIT,
    UI_SET_KEYBIT,
    UI_SET_MSCBIT,
    begin_upload,
    decode_erase,
    decode_upload,
    encode_abs_setup,
    encode_erase,
    encode_setup,
    end_upload,
)
from cardan.sim_peers.backends.base import DeviceBackend
from cardan.sim_peers.backends.server import PacketClient
from cardan.sim_peers.backends.unix_socket import PacketBackend
from cardan.sim_peers.base import strikes
from cardan.sim_peers.evdev.core import EFFECTS, InputEvents, SimulatedInput

if sys.platform != "win32":
    import fcntl

QUEUE_EVENTS = 64
"""Most events the kernel keeps for a program that does not read; with one more all are dropped."""
_ROOM = 4096


class _Client(PacketClient):
    """A client with the kernel's queue for it."""

    def send(self, events: Sequence[InputEvent]) -> None:
        """Queue a frame; a full queue is dropped whole, as the kernel does."""
        queued = sum(len(packet) // EVENT_BYTES for packet in self._queue)
        if queued + len(events) > QUEUE_EVENTS:
            self._queue.clear()
            self.lost += 1
            events = [events[0]._replace(type=EV_SYN, code=SYN_DROPPED, value=0), events[-1]]
        self.send_bytes(encode_events(events))

    def send_bytes(self, packet: bytes) -> None:
        """Queue a packet with any content."""
        self._queue.append(packet)


class EventSocket(PacketBackend[InputEvents, _Client]):
    """Socket in place of a node of /dev/input: a packet is a read or a write.

    A packet that is not of whole events is an ioctl request or its answer.
    """

    def __init__(
        self,
        path: str,
        device: SimulatedInput,
        faults: Mapping[str, float],
        seed: int,
        mode: int = OWNER_ONLY,
    ) -> None:
        super().__init__(path, mode)
        self._device = device
        self._faults = faults
        self._random = random.Random(seed)
        self._frames = 0

    def send(self, messages: Sequence[InputEvents]) -> None:
        """Send a packet per frame to all clients, or to the one that has grabbed the device."""
        # The kernel stamps events with the wall clock unless a program asks for another.
        offset_s = time.time() - self.shell.device_s()
        for frame in messages:
            self._frames += 1
            events = frame.stamped(offset_s)
            if self._strikes("dropped"):
                events = [
                    events[0]._replace(type=EV_SYN, code=SYN_DROPPED, value=0),
                    events[0]._replace(type=EV_SYN, code=SYN_REPORT, value=0),
                ]
            for client in self.clients:
                if self._device.grabbed_by not in (None, client):
                    continue
                if self._strikes("garbage"):
                    client.send_bytes(self._random.randbytes(self._random.randint(1, 90)))
                if self._strikes("short"):
                    client.send_bytes(encode_events(events)[: -self._random.randint(1, 23)])
                else:
                    client.send(events)
        self._flush()

    def _strikes(self, fault: str) -> bool:
        return strikes(self._faults, fault, self._frames)

    def _meet(self, sock: socket.socket) -> _Client:
        return _Client(sock)

    def _take(self, client: _Client, packet: bytes) -> None:
        """Handle a packet that the client wrote: events or a request."""
        now_s = self.shell.device_s()
        if len(packet) % EVENT_BYTES == 0:
            self._device.write(client, packet, now_s)
        else:
            call = decode_call(packet)
            if isinstance(call, MalformedPacket):
                self._device.refused += 1
            else:
                answer = self._device.call(client, call.request, call.argument, now_s)
                client.send_bytes(encode_call(answer))

    def _part(self, client: _Client) -> None:
        super()._part(client)
        self._device.gone(client)


class UinputBackend(DeviceBackend[InputEvents]):
    """Device of the kernel's uinput: a node of /dev/input with the full behavior of the kernel.

    `root`: parent folder of /dev and /sys.
    """

    awaits_program = False

    def __init__(self, device: SimulatedInput, root: Path = Path("/")) -> None:
        self._device = device
        self._root = root
        self._fd: int | None = None
        self._node = ""

    @property
    def endpoint(self) -> str:
        """The node's path."""
        return self._node

    @property
    def there(self) -> bool:
        """True if the node exists."""
        return self._fd is not None

    def appear(self) -> None:
        """Make the device."""
        path = self._root / "dev/uinput"
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            self._make(self._fd)
        except OSError as error:
            if self._fd is not None:
                os.close(self._fd)
                self._fd = None
            raise AddressError(
                f"cannot make an input device by {path}: {error.strerror or error}; "
                "load the module (sudo modprobe uinput) and let this user write to it"
            ) from None
        self.shell.selector.register(self._fd, selectors.EVENT_READ, self._serve)

    def vanish(self) -> None:
        """Destroy the device."""
        fd, self._fd = self._fd, None
        if fd is not None:
            self.shell.selector.unregister(fd)
            with contextlib.suppress(OSError):
                fcntl.ioctl(fd, UI_DEV_DESTROY)
            os.close(fd)

    def send(self, messages: Sequence[InputEvents]) -> None:
        """Write once per frame; the kernel adds its own time."""
        assert self._fd is not None
        for frame in messages:
            events = [InputEvent(0, 0, *event) for event in frame.events]
            os.write(self._fd, encode_events(events))

    def _make(self, fd: int) -> None:
        model = self._device.model
        kinds = {EV_KEY, *([EV_ABS] if model.axes else []), *([EV_FF] if model.effects else [])}
        if model.repeats:
            kinds |= {EV_MSC, EV_REP}
            fcntl.ioctl(fd, UI_SET_MSCBIT, MSC_SCAN)
        for kind in sorted(kinds):
            fcntl.ioctl(fd, UI_SET_EVBIT, kind)
        for code in model.codes.values():
            fcntl.ioctl(fd, UI_SET_KEYBIT, code)
        for effect in sorted(model.effects):
            fcntl.ioctl(fd, UI_SET_FFBIT, effect)
        for code, info in model.axes.items():
            fcntl.ioctl(fd, UI_SET_ABSBIT, code)
            fcntl.ioctl(fd, UI_ABS_SETUP, encode_abs_setup(code, info))
        effects = EFFECTS if model.effects else 0
        fcntl.ioctl(fd, UI_DEV_SETUP, encode_setup(model.id, model.name, effects))
        fcntl.ioctl(fd, UI_DEV_CREATE)
        self._node = self._find_node(fd)

    def _find_node(self, fd: int) -> str:
        name = bytearray(SYSNAME_BYTES)
        fcntl.ioctl(fd, UI_GET_SYSNAME, name, True)
        folder = self._root / "sys/devices/virtual/input" / name.split(b"\0", 1)[0].decode()
        nodes = sorted(entry.name for entry in folder.glob("event*"))
        if not nodes:
            raise OSError(errno.ENODEV, "the kernel made no node for it")
        return f"/dev/input/{nodes[0]}"

    def _serve(self) -> None:
        """Handle clients' requests for the motors or an LED from the kernel."""
        fd = self._fd
        if fd is None:
            return
        try:
            events = decode_events(os.read(fd, _ROOM // EVENT_BYTES * EVENT_BYTES))
        except OSError:
            return
        if isinstance(events, MalformedPacket):
            return
        for event in events:
            if event.type == EV_UINPUT and event.code == UI_FF_UPLOAD:
                self._upload(fd, event.value)
            elif event.type == EV_UINPUT and event.code == UI_FF_ERASE:
                self._erase(fd, event.value)
            elif event.type == EV_FF:
                self._device.play(event.code, self.shell.device_s(), on=event.value > 0)

    def _upload(self, fd: int, request_id: int) -> None:
        argument = bytearray(begin_upload(request_id & 0xFFFFFFFF))
        fcntl.ioctl(fd, UI_BEGIN_FF_UPLOAD, argument, True)
        effect = decode_upload(bytes(argument)).effect
        if effect is not None:
            self._device.take_effect(effect, self.shell.device_s())
        result = 0 if effect is not None else -errno.EINVAL
        fcntl.ioctl(fd, UI_END_FF_UPLOAD, end_upload(bytes(argument), result))

    def _erase(self, fd: int, request_id: int) -> None:
        argument = bytearray(encode_erase(request_id & 0xFFFFFFFF))
        fcntl.ioctl(fd, UI_BEGIN_FF_ERASE, argument, True)
        self._device.erase(decode_erase(bytes(argument)))
        fcntl.ioctl(fd, UI_END_FF_ERASE, bytes(argument))
