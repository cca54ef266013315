"""Subscriptions of a client, merged by topic."""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.rosbridge.operations import COMPRESSIONS, Id, Subscribe, Unsubscribe

MAX_SUBSCRIPTIONS = 1000
"""Most subscriptions of a client."""


class Delivery(NamedTuple):
    """Merged subscription of a client to a topic."""

    throttle_s: float
    queue_length: int
    compression: str
    fragment_size: int


class Subscriptions:
    """Subscriptions of a client, those to one topic merged to one stream."""

    def __init__(self) -> None:
        self._of_topic: dict[str, dict[Id, Subscribe]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._of_topic.values()))

    def topics(self) -> list[str]:
        """Topics by the client's names."""
        return list(self._of_topic)

    def add(self, asked: Subscribe) -> Delivery:
        """Add a subscription, replacing one with the same id; return the topic's delivery."""
        self._of_topic.setdefault(asked.topic, {})[asked.id] = asked
        return self._merged(asked.topic)

    def remove(self, asked: Unsubscribe) -> Delivery | None:
        """Remove a subscription; return the remaining delivery of the topic, or None."""
        ids = self._of_topic.get(asked.topic, {})
        if asked.id is None:
            ids.clear()
        ids.pop(asked.id, None)
        if not ids:
            self._of_topic.pop(asked.topic, None)
            return None
        return self._merged(asked.topic)

    def _merged(self, topic: str) -> Delivery:
        all_of_it = self._of_topic[topic].values()
        sizes = [each.fragment_size for each in all_of_it if each.fragment_size]
        return Delivery(
            min(each.throttle_ms for each in all_of_it) * 1e-3,
            min(each.queue_length for each in all_of_it),
            max((each.compression for each in all_of_it), key=COMPRESSIONS.index),
            min(sizes, default=0),
        )
