"""The ROS network behind a server: topics and services of other processes, messages as CDR."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol


class Topic(NamedTuple):
    """A topic with a publisher or subscriber."""

    type: str
    """In full: "geometry_msgs/msg/PoseStamped"."""
    publishers: tuple[str, ...] = ()
    """Full names of the nodes that publish."""
    subscribers: tuple[str, ...] = ()
    latched: bool = False
    """True if a subscription begins with the last messages (transient local)."""


class ServiceInfo(NamedTuple):
    """A service that a node offers."""

    type: str
    """In full: "std_srvs/srv/Trigger"."""
    servers: tuple[str, ...] = ()
    """Full names of the nodes that offer it."""


class NetworkError(Exception):
    """Request that the network cannot carry out; the text gives the reason."""


class Failure(NamedTuple):
    """Reason why a call has no reply."""

    reason: str


class Handle(Protocol):
    """Subscription, publisher or service on the network until it is closed."""

    def close(self) -> None:
        """Remove it from the network; no callback follows. May be called twice."""


class PublisherHandle(Handle, Protocol):
    """Publishes on one topic."""

    def publish(self, cdr: bytes, sent_ns: int = 0) -> None:
        """Publish a message: plain CDR with its encapsulation, of exact length.

        `sent_ns`: time when the original sender sent it, ns since the epoch, for the reader's
        measurement of latency; 0: now. DDS always stamps the present time."""


Heard = Callable[[bytes, int], None]
"""A message: CDR with its encapsulation, and the time it was published, ns since the epoch."""

Answered = Callable[["bytes | Failure"], None]
"""The reply to a call: CDR with its encapsulation."""

Asked = Callable[[bytes, Answered], None]
"""Request to an offered service, and the callback for its reply, to be called once."""


class Network(Protocol):
    """The ROS graph, and operations on it.

    Methods are called from one thread, and do not block. Callbacks may be called from any thread.
    Names are absolute, types in full.
    """

    def topics(self) -> Mapping[str, Topic]:
        """All topics by name, actions' among them."""

    def services(self) -> Mapping[str, ServiceInfo]:
        """All services by name, actions' among them."""

    def nodes(self) -> Sequence[str]:
        """Full names of all nodes."""

    def subscribe(self, topic: str, type_name: str | None, heard: Heard) -> Handle:
        """Call `heard` with each message; type None: any type. A latched topic begins with its last
        messages. Raises NetworkError."""

    def advertise(self, topic: str, type_name: str, latched: bool) -> PublisherHandle:
        """Return a publisher; `latched`: for later subscriptions too. Raises NetworkError."""

    def call(
        self,
        service: str,
        type_name: str,
        request: bytes,
        answered: Answered,
        timeout_s: float | None,
    ) -> None:
        """Call a service; `answered` is called once, with a Failure after `timeout_s` (None: no
        limit). Raises NetworkError."""

    def serve(self, service: str, type_name: str, asked: Asked) -> Handle:
        """Offer a service; `asked` is called with each request. Raises NetworkError."""

    def part(self, name: str) -> Network:
        """Return the same network as a separate node, for one client of a server: the client's
        endpoints and the motions without end that it requested end with it. Raises DriverError."""

    def close(self) -> None:
        """Leave the network, and close all open endpoints. Never raises; may be called twice."""
