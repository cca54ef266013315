"""Reads pcap and pcapng files, btsnoop logs and logs of a CAN bus, also gzipped and from pipes,
packet by packet, with the exact place of a truncation."""

from __future__ import annotations

import contextlib
import enum
import gzip
import io
import os
import shlex
import stat
import struct
import sys
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any, BinaryIO, NamedTuple, cast

from cardan.common.files import PIECE_BYTES, open_file, read_up_to
from cardan.errors import CaptureError
from cardan_dissect import btsnoop, can_log

MAX_BLOCK_BYTES = 256 * 2**20
"""Twice libpcap's limit for a USB capture; a longer block has a damaged length."""
MAX_TIME_NS = 2**63
"""In the year 2262."""
BLOCK_OVERHEAD_BYTES = 12
"""Type and both lengths of a pcapng block."""

ENDS_INSIDE = "truncated: the file ends inside a packet"

PCAP_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Byte order, and nanoseconds per unit of the second time stamp word."""
PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"
MCAP_MAGIC = b"\x89MCA"
GZIP_MAGIC = b"\x1f\x8b"
UNPACKED_BY = {
    b"\x28\xb5\x2f\xfd": ("zstd", "zstd -dc"),
    b"\xfd7zX": ("xz", "xz -dc"),
    b"\x04\x22\x4d\x18": ("lz4", "lz4 -dc"),
    b"BZh": ("bzip2", "bzip2 -dc"),
    b"PK\x03\x04": ("zip", "unzip -p"),
}
"""Compressed files that cannot be read, by their first bytes, and the programs that unpack them."""
STANDARD_INPUT = "-"
LINK_CAN = 227
"""LINKTYPE_CAN_SOCKETCAN, for frames from a log."""
SECTION, INTERFACE, OLD_PACKET, SIMPLE_PACKET, STATISTICS, PACKET = 0x0A0D0D0A, 1, 2, 3, 5, 6
OPTION_END, OPTION_RESOLUTION, OPTION_OFFSET = 0, 9, 14
OPTIONS_DROPPED = 5, 7
"""Options of statistics: packets dropped by the interface and by the system."""

_new = tuple.__new__


class Direction(enum.Enum):
    """Direction of a message. The device is the operator's, the robot controller, the simulated arm
    or the sensor's board; the values are USB's names of the directions."""

    FROM_DEVICE = "IN"
    TO_DEVICE = "OUT"

    @property
    def opposite(self) -> Direction:
        """Direction of the reply."""
        return Direction.TO_DEVICE if self is Direction.FROM_DEVICE else Direction.FROM_DEVICE


class CapturedPacket(NamedTuple):
    """A captured packet. `number` counts from 1; `time_ns` is since the Unix epoch."""

    number: int
    time_ns: int
    link_type: int
    byte_order: str  # struct's sign for the capturing machine.
    data: bytes
    wire_bytes: int  # Original length; more than len(data) if the capture cut it.
    interface: int | None = None  # Its number in a pcapng file.

    @property
    def cut(self) -> bool:
        """True if the capture has less than was sent."""
        return self.wire_bytes > len(self.data)


class _Interface(NamedTuple):
    link_type: int
    snap_bytes: int
    units_per_s: int
    offset_s: int


class _Again(io.RawIOBase):
    """Stream from which `head` was read already. A pipe cannot be rewound."""

    def __init__(self, head: bytes, stream: BinaryIO) -> None:
        self._head, self._stream = head, cast(io.BufferedReader, stream)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        """Read the available bytes, without waiting until the buffer is full."""
        data = self._head[: len(buffer)] or self._stream.read1(len(buffer))
        self._head = self._head[len(data) :]
        buffer[: len(data)] = data
        return len(data)


class Capture:
    """The packets of a file or a pipe, iterated once; "-" is standard input. They are counted from
    `first` on. Raises CaptureError with the fault of the file."""

    def __init__(self, path: str | os.PathLike[str], first: int = 1) -> None:
        self.path = os.fspath(path)
        self.lost = 0
        """Packets that were lost according to the capturing program, in a pcapng file."""
        self._count = first - 1
        self._stream: BinaryIO | None = None
        self._bytes: int | None = None
        self.damage = ""
        """Truncation or damage of the file, and its place; empty: none as far as it was read."""

    @property
    def share(self) -> float | None:
        """Share of the file that has been read, 0 to 1; None if its length is unknown."""
        if self._stream is None or not self._bytes:
            return None
        return min(1.0, self._stream.tell() / self._bytes)

    def look(self) -> None:
        """Raise CaptureError if the file is missing or not a capture; a damaged capture passes.
        Pipes are not checked."""
        if self.path == STANDARD_INPUT:
            return
        try:
            with self._errors_translated():
                if not stat.S_ISFIFO(os.stat(self.path).st_mode):
                    with open_file(self.path) as stream:
                        next(self._packets(stream), None)
        except CaptureError:
            if not self.damage:
                raise

    def __iter__(self) -> Iterator[CapturedPacket]:
        with self._errors_translated(), self._opened() as stream:
            yield from self._packets(stream)

    @contextlib.contextmanager
    def _errors_translated(self) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError:
            raise CaptureError(f"{self.path}: there is no such file") from None
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise self._damaged(f"the gzip data are damaged ({error})") from error
        except OSError as error:
            raise CaptureError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _opened(self) -> AbstractContextManager[BinaryIO]:
        if self.path == STANDARD_INPUT:
            return contextlib.nullcontext(sys.stdin.buffer)
        mode = os.stat(self.path).st_mode
        if stat.S_ISFIFO(mode):
            return open(self.path, "rb")
        stream = self._stream = open_file(self.path)
        self._bytes = os.fstat(stream.fileno()).st_size
        return stream

    def _packets(self, stream: BinaryIO) -> Iterator[CapturedPacket]:
        magic = read_up_to(stream, 4)
        if magic.startswith(GZIP_MAGIC):
            with gzip.GzipFile(fileobj=cast(BinaryIO, _Again(magic, stream))) as unzipped:
                unpacked = cast(BinaryIO, unzipped)
                yield from self._unzipped(read_up_to(unpacked, 4), unpacked)
        else:
            yield from self._unzipped(magic, stream)

    def _unzipped(self, magic: bytes, stream: BinaryIO) -> Iterator[CapturedPacket]:
        packed = next((by for start, by in UNPACKED_BY.items() if magic.startswith(start)), None)
        if packed is not None:
            kind, command = packed
            file = "FILE" if self.path == STANDARD_INPUT else self.path
            raise CaptureError(
                f"{self.path}: it is compressed with {kind}: "
                f"`{command} {shlex.quote(file)} | cardan dissect -`"
            )
        if magic in PCAP_MAGICS:
            return self._pcap(stream, *PCAP_MAGICS[magic])
        if magic == PCAPNG_MAGIC:
            return self._pcapng(stream)
        if magic == btsnoop.MAGIC[:4]:
            return self._btsnoop(stream)
        if log := can_log.reader(magic):
            return self._can_log(log(io.BufferedReader(_Again(magic, stream))))
        if not magic:
            raise CaptureError(f"{self.path}: the file is empty")
        if magic == MCAP_MAGIC:
            file = shlex.quote(self.path)
            raise CaptureError(
                f"{self.path}: it is a record (MCAP) and no capture: `cardan net replay {file}` "
                f"publishes it, `cardan net plot {file}` draws it, `cardan net export {file}` "
                "makes a data set of it"
            )
        raise CaptureError(
            f"{self.path}: not a pcap or pcapng capture, and no log of Bluetooth or of a CAN "
            f"bus (it begins with {magic.hex(' ')}); record one with tcpdump -w or Wireshark"
        )

    def _damaged(self, what: str) -> CaptureError:
        self.damage = f"{what} after packet {self._count}"
        return CaptureError(f"{self.path}: {self.damage}; the rest is not read")

    def _exactly(self, stream: BinaryIO, size: int) -> bytes:
        if size > MAX_BLOCK_BYTES:
            raise self._damaged(f"damaged: a length of {size} bytes")
        data = read_up_to(stream, size)
        if len(data) < size:
            raise self._damaged(ENDS_INSIDE)
        return data

    def _captured(
        self,
        time_ns: int,
        link_type: int,
        order: str,
        data: bytes,
        wire_bytes: int,
        interface: int | None = None,
    ) -> CapturedPacket:
        if not 0 <= time_ns < MAX_TIME_NS:
            raise self._damaged("damaged: a time stamp out of range")
        self._count += 1
        return CapturedPacket(self._count, time_ns, link_type, order, data, wire_bytes, interface)

    def _can_log(self, frames: Iterator[can_log.Logged]) -> Iterator[CapturedPacket]:
        try:
            for time_ns, data in frames:
                yield self._captured(time_ns, LINK_CAN, "<", data, len(data))
        except ValueError as error:
            raise self._damaged(f"damaged: {error}") from error

    def _pcap(self, stream: BinaryIO, order: str, unit_ns: int) -> Iterator[CapturedPacket]:
        link_type = struct.unpack(f"{order}16xI", self._exactly(stream, 20))[0] & 0xFFFF
        unpack, read = struct.Struct(f"{order}4I").unpack, stream.read
        while head := read(16):
            if len(head) < 16:
                raise self._damaged(ENDS_INSIDE)
            seconds, units, size, wire_bytes = unpack(head)
            data = read(size) if size <= PIECE_BYTES else self._exactly(stream, size)
            if len(data) < size:
                raise self._damaged(ENDS_INSIDE)
            time_ns = seconds * 10**9 + units * unit_ns  # Never out of range.
            self._count += 1
            yield _new(
                CapturedPacket,
                (self._count, time_ns, link_type, order, data, wire_bytes, None),
            )

    def _btsnoop(self, stream: BinaryIO) -> Iterator[CapturedPacket]:
        self._exactly(stream, len(btsnoop.MAGIC) - 4)
        version, datalink = btsnoop.HEAD.unpack(self._exactly(stream, btsnoop.HEAD.size))
        if version != btsnoop.VERSION or datalink not in (
            btsnoop.H1, btsnoop.H4, btsnoop.MONITOR
        ):  # fmt: skip
            raise CaptureError(
                f"{self.path}: a btsnoop log of version {version} and datalink type {datalink} is "
                f"not read, only version {btsnoop.VERSION} of HCI ({btsnoop.H1}, {btsnoop.H4}) and "
                f"of btmon ({btsnoop.MONITOR})"
            )
        while first := stream.read(1):
            head = first + self._exactly(stream, btsnoop.RECORD.size - 1)
            wire_bytes, size, flags, self.lost, time_us = btsnoop.RECORD.unpack(head)
            data = self._exactly(stream, size)
            link_type, packet, adapter = btsnoop.link_packet(datalink, flags, data)
            yield self._captured(
                (time_us - btsnoop.EPOCH_US) * 1000,
                link_type,
                "<",
                packet,
                wire_bytes + len(packet) - size,
                adapter if datalink == btsnoop.MONITOR else None,
            )

    def _pcapng(self, stream: BinaryIO) -> Iterator[CapturedPacket]:
        order, interfaces, time_ns = "<", list[_Interface](), 0
        lost: dict[int, int] = {}
        """Lost packets by interface: the counts continue from block to block."""
        start = PCAPNG_MAGIC + self._exactly(stream, 4)
        while True:
            if start[:4] == PCAPNG_MAGIC:
                mark = self._exactly(stream, 4)
                if mark not in (b"\x4d\x3c\x2b\x1a", b"\x1a\x2b\x3c\x4d"):
                    raise self._damaged(f"damaged: byte order mark {mark.hex(' ')}")
                order = "<" if mark[0] == 0x4D else ">"
                interfaces = []
                body = mark + self._exactly(stream, self._body_bytes(order, start) - 4)
            else:
                body = self._exactly(stream, self._body_bytes(order, start))
            self._exactly(stream, 4)
            kind = struct.unpack(f"{order}I", start[:4])[0]
            try:
                if kind == INTERFACE:
                    interfaces.append(_interface(order, body))
                elif kind == STATISTICS:
                    lost[struct.unpack_from(f"{order}I", body)[0]] = _dropped(order, body)
                    self.lost = sum(lost.values())
                elif kind in (PACKET, OLD_PACKET, SIMPLE_PACKET):
                    index, stamp, data, wire_bytes = _packet(order, kind, body, interfaces)
                    interface = interfaces[index]
                    if stamp is not None:
                        time_ns = (
                            interface.offset_s * 10**9 + stamp * 10**9 // interface.units_per_s
                        )
                    yield self._captured(
                        time_ns, interface.link_type, order, data, wire_bytes, index
                    )
            except (struct.error, IndexError):
                raise self._damaged(f"damaged: a pcapng block of type {kind}") from None
            first = stream.read(1)
            if not first:
                return
            start = first + self._exactly(stream, 7)

    def _body_bytes(self, order: str, start: bytes) -> int:
        size: int = struct.unpack(f"{order}4xI", start)[0]
        if size < BLOCK_OVERHEAD_BYTES + 4 * (start[:4] == PCAPNG_MAGIC) or size % 4:
            raise self._damaged(f"damaged: a pcapng block of {size} bytes")
        return size - BLOCK_OVERHEAD_BYTES


def _interface(order: str, body: bytes) -> _Interface:
    link_type, snap_bytes = struct.unpack_from(f"{order}HxxI", body)
    units_per_s, offset_s = 10**6, 0
    for code, at in _options(order, body, 8):
        if code == OPTION_RESOLUTION:
            resolution = body[at]
            units_per_s = (2 if resolution & 0x80 else 10) ** (resolution & 0x7F)
        elif code == OPTION_OFFSET:
            offset_s = struct.unpack_from(f"{order}q", body, at)[0]
    return _Interface(link_type, snap_bytes, units_per_s, offset_s)


def _dropped(order: str, body: bytes) -> int:
    """Return the number of lost packets from an interface's statistics."""
    found = [at for code, at in _options(order, body, 12) if code in OPTIONS_DROPPED]
    return sum(struct.unpack_from(f"{order}Q", body, at)[0] for at in found)


def _options(order: str, body: bytes, at: int) -> Iterator[tuple[int, int]]:
    """Yield the options of a block from `at` on: the code of each, and the offset of its value."""
    while at + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}HH", body, at)
        if code == OPTION_END:
            break
        yield code, at + 4
        at += 4 + size + -size % 4


def _packet(
    order: str, kind: int, body: bytes, interfaces: list[_Interface]
) -> tuple[int, int | None, bytes, int]:
    """Return interface number, time stamp in its units, data and length on the wire of a packet
    block."""
    if kind == SIMPLE_PACKET:
        (wire_bytes,) = struct.unpack_from(f"{order}I", body)
        size = min(wire_bytes, interfaces[0].snap_bytes or wire_bytes)
        return 0, None, body[4 : 4 + size], wire_bytes
    layout = "5I" if kind == PACKET else "HH4I"
    index, *_, high, low, size, wire_bytes = struct.unpack_from(order + layout, body)
    return index, high << 32 | low, body[20 : 20 + size], wire_bytes
