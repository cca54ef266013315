"""The services of rosapi: queries of rosbridge clients about graph, types and parameters."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from cardan.bus.network import Network, ServiceInfo, Topic
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.calls import ServiceCaller
from cardan.gateway.servers.graph import VisibleGraph, definition
from cardan.gateway.servers.parameters import REFUSALS, VALUE, NodeParameters
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.interfaces import (
    action_type,
    full_name,
    known_types,
    service_type,
)
from cardan.protocols.ros2.messages import Stamp, completed
from cardan.protocols.ros2.parameters import ParameterKind
from cardan.protocols.rosbridge import rosapi

NODE = "/rosapi"
"""Node of these services, named as in rosbridge_suite."""

ROSOUT, LOG = "/rosout", "rcl_interfaces/msg/Log"
"""Topic that is always listed: Lichtblick takes a graph without this type for one of ROS 1."""

_SEND_GOAL = "/_action/send_goal"
_SERVICE_NAMES = {
    "topics": "Topics",
    "topics_and_raw_types": "TopicsAndRawTypes",
    "topic_type": "TopicType",
    "topics_for_type": "TopicsForType",
    "publishers": "Publishers",
    "subscribers": "Subscribers",
    "services": "Services",
    "service_type": "ServiceType",
    "services_for_type": "ServicesForType",
    "service_node": "ServiceNode",
    "service_providers": "ServiceProviders",
    "nodes": "Nodes",
    "node_details": "NodeDetails",
    "action_servers": "ActionServers",
    "action_type": "ActionType",
    "interfaces": "Interfaces",
    "message_details": "MessageDetails",
    "service_request_details": "ServiceRequestDetails",
    "service_response_details": "ServiceResponseDetails",
    "action_goal_details": "ActionGoalDetails",
    "action_result_details": "ActionResultDetails",
    "action_feedback_details": "ActionFeedbackDetails",
    "get_time": "GetTime",
    "get_ros_version": "GetROSVersion",
    "get_param": "GetParam",
    "set_param": "SetParam",
    "delete_param": "DeleteParam",
    "has_param": "HasParam",
    "get_param_names": "GetParamNames",
}
SERVICES = {f"{NODE}/{name}": f"rosapi/srv/{kind}" for name, kind in _SERVICE_NAMES.items()}
"""The type of each service by its name."""


class RosApi:
    """Answers these services from the visible part of the network."""

    def __init__(self, network: Network, caller: ServiceCaller, allowed: Allowed) -> None:
        self._network, self._allowed = network, allowed
        self._graph = VisibleGraph(network, allowed)
        self._parameters = NodeParameters(network, caller, allowed)

    async def answer(self, service: str, args: Any) -> Message:
        """Return the response of the service, one of SERVICES. `args` as sent by the client. Raises
        MessageError and InterfaceError."""
        kind = service_type(SERVICES[service])
        if isinstance(args, Mapping) and "default" in args:  # Its name before ROS 2.
            args = {
                "default_value" if key == "default" else key: each for key, each in args.items()
            }
        request = completed(kind.request, args)
        name = service.rpartition("/")[2]
        if (of_parameters := self._of_parameters(name)) is not None:
            response = await of_parameters(request)
        else:
            response = getattr(self, f"_{name}")(request)
        whole = completed(kind.response, response)
        if name == "get_time":  # roslibpy reads the names that ROS 1 had.
            now = whole["time"]
            whole["time"] = {**now, "secs": now["sec"], "nsecs": now["nanosec"]}
        return whole

    # -- graph -----------------------------------------------------------------------------------

    def visible_topics(self) -> dict[str, Topic]:
        """Return the topics that clients may see, without those of actions, sorted."""
        found = self._graph.topics()
        found.setdefault(ROSOUT, Topic(LOG))
        return dict(sorted(found.items()))

    def visible_services(self) -> dict[str, ServiceInfo]:
        """Return the services that clients may see, including those of rosapi, sorted."""
        found = self._graph.services()
        found.update({name: ServiceInfo(kind, (NODE,)) for name, kind in SERVICES.items()})
        return dict(sorted(found.items()))

    def _topics(self, _request: Message) -> Message:
        topics = self.visible_topics()
        return {"topics": list(topics), "types": [each.type for each in topics.values()]}

    def _topics_and_raw_types(self, request: Message) -> Message:
        found = self._topics(request)
        return {**found, "typedefs_full_text": [definition(each) for each in found["types"]]}

    def _topic_type(self, request: Message) -> Message:
        topic = self.visible_topics().get(_absolute(request["topic"]))
        return {"type": topic.type if topic else ""}

    def _topics_for_type(self, request: Message) -> Message:
        kind = full_name(request["type"])
        return {"topics": [n for n, each in self.visible_topics().items() if each.type == kind]}

    def _publishers(self, request: Message) -> Message:
        topic = self.visible_topics().get(_absolute(request["topic"]))
        return {"publishers": list(topic.publishers) if topic else []}

    def _subscribers(self, request: Message) -> Message:
        topic = self.visible_topics().get(_absolute(request["topic"]))
        return {"subscribers": list(topic.subscribers) if topic else []}

    def _services(self, _request: Message) -> Message:
        return {"services": list(self.visible_services())}

    def _service_type(self, request: Message) -> Message:
        service = self.visible_services().get(_absolute(request["service"]))
        return {"type": service.type if service else ""}

    def _services_for_type(self, request: Message) -> Message:
        kind = full_name(request["type"], "srv")
        return {"services": [n for n, each in self.visible_services().items() if each.type == kind]}

    def _service_providers(self, request: Message) -> Message:
        service = self.visible_services().get(_absolute(request["service"]))
        return {"providers": list(service.servers) if service else []}

    def _service_node(self, request: Message) -> Message:
        return {"node": next(iter(self._service_providers(request)["providers"]), "")}

    def _nodes(self, _request: Message) -> Message:
        return {"nodes": sorted({*self._network.nodes(), NODE})}

    def _node_details(self, request: Message) -> Message:
        node = _absolute(request["node"])
        topics, services = self.visible_topics(), self.visible_services()
        return {
            "subscribing": [name for name, each in topics.items() if node in each.subscribers],
            "publishing": [name for name, each in topics.items() if node in each.publishers],
            "services": [name for name, each in services.items() if node in each.servers],
        }

    def _actions(self) -> dict[str, str]:
        found = {
            name.removesuffix(_SEND_GOAL): service.type.removesuffix("_SendGoal")
            for name, service in self._network.services().items()
            if name.endswith(_SEND_GOAL)
        }
        return {name: found[name] for name in sorted(found) if self._allowed.service(name)}

    def _action_servers(self, _request: Message) -> Message:
        return {"action_servers": list(self._actions())}

    def _action_type(self, request: Message) -> Message:
        return {"type": self._actions().get(_absolute(request["action"]), "")}

    # -- types -----------------------------------------------------------------------------------

    def _interfaces(self, _request: Message) -> Message:
        return {"interfaces": list(known_types())}

    def _message_details(self, request: Message) -> Message:
        return {"typedefs": rosapi.typedefs(full_name(request["type"]))}

    def _service_request_details(self, request: Message) -> Message:
        return {
            "typedefs": rosapi.typedefs(service_type(full_name(request["type"], "srv")).request)
        }

    def _service_response_details(self, request: Message) -> Message:
        kind = service_type(full_name(request["type"], "srv"))
        return {"typedefs": rosapi.typedefs(kind.response)}

    def _action_goal_details(self, request: Message) -> Message:
        kind = action_type(full_name(request["type"], "action"))
        return {"typedefs": rosapi.typedefs(kind.goal)}

    def _action_result_details(self, request: Message) -> Message:
        kind = action_type(full_name(request["type"], "action"))
        return {"typedefs": rosapi.typedefs(kind.result)}

    def _action_feedback_details(self, request: Message) -> Message:
        kind = action_type(full_name(request["type"], "action"))
        return {"typedefs": rosapi.typedefs(f"{kind.name}_Feedback")}

    def _get_time(self, _request: Message) -> Message:
        return {"time": Stamp.of_ns(time.time_ns())._asdict()}

    def _get_ros_version(self, _request: Message) -> Message:
        return {"version": rosapi.ROS_VERSION, "distro": rosapi.DISTRIBUTION}

    # -- parameters ------------------------------------------------------------------------------

    def _of_parameters(self, name: str) -> Callable[[Message], Awaitable[Message]] | None:
        return {
            "get_param": self._get_param,
            "set_param": self._set_param,
            "delete_param": self._delete_param,
            "has_param": self._has_param,
            "get_param_names": self._get_param_names,
        }.get(name)

    async def _get_param(self, request: Message) -> Message:
        try:
            value = await self._parameters.value(request["name"])
        except REFUSALS as error:
            return {"value": request["default_value"] or "null", **_failed(error)}
        if value["type"] != ParameterKind.NOT_SET:
            return {"value": rosapi.parameter_text(value), "successful": True}
        if request["default_value"]:
            return {"value": request["default_value"], "successful": True}
        return {"value": "null", **_failed(f"{request['name']} is not set")}

    async def _has_param(self, request: Message) -> Message:
        try:
            value = await self._parameters.value(request["name"])
        except REFUSALS:
            return {"exists": False}
        return {"exists": value["type"] != ParameterKind.NOT_SET}

    async def _set_param(self, request: Message) -> Message:
        try:
            present = await self._parameters.value(request["name"])
            value = rosapi.parameter_value(request["value"], present["type"])
            return await self._parameters.change(request["name"], value)
        except REFUSALS as error:
            return _failed(error)

    async def _delete_param(self, request: Message) -> Message:
        try:
            value = completed(VALUE, {})
            return await self._parameters.change(request["name"], value)
        except REFUSALS as error:
            return _failed(error)

    async def _get_param_names(self, _request: Message) -> Message:
        return {"names": await self._parameters.names()}


def _failed(reason: object) -> Message:
    return {"successful": False, "reason": str(reason)}


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"
