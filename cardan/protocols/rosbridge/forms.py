"""A server's messages in the encodings that clients request: JSON, PNG, CBOR, CBOR with CDR in it.

CBOR is RFC 8949, arrays of numbers RFC 8746 (little-endian typed arrays).
"""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Mapping
from typing import Any

from cardan.common.extras import missing_extra

try:
    import cbor2
except ImportError as error:
    raise missing_extra("rosbridge", "cbor2", "network", error) from error

from cardan.protocols.ros2.cdr import MalformedCdr, Message, decoded
from cardan.protocols.ros2.interfaces import DUMMY_MEMBER, Field, message_type
from cardan.protocols.ros2.messages import Stamp, json_text
from cardan.protocols.rosbridge.operations import Id
from cardan.protocols.rosbridge.png import png_of

Frame = str | bytes
"""A text or a binary frame."""

MAX_FRAGMENTS = 1000
"""Most fragments of a message; smaller ones than that allows are enlarged."""

_TYPED_ARRAYS = {
    "uint16": (69, "H"), "uint32": (70, "I"), "uint64": (71, "Q"), "int8": (72, "b"),
    "int16": (77, "h"), "int32": (78, "i"), "int64": (79, "q"), "float32": (85, "f"),
    "float64": (86, "d"),
}  # fmt: skip
"""Tag of RFC 8746 for each type's little-endian array, and struct's letter."""

_fragmented = itertools.count(1)


class UnreadableError(ValueError):
    """Bytes on the network that are no message of their topic's type."""


class EncodedMessage:
    """A message of a topic, encoded once in each form that clients request."""

    __slots__ = ("_frames", "_message", "cdr", "stamp_ns", "type")

    def __init__(self, type_name: str | None, cdr: bytes, stamp_ns: int) -> None:
        """Set the full `type_name`; None: unknown, sufficient only for "cbor-raw"."""
        self.type, self.cdr, self.stamp_ns = type_name, cdr, stamp_ns
        self._message: tuple[str, Message] | None = None
        self._frames: dict[tuple[str, str, int], tuple[Frame, ...]] = {}

    def frames(self, topic: str, compression: str, fragment_size: int = 0) -> tuple[Frame, ...]:
        """Return the frames of the message for a client that calls the topic `topic`.

        Raises UnreadableError and InterfaceError.
        """
        key = (topic, compression, fragment_size)
        if (found := self._frames.get(key)) is None:
            found = self._frames[key] = self._encoded(*key)
        return found

    def _encoded(self, topic: str, compression: str, fragment_size: int) -> tuple[Frame, ...]:
        if compression == "cbor-raw":
            seconds, nanoseconds = Stamp.of_ns(self.stamp_ns)
            raw = {"secs": seconds, "nsecs": nanoseconds, "bytes": self.cdr}
            return (_cbor({"op": "publish", "topic": topic, "msg": raw}),)
        if compression == "cbor":
            message = _cbor_ready(*self._decoded())
            return (_cbor({"op": "publish", "topic": topic, "msg": message}),)
        if compression == "png":
            (text,) = self.frames(topic, "none")
            return fragments(png_frame(str(text)), fragment_size)
        if fragment_size:
            (text,) = self.frames(topic, "none")
            return fragments(str(text), fragment_size)
        inner = json_text(*self._decoded())
        return (f'{{"op":"publish","topic":{json.dumps(topic)},"msg":{inner}}}',)

    def _decoded(self) -> tuple[str, Message]:
        """Decode the message; return its type, which may be a later revision of the topic's, and
        the message. Raises UnreadableError."""
        if self._message is None:
            if self.type is None:
                raise UnreadableError("the type of the message is not known")
            name, message = decoded(self.type, self.cdr)
            if isinstance(message, MalformedCdr):
                raise UnreadableError(message.reason)
            self._message = name, message
        return self._message


def fragments(text: str, size: int) -> tuple[str, ...]:
    """Return `text` unchanged, or if it is longer than `size` (0: any), as fragment operations."""
    if not size or len(text) <= size:
        return (text,)
    size = max(size, -(-len(text) // MAX_FRAGMENTS))
    parts = [text[begin : begin + size] for begin in range(0, len(text), size)]
    identity = f"fragment:{next(_fragmented)}"
    return tuple(
        object_text(op="fragment", id=identity, num=number, total=len(parts), data=part)
        for number, part in enumerate(parts)
    )


def png_frame(text: str) -> str:
    """Make the ``png`` operation that carries the operation `text`."""
    return object_text(op="png", data=png_of(text))


def object_text(**fields: Any) -> str:
    """Encode a JSON object; fields that are None are left out."""
    return json.dumps(
        {key: value for key, value in fields.items() if value is not None}, separators=(",", ":")
    )


def service_response(
    identity: Id,
    service: str,
    type_name: str,
    message: Message,
    compression: str = "none",
    fragment_size: int = 0,
) -> tuple[Frame, ...]:
    """Encode the response of a service, a message of the type `type_name`."""
    if compression == "cbor":
        answer = {"op": "service_response", "id": identity, "service": service, "result": True}
        return (_cbor({**answer, "values": _cbor_ready(type_name, message)}),)
    text = _with_message(
        object_text(op="service_response", id=identity, service=service, result=True),
        "values",
        json_text(type_name, message),
    )
    return fragments(png_frame(text) if compression == "png" else text, fragment_size)


def service_refusal(identity: Id, service: str, reason: str) -> str:
    """Encode the response if a service could not be called."""
    return object_text(
        op="service_response", id=identity, service=service, values=reason, result=False
    )


def service_request(
    identity: str, service: str, type_name: str, request_type: str, request: Message
) -> str:
    """Encode a request to a service that the client offers."""
    return _with_message(
        object_text(op="call_service", id=identity, service=service, type=type_name),
        "args",
        json_text(request_type, request),
    )


def action_feedback(identity: Id, action: str, type_name: str, message: Message) -> str:
    """Encode the feedback of an action server about a goal in execution."""
    head = object_text(op="action_feedback", id=identity, action=action)
    return _with_message(head, "values", json_text(type_name, message))


def action_result(identity: Id, action: str, type_name: str, message: Message, status: int) -> str:
    """Encode the end of a goal; `status` is that of ``action_msgs/msg/GoalStatus``."""
    head = object_text(op="action_result", id=identity, action=action, status=status, result=True)
    return _with_message(head, "values", json_text(type_name, message))


def action_refusal(identity: Id, action: str, reason: str, status: int) -> str:
    """Encode the end of a goal without a result."""
    return object_text(
        op="action_result", id=identity, action=action, values=reason, status=status, result=False
    )


def _with_message(head: str, key: str, message: str) -> str:
    return f'{head[:-1]},"{key}":{message}}}'


def _cbor(value: Mapping[str, Any]) -> bytes:
    return cbor2.dumps(value)


def _cbor_ready(name: str, message: Message) -> dict[str, Any]:
    """Convert a message of the type `name` to one with typed arrays of numbers."""
    return {
        field.name: _cbor_value(field, message[field.name])
        for field in message_type(name).fields
        if field.name != DUMMY_MEMBER
    }


def _cbor_value(field: Field, value: Any) -> Any:
    if field.nested:
        if field.array:
            return [_cbor_ready(field.base, each) for each in value]
        return _cbor_ready(field.base, value)
    if field.array and field.base in _TYPED_ARRAYS:
        tag, code = _TYPED_ARRAYS[field.base]
        return cbor2.CBORTag(tag, struct.pack(f"<{len(value)}{code}", *value))
    return value
