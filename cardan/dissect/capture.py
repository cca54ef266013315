"""Reads pcap and pcapng files, also gzipped, packet by packet; exact about where a file is cut."""

from __future__ import annotations

import enum
import gzip
import os
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple, cast

from cardan.common.files import open_file, read_up_to
from cardan.errors import CaptureError

MAX_BLOCK_BYTES = 256 * 2**20
"""Twice what libpcap lets a USB capture have; a longer block is a damaged length."""
MAX_TIME_NS = 2**63
"""In the year 2262."""
BLOCK_OVERHEAD_BYTES = 12
"""Type and both lengths of a pcapng block."""

PCAP_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Byte order, and nanoseconds per unit of the second time stamp word."""
PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"
GZIP_MAGIC = b"\x1f\x8b"
SECTION, INTERFACE, OLD_PACKET, SIMPLE_PACKET, PACKET = 0x0A0D0D0A, 1, 2, 3, 6
OPTION_END, OPTION_RESOLUTION, OPTION_OFFSET = 0, 9, 14


class Direction(enum.Enum):
    """Which way something went. The device is the operator's, the robot controller, the simulated
    arm or the sensor's board; the values are what USB calls the directions."""

    FROM_DEVICE = "IN"
    TO_DEVICE = "OUT"

    @property
    def opposite(self) -> Direction:
        """The way of the answer."""
        return Direction.TO_DEVICE if self is Direction.FROM_DEVICE else Direction.FROM_DEVICE


class CapturedPacket(NamedTuple):
    """One captured packet. `number` counts from 1; `time_ns` is since the Unix epoch."""

    number: int
    time_ns: int
    link_type: int
    byte_order: str  # struct's sign for the capturing machine
    data: bytes
    wire_bytes: int  # how long it was; more than len(data) when the capture cut it

    @property
    def cut(self) -> bool:
        """Whether the capture holds less than was sent."""
        return self.wire_bytes > len(self.data)


class _Interface(NamedTuple):
    link_type: int
    snap_bytes: int
    units_per_s: int
    offset_s: int


class Capture:
    """The packets of a file, iterated once. CaptureError names what is wrong with the file."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self._count = 0

    def __iter__(self) -> Iterator[CapturedPacket]:
        try:
            with open_file(self.path) as stream:
                yield from self._packets(stream)
        except FileNotFoundError:
            raise CaptureError(f"{self.path}: there is no such file") from None
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise self._damaged(f"the gzip data are damaged ({error})") from error
        except OSError as error:
            raise CaptureError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _packets(self, stream: BinaryIO) -> Iterator[CapturedPacket]:
        magic = stream.read(2)
        stream.seek(0)
        if magic == GZIP_MAGIC:
            with gzip.open(stream) as unzipped:
                yield from self._unzipped(cast(BinaryIO, unzipped))
        else:
            yield from self._unzipped(stream)

    def _unzipped(self, stream: BinaryIO) -> Iterator[CapturedPacket]:
        magic = stream.read(4)
        if magic in PCAP_MAGICS:
            yield from self._pcap(stream, *PCAP_MAGICS[magic])
        elif magic == PCAPNG_MAGIC:
            yield from self._pcapng(stream)
        elif not magic:
            raise CaptureError(f"{self.path}: the file is empty")
        else:
            raise CaptureError(
                f"{self.path}: not a pcap or pcapng capture (it begins with {magic.hex(' ')}); "
                "record one with tcpdump -w or Wireshark"
            )

    def _damaged(self, what: str) -> CaptureError:
        return CaptureError(f"{self.path}: {what} after packet {self._count}; the rest is not read")

    def _exactly(self, stream: BinaryIO, size: int) -> bytes:
        if size > MAX_BLOCK_BYTES:
            raise self._damaged(f"damaged: a length of {size} bytes")
        data = read_up_to(stream, size)
        if len(data) < size:
            raise self._damaged("truncated: the file ends inside a packet")
        return data

    def _captured(
        self, time_ns: int, link_type: int, order: str, data: bytes, wire_bytes: int
    ) -> CapturedPacket:
        if not 0 <= time_ns < MAX_TIME_NS:
            raise self._damaged("damaged: a time stamp out of range")
        self._count += 1
        return CapturedPacket(self._count, time_ns, link_type, order, data, wire_bytes)

    def _pcap(self, stream: BinaryIO, order: str, unit_ns: int) -> Iterator[CapturedPacket]:
        link_type = struct.unpack(f"{order}16xI", self._exactly(stream, 20))[0] & 0xFFFF
        while first := stream.read(1):
            header = first + self._exactly(stream, 15)
            seconds, units, size, wire_bytes = struct.unpack(f"{order}4I", header)
            data = self._exactly(stream, size)
            time_ns = seconds * 10**9 + units * unit_ns
            yield self._captured(time_ns, link_type, order, data, wire_bytes)

    def _pcapng(self, stream: BinaryIO) -> Iterator[CapturedPacket]:
        order, interfaces, time_ns = "<", list[_Interface](), 0
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
                elif kind in (PACKET, OLD_PACKET, SIMPLE_PACKET):
                    interface, stamp, data, wire_bytes = _packet(order, kind, body, interfaces)
                    if stamp is not None:
                        time_ns = (
                            interface.offset_s * 10**9 + stamp * 10**9 // interface.units_per_s
                        )
                    yield self._captured(time_ns, interface.link_type, order, data, wire_bytes)
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
    units_per_s, offset_s, at = 10**6, 0, 8
    while at + 4 <= len(body):
        code, size = struct.unpack_from(f"{order}HH", body, at)
        if code == OPTION_END:
            break
        if code == OPTION_RESOLUTION:
            resolution = body[at + 4]
            units_per_s = (2 if resolution & 0x80 else 10) ** (resolution & 0x7F)
        elif code == OPTION_OFFSET:
            offset_s = struct.unpack_from(f"{order}q", body, at + 4)[0]
        at += 4 + size + -size % 4
    return _Interface(link_type, snap_bytes, units_per_s, offset_s)


def _packet(
    order: str, kind: int, body: bytes, interfaces: list[_Interface]
) -> tuple[_Interface, int | None, bytes, int]:
    """Interface, time stamp in its units, data and length on the wire of a packet block."""
    if kind == SIMPLE_PACKET:
        (wire_bytes,) = struct.unpack_from(f"{order}I", body)
        size = min(wire_bytes, interfaces[0].snap_bytes or wire_bytes)
        return interfaces[0], None, body[4 : 4 + size], wire_bytes
    layout = "5I" if kind == PACKET else "HH4I"
    index, *_, high, low, size, wire_bytes = struct.unpack_from(order + layout, body)
    return interfaces[index], high << 32 | low, body[20 : 20 + size], wire_bytes
