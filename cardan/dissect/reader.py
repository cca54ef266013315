"""The parts of a protocol's dissector: its reader, and the declaration that it is found by."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar, NamedTuple

from cardan.dissect.capture import CapturedPacket
from cardan.dissect.network import Segment
from cardan.errors import ConfigurationError

PacketLine = tuple[CapturedPacket, str]
"""A line to print, with the packet that it is about."""

CUT = "cut by the capture"
"""Reason of a malformed message that is not whole in the capture."""


class ProtocolReader(ABC):
    """Sees the packets of its link types in order and takes those of its protocol.

    A packet that it takes (`packets` has grown) is not offered to the readers after it.
    """

    def __init__(self) -> None:
        self.packets = 0
        """Packets that belong to the protocol, those without a message of it included."""
        self.messages = 0
        """Datagrams, reports or messages of a stream shown, malformed ones included."""
        self.malformed: Counter[str] = Counter()
        """Those that are not what they should be, by reason."""

    @abstractmethod
    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        """Lines to show, each with its packet; none when this one holds nothing of the protocol.

        `network` is what :func:`cardan.dissect.network.parse` says of the packet.
        """

    def finish(self) -> Iterable[PacketLine]:
        """Lines that were held back when the capture ended."""
        return ()

    @abstractmethod
    def summary(self) -> Iterable[str]:
        """Lines about everything that was fed."""

    def count_malformed(self, reason: str, *counters: Counter[str]) -> None:
        """One more malformed message, here and in `counters` of its flow or device."""
        for counter in (self.malformed, *counters):
            counter[reason] += 1


class Numbers(NamedTuple):
    """An option that adds numbers to those a protocol is looked for at: ports, nodes."""

    key: str
    """The keyword of :func:`cardan.dissect.dissect_file` and of the reader."""
    flag: str
    """On the command line, without the leading dashes; it can be given several times."""
    metavar: str
    help: str
    """In a few words without a full stop; that the option is repeatable is added."""
    what: str
    """What one of the numbers is ("UDP port")."""
    allowed: range
    usual: frozenset[int] = frozenset()
    """Those that are looked at anyway."""

    def with_usual(self, more: Iterable[int]) -> frozenset[int]:
        """The usual numbers and `more`; ConfigurationError for one out of range."""
        numbers = frozenset(more)
        if wrong := sorted(numbers.difference(self.allowed)):
            listed = ", ".join(map(str, wrong))
            raise ConfigurationError(
                self.key,
                f"{self.what} {listed}: allowed are {self.allowed[0]} to {self.allowed[-1]}",
            )
        return self.usual | numbers


class Dissector:
    """A protocol as ``cardan dissect`` has it: where it is looked for, its options, its reader.

    It is never instantiated, and looking at it needs no scapy. The class's docstring says in a line
    what it reads.
    """

    name: ClassVar[str]
    """The protocol's, in the figures of a capture."""
    page: ClassVar[str]
    """Where it is described: a page under docs/, or an address."""
    link_types: ClassVar[frozenset[int]]
    """Link types of the packets that it is offered (LINKTYPE_ numbers of libpcap)."""
    always: ClassVar[bool] = False
    """Whether the figures say of every capture how much of it there was, instead of captures with
    one of its link types only."""
    options: ClassVar[Sequence[Numbers]] = ()
    reader: ClassVar[str]
    """The ProtocolReader as "package.module:Class", which is imported when a capture needs it: most
    need scapy. It is made with the numbers of each option by its key."""

    @classmethod
    def open(cls, numbers: Mapping[str, frozenset[int]]) -> ProtocolReader:
        """A fresh reader, with those of `numbers` that are its options'. ExtraMissingError."""
        module, _, name = cls.reader.partition(":")
        make = getattr(importlib.import_module(module), name)
        reader: ProtocolReader = make(**{o.key: numbers[o.key] for o in cls.options})
        return reader
