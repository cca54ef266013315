"""Parts of the Foxglove WebSocket protocol, v1, that foxglove-sdk's server does not implement:
parameters, and headers of relayed frames.

Source: foxglove/ws-protocol, docs/spec.md; the messages of foxglove-sdk 0.30 are the same under
another name of the sub-protocol.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from cardan.errors import shown
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.parameters import ParameterKind, content_of, value_of

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""Subprotocols that clients may request; their messages are the same."""

CDR, JSON, ROS2MSG = "cdr", "json", "ros2msg"
"""Encodings of messages and their definitions."""

WARNING, ERROR = 1, 2
"""Levels of a status."""

MOST_NAMES = 1000
"""Most parameters or subscriptions in one parsed message."""

_MESSAGE_DATA, _TIME, _CLIENT_MESSAGE_DATA = 1, 2, 1
_DATA_HEADER = struct.Struct("<BIQ")
_CHANNEL = struct.Struct("<BI")
_SERVICE_CALL = 2
_CALL = struct.Struct("<BII")
"""Header of a client's call: opcode, service, number of the call."""
_MAX_ID = 2**32 - 1
_FLOAT64, _FLOAT64_ARRAY, _BYTE_ARRAY = "float64", "float64_array", "byte_array"


class Subscription(NamedTuple):
    """Number that a client assigns to a channel that it subscribes to."""

    id: int
    channel: int


class Subscribe(NamedTuple):
    """``subscribe``"""

    subscriptions: tuple[Subscription, ...]


class Unsubscribe(NamedTuple):
    """``unsubscribe``"""

    ids: tuple[int, ...]


class GetParameters(NamedTuple):
    """``getParameters``"""

    names: tuple[str, ...]
    """Empty: all."""
    id: str | None


class SetParameters(NamedTuple):
    """``setParameters``"""

    parameters: tuple[Given, ...]
    id: str | None


class Given(NamedTuple):
    """Parameter from a client."""

    name: str
    value: Any
    """None: delete it."""
    type: str


def parse_operation(
    text: str,
) -> Subscribe | Unsubscribe | GetParameters | SetParameters | None:
    """Decode the request in a client's text frame; None: another operation, or malformed."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    try:
        op = found.get("op")
        if op == "subscribe":
            return Subscribe(
                tuple(
                    Subscription(_number(each["id"]), _number(each["channelId"]))
                    for each in _list(found["subscriptions"])
                )
            )
        if op == "unsubscribe":
            return Unsubscribe(tuple(map(_number, _list(found["subscriptionIds"]))))
        if op == "getParameters":
            names = tuple(map(_text, _list(found["parameterNames"])))
            return GetParameters(names, _identity(found))
        if op == "setParameters":
            given = tuple(
                Given(_text(each["name"]), each.get("value"), str(each.get("type") or ""))
                for each in _list(found["parameters"])
            )
            return SetParameters(given, _identity(found))
    except (KeyError, TypeError, AttributeError):
        pass
    return None


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list) or len(value) > MOST_NAMES:
        raise TypeError
    return value


def _number(value: Any) -> int:
    if type(value) is not int or not 0 <= value <= _MAX_ID:
        raise TypeError
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _identity(found: dict[str, Any]) -> str | None:
    identity = found.get("id")
    return None if identity is None else _text(identity)


def subscription_of(frame: bytes) -> int | None:
    """Return the subscription of the message in a server's binary frame; None: no message."""
    if len(frame) < _DATA_HEADER.size or frame[0] != _MESSAGE_DATA:
        return None
    number: int = _DATA_HEADER.unpack_from(frame)[1]
    return number


def is_time(frame: bytes) -> bool:
    """Return True if a server's binary frame carries the time."""
    return frame[:1] == bytes([_TIME])


def published_channel(frame: bytes) -> int | None:
    """Return the client's channel of a publication in its binary frame; None: no publication."""
    if len(frame) < _CHANNEL.size or frame[0] != _CLIENT_MESSAGE_DATA:
        return None
    number: int = _CHANNEL.unpack_from(frame)[1]
    return number


def call_number(frame: bytes) -> int | None:
    """Return the client's number of the service call in its binary frame; None: the frame is no
    call."""
    if len(frame) < _CALL.size or frame[0] != _SERVICE_CALL:
        return None
    number: int = _CALL.unpack_from(frame)[2]
    return number


def status(level: int, message: str, identity: str) -> str:
    """Encode a ``status`` that replaces an earlier one with the same identity."""
    return _object(op="status", level=level, message=message, id=identity)


def advertise(channel: int, topic: str) -> str:
    """Encode a client's ``advertise`` of a channel without publications."""
    entry = {"id": channel, "topic": topic, "encoding": CDR, "schemaName": ""}
    return _object(op="advertise", channels=[entry])


def unadvertise(channel: int) -> str:
    """Encode a client's ``unadvertise``."""
    return _object(op="unadvertise", channelIds=[channel])


def parameter_values(parameters: Sequence[dict[str, Any]], identity: str | None) -> str:
    """Encode ``parameterValues``, the reply to a request with this identity."""
    more = {} if identity is None else {"id": identity}
    return _object(op="parameterValues", parameters=list(parameters), **more)


def _object(**fields: Any) -> str:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False)


# -- parameters -----------------------------------------------------------------------------------


def network_name(name: str) -> str:
    """Return "/node:parameter" for a name in the form of Foxglove's bridges: "/node.parameter"."""
    node, _, parameter = name.partition(".")
    return f"{node}:{parameter}"


def client_name(node: str, parameter: str) -> str:
    """Return the name in the form of Foxglove's bridges."""
    return f"{node}.{parameter}"


def parameter_entry(name: str, value: Message) -> dict[str, Any] | None:
    """Return a parameter in the form for clients; None if it is not set, or not representable in
    JSON."""
    content = content_of(value)
    if content is None:
        return None
    entry: dict[str, Any] = {"name": name}
    kind = value["type"]
    if kind == ParameterKind.BYTE_ARRAY:
        return {**entry, "type": _BYTE_ARRAY, "value": base64.b64encode(content).decode()}
    if kind == ParameterKind.DOUBLE:
        return {**entry, "type": _FLOAT64, "value": content} if math.isfinite(content) else None
    content = list(content) if kind > ParameterKind.BYTE_ARRAY else content
    if kind == ParameterKind.DOUBLE_ARRAY:
        finite = all(map(math.isfinite, content))
        return {**entry, "type": _FLOAT64_ARRAY, "value": content} if finite else None
    return {**entry, "value": content}


def given_value(given: Given, present_type: int) -> Message:
    """Return the ``rcl_interfaces/msg/ParameterValue`` of a client's value; integers and empty
    lists are converted to `present_type`, the parameter's type now. Raises ValueError."""
    content = given.value
    if content is None:
        return default_message("rcl_interfaces/msg/ParameterValue")
    if given.type == _BYTE_ARRAY:
        try:
            content = base64.b64decode(content, validate=True)
        except (binascii.Error, TypeError, ValueError):
            raise ValueError(f"{shown(content)} is not base64, as a byte_array is") from None
    kinds = {_FLOAT64: ParameterKind.DOUBLE, _FLOAT64_ARRAY: ParameterKind.DOUBLE_ARRAY}
    return value_of(content, kinds.get(given.type, present_type))
