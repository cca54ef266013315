"""ROS 2 parameters of a node: requests in, responses and events out.

A :class:`ParameterServer` has a table of the parameters; the caller keeps the values, passes them
in, and applies changes. Source: rcl_interfaces, and the behavior of rclcpp's parameter services.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from cardan.errors import shown
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.messages import MessageError, completed, default_message

Value = bool | int | float | str
"""Value of a parameter."""

MAX_NAMES = 1000
"""Most names answered in one request: no node has as many parameters."""


class ParameterError(ValueError):
    """A parameter cannot be set to a value; the text tells why."""


class ParameterKind(IntEnum):
    """The type of a value, by rcl_interfaces/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @property
    def words(self) -> str:
        """Name of the kind for messages."""
        return self.name.lower().replace("_", " ")


_FIELDS = {
    ParameterKind.BOOL: "bool_value",
    ParameterKind.INTEGER: "integer_value",
    ParameterKind.DOUBLE: "double_value",
    ParameterKind.STRING: "string_value",
    ParameterKind.BYTE_ARRAY: "byte_array_value",
    ParameterKind.BOOL_ARRAY: "bool_array_value",
    ParameterKind.INTEGER_ARRAY: "integer_array_value",
    ParameterKind.DOUBLE_ARRAY: "double_array_value",
    ParameterKind.STRING_ARRAY: "string_array_value",
}
"""Field of a message with the value of each kind."""

_ARRAYS = {
    ParameterKind.BOOL: ParameterKind.BOOL_ARRAY,
    ParameterKind.INTEGER: ParameterKind.INTEGER_ARRAY,
    ParameterKind.DOUBLE: ParameterKind.DOUBLE_ARRAY,
    ParameterKind.STRING: ParameterKind.STRING_ARRAY,
}

_VALUE = "rcl_interfaces/msg/ParameterValue"


def content_of(value: Message) -> Any:
    """Return the value of a ``rcl_interfaces/msg/ParameterValue``; None: not set, or of an unknown
    type."""
    field = _FIELDS.get(value["type"])
    return value[field] if field else None


def value_of(content: Any, present_type: int) -> Message:
    """Make the ``rcl_interfaces/msg/ParameterValue`` of `content`. Integers and empty lists conform
    to `present_type`, the parameter's type now. Raises ValueError."""
    kind = _kind_of(content, present_type)
    if kind is ParameterKind.NOT_SET:
        raise ValueError(f"{shown(content)} is not a value of a parameter")
    try:
        return completed(_VALUE, {"type": int(kind), _FIELDS[kind]: content})
    except MessageError as error:
        raise ValueError(f"{shown(content)} is not a value of a parameter: {error}") from None


def _kind_of(content: Any, present_type: int) -> ParameterKind:
    none = ParameterKind.NOT_SET
    if isinstance(content, bytes):
        return ParameterKind.BYTE_ARRAY
    if isinstance(content, list):
        kinds = {none if isinstance(each, list) else _kind_of(each, none) for each in content}
        numbers = {ParameterKind.INTEGER, ParameterKind.DOUBLE}
        if not kinds:
            arrays = ParameterKind.BYTE_ARRAY <= present_type <= ParameterKind.STRING_ARRAY
            return ParameterKind(present_type) if arrays else ParameterKind.STRING_ARRAY
        if kinds == {ParameterKind.INTEGER} and present_type in (
            ParameterKind.BYTE_ARRAY,
            ParameterKind.DOUBLE_ARRAY,
        ):
            return ParameterKind(present_type)
        if kinds == numbers:
            return ParameterKind.DOUBLE_ARRAY
        return _ARRAYS.get(kinds.pop(), none) if len(kinds) == 1 else none
    if isinstance(content, bool):
        return ParameterKind.BOOL
    if isinstance(content, int):
        is_double = present_type == ParameterKind.DOUBLE
        return ParameterKind.DOUBLE if is_double else ParameterKind.INTEGER
    if isinstance(content, float):
        return ParameterKind.DOUBLE
    return ParameterKind.STRING if isinstance(content, str) else none


@dataclass(frozen=True)
class Declared:
    """A parameter that a node has."""

    name: str
    kind: ParameterKind
    """BOOL, INTEGER, DOUBLE or STRING."""
    description: str
    lowest: float | None = None
    """Limits of a number; None: no limit."""
    highest: float | None = None
    choices: tuple[str, ...] = ()
    """Allowed texts; empty: any."""
    constraints: str = ""
    """Further constraints on its values, in words."""
    read_only: bool = False

    def checked(self, value: Value) -> Value:
        """Return `value`, of the right kind, if it is allowed. Raises ParameterError."""
        if self.choices and value not in self.choices:
            raise ParameterError(
                f"{self.name}: allowed are {', '.join(self.choices)}, not {value!r:.60}"
            )
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(f"{self.name}: {value} is not a finite number")
        if self.lowest is not None and not isinstance(value, str):
            highest = math.inf if self.highest is None else self.highest
            if not self.lowest <= value <= highest:
                raise ParameterError(
                    f"{self.name}: allowed are {self.lowest:g} to {highest:g}, not {value!r}"
                )
        return value

    def descriptor(self) -> Message:
        """Convert to rcl_interfaces/ParameterDescriptor."""
        message = default_message("rcl_interfaces/msg/ParameterDescriptor")
        words = [f"one of {', '.join(self.choices)}"] if self.choices else []
        words += [self.constraints] if self.constraints else []
        message |= {
            "name": self.name,
            "type": int(self.kind),
            "description": self.description,
            "additional_constraints": "; ".join(words),
            "read_only": self.read_only,
        }
        if self.lowest is not None and self.highest is not None:
            whole = self.kind is ParameterKind.INTEGER
            number = int if whole else float
            message["integer_range" if whole else "floating_point_range"] = [
                {"from_value": number(self.lowest), "to_value": number(self.highest), "step": 0}
            ]
        return message


USE_SIM_TIME = Declared(
    "use_sim_time", ParameterKind.BOOL, "Whether the node's time is that of the topic /clock",
    constraints="all times are of this computer's clock, and what moves an arm must not stand "
    "still or jump with a simulation's",
    read_only=True,
)  # fmt: skip
"""Parameter of every ROS 2 node: false here."""


class ParameterServer:
    """Server of a node's parameter services and events.

    Requests and responses are those of rcl_interfaces. `values` are the values by name; a parameter
    without one is answered as not set.
    """

    def __init__(self, declared: Iterable[Declared]) -> None:
        self.declared = {each.name: each for each in (*declared, USE_SIM_TIME)}
        self._reported: dict[str, Value] = {}

    # -- queries -----------------------------------------------------------------------------------

    def get(self, request: Message, values: Mapping[str, Value]) -> Message:
        """Answer GetParameters: an unknown name is not set, so that the others keep their
        places."""
        return {"values": [self._value(name, values) for name in request["names"][:MAX_NAMES]]}

    def get_types(self, request: Message) -> Message:
        """Answer GetParameterTypes."""
        kinds = (self.declared.get(name) for name in request["names"][:MAX_NAMES])
        return {"types": bytes(0 if each is None else each.kind for each in kinds)}

    def describe(self, request: Message) -> Message:
        """Answer DescribeParameters: an unknown name has the type 0."""
        descriptors = []
        for name in request["names"][:MAX_NAMES]:
            known = self.declared.get(name)
            if known is None:
                unknown = default_message("rcl_interfaces/msg/ParameterDescriptor")
                descriptors.append(unknown | {"name": name})
            else:
                descriptors.append(known.descriptor())
        return {"descriptors": descriptors}

    def list_names(self, request: Message) -> Message:
        """Answer ListParameters: names within the prefixes, `depth` words deep below them; 0:
        all."""
        wanted, depth = request["prefixes"][:MAX_NAMES], request["depth"]
        found = []
        for name in self.declared:
            rests = [_below(name, prefix) for prefix in wanted] if wanted else [name]
            if any(rest is not None and _fits(rest, depth) for rest in rests):
                found.append(name)
        prefixes = {name.rpartition(".")[0] for name in found} - {""}
        return {"result": {"names": found, "prefixes": sorted(prefixes)}}

    def _value(self, name: str, values: Mapping[str, Value]) -> Message:
        known = self.declared.get(name)
        message = default_message("rcl_interfaces/msg/ParameterValue")
        values = {**values, USE_SIM_TIME.name: False}
        if known is not None and name in values:
            message["type"] = int(known.kind)
            message[_FIELDS[known.kind]] = values[name]
        return message

    # -- changes ---------------------------------------------------------------------------------

    def checked(self, parameter: Message) -> tuple[str, Value]:
        """Return the name and the new value of a Parameter that may be set. Raises
        ParameterError."""
        name, given = parameter["name"], parameter["value"]
        known = self.declared.get(name)
        if known is None:
            raise ParameterError(
                f"there is no parameter {name!r:.80}; there are {', '.join(self.declared)}"
            )
        if known.read_only:
            why = f": {known.constraints}" if known.constraints else ""
            raise ParameterError(f"{name}: it can only be read{why}")
        if given["type"] != known.kind:
            try:
                kind = ParameterKind(given["type"]).words
            except ValueError:
                kind = f"type {given['type']}"
            hint = ""
            if known.kind is ParameterKind.DOUBLE and given["type"] == ParameterKind.INTEGER:
                hint = f": write {given['integer_value']}.0"
            elif given["type"] == ParameterKind.NOT_SET:
                hint = ": it cannot be deleted"
            raise ParameterError(f"{name}: it is a {known.kind.words}, not {kind}{hint}")
        return name, known.checked(given[_FIELDS[known.kind]])

    def checked_group(self, parameters: Iterable[Message]) -> dict[str, Value]:
        """Return the new values of parameters that are set together. Raises ParameterError for the
        first that may not be set, and if one is named twice."""
        found: dict[str, Value] = {}
        for parameter in parameters:
            name, value = self.checked(parameter)
            if name in found:
                raise ParameterError(f"{name}: it is given twice")
            found[name] = value
        return found

    def event(self, node: str, values: Mapping[str, Value], now_ns: int) -> Message | None:
        """Return the ParameterEvent of the changes since the last one; None if there are none.

        `node`: full name; `now_ns`: since the epoch.
        """
        reported, values = self._reported, {**values, USE_SIM_TIME.name: False}
        new: list[Message] = []
        changed: list[Message] = []
        for name in self.declared:
            if name in values and (name not in reported or reported[name] != values[name]):
                parameter = {"name": name, "value": self._value(name, values)}
                (changed if name in reported else new).append(parameter)
        if not new and not changed:
            return None
        self._reported = dict(values)
        return {
            "stamp": {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9},
            "node": node,
            "new_parameters": new,
            "changed_parameters": changed,
            "deleted_parameters": [],
        }


def _below(name: str, prefix: str) -> str | None:
    """Return the part of `name` below `prefix`, "" if they are equal; None if it is not below."""
    if name == prefix or not prefix:
        return "" if prefix else name
    return name[len(prefix) + 1 :] if name.startswith(f"{prefix}.") else None


def _fits(rest: str, depth: int) -> bool:
    return depth == 0 or rest.count(".") < depth


def set_result(reason: str = "") -> dict[str, Any]:
    """Make a SetParametersResult; successful if there is no reason against it."""
    return {"successful": not reason, "reason": reason}
