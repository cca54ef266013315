"""Values common to the packets of all three serial protocols."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, NamedTuple, TypeVar

CR = 0x0D

LONGEST_PACKET_BYTES = 160
"""Longer runs without an end are noise: the longest packets are lines of text of some 60 bytes."""

TOO_LONG = "without an end"
BAD_LENGTH = "of a wrong length"
BAD_CODE = "with an impossible byte"
BAD_CHECKSUM = "with a wrong checksum"
UNKNOWN_LETTER = "of an unknown letter"


class Malformed(NamedTuple):
    """Bytes that are not a valid packet."""

    reason: str
    """Reason: one of a few fixed phrases, for counting."""
    letter: int
    """The byte that the packet began with."""


PacketT = TypeVar("PacketT")


class LineReader(ABC, Generic[PacketT]):
    """Splits a stream into packets, which end in CR, and resynchronizes after noise. Never
    raises."""

    def __init__(self) -> None:
        self._pending = b""
        self._skipping = False

    @abstractmethod
    def _decode(self, line: bytes, packets: list[PacketT | Malformed]) -> None:
        """Add the packets in the possibly empty bytes before a CR."""

    def feed(self, data: bytes) -> list[PacketT | Malformed]:
        """Add received bytes; return the packets that are complete now."""
        *lines, self._pending = (self._pending + data).split(b"\r")
        packets: list[PacketT | Malformed] = []
        for line in lines:
            if self._skipping:
                self._skipping = False
            elif len(line) > LONGEST_PACKET_BYTES:
                packets.append(Malformed(TOO_LONG, line[0]))
            else:
                self._decode(line, packets)
        if len(self._pending) > LONGEST_PACKET_BYTES:
            if not self._skipping:
                packets.append(Malformed(TOO_LONG, self._pending[0]))
            self._skipping = True
            self._pending = self._pending[:1]
        return packets


class CommandReader:
    """Splits a host's bytes into commands, which end in CR. Never raises."""

    def __init__(self) -> None:
        self._pending = bytearray()

    @property
    def pending(self) -> bool:
        """True in the middle of a command."""
        return bool(self._pending)

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes; return the commands that are complete now, without their CR."""
        commands = []
        for byte in data:
            if byte == CR:
                commands.append(bytes(self._pending))
                self._pending.clear()
            elif len(self._pending) < LONGEST_PACKET_BYTES:
                self._pending.append(byte)
        return commands

    def reset(self) -> None:
        """Discard an incomplete command."""
        self._pending.clear()
