"""The parts of a protocol's dissector, and what is printed of the values that its codec decodes."""

from __future__ import annotations

import enum
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

from cardan.errors import ConfigurationError
from cardan_dissect import network
from cardan_dissect.capture import CapturedPacket
from cardan_dissect.network import Endpoint, Segment

CUT = "cut by the capture"
"""Why a message that is not whole in the capture is malformed."""
SHOWN_BYTES = 24
"""Bytes shown of a malformed message; the first fields show its intended type."""


class Decoded(NamedTuple):
    """Bytes of a message as decoded by a codec."""

    value: Any
    """A named tuple, or names and values; None where the bytes are malformed. A function that gives
    it is called when it is shown; then there must be a title."""
    title: str = ""
    """Title of the message; empty: that of the value's class."""
    fault: str = ""
    """Why it is malformed; what stands before a colon is counted."""
    sequence: int | None = None
    """The sender's count of its messages, where it has one, modulo 2**32."""
    asks: int | None = None
    """Value that the answer to it repeats, where the protocol has that."""
    answers: int | None = None
    """Value repeated from the message that it answers; None: it answers the newest one."""
    remarks: tuple[str, ...] = ()
    """Remarks about it besides its values."""


class Message(NamedTuple):
    """A message in a packet."""

    packet: CapturedPacket
    where: str
    """Sender and receiver; figures are kept by this."""
    decoded: Decoded
    data: bytes
    other_way: str = ""
    """Where the answers to it are."""


class Note(NamedTuple):
    """A remark about a capture besides its messages."""

    packet: CapturedPacket
    where: str
    text: str


Found = Iterable[Message | Note]


class Numbers(NamedTuple):
    """An option that adds numbers to those a protocol is looked for at: ports, nodes."""

    key: str
    """The keyword of :func:`cardan_dissect.dissect_file`."""
    flag: str
    """On the command line, without the leading dashes; it can be given several times."""
    metavar: str
    help: str
    """In a few words without a full stop; that the option is repeatable is added."""
    what: str
    """Noun for such a number ("UDP port")."""
    allowed: range = range(1, 0x10000)
    usual: frozenset[int] = frozenset()
    """Numbers that are always looked at."""

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


class Dissector(ABC):
    """A protocol as ``cardan dissect`` has it: where it is looked for, its options, its codec.

    The class's docstring says in a line what it reads. A dissector is made for each capture that
    has one of its link types; it sees their packets in order and takes those of its protocol.
    """

    name: ClassVar[str]
    """The protocol's, in the figures of a capture."""
    page: ClassVar[str]
    """Where it is described: a page under docs/, or an address."""
    link_types: ClassVar[frozenset[int]] = network.LINK_TYPES
    """Link types of the packets that it is offered (LINKTYPE_ numbers of libpcap)."""
    always: ClassVar[bool] = False
    """Whether the figures say of every capture how much of it there was, instead of captures with
    one of its link types only."""
    options: ClassVar[Sequence[Numbers]] = ()

    def __init__(self, numbers: Mapping[str, frozenset[int]]) -> None:
        self.numbers = numbers
        """Numbers of each option by its key."""
        self.packets = 0
        """Packets that belong to the protocol, those without a message of it included. When it has
        grown, the packet is not offered to the dissectors after this one."""

    @abstractmethod
    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        """Return messages of a packet. `network` is :func:`cardan_dissect.network.parse`'s result.

        Messages can be those of earlier packets, which were held back.
        """

    def finish(self) -> Found:
        """Return messages held back when the capture ends."""
        return ()

    def about(self, where: str) -> str:
        """Return text for the figures about the ends at `where`, besides their messages."""
        return ""

    def recognized(self, messages: Sequence[Message], end: Endpoint, other: Endpoint) -> str:
        """Describe the sides ("the robot at ...") of a flow between two ends that was read on
        trial, with the port of `end` as a number of the first option, if its first messages can be
        no other protocol's; else empty, as it is where a protocol is found without ports."""
        return ""


class DatagramDissector(Dissector):
    """A protocol on UDP, a message in each datagram."""

    always = True

    @abstractmethod
    def decode(self, segment: Segment) -> Decoded | None:
        """A datagram; None: it is another protocol's."""

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        if isinstance(network, str) or network.protocol != "UDP":
            return ()
        decoded = self.decode(network)
        if decoded is None:
            return ()
        if network.cut:
            decoded = Decoded(None, decoded.title, CUT)
        self.packets += 1
        return (message_in(packet, network, decoded),)


def message_in(packet: CapturedPacket, segment: Segment, decoded: Decoded) -> Message:
    """Return the message of a datagram."""
    where, other_way = _ways(segment.source, segment.destination)
    return tuple.__new__(Message, (packet, where, decoded, segment.payload, other_way))


@functools.lru_cache(maxsize=1024)
def _ways(source: Endpoint, destination: Endpoint) -> tuple[str, str]:
    return f"{source} > {destination}", f"{destination} > {source}"


def value_of(decoded: Decoded) -> Any:
    """The values of a message, decoded now where they were not before."""
    return decoded.value() if callable(decoded.value) else decoded.value


def describe(decoded: Decoded) -> str:
    """Return title and values, one after the other; absent values are left out."""
    value = value_of(decoded)
    title = decoded.title or type(value).__name__
    fields = value if isinstance(value, Mapping) else value._asdict()
    return " | ".join((title, *_named(fields.items()), *decoded.remarks))


def _named(fields: Iterable[tuple[str, Any]]) -> list[str]:
    return [f"{name} {_text(each.__class__)(each)}" for name, each in fields if each is not None]


@functools.lru_cache(maxsize=1024)
def _text(kind: type) -> Callable[[Any], str]:
    """Return the formatter for values of this type."""
    if issubclass(kind, float):
        return "{:.8g}".format
    if issubclass(kind, enum.Enum):
        return lambda value: value.name
    if issubclass(kind, bytes):
        return lambda value: value.hex(" ") or "(none)"
    if issubclass(kind, str):
        return repr
    if hasattr(kind, "_asdict"):
        return _text_of_fields(kind)
    if issubclass(kind, tuple | list):
        return _text_of_list
    return str


def _text_of_fields(kind: Any) -> Callable[[Any], str]:
    names = kind._fields
    numbers = f"({', '.join(f'{name} %.8g' for name in names)})"

    def text(value: Any) -> str:
        if set(map(type, value)) == {float}:
            return numbers % value
        return f"({', '.join(_named(zip(names, value, strict=True)))})"

    return text


def _text_of_list(value: Sequence[Any]) -> str:
    if set(map(type, value)) == {float}:
        return ("%.8g " * len(value) % tuple(value))[:-1]
    return " ".join([_text(each.__class__)(each) for each in value]) or "(none)"


def excerpt(data: bytes) -> str:
    """The length of malformed bytes, and the first of them in hex."""
    more = " ..." if len(data) > SHOWN_BYTES else ""
    return f"({len(data)} B: {data[:SHOWN_BYTES].hex(' ')}{more})"
