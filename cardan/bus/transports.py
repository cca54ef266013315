"""Nodes of plug-ins on another transport than Zenoh: their interface for drivers and simulated
robots, and their discovery."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from cardan.bus.dds_options import DdsOptions
from cardan.bus.node import Received
from cardan.common.plugins import Finder, entry_points
from cardan.protocols.ros2.zenoh import DEFAULT_QOS, Qos

ENTRY_POINT_GROUP = "cardan.buses"


class OtherPublisher(Protocol):
    """Publishes messages of one type on one topic."""

    def put(self, data: bytes | bytearray, now_ns: int, /) -> None:
        """Publish an encoded message. Never waits for a subscriber."""

    def put_as(self, sequence: int, data: bytes | bytearray, now_ns: int, /) -> None:
        """The same with a number, where the transport has none of its own."""

    @property
    def heard(self) -> bool:
        """True if there is a subscriber."""

    def close(self) -> None:
        """Leave the graph."""


class OtherSubscription(Protocol):
    """Receives the messages of one topic."""

    def wait(self, timeout_s: float) -> Received | None:
        """The oldest message that is kept, or the next one; None where none comes in time."""

    def poll(self) -> Received | None:
        """The oldest message that is kept, None where there is none."""

    def wake(self) -> None:
        """End a wait in another thread, without a message."""

    def close(self) -> None:
        """Leave the graph."""


class OtherGraph(Protocol):
    """The nodes of other programs on the transport."""

    def look(self) -> None:
        """Update the known nodes."""

    def writer(self, gid: bytes) -> str:
        """Full name of the node whose publisher has this id in attachments; empty: unknown."""

    def close(self) -> None:
        """Look no more."""


class OtherNode(ABC):
    """A node: BusNode as far as drivers and simulated robots need it."""

    @abstractmethod
    def __init__(self, options: DdsOptions, name: str) -> None:
        """Not on the transport before it is opened."""

    @abstractmethod
    def open(self) -> None:
        """Join. Raises ExtraMissingError, ConfigurationError, or DriverError."""

    @abstractmethod
    def close(self) -> None:
        """Leave, with all that it has there. Twice is fine."""

    @abstractmethod
    def publisher(self, name: str, type_name: str, qos: Qos = DEFAULT_QOS) -> OtherPublisher:
        """A publisher of a topic. Raises InterfaceError, RosNameError or DriverError."""

    @abstractmethod
    def waiting_subscription(
        self, name: str, type_name: str, depth: int, qos: Qos = DEFAULT_QOS
    ) -> OtherSubscription:
        """A subscription that keeps the newest `depth` messages. Raises InterfaceError,
        RosNameError or DriverError."""

    @abstractmethod
    def graph_reader(self) -> OtherGraph:
        """A reader of the nodes that are there. Raises DriverError."""


FINDER: Finder[OtherNode] = Finder(
    OtherNode,  # type: ignore[type-abstract]
    "transport",
    {},
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
load, load_all = FINDER.load, FINDER.load_all
