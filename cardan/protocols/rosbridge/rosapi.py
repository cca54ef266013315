"""Answers of rosapi about types and parameters, without a graph.

Source: rosbridge_suite, rosapi/src/rosapi/objectutils.py and params.py.
"""

from __future__ import annotations

import json

from cardan.errors import shown
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.interfaces import (
    DUMMY_MEMBER,
    FLOATS,
    Field,
    message_type,
    referenced,
)
from cardan.protocols.ros2.parameters import content_of, value_of

ROS_VERSION = 2
DISTRIBUTION = "jazzy"
"""ROS distribution of Cardan's messages."""


def typedefs(name: str) -> list[Message]:
    """Make the ``rosapi/msg/TypeDef`` of a message and of those that it contains. Raises
    InterfaceError."""
    return [_typedef(each) for each in (name, *referenced(name))]


def _typedef(name: str) -> Message:
    kind = message_type(name)
    fields = [field for field in kind.fields if field.name != DUMMY_MEMBER]
    lengths = {"": -1, "sequence": 0, "bounded": 0}
    return {
        "type": name,
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [field.base for field in fields],
        "fieldarraylen": [lengths.get(field.array, field.length) for field in fields],
        "examples": [_example(field) for field in fields],
        "constnames": [each.name for each in kind.constants],
        "constvalues": [each.value for each in kind.constants],
    }


def _example(field: Field) -> str:
    if field.array:
        return "[]"
    if field.nested:
        return "{}"
    if field.default:
        return field.default
    return {"string": "", "bool": "False"}.get(field.base, "0.0" if field.base in FLOATS else "0")


def parameter_text(value: Message) -> str:
    """Convert a ``rcl_interfaces/msg/ParameterValue`` to JSON."""
    content = content_of(value)
    return json.dumps(list(content) if isinstance(content, bytes) else content)


def parameter_value(text: str, present_type: int) -> Message:
    """Convert a JSON text to a ``rcl_interfaces/msg/ParameterValue``. Integers and empty lists
    conform to `present_type`, the parameter's type now. Raises ValueError."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError(f"{shown(text)} is not JSON") from None
    return value_of(content, present_type)
