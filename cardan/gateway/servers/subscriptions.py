"""Subscriptions of a server's clients: each topic is subscribed to once for all."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from cardan.bus.network import Handle, Network

KeyT = TypeVar("KeyT")
ReceiverT = TypeVar("ReceiverT")


class TopicSubscription(ABC, Generic[KeyT, ReceiverT]):
    """A topic with subscribed clients, subscribed to once on the network."""

    def __init__(self, network: Network, topic: str, type_name: str | None) -> None:
        """Raises NetworkError."""
        self.topic, self.type = topic, type_name
        self.receivers: dict[KeyT, ReceiverT] = {}
        self._network = network
        self._handle: Handle | None = None

    def open(self) -> None:
        """Subscribe. Raises NetworkError."""
        self._handle = self._network.subscribe(self.topic, self.type, self._hear)

    def close(self) -> None:
        """Leave the network."""
        if self._handle is not None:
            self._handle.close()

    @abstractmethod
    def _hear(self, cdr: bytes, stamp_ns: int) -> None:
        """Handle a message; in any thread."""


SubscriptionT = TypeVar("SubscriptionT", bound=TopicSubscription[Any, Any])


class SharedSubscriptions(Generic[SubscriptionT]):
    """All topics with subscribed clients."""

    def __init__(self, make: Callable[[str, str | None], SubscriptionT]) -> None:
        """`make(topic, type)` makes a subscription that is not open."""
        self._make = make
        self._shared: dict[tuple[str, str | None], SubscriptionT] = {}

    def join(
        self, topic: str, type_name: str | None, latched: bool, key: object, receiver: object
    ) -> SubscriptionT:
        """Send a topic's messages to a client. Raises NetworkError. A `latched` topic is subscribed
        to again, because the network begins with its last messages."""
        subscription = None if latched else self._shared.get((topic, type_name))
        if subscription is not None:
            subscription.receivers[key] = receiver
            return subscription
        subscription = self._make(topic, type_name)
        subscription.receivers[key] = receiver
        subscription.open()
        if not latched:
            self._shared[topic, type_name] = subscription
        return subscription

    def leave(self, subscription: SubscriptionT, key: object) -> None:
        """Unsubscribe a client; idempotent."""
        subscription.receivers.pop(key, None)
        if not subscription.receivers:
            subscription.close()
            if self._shared.get((subscription.topic, subscription.type)) is subscription:
                del self._shared[subscription.topic, subscription.type]
