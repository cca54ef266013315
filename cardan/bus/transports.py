"""Interface of nodes on other transports than Zenoh, for drivers and simulated robots, and their
discovery."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from cardan.bus.dds_options import DdsOptions
from cardan.bus.node import Received
from cardan.common.plugins import Finder, entry_points
from cardan.protocols.ros2.zenoh import DEFAULT_QOS, Qos

ENTRY_POINT_GROUP = "cardan.buses"


class OtherPublisher(Protocol):
    """Publisher of messages of one type on one topic."""

    def put(self, data: bytes | bytearray, now_ns: int, /) -> None:
        """Publish an encoded message. Never waits for a subscriber."""

    def put_as(self, sequence: int, data: bytes | bytearray, now_ns: int, /) -> None:
        """Publish with a sequence number, if the transport has none."""

    @property
    def heard(self) -> bool:
        """Return True if there is a subscriber."""

    def close(self) -> None:
        """Leave the graph."""


class OtherSubscription(Protocol):
    """Subscription to one topic."""

    def wait(self, timeout_s: float) -> Received | None:
        """Return the oldest message in the queue, or the next one; None if none arrives in time."""

    def poll(self) -> Received | None:
        """Return the oldest message in the queue, or None."""

    def wake(self) -> None:
        """End a wait in another thread, without a message."""

    def close(self) -> None:
        """Leave the graph."""


class OtherGraph(Protocol):
    """Nodes of other programs on the transport."""

    def look(self) -> None:
        """Update the known nodes."""

    def writer(self, gid: bytes) -> str:
        """Return the full name of the node whose publisher has this id; empty: unknown."""

    def close(self) -> None:
        """Stop watching."""


class OtherNode(ABC):
    """Node with the part of BusNode's interface that drivers and simulated robots need."""

    @abstractmethod
    def __init__(self, options: DdsOptions, name: str) -> None:
        """Prepare a node; `open` joins the transport."""

    @abstractmethod
    def open(self) -> None:
        """Join. Raises ExtraMissingError, ConfigurationError, or DriverError."""

    @abstractmethod
    def close(self) -> None:
        """Leave, and close all endpoints. May be called twice."""

    @abstractmethod
    def publisher(self, name: str, type_name: str, qos: Qos = DEFAULT_QOS) -> OtherPublisher:
        """Return a publisher of a topic. Raises InterfaceError, RosNameError or DriverError."""

    @abstractmethod
    def waiting_subscription(
        self, name: str, type_name: str, depth: int, qos: Qos = DEFAULT_QOS
    ) -> OtherSubscription:
        """Return a subscription that keeps the newest `depth` messages. Raises InterfaceError,
        RosNameError or DriverError."""

    @abstractmethod
    def graph_reader(self) -> OtherGraph:
        """Return a reader of the graph of nodes. Raises DriverError."""


FINDER: Finder[OtherNode] = Finder(
    OtherNode,  # type: ignore[type-abstract]
    "transport",
    {},
    lambda: entry_points(group=ENTRY_POINT_GROUP),
)
load, load_all = FINDER.load, FINDER.load_all
