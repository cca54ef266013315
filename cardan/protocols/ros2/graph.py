"""ROS graph from liveliness tokens: nodes, topics, services, and the nodes that have them."""

from __future__ import annotations

from collections.abc import Iterable

from cardan.protocols.ros2.zenoh import NODE, PUBLISHER, SERVICE, SUBSCRIPTION, Entity


class Graph:
    """Entities on the bus. Tokens may be declared twice, or removed without having been
    declared."""

    def __init__(self) -> None:
        self._entities: dict[str, Entity] = {}
        self.strange = 0
        """Number of tokens that are not ROS 2's."""

    def add(self, token: str) -> Entity | None:
        """Add a declared token; return the entity if it is new."""
        entity = Entity.parse(token)
        if entity is None:
            self.strange += 1
            return None
        if token in self._entities:
            return None
        self._entities[token] = entity
        return entity

    def remove(self, token: str) -> Entity | None:
        """Remove a token; return its entity."""
        return self._entities.pop(token, None)

    def clear(self) -> None:
        """Remove all tokens, because the bus is gone."""
        self._entities.clear()

    def entities(self, *kinds: str) -> list[Entity]:
        """Return entities of these kinds; without arguments, of all."""
        return [each for each in self._entities.values() if not kinds or each.kind in kinds]

    def nodes(self) -> list[str]:
        """Return the full names of all nodes, sorted."""
        return sorted({each.full_node for each in self._entities.values()})

    def sessions(self) -> set[str]:
        """Return the Zenoh sessions that have nodes."""
        return {each.zid for each in self._entities.values()}

    def topics(self) -> dict[str, str]:
        """Return the type of each topic with a publisher or a subscription."""
        return _types(self.entities(PUBLISHER, SUBSCRIPTION))

    def services(self) -> dict[str, str]:
        """Return the type of each service that a node offers."""
        return _types(self.entities(SERVICE))

    def publishers(self, topic: str) -> list[Entity]:
        """Return the publishers of `topic`."""
        return self._having(topic, PUBLISHER)

    def subscribers(self, topic: str) -> list[Entity]:
        """Return the subscribers of `topic`."""
        return self._having(topic, SUBSCRIPTION)

    def servers(self, service: str) -> list[Entity]:
        """Return the servers of `service`."""
        return self._having(service, SERVICE)

    def by_name(self, kind: str) -> dict[str, list[Entity]]:
        """Return entities of a kind by the name of their topic or service, sorted by it."""
        found: dict[str, list[Entity]] = {}
        for each in self.entities(kind):
            found.setdefault(each.name, []).append(each)
        return dict(sorted(found.items()))

    def _having(self, name: str, kind: str) -> list[Entity]:
        return [each for each in self.entities(kind) if each.name == name]


def _types(entities: Iterable[Entity]) -> dict[str, str]:
    """Return types by name, sorted by name; of several types, the first declared."""
    types: dict[str, str] = {}
    for each in entities:
        if each.kind != NODE:
            types.setdefault(each.name, each.type_name)
    return dict(sorted(types.items()))
