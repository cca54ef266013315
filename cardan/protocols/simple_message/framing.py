"""Framing of simple message on a TCP stream."""

from __future__ import annotations

import enum

PREFIX_BYTES = 4
HEADER_BYTES = 12
"""Message type, communication type and reply code; the prefix counts them and the body."""
SHORTEST_PREFIX = HEADER_BYTES
LONGEST_PREFIX = 0xFFFF
"""Longest prefix of any message; it also serves to detect the byte order."""
LONGEST_PREFIX_OF_MOTOROS = 1020
"""Longest message: MotoROS's has 544 bytes; ROS's own client sends none longer than this."""


class ByteOrder(enum.Enum):
    """Byte order of integers and reals, that of the controller's CPU; struct's sign."""

    LITTLE = "<"
    """DX100, DX200, YRC1000, YRC1000micro."""
    BIG = ">"
    """FS100."""


def _prefix(data: bytes | bytearray, order: ByteOrder) -> int:
    name = "little" if order is ByteOrder.LITTLE else "big"
    return int.from_bytes(data[:PREFIX_BYTES], name, signed=True)  # type: ignore[arg-type]


def detect_byte_order(data: bytes | bytearray) -> ByteOrder | None:
    """Return the byte order in which the first prefix is plausible; None if neither is.

    `data` begins with a prefix. No field has the byte order, but a length is below 64 KiB.
    """
    for order in ByteOrder:
        if SHORTEST_PREFIX <= _prefix(data, order) <= LONGEST_PREFIX:
            return order
    return None


def speaks_simple_message(said: bytes) -> bool | None:
    """True if a server's first bytes are simple message; None if more are needed."""
    return None if len(said) < PREFIX_BYTES else detect_byte_order(said) is not None


class FrameReader:
    """Splitter of a TCP stream into complete messages, each with its prefix.

    The byte order is detected from the first prefix unless it is given. After an invalid prefix,
    which hides the begin of the next message, the rest is ignored; `failure` is the reason.
    """

    def __init__(
        self, byte_order: ByteOrder | None = None, longest_prefix: int = LONGEST_PREFIX
    ) -> None:
        self.byte_order = byte_order
        self.failure = ""
        self._longest = longest_prefix
        self._buffer = bytearray()

    @property
    def pending_bytes(self) -> int:
        """Bytes received of an incomplete message."""
        return len(self._buffer)

    def feed(self, data: bytes) -> None:
        if not self.failure:
            self._buffer += data

    def take(self) -> bytes | None:
        """Return the next complete message; None if there is none."""
        buffer = self._buffer
        if len(buffer) < PREFIX_BYTES or self.failure:
            return None
        if self.byte_order is None:
            self.byte_order = detect_byte_order(buffer)
        order = self.byte_order or ByteOrder.LITTLE
        length = _prefix(buffer, order)
        if not SHORTEST_PREFIX <= length <= self._longest:
            self.failure = (
                f"a prefix of {length} ({bytes(buffer[:PREFIX_BYTES]).hex(' ')}); messages have "
                f"{SHORTEST_PREFIX} to {self._longest}"
            )
            buffer.clear()
            return None
        end = PREFIX_BYTES + length
        if len(buffer) < end:
            return None
        frame = bytes(buffer[:end])
        del buffer[:end]
        return frame
