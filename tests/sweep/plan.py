"""Task of a judge, as JSON, for programs in processes of their own."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection
from typing import Any, NamedTuple, get_args

from cardan.gateway.bus.arm_topics import ArmNames
from cardan.gateway.bus.commands import TOPICS, joint_command
from cardan.gateway.bus.compatibility import NamesOf, ServoScales, other_names
from cardan.gateway.bus.device_topics import RUMBLE, RUMBLE_TOPIC
from cardan.protocols.ros2.messages import default_message
from tests.network_table import Coverage, Row, rows

NAMESPACE, NODE = "/left", "/left/arm"
RESULT = f"{NODE}/result"
RUMBLED = "rumble"
"""Name of the device's rumble command in its results."""
REPEAT_S = 0.5
"""A command without a result is sent again after this time: the session may not have discovered its
publisher yet."""

NOT_OF_A_STICK = {"imu/data_raw"}
"""Names that only a device with inertial sensors has."""

REQUESTS: dict[str, dict[str, Any]] = {
    "~/ask": {
        "request": '{"id": 1, "source": "sweep", "verb": "relj", "value": [0, 0, 0.01, 0, 0, 0]}'
    },
    "~/describe_parameters": {"names": ["gain"]},
    "~/get_parameters": {"names": ["gain"]},
    "~/get_parameter_types": {"names": ["gain", "frame"]},
    "~/set_parameters": {
        "parameters": [{"name": "gain", "value": {"type": 3, "double_value": 1.5}}]
    },
    "~/set_parameters_atomically": {
        "parameters": [{"name": "gain", "value": {"type": 3, "double_value": 1.25}}]
    },
    "~/get_type_description": {"type_name": "geometry_msgs/msg/Pose", "type_hash": "none"},
}
"""Requests that differ from the defaults of their type."""

GOALS: dict[str, dict[str, Any]] = {"~/action/movv": {"xdot": {"linear": {"x": 99.0}}}}


class Plan(NamedTuple):
    """Task of a judge. Its parts are done in this order, except `hear`, which runs from the
    beginning."""

    commands: list[tuple[str, str, dict[str, Any], str, str]]
    """Topic, type, message, command, and a part of the reason that its result must have."""
    services: list[tuple[str, str, dict[str, Any]]]
    actions: list[tuple[str, str, dict[str, Any]]]
    hear: list[tuple[str, str]]
    """Topics that must be received, and their types."""

    def text(self) -> str:
        """Return the plan as JSON."""
        return json.dumps(self._asdict())


def full_name(name: str) -> str:
    """Full name of a row in the session of the sweep."""
    if name.startswith("~"):
        return NODE + name[1:]
    return name if name.startswith("/") else f"{NAMESPACE}/{name}"


def wanted_rows() -> set[Row]:
    """Return the rows of the table that the session of the sweep has in its graph."""
    return {row for row in rows() if row.name not in NOT_OF_A_STICK}


def verbs() -> dict[str, str]:
    """Map each topic to the command that its results name, by the session's own tables."""
    names = ArmNames(("joint_1",))
    others = other_names(get_args(NamesOf), names, "servo_node", ServoScales())
    tables = (*TOPICS, joint_command(names.joints), *(t for each in others for t in each.topics))
    return {RUMBLE_TOPIC: RUMBLED, **{each.topic: each.verb for each in tables}}


def plan(every: Collection[Row], mark: Coverage) -> Plan:
    """Return the task of a judge for the rows of its mark."""
    known, asked = verbs(), mark.rows(every)
    commands = []
    for row in asked:
        if row.kind == "taken":
            message, tag = _telling(row)
            commands.append((full_name(row.name), row.type_name, message, known[row.name], tag))
    services = [
        (full_name(row.name), row.type_name, REQUESTS.get(row.name, {}))
        for row in asked
        if row.kind == "service"
    ]
    # A client of the packet services is a separate source, which gets the arm when the network
    # source releases it.
    services.sort(key=lambda each: not each[0].endswith("/release"))
    actions = [
        (full_name(row.name), row.type_name, GOALS.get(row.name, {}))
        for row in asked
        if row.kind == "action"
    ]
    hear = [(full_name(row.name), row.type_name) for row in asked if row.kind == "published"]
    return Plan(commands, services, actions, hear)


def _telling(row: Row) -> tuple[dict[str, Any], str]:
    """A message whose refusal names its topic, if the message has a text; and that text."""
    tag = row.name.rpartition("/")[2]
    fields = default_message(row.type_name)
    if row.name == RUMBLE_TOPIC:
        return {"type": RUMBLE, "intensity": 0.5}, ""
    if "joint_names" in fields:
        return {"joint_names": [tag], "velocities": [0.1]}, tag
    if "name" in fields:
        return {"name": [tag], "velocity": [0.1]}, tag
    if "string" in fields:
        return {"string": tag}, tag
    if "header" in fields:
        return {"header": {"frame_id": tag}}, tag
    return {}, ""


def command(
    given: tuple[str, str, dict[str, Any], str, str],
    publish: Callable[[], None],
    results: Callable[[], list[dict[str, Any]]],
    until_s: float,
) -> str:
    """Publish a command until its result arrives; return the result's outcome, or "" if none came.

    `results` returns the results that have arrived since.
    """
    _topic, _type, _message, verb, tag = given
    results()
    while time.monotonic() < until_s:
        publish()
        again_s = time.monotonic() + REPEAT_S
        while time.monotonic() < again_s:
            for each in results():
                if each["command"] == verb and tag in each["reason"]:
                    return f"{each['outcome']}: {each['reason']}"
            time.sleep(0.005)
    return ""
