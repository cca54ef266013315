"""Parts of a protocol's dissector, and formatting of the decoded values."""

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
"""Reason why a message that is incomplete in the capture is malformed."""
SHOWN_BYTES = 24
"""Number of shown bytes of a malformed message; the first fields show its intended type."""


class Decoded(NamedTuple):
    """Bytes of a message as decoded by a codec."""

    value: Any
    """Named tuple, or names and values; None if the bytes are malformed. A function that returns it
    is called for display; then a title is required."""
    title: str = ""
    """Title of the message; empty: that of the value's class."""
    fault: str = ""
    """Why it is malformed; the words before a colon are counted."""
    sequence: int | None = None
    """Sender's count of its messages, if it has one, modulo 2**32."""
    asks: int | None = None
    """Value that the reply to it repeats, if the protocol has one."""
    answers: int | None = None
    """Value repeated from the message that it answers; None: it answers the newest one."""
    remarks: tuple[str, ...] = ()
    """Remarks about it in addition to its values."""


class Message(NamedTuple):
    """Message in a packet."""

    packet: CapturedPacket
    where: str
    """Sender and receiver, the key of its figures."""
    decoded: Decoded
    data: bytes
    other_way: str = ""
    """Sender and receiver of its replies."""


class Note(NamedTuple):
    """Remark about a capture in addition to its messages."""

    packet: CapturedPacket
    where: str
    text: str


Found = Iterable[Message | Note]


class Numbers(NamedTuple):
    """Option that adds numbers, such as ports or nodes, to those where a protocol is expected."""

    key: str
    """Keyword of :func:`cardan_dissect.dissect_file`."""
    flag: str
    """Name on the command line, without the leading dashes; it is repeatable."""
    metavar: str
    help: str
    """Short help without a full stop; a remark that the option is repeatable is appended."""
    what: str
    """Noun for such a number ("UDP port")."""
    allowed: range = range(1, 0x10000)
    usual: frozenset[int] = frozenset()
    """Numbers that are always examined."""

    def with_usual(self, more: Iterable[int]) -> frozenset[int]:
        """Return the usual numbers and `more`. Raises ConfigurationError for one out of range."""
        numbers = frozenset(more)
        if wrong := sorted(numbers.difference(self.allowed)):
            listed = ", ".join(map(str, wrong))
            raise ConfigurationError(
                self.key,
                f"{self.what} {listed}: allowed are {self.allowed[0]} to {self.allowed[-1]}",
            )
        return self.usual | numbers


class Dissector(ABC):
    """Protocol of ``cardan dissect``: its ports, options and codec.

    The class's docstring is a one-line description. A dissector is made for each capture that has
    one of its link types; it sees their packets in order and takes those of its protocol.
    """

    name: ClassVar[str]
    """Name of the protocol in the figures of a capture."""
    page: ClassVar[str]
    """Its documentation: a page under docs/, or a URL."""
    link_types: ClassVar[frozenset[int]] = network.LINK_TYPES
    """Link types of the packets that it is offered (LINKTYPE_ numbers of libpcap)."""
    always: ClassVar[bool] = False
    """True if the figures of every capture have its count, not only those of captures with one of
    its link types."""
    options: ClassVar[Sequence[Numbers]] = ()

    def __init__(self, numbers: Mapping[str, frozenset[int]]) -> None:
        self.numbers = numbers
        """Numbers of each option by its key."""
        self.packets = 0
        """Number of packets of the protocol, including those without a message. After an increase
        the packet is not offered to later dissectors."""

    @abstractmethod
    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        """Return messages of a packet. `network` is :func:`cardan_dissect.network.parse`'s result.

        They may be from earlier packets that were held back.
        """

    def finish(self) -> Found:
        """Return messages held back at the end of the capture."""
        return ()

    def about(self, where: str) -> str:
        """Return text for the figures about the ends at `where`, in addition to their messages."""
        return ""

    def recognized(self, messages: Sequence[Message], end: Endpoint, other: Endpoint) -> str:
        """Describe the sides ("the robot at ...") of a flow between two ends that was tried with
        the port of `end` as the first option, if its first messages fit no other protocol; else,
        and for protocols recognized without ports, return empty."""
        return ""


class DatagramDissector(Dissector):
    """A protocol on UDP, a message in each datagram."""

    always = True

    @abstractmethod
    def decode(self, segment: Segment) -> Decoded | None:
        """Decode a datagram; None if it is another protocol's."""

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
    """Return the values of a message, decoded now if they were not before."""
    return decoded.value() if callable(decoded.value) else decoded.value


def describe(decoded: Decoded) -> str:
    """Return title and values in sequence; absent values are omitted."""
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
    """Return the length of malformed bytes, and the first of them in hex."""
    more = " ..." if len(data) > SHOWN_BYTES else ""
    return f"({len(data)} B: {data[:SHOWN_BYTES].hex(' ')}{more})"
