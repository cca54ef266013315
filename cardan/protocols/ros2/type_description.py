"""A node's answers to `~/get_type_description`: descriptions of types by their hashes.

Source: type_description_interfaces/srv/GetTypeDescription, REP 2011.
"""

from __future__ import annotations

from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.interfaces import (
    FILES,
    InterfaceError,
    full_name,
    message_type,
    name_on_the_wire,
    referenced,
)
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.type_hash import described, revision_of, type_hash

TYPE_DESCRIPTION = "type_description_interfaces/srv/GetTypeDescription"


def describe_type(request: Message) -> Message:
    """Answer a GetTypeDescription request with a message's type; never an error."""
    response = default_message(f"{TYPE_DESCRIPTION}_Response")
    try:
        name = revision_of(full_name(request["type_name"]), request["type_hash"])
        mark = type_hash(name)
        message_type(name)
    except InterfaceError as error:
        return response | {"failure_reason": str(error)}
    if request["type_hash"] not in ("", mark):
        return response | {"failure_reason": f"{name} has the hash {mark} here"}
    within = referenced(name)
    response["successful"] = True
    response["type_description"] = {
        "type_description": _individual(name),
        "referenced_type_descriptions": [_individual(each) for each in within],
    }
    if request["include_type_sources"]:
        response["type_sources"] = [
            {"type_name": each, "encoding": "msg", "raw_file_contents": FILES[each]}
            for each in (name, *within)
            if each in FILES
        ]
    return response


def _individual(name: str) -> Message:
    fields = [
        {**described(field), "default_value": field.default} for field in message_type(name).fields
    ]
    return {"type_name": name_on_the_wire(name), "fields": fields}
