"""The network's graph for clients of a server: topics, services, and their definitions."""

from __future__ import annotations

from cardan.bus.network import Network, ServiceInfo, Topic
from cardan.gateway.servers.allow_list import Allowed
from cardan.protocols.ros2.interfaces import InterfaceError, full_text, message_type


class VisibleGraph:
    """The graph as far as clients may see it, without the topics and services of actions."""

    def __init__(self, network: Network, allowed: Allowed) -> None:
        self._network, self._allowed = network, allowed

    def topics(self) -> dict[str, Topic]:
        """The topics by name."""
        return {
            name: topic
            for name, topic in self._network.topics().items()
            if self._allowed.topic(name) and not _is_hidden(name)
        }

    def services(self) -> dict[str, ServiceInfo]:
        """The services by name."""
        return {
            name: service
            for name, service in self._network.services().items()
            if self._allowed.service(name) and not _is_hidden(name)
        }

    def callable_services(self) -> dict[str, ServiceInfo]:
        """The services that clients may call. If parameters are restricted, the parameter services
        of nodes are left out."""
        services = self.services().items()
        return {name: each for name, each in services if self._allowed.call(each.type)}


def definition(type_name: str) -> str:
    """Return the full definition of a message's type; empty if Cardan does not know it."""
    try:
        message_type(type_name)
        return full_text(type_name)
    except InterfaceError:
        return ""


def _is_hidden(name: str) -> bool:
    """Return whether ``ros2 topic list`` leaves it out: a part of it begins with _."""
    return "/_" in name
