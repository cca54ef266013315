"""Topics that a client of a server publishes on."""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

from cardan.bus.network import Network, PublisherHandle
from cardan.gateway.servers.allow_list import Allowed
from cardan.protocols.ros2.interfaces import full_name, message_type
from cardan.protocols.ros2.names import checked_name

MAX_ADVERTISED = 1000
"""Most topics that a client publishes on."""


class RefusedError(Exception):
    """Error: the client's request cannot be carried out."""


class Advertised(NamedTuple):
    """A topic that the client publishes on."""

    type: str
    publisher: PublisherHandle
    ids: set[Hashable]
    """The client's ids of its advertisements; the topic stays until the last one has gone."""


class Advertisements:
    """All topics that a client publishes on, each of one type."""

    def __init__(self, network: Network, allowed: Allowed) -> None:
        self._network, self._allowed = network, allowed
        self._of_topic: dict[str, Advertised] = {}

    def topic(self, name: str) -> str:
        """Return the absolute name of a topic that the client may use. Raises RefusedError and
        RosNameError."""
        topic = checked_name(name)
        if not self._allowed.topic(topic):
            raise RefusedError(f"{topic} is not among the topics that clients may use")
        return topic

    def get(self, topic: str) -> Advertised | None:
        """Return the client's advertisement of a topic; None if it does not publish there."""
        return self._of_topic.get(topic)

    def type_of(self, topic: str) -> str:
        """Return the type of the topic for this client or on the network; empty: none yet."""
        known = self._of_topic.get(topic) or self._network.topics().get(topic)
        return known.type if known else ""

    def add(self, topic: str, type_name: str, latched: bool, identity: Hashable) -> Advertised:
        """Publish on a topic, of this type or, if it is empty, of the topic's. Raises RefusedError,
        InterfaceError and NetworkError."""
        wanted = agreed_type(topic, type_name, self.type_of(topic))
        found = self._of_topic.get(topic)
        if found is not None:
            found.ids.add(identity)
            return found
        if len(self._of_topic) >= MAX_ADVERTISED:
            raise RefusedError(f"{MAX_ADVERTISED} topics are advertised; no more are taken")
        message_type(wanted)
        publisher = self._network.advertise(topic, wanted, latched)
        found = self._of_topic[topic] = Advertised(wanted, publisher, {identity})
        return found

    def remove(self, topic: str, identity: Hashable) -> None:
        """Remove one advertisement; None: all. Raises RefusedError if there is none."""
        found = self._of_topic.get(topic)
        if found is None:
            raise RefusedError(f"{topic} is not advertised")
        found.ids.discard(identity)
        if identity is None or not found.ids:
            del self._of_topic[topic]
            found.publisher.close()

    def close(self) -> None:
        """Remove all."""
        for each in self._of_topic.values():
            each.publisher.close()
        self._of_topic.clear()


def agreed_type(name: str, asked: str, present: str) -> str:
    """Return the type that a topic has or gets; empty if neither is given. Raises RefusedError if
    they differ."""
    wanted = full_name(asked) if asked else ""
    if wanted and present and wanted != present:
        raise RefusedError(f"{name} is of type {present}, not {wanted}")
    return wanted or present
