"""Virtual HID devices of the Linux kernel, through /dev/uhid.

A program that writes to /dev/uhid is the hardware: the kernel binds its HID drivers to it and
makes hidraw and evdev nodes. The device is gone when its file is closed. The codec below does no
I/O; :class:`UhidDevice` is the file, :class:`UhidBackend` serves a simulated device by it. Source:
Linux, include/uapi/linux/uhid.h and Documentation/hid/uhid.rst. All numbers are in the machine's
byte order, without padding.
"""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from cardan.errors import DeviceAccessError
from cardan.sim_peers.backends.base import DeviceBackend, Shell

UHID_PATH = "/dev/uhid"

BUS_USB = 0x03
BUS_BLUETOOTH = 0x05

DATA_MAX = 4096
"""Bytes that a report or a report descriptor may have."""

EVENT_BYTES = 4 + 128 + 64 + 64 + 2 + 2 + 4 * 4 + DATA_MAX
"""Size of struct uhid_event, which every read gives."""

_DESTROY, _START, _STOP, _OPEN, _CLOSE, _OUTPUT = 1, 2, 3, 4, 5, 6
_GET_REPORT, _GET_REPORT_REPLY, _CREATE2, _INPUT2, _SET_REPORT, _SET_REPORT_REPLY = range(9, 15)

_TYPE = struct.Struct("=I")
_CREATE = struct.Struct("=I128s64s64sHHIIII")
_INPUT = struct.Struct("=IH")
_FLAGS = struct.Struct("=Q")
_OUTPUT_TAIL = struct.Struct("=HB")
_GET = struct.Struct("=IBB")
_GET_REPLY = struct.Struct("=IIHH")
_SET = struct.Struct("=IBBH")
_SET_REPLY = struct.Struct("=IIH")

FEATURE_REPORT, OUTPUT_REPORT, INPUT_REPORT = 0, 1, 2
"""Types of reports in events."""


class HidIdentity(NamedTuple):
    """Identity of a HID device for the kernel."""

    name: str
    """At most 127 bytes, as `physical_path`, `serial`: 63."""
    bus: int
    vendor_id: int
    product_id: int
    descriptor: bytes
    """The report descriptor."""
    physical_path: str = ""
    serial: str = ""
    version: int = 0
    country: int = 0


class Start(NamedTuple):
    """The kernel has taken the device; the flags say which report types are numbered."""

    flags: int


class Stop(NamedTuple):
    """The kernel has stopped using the device."""


class Open(NamedTuple):
    """The first program opened the device."""


class Close(NamedTuple):
    """The last program closed the device."""


class Output(NamedTuple):
    """An output (or feature) report for the device, its id first if it has one."""

    report_type: int
    data: bytes


class GetReport(NamedTuple):
    """A program waits for a report; answer with `encode_get_report_reply` within 5 s."""

    request_id: int
    report_id: int
    report_type: int


class SetReport(NamedTuple):
    """A program waits for a report to be taken; answer with `encode_set_report_reply`."""

    request_id: int
    report_id: int
    report_type: int
    data: bytes


class MalformedEvent(NamedTuple):
    """Bytes that are not an event of the kernel."""

    reason: str


Event = Start | Stop | Open | Close | Output | GetReport | SetReport | MalformedEvent


def encode_create(identity: HidIdentity) -> bytes:
    """Encode UHID_CREATE2. Raises ValueError for a value that does not fit."""
    texts = []
    for field, room in (("name", 128), ("physical_path", 64), ("serial", 64)):
        text = getattr(identity, field).encode()
        if len(text) >= room:
            raise ValueError(f"{field} has {len(text)} bytes; allowed: at most {room - 1}")
        texts.append(text)
    if not 0 < len(identity.descriptor) <= DATA_MAX:
        raise ValueError(
            f"descriptor has {len(identity.descriptor)} bytes; allowed: 1 to {DATA_MAX}"
        )
    head = _CREATE.pack(
        _CREATE2, *texts, len(identity.descriptor), identity.bus, identity.vendor_id,
        identity.product_id, identity.version, identity.country,
    )  # fmt: skip
    return head + identity.descriptor


def encode_destroy() -> bytes:
    """Encode UHID_DESTROY: unplug."""
    return _TYPE.pack(_DESTROY)


def encode_input(report: bytes) -> bytes:
    """Encode UHID_INPUT2: an input report, its id first if any. Raises ValueError if too long."""
    if len(report) > DATA_MAX:
        raise ValueError(f"a report of {len(report)} bytes; allowed: at most {DATA_MAX}")
    return _INPUT.pack(_INPUT2, len(report)) + report


def encode_get_report_reply(request_id: int, error: int, report: bytes = b"") -> bytes:
    """Encode UHID_GET_REPORT_REPLY; `error` is an errno, 0 for none."""
    if len(report) > DATA_MAX:
        raise ValueError(f"a report of {len(report)} bytes; allowed: at most {DATA_MAX}")
    return _GET_REPLY.pack(_GET_REPORT_REPLY, request_id, error, len(report)) + report


def encode_set_report_reply(request_id: int, error: int) -> bytes:
    """Encode UHID_SET_REPORT_REPLY; `error` is an errno, 0 for none."""
    return _SET_REPLY.pack(_SET_REPORT_REPLY, request_id, error)


def decode_event(data: bytes) -> Event:
    """Decode the data of one read of the file. Never raises."""
    if len(data) < _TYPE.size:
        return MalformedEvent(f"{len(data)} bytes, shorter than a type")
    (kind,) = _TYPE.unpack_from(data)
    body = data[_TYPE.size :]
    try:
        return _decode(kind, body)
    except struct.error:
        return MalformedEvent(f"type {kind} with only {len(body)} bytes")


def _decode(kind: int, body: bytes) -> Event:
    if kind == _START:
        return Start(*_FLAGS.unpack_from(body))
    if kind == _STOP:
        return Stop()
    if kind == _OPEN:
        return Open()
    if kind == _CLOSE:
        return Close()
    if kind == _OUTPUT:
        size, report_type = _OUTPUT_TAIL.unpack_from(body, DATA_MAX)
        if size > DATA_MAX:
            return MalformedEvent(f"an output report of {size} bytes")
        return Output(report_type, body[:size])
    if kind == _GET_REPORT:
        return GetReport(*_GET.unpack_from(body))
    if kind == _SET_REPORT:
        request_id, report_id, report_type, size = _SET.unpack_from(body)
        report = body[_SET.size : _SET.size + size]
        if len(report) < size:
            return MalformedEvent(f"a report of {size} bytes in {len(report)}")
        return SetReport(request_id, report_id, report_type, report)
    return MalformedEvent(f"type {kind}")


class UhidDevice:
    """HID device of this program. Wait for `fileno()` to become readable."""

    def __init__(self, path: str = UHID_PATH) -> None:
        self._path = path
        self._fd = -1
        self._plugged = False

    def open(self) -> None:
        """Open the file, without a device. Raises DeviceAccessError."""
        if self._fd >= 0:
            return
        try:
            self._fd = os.open(self._path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            hint = {
                errno.ENOENT: "load the kernel's module: `modprobe uhid` as root",
                errno.ENODEV: "load the kernel's module: `modprobe uhid` as root",
                errno.EACCES: "run this as root, or grant yourself write access to it",
                errno.EPERM: "run this as root, or grant yourself write access to it",
            }.get(error.errno or 0, "is this a Linux kernel with uhid?")
            raise DeviceAccessError(
                f"cannot open {self._path}: {error.strerror or error}; {hint}"
            ) from None

    def fileno(self) -> int:
        """The file's descriptor."""
        return self._fd

    def plug(self, identity: HidIdentity) -> None:
        """Make the device appear. Raises DeviceAccessError when the kernel refuses it."""
        try:
            self._write(encode_create(identity))
        except OSError as error:
            raise DeviceAccessError(
                f"the kernel refuses {identity.name}: {error.strerror or error}"
            ) from None
        self._plugged = True

    def unplug(self) -> None:
        """Make the device vanish."""
        if self._plugged:
            self._plugged = False
            self._write(encode_destroy())

    def send(self, report: bytes) -> None:
        """Send an input report; without effect while unplugged."""
        if self._plugged:
            self._write(encode_input(report))

    def reply_to(self, request: GetReport | SetReport, error: int, report: bytes = b"") -> None:
        """Reply to a waiting program; `error` is an errno, 0 for none."""
        if isinstance(request, GetReport):
            self._write(encode_get_report_reply(request.request_id, error, report))
        else:
            self._write(encode_set_report_reply(request.request_id, error))

    def read(self) -> Event | None:
        """Return the oldest waiting event; None if there is none."""
        try:
            return decode_event(os.read(self._fd, EVENT_BYTES))
        except BlockingIOError:
            return None

    def close(self) -> None:
        """Close the file, and with it the device. Never raises."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                os.close(self._fd)
            self._fd = -1
            self._plugged = False

    def _write(self, event: bytes) -> None:
        os.write(self._fd, event)


class UhidBackend(DeviceBackend[bytes]):
    """Virtual device of the kernel; unplugging removes its nodes.

    `take` gets each output report and the device's time, s.
    """

    def __init__(
        self, identity: HidIdentity, take: Callable[[bytes, float], None], path: str = UHID_PATH
    ) -> None:
        self.identity = identity
        self.device = UhidDevice(path)
        self._take = take
        self._plugged = False

    @property
    def endpoint(self) -> str:
        """Vendor and product id, by which programs find the device."""
        return f"{self.identity.vendor_id:04x}:{self.identity.product_id:04x}"

    @property
    def there(self) -> bool:
        """True if the kernel has the device."""
        return self._plugged

    def open(self, shell: Shell) -> None:
        """Open the kernel's file. Raises DeviceAccessError."""
        super().open(shell)
        self.device.open()
        shell.selector.register(self.device.fileno(), selectors.EVENT_READ, self._serve)

    def appear(self) -> None:
        """Make the device. Raises DeviceAccessError."""
        self.device.plug(self.identity)
        self._plugged = True

    def vanish(self) -> None:
        """Destroy the device."""
        if self._plugged:
            self._plugged = False
            with contextlib.suppress(OSError):
                self.device.unplug()

    def send(self, messages: Sequence[bytes]) -> None:
        """Send input reports to the kernel."""
        for report in messages:
            if self._plugged:
                self.device.send(report)

    def close(self) -> None:
        """Destroy the device and close the file."""
        self.vanish()
        self.device.close()
        self._plugged = False

    def _serve(self) -> None:
        """Handle the kernel's events for the device."""
        while (event := self.device.read()) is not None:
            if isinstance(event, Open):
                self.shell.begin()
            elif isinstance(event, Output):
                self._take(event.data, self.shell.device_s())
            elif isinstance(event, SetReport):
                taken = event.report_type == OUTPUT_REPORT and self._set_report(event.data)
                self.device.reply_to(event, 0 if taken else errno.EIO)
            elif isinstance(event, GetReport):
                self.device.reply_to(event, errno.EIO)

    def _set_report(self, report: bytes) -> bool:
        """Handle an output report that a program waits for; return False if it is refused."""
        self._take(report, self.shell.device_s())
        return True
