"""Type hashes (RIHS01) of ROS 2 interfaces, as in rmw_zenoh's keys and DDS endpoints.

Source: REP 2011 and rosidl's type description; a SHA-256 over a JSON text of the definition, whose
form is part of the standard.
"""

from __future__ import annotations

import hashlib
import json
from functools import cache
from typing import Any

from cardan.protocols.ros2.interfaces import (
    Field,
    full_name,
    message_type,
    name_on_the_wire,
    referenced,
    revised,
)

UNSUPPORTED = "TypeHashNotSupported"
"""Placeholder of ROS 2 Humble, which has no type hashes."""

_NESTED = 1
_TYPE_IDS = {
    "int8": 2, "uint8": 3, "char": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8,
    "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
_BOUNDED_STRING = 21
_ARRAY_OFFSETS = {"": 0, "fixed": 48, "bounded": 96, "sequence": 144}


@cache
def type_hash(name: str) -> str:
    """Return the ``RIHS01_...`` of a message or a service, also of an action's. Raises
    InterfaceError, also for an action as a whole, which is not on the wire and has no hash."""
    kind = full_name(name).split("/")[1]
    last = name.rpartition("/")[2]
    if kind == "srv" and not last.endswith(("_Request", "_Response", "_Event")):
        return _hash_of_service(name)
    if kind == "action" and last.endswith(("_SendGoal", "_GetResult")):
        return _hash_of_service(name)
    fields = [described(field) for field in message_type(name).fields]
    return _hash(full_name(name), fields, set(referenced(name)))


def revision_of(name: str, mark: str) -> str:
    """Return the revision of the type `name` with the hash `mark`: a later one, or `name`."""
    later = revised(name)
    return later if later and mark == type_hash(later) != type_hash(name) else name


def _hash_of_service(name: str) -> str:
    parts = {part: f"{name}_{part.capitalize()}" for part in ("request", "response", "event")}
    within: set[str] = set()
    for part in parts.values():
        within |= {part, *referenced(part)}
    fields = [described(Field(f"{part}_message", of)) for part, of in parts.items()]
    return _hash(name, fields, within)


def _hash(name: str, fields: list[Any], within: set[str]) -> str:
    description = {
        "type_description": {"type_name": name_on_the_wire(name), "fields": fields},
        "referenced_type_descriptions": [
            {
                "type_name": name_on_the_wire(each),
                "fields": [described(field) for field in message_type(each).fields],
            }
            for each in sorted(within, key=name_on_the_wire)
        ],
    }
    text = json.dumps(description, separators=(", ", ": "))
    return "RIHS01_" + hashlib.sha256(text.encode("ascii")).hexdigest()


def described(field: Field) -> dict[str, Any]:
    """Make a field of a type description, without its default."""
    if field.nested:
        number = _NESTED
    elif field.most_characters:
        number = _BOUNDED_STRING
    else:
        number = _TYPE_IDS[field.base]
    return {
        "name": field.name,
        "type": {
            "type_id": number + _ARRAY_OFFSETS[field.array],
            "capacity": field.length,
            "string_capacity": field.most_characters,
            "nested_type_name": name_on_the_wire(field.base) if field.nested else "",
        },
    }
