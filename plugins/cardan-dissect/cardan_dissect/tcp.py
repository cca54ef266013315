"""Reassembly of one direction of a TCP connection: segments in any order to bytes in order.

Handles segments that overlap, repeat, arrive early or are missing in the capture; a protocol's
reader splits the bytes into messages.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from cardan_dissect.network import TCP_FIN, TCP_RST, TCP_SYN, Segment

SEQUENCE_MODULUS = 2**32
HELD_BYTES, HELD_NS = 2**16, 10**9
"""Bytes, and time, that follow a hole in a stream before it counts as missing in the capture."""
FARTHEST_BACK = 2**20
"""Farthest step back of a retransmission; beyond it is another connection."""


class Begin(NamedTuple):
    """Beginning of a connection: the bytes that follow are its first."""


class Bytes(NamedTuple):
    """Next bytes of the stream."""

    data: bytes
    time_ns: int
    """Time at which they could be read: when the hole before them was filled, or, after a hole in
    the capture, when they arrived."""


class Gap(NamedTuple):
    """Bytes that are missing in the capture."""

    size: int


class Cut(NamedTuple):
    """Bytes that were sent but that the capture did not keep."""

    size: int


class End(NamedTuple):
    """End of the connection."""


Event = Begin | Bytes | Gap | Cut | End


class _Held(NamedTuple):
    """Segment that arrived before the bytes in front of it."""

    sequence: int
    payload: bytes
    missing: int
    """Bytes after the payload that the capture cut off."""
    time_ns: int


class TcpStream:
    """Puts the segments of one direction in order."""

    def __init__(self) -> None:
        self.segments = self.retransmitted = self.reordered = self.gaps = self.lost_bytes = 0
        self.cut = 0
        """Number of segments of which the capture lacks the end."""
        self._next: int | None = None
        self._begun = False
        """True if bytes followed the connection's beginning."""
        self._held: list[_Held] = []
        self._held_since_ns = 0

    def feed(self, segment: Segment, time_ns: int) -> Iterator[Event]:
        """Add a segment; yield the events that can be read now."""
        sequence, payload, missing = segment.sequence, segment.payload, segment.missing
        if segment.flags & TCP_SYN:
            start = (sequence + 1) % SEQUENCE_MODULUS
            if start != self._next or self._begun:  # Otherwise a repeated SYN.
                yield from self._end()
                self._next = start
                yield Begin()
            sequence = start
        if payload or missing:
            self.segments += 1
            self.cut += missing > 0
            yield from self._take(_Held(sequence, payload, missing, time_ns))
        if segment.flags & TCP_RST or (
            segment.flags & TCP_FIN
            and not self._held
            and self._next == (sequence + len(payload) + missing) % SEQUENCE_MODULUS
        ):
            yield from self._end()

    def flush(self) -> Iterator[Event]:
        """Yield the held segments at the end of the capture."""
        while self._held:
            yield from self._give_up()

    def missing_before(self, sequence: int) -> int:
        """Return the number of missing bytes before `sequence`; 0 after the end of the stream."""
        return 0 if self._next is None else max(0, self._ahead(sequence))

    def _take(self, segment: _Held) -> Iterator[Event]:
        time_ns = segment.time_ns
        ahead = self._ahead(segment.sequence)
        if ahead < -FARTHEST_BACK:
            yield from self._end()
            ahead = self._ahead(segment.sequence)
        if ahead > 0:
            if not self._held:
                self._held_since_ns = time_ns
            self.reordered += 1
            self._held.append(segment)
        else:
            yield from self._append(segment)
            yield from self._release(time_ns)
        if self._held and (
            time_ns - self._held_since_ns > HELD_NS
            or sum(len(held.payload) + held.missing for held in self._held) > HELD_BYTES
        ):
            yield from self._give_up()

    def _ahead(self, sequence: int) -> int:
        """Number of missing bytes before it, modulo 2**32; below 0: number of known bytes."""
        if self._next is None:
            self._next = sequence
        half = SEQUENCE_MODULUS // 2
        return (sequence - self._next + half) % SEQUENCE_MODULUS - half

    def _advance(self, size: int) -> None:
        self._next = ((self._next or 0) + size) % SEQUENCE_MODULUS

    def _append(self, segment: _Held) -> Iterator[Event]:
        """Append a segment that begins at or before the next expected byte."""
        known = -self._ahead(segment.sequence)
        if known:
            self.retransmitted += 1
        fresh = segment.payload[known:]
        if fresh:
            self._advance(len(fresh))
            self._begun = True
            yield Bytes(fresh, segment.time_ns)
        cut = segment.missing - max(0, known - len(segment.payload))
        if cut > 0:
            self._advance(cut)
            self._begun = True
            yield Cut(cut)

    def _release(self, time_ns: int | None) -> Iterator[Event]:
        """Yield held segments that are not ahead any more. They became readable at `time_ns`, when
        the hole was filled; None: the capture lacks it, and they were readable on arrival."""
        while ready := next((h for h in self._held if self._ahead(h.sequence) <= 0), None):
            self._held.remove(ready)
            when_ns = ready.time_ns if time_ns is None else time_ns
            yield from self._append(ready._replace(time_ns=when_ns))

    def _give_up(self) -> Iterator[Event]:
        """Skip the missing bytes."""
        nearest = min(self._ahead(held.sequence) for held in self._held)
        self.gaps += 1
        self.lost_bytes += nearest
        self._advance(nearest)
        yield Gap(nearest)
        yield from self._release(None)

    def _end(self) -> Iterator[Event]:
        yield from self.flush()
        yield End()
        self._next, self._begun = None, False
