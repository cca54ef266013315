"""Reads logs of a CAN bus: candump's, and Vector's .asc and .blf by python-can. Frames are
converted to the format of SocketCAN captures.

candump's logs are parsed here, because python-can takes most error lines ("bus off") for data
frames.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from io import TextIOWrapper
from typing import Any, BinaryIO, NamedTuple, TextIO, cast

from cardan.common.extras import missing_extra

EXTENDED, REMOTE, ERROR, IDENTIFIER = 0x80000000, 0x40000000, 0x20000000, 0x1FFFFFFF
FD_FRAME = 0x04
"""CANFD_FDF, of the flags of a frame."""
PADDING_BYTES = 4
"""Fewer missing bytes at the end of a .blf are possible: it is padded."""
_HEAD = struct.Struct("!IBB2x")
_LINE = re.compile(
    r"\((?P<seconds>\d{1,20})\.(?P<fraction>\d{1,9})\)\s+\S+\s+(?P<id>[0-9A-F]{8}|[0-9A-F]{3})#"
    r"((?P<remote>R)\d?|(?P<fd>#[0-9A-F])?(?P<data>([0-9A-F]{2}\.?)*))(_[0-9A-F])?(\s+[RT])?",
    re.IGNORECASE,
)
_REQUEST = re.compile(r"\sTxRq\s")


class Logged(NamedTuple):
    """A frame in the format of a capture."""

    time_ns: int
    data: bytes


def reader(head: bytes) -> Callable[[BinaryIO], Iterator[Logged]] | None:
    """Return the reader of a log that begins with these four bytes; None: not a log.

    The reader raises ValueError that says what is wrong with the log.
    """
    if head[:1] == b"(" and head[1:].isdigit():
        return _candump
    if head == b"LOGG":
        return _blf
    return _asc if head in (b"date", b"base", b"// v") else None


def _candump(stream: BinaryIO) -> Iterator[Logged]:
    for number, line in enumerate(TextIOWrapper(stream, "utf-8", "replace"), 1):
        text = line.strip()
        if not text:
            continue
        match = _LINE.fullmatch(text)
        if match is None:
            raise ValueError(f"line {number} is not of candump -L: {text[:80]!r}")
        word = int(match["id"], 16)
        if len(match["id"]) > 3 and not word & ERROR:
            word |= EXTENDED
        word |= REMOTE if match["remote"] else 0
        data = bytes.fromhex((match["data"] or "").replace(".", ""))
        time_ns = int(match["seconds"]) * 10**9 + int(match["fraction"].ljust(9, "0"))
        flags = FD_FRAME | int(match["fd"][1], 16) if match["fd"] else 0
        yield Logged(time_ns, _HEAD.pack(word, len(data), flags) + data)


def _asc(stream: BinaryIO) -> Iterator[Logged]:
    try:
        from can import ASCReader
    except ImportError as error:
        raise missing_extra("a log of Vector's", "python-can", "can", error) from error

    class Reader(ASCReader):
        """Begins at 0 if the date is in another language."""

        @staticmethod
        def _datetime_to_timestamp(datetime_string: str) -> float:
            try:
                return ASCReader._datetime_to_timestamp(datetime_string)
            except ValueError:
                return 0.0

    read = 0, ""

    def lines() -> Iterator[str]:
        nonlocal read
        for number, line in enumerate(TextIOWrapper(stream, "utf-8", "replace"), 1):
            read = number, line.strip()
            if not _REQUEST.search(line):  # The log repeats it once it was sent.
                yield line

    try:
        yield from _messages(Reader(cast(TextIO, lines()), relative_timestamp=False))
    except (ValueError, IndexError) as error:
        number, line = read
        raise ValueError(f"line {number} cannot be read: {line[:80]!r}") from error


def _blf(stream: BinaryIO) -> Iterator[Logged]:
    try:
        from can import BLFReader
        from can.io.blf import BLFParseError
    except ImportError as error:
        raise missing_extra("a log of Vector's", "python-can", "can", error) from error
    counted = _Counted(stream)
    try:
        log = BLFReader(cast(BinaryIO, counted))
        yield from _messages(log)
    except (BLFParseError, ValueError, struct.error, zlib.error) as error:
        raise ValueError("a part of it is not where it should be") from error
    if counted.bytes <= log.file_size - PADDING_BYTES:
        raise ValueError(f"it has {counted.bytes} of {log.file_size} bytes")


class _Counted:
    """Stream that counts the bytes read."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self.bytes = stream, 0

    def read(self, size: int) -> bytes:
        data = self._stream.read(size)
        self.bytes += len(data)
        return data

    def close(self) -> None:
        """Leave the stream open: its owner closes it."""


def _messages(log: Any) -> Iterator[Logged]:
    for message in log:
        word = message.arbitration_id & IDENTIFIER
        for flag, is_set in (
            (EXTENDED, message.is_extended_id and not message.is_error_frame),
            (REMOTE, message.is_remote_frame),
            (ERROR, message.is_error_frame),
        ):
            word |= flag if is_set else 0
        flags = FD_FRAME if message.is_fd else 0
        data = bytes(message.data)
        head = _HEAD.pack(word, len(data), flags)
        yield Logged(round(message.timestamp * 1e6) * 1000, head + data)
