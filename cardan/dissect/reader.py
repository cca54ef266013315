"""What one protocol makes of a capture: the interface, and the table of protocols there are.

A new protocol is a module with a :class:`ProtocolReader` and a line in :data:`READERS`, or in
:data:`LINK_READERS` when it is found on links of one kind only.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from typing import ClassVar, NamedTuple

from cardan.dissect.capture import CapturedPacket
from cardan.dissect.network import Segment
from cardan.dissect.ports import SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT

PacketLine = tuple[CapturedPacket, str]
"""A line to print, with the packet that it is about."""

READERS = (
    "cardan.dissect.egm_reader:EgmReader",
    "cardan.dissect.connexion_reader:ConnexionReader",
    "cardan.dissect.joint_stream_reader:JointStreamReader",
    "cardan.dissect.simple_message_reader:SimpleMessageReader",
)
"""By name, because the modules need scapy."""
LINK_READERS = {
    187: "cardan.dissect.wiimote_reader:WiimoteReader",
    201: "cardan.dissect.wiimote_reader:WiimoteReader",
    227: "cardan.dissect.jr3_can_reader:Jr3CanReader",
}
"""By the link type whose first frame makes them worth loading: Bluetooth HCI and CAN."""


class Options(NamedTuple):
    """What the user can choose."""

    egm_ports: frozenset[int]
    """UDP ports of a PC."""
    simple_message_ports: frozenset[int] = frozenset(
        (*SIMPLE_MESSAGE_PORTS, SIMPLE_MESSAGE_RT_CONTROL_PORT)
    )
    """TCP ports of a controller."""
    jr3_nodes: frozenset[int] = frozenset()
    """Node ids of JR3 boards on CAN besides those that are recognised."""


class ProtocolReader(ABC):
    """Sees every frame of a capture in order and takes those of its protocol."""

    name: ClassVar[str]

    def __init__(self, options: Options) -> None:
        self.frames = 0
        """Frames that belong to the protocol, those without a message of it included."""
        self.messages = 0
        """Datagrams, reports or messages of a stream shown, malformed ones included."""
        self.malformed: Counter[str] = Counter()
        """Those that are not what they should be, by reason."""

    @abstractmethod
    def feed(self, frame: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        """Lines to show, each with its frame; none when the frame holds nothing of the protocol.

        `network` is what :func:`cardan.dissect.network.parse` says of the frame.
        """

    def finish(self) -> Iterable[PacketLine]:
        """Lines that were held back when the capture ended."""
        return ()

    @abstractmethod
    def summary(self) -> Iterable[str]:
        """Lines about everything that was fed."""


def load_readers(options: Options) -> list[ProtocolReader]:
    """A fresh reader of every protocol; ScapyMissingError without scapy."""
    return [_load(target, options) for target in READERS]


def load_link_reader(
    link_type: int, readers: list[ProtocolReader], options: Options
) -> ProtocolReader | None:
    """A fresh reader of what only links of this type carry; None when there is none, or when
    `readers` have it."""
    target = LINK_READERS.get(link_type)
    if target is None or any(f"{type(r).__module__}:{type(r).__name__}" == target for r in readers):
        return None
    return _load(target, options)


def _load(target: str, options: Options) -> ProtocolReader:
    module, _, name = target.partition(":")
    reader: ProtocolReader = getattr(importlib.import_module(module), name)(options)
    return reader
