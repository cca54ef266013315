"""The parameters of the network's nodes, for the clients of a server: "/node:parameter"."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

from cardan.bus.network import Network, NetworkError
from cardan.errors import shown
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.calls import CallError, ServiceCaller
from cardan.protocols.ros2.cdr import CdrError, Message
from cardan.protocols.ros2.interfaces import service_type
from cardan.protocols.ros2.messages import completed

TIMEOUT_S = 5.0
"""Longest wait for a node's parameters, the same as in rosapi."""

EVENTS, EVENT = "/parameter_events", "rcl_interfaces/msg/ParameterEvent"
"""Topic on which nodes report changes of their parameters."""

VALUE = "rcl_interfaces/msg/ParameterValue"

_LIST = "/list_parameters"


def parameter_name(name: str) -> tuple[str, str]:
    """Node and parameter of ``/node:parameter``. Raises ValueError."""
    node, colon, parameter = name.partition(":")
    if not node or not colon or not parameter:
        raise ValueError(f"{shown(name)} names no parameter; one looks like /node:parameter")
    return (node if node.startswith("/") else f"/{node}"), parameter


class NodeParameters:
    """Reads and sets parameters by the nodes' own services, as far as clients may."""

    def __init__(self, network: Network, caller: ServiceCaller, allowed: Allowed) -> None:
        self._network, self._caller, self._allowed = network, caller, allowed

    def nodes(self) -> list[str]:
        """Return the full names of the nodes that have parameters."""
        return [
            name.removesuffix(_LIST)
            for name, service in self._network.services().items()
            if name.endswith(_LIST) and service.type == "rcl_interfaces/srv/ListParameters"
        ]

    async def names(self) -> list[str]:
        """Return all names that clients may use, sorted, without nodes that do not answer."""
        nodes = self.nodes()
        found = await asyncio.gather(*map(self._names_of, nodes))
        names = [f"{node}:{name}" for node, own in zip(nodes, found, strict=True) for name in own]
        return sorted(filter(self._allowed.parameter, names))

    async def _names_of(self, node: str) -> list[str]:
        try:
            response = await self._call(node, "list_parameters", "ListParameters", {})
        except REFUSALS:
            return []
        return [str(name) for name in response["result"]["names"]]

    async def value(self, name: str) -> Message:
        """Return the ``rcl_interfaces/msg/ParameterValue``. Raises one of REFUSALS."""
        return (await self.values_of([name]))[name]

    async def values_of(self, names: Sequence[str]) -> dict[str, Message]:
        """Return the values of parameters of one node, by name. Raises one of REFUSALS."""
        node = self.checked(names[0])[0]
        asked = [self.checked(name)[1] for name in names]
        response = await self._call(node, "get_parameters", "GetParameters", {"names": asked})
        values = response["values"] if len(response["values"]) == len(asked) else [{}] * len(asked)
        return {name: completed(VALUE, value) for name, value in zip(names, values, strict=True)}

    async def change(self, name: str, value: Message) -> Message:
        """Set a parameter; return the result with its `successful` and `reason`. Raises one of
        REFUSALS."""
        node, parameter = self.checked(name)
        change = {"parameters": [{"name": parameter, "value": value}]}
        response = await self._call(node, "set_parameters", "SetParameters", change)
        results = response["results"]
        if not results:
            raise CallError(f"{node} did not say whether it did")
        return {"successful": results[0]["successful"], "reason": results[0]["reason"]}

    def checked(self, name: str) -> tuple[str, str]:
        """Return node and parameter. Raises ValueError, also if clients may not use it."""
        node, parameter = parameter_name(name)
        if not self._allowed.parameter(f"{node}:{parameter}"):
            raise ValueError(f"{node}:{parameter} is not among the parameters that clients may use")
        return node, parameter

    async def _call(self, node: str, name: str, kind: str, request: Mapping[str, Any]) -> Message:
        service, type_name = f"{node}/{name}", f"rcl_interfaces/srv/{kind}"
        if service not in self._network.services():
            raise CallError(f"there is no node {node} with parameters")
        whole = completed(service_type(type_name).request, request)
        return await self._caller.start(service, type_name, whole, TIMEOUT_S)


REFUSALS = (ValueError, CallError, NetworkError, CdrError)
"""Errors of requests for parameters; MessageError and InterfaceError are ValueErrors."""
