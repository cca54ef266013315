"""The network for a viewer: reading, no commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cardan.bus.network import (
    Answered,
    Asked,
    Handle,
    Heard,
    Network,
    NetworkError,
    PublisherHandle,
    ServiceInfo,
    Topic,
)
from cardan.gateway.servers.tokens import Role

READING_SERVICES = frozenset(
    {
        "cardan_msgs/srv/Stat",
        "rcl_interfaces/srv/DescribeParameters",
        "rcl_interfaces/srv/GetParameterTypes",
        "rcl_interfaces/srv/GetParameters",
        "rcl_interfaces/srv/ListParameters",
        "rl_cartesian_control_msgs/srv/Inv",
        "type_description_interfaces/srv/GetTypeDescription",
        "yarp_control_msgs/srv/GetMaxFeedback",
        "yarp_control_msgs/srv/GetTransformation",
    }
)
"""Types of services that change nothing. All others may be commands: the effect of a Trigger is
unknown."""


class ReadingNetwork:
    """A network without publishing, offering and commands, except stops of arms; refusals are
    NetworkErrors."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def topics(self) -> Mapping[str, Topic]:
        return self._network.topics()

    def services(self) -> Mapping[str, ServiceInfo]:
        return self._network.services()

    def nodes(self) -> Sequence[str]:
        return self._network.nodes()

    def subscribe(self, topic: str, type_name: str | None, heard: Heard) -> Handle:
        return self._network.subscribe(topic, type_name, heard)

    def advertise(self, topic: str, type_name: str, latched: bool) -> PublisherHandle:
        raise _refusal(f"publish on {topic}")

    def call(
        self,
        service: str,
        type_name: str,
        request: bytes,
        answered: Answered,
        timeout_s: float | None,
    ) -> None:
        if type_name not in READING_SERVICES and not self._stops_arm(service, type_name):
            raise _refusal(f"call {service}, which may command something")
        self._network.call(service, type_name, request, answered, timeout_s)

    def _stops_arm(self, service: str, type_name: str) -> bool:
        """Return whether it is the stop of an arm: its node offers the arm's figures too."""
        node, _, name = service.rpartition("/")
        if (name, type_name) != ("stop", "std_srvs/srv/Trigger"):
            return False
        stat = self._network.services().get(f"{node}/stat")
        return stat is not None and stat.type == "cardan_msgs/srv/Stat"

    def serve(self, service: str, type_name: str, asked: Asked) -> Handle:
        raise _refusal(f"offer {service}")

    def part(self, name: str) -> Network:
        return ReadingNetwork(self._network.part(name))

    def close(self) -> None:
        self._network.close()


def _refusal(what: str) -> NetworkError:
    return NetworkError(f"a viewer may not {what}: connect with the token of an operator")


def network_for(role: Role, network: Network) -> Network:
    """Return `network` with the rights of this role."""
    return network if role >= Role.OPERATOR else ReadingNetwork(network)
