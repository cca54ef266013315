"""Operations that clients of rosbridge v2 request: one JSON object, an "operation", per text frame.

Source: RobotWebTools/rosbridge_suite, ROSBRIDGE_PROTOCOL.md; what roslibpy 2.1, roslib 1.4 and 2.1
and Lichtblick send.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from cardan.errors import shown

MAX_NAME_CHARACTERS = 255
"""Longest name of a topic, a service, an action or a type."""

MAX_ID_CHARACTERS = 1000
"""Longest id; clients make theirs of an operation, a name and a UUID."""

MAX_QUEUE_LENGTH = 1000
"""Upper limit of queue_length; larger values are clipped."""

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
"""Encodings of messages to a client; of several requested ones, the last in this order is used."""

LEVELS = ("error", "warning", "info")
"""Levels of status messages, the most severe first; a client gets its level and more severe
ones."""

Id = str | int | None
"""Id of an operation, chosen by the client and repeated in answers."""


class RefusedOperation(NamedTuple):
    """A client's operation that cannot be executed."""

    reason: str
    op: str = ""
    """Name of the operation, as far as it was parsed."""
    id: Id = None
    name: str = ""
    """Topic, service or action."""


class Fragment(NamedTuple):
    """A part of an operation's text."""

    id: Id
    number: int
    total: int
    data: str


class Advertise(NamedTuple):
    """The client will publish on a topic."""

    id: Id
    topic: str
    type: str
    latch: bool


class Unadvertise(NamedTuple):
    """The end of an Advertise with the same id, or of all on the topic."""

    id: Id
    topic: str


class Publish(NamedTuple):
    """A message for a topic."""

    id: Id
    topic: str
    message: Any
    type: str
    """Type; empty: as advertised."""
    latch: bool


class Subscribe(NamedTuple):
    """The client subscribes to a topic."""

    id: Id
    topic: str
    type: str
    """Type; empty: the topic's."""
    throttle_ms: float
    """Least time between two messages."""
    queue_length: int
    """Messages queued for that time; 0: early ones are dropped."""
    compression: str
    fragment_size: int
    """Longest text of a frame's data; 0: any."""


class Unsubscribe(NamedTuple):
    """The end of a Subscribe with the same id, or of all on the topic."""

    id: Id
    topic: str


class CallService(NamedTuple):
    """A request to a service."""

    id: Id
    service: str
    args: Any
    """An object, a list in the order of the fields, or None."""
    compression: str
    fragment_size: int
    timeout_s: float
    """Timeout; 0: the server's own."""


class AdvertiseService(NamedTuple):
    """The client offers a service."""

    id: Id
    service: str
    type: str


class UnadvertiseService(NamedTuple):
    """The client no longer offers a service."""

    id: Id
    service: str


class ServiceResponse(NamedTuple):
    """The client's answer to a request to its service."""

    id: Id
    service: str
    values: Any
    result: bool
    """False: the call failed; `values` may have the reason."""


class SendActionGoal(NamedTuple):
    """A goal for an action."""

    id: Id
    action: str
    type: str
    args: Any
    feedback: bool
    """True if the client requests the action's feedback."""


class CancelActionGoal(NamedTuple):
    """Cancellation of the goal that was sent with this id."""

    id: Id
    action: str


class SetLevel(NamedTuple):
    """Request for a level of status messages."""

    id: Id
    level: str
    """One of LEVELS, or "none"."""


class Authenticate(NamedTuple):
    """The ``auth`` of old servers, which is ignored: access is by the address's token."""

    id: Id


Operation = (
    Fragment
    | Advertise
    | Unadvertise
    | Publish
    | Subscribe
    | Unsubscribe
    | CallService
    | AdvertiseService
    | UnadvertiseService
    | ServiceResponse
    | SendActionGoal
    | CancelActionGoal
    | SetLevel
    | Authenticate
)


def parse_operation(text: str) -> Operation | RefusedOperation:
    """Parse the operation of a text frame, or return why it is refused."""
    try:
        given = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        return RefusedOperation(f"this is not JSON: {error}; it begins with {shown(text[:40])}")
    if not isinstance(given, dict):
        return RefusedOperation(f"an operation is a JSON object, not {shown(given)}")
    op = given.get("op")
    known = _PARSERS.get(op) if isinstance(op, str) else None
    identity, name = given.get("id"), ""
    fields = _Fields(given)
    try:
        identity = fields.id()
        if known is None:
            raise _WrongError(f"op: unknown operation {shown(op)}")
        key, parse = known
        name = fields.name(key) if key else ""
        return parse(fields, identity, name)
    except _WrongError as error:
        known_id = identity if isinstance(identity, (str, int)) else None
        return RefusedOperation(str(error), str(op) if known else "", known_id, name)


_LARGEST = 1e12
"""Upper limit of numbers; larger values are clipped."""


class _WrongError(Exception):
    """A field of an operation is wrong."""


def _no_constant(text: str) -> float:
    raise ValueError(f"JSON has no {text}; a float that is not a number is null")


class _Fields:
    """Fields of an operation; null counts as absent."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.given = given

    def id(self) -> Id:
        value = self.given.get("id")
        if isinstance(value, str) and len(value) > MAX_ID_CHARACTERS:
            raise _WrongError(f"id: has more than {MAX_ID_CHARACTERS} characters")
        if value is not None and (isinstance(value, bool) or not isinstance(value, (str, int))):
            raise _WrongError(f"id: takes a text, not {shown(value)}")
        return value

    def name(self, key: str) -> str:
        value = self.given.get(key)
        if not isinstance(value, str) or not 0 < len(value) <= MAX_NAME_CHARACTERS:
            raise _WrongError(
                f"{key}: takes a name of 1 to {MAX_NAME_CHARACTERS} characters, not {shown(value)}"
            )
        return value

    def optional_name(self, key: str) -> str:
        return "" if self.given.get(key) in (None, "") else self.name(key)

    def text(self, key: str) -> str:
        value = self.given.get(key)
        if not isinstance(value, str):
            raise _WrongError(f"{key}: takes a text, not {shown(value)}")
        return value

    def flag(self, key: str) -> bool:
        value = self.given.get(key)
        if value is not None and not isinstance(value, bool):
            raise _WrongError(f"{key}: takes true or false, not {shown(value)}")
        return bool(value)

    def number(self, key: str) -> float:
        value = self.given.get(key)
        if value is None:
            return 0.0
        good = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not good or not 0 <= value < math.inf:
            raise _WrongError(f"{key}: takes a number of 0 or more, not {shown(value)}")
        return float(min(value, _LARGEST))

    def count(self, key: str) -> int:
        number = self.number(key)
        if not number.is_integer():
            raise _WrongError(f"{key}: takes a whole number, not {shown(number)}")
        return int(number)

    def choice(self, key: str, allowed: tuple[str, ...], default: str) -> str:
        value = self.given.get(key)
        value = default if value is None else value
        if value not in allowed:
            raise _WrongError(f"{key}: takes {', '.join(allowed)}, not {shown(value)}")
        return str(value)


def _fragment(fields: _Fields, identity: Id, _name: str) -> Fragment:
    number, total = fields.count("num"), fields.count("total")
    if not number < total:
        raise _WrongError(f"num: counts from 0 to total - 1; it is {number} of {total}")
    return Fragment(identity, number, total, fields.text("data"))


def _subscribe(fields: _Fields, identity: Id, topic: str) -> Subscribe:
    return Subscribe(
        identity,
        topic,
        fields.optional_name("type"),
        fields.number("throttle_rate"),
        min(fields.count("queue_length"), MAX_QUEUE_LENGTH),
        fields.choice("compression", COMPRESSIONS, "none"),
        fields.count("fragment_size"),
    )


def _publish(fields: _Fields, identity: Id, topic: str) -> Publish:
    message = fields.given.get("msg")
    message = {} if message is None else message
    return Publish(identity, topic, message, fields.optional_name("type"), fields.flag("latch"))


def _call(fields: _Fields, identity: Id, service: str) -> CallService:
    return CallService(
        identity,
        service,
        fields.given.get("args"),
        fields.choice("compression", ("none", "png", "cbor"), "none"),
        fields.count("fragment_size"),
        fields.number("timeout"),
    )


def _response(fields: _Fields, identity: Id, service: str) -> ServiceResponse:
    values = fields.given.get("values")
    result = True if fields.given.get("result") is None else fields.flag("result")
    return ServiceResponse(identity, service, values, result)


def _goal(fields: _Fields, identity: Id, action: str) -> SendActionGoal:
    args = fields.given.get("args")
    return SendActionGoal(
        identity, action, fields.name("action_type"), args, fields.flag("feedback")
    )


_PARSERS: dict[str, tuple[str, Callable[[_Fields, Id, str], Operation]]] = {
    "fragment": ("", _fragment),
    "advertise": (
        "topic",
        lambda fields, identity, topic: Advertise(
            identity, topic, fields.name("type"), fields.flag("latch")
        ),
    ),
    "unadvertise": ("topic", lambda _fields, identity, topic: Unadvertise(identity, topic)),
    "publish": ("topic", _publish),
    "subscribe": ("topic", _subscribe),
    "unsubscribe": ("topic", lambda _fields, identity, topic: Unsubscribe(identity, topic)),
    "call_service": ("service", _call),
    "advertise_service": (
        "service",
        lambda fields, identity, service: AdvertiseService(identity, service, fields.name("type")),
    ),
    "unadvertise_service": (
        "service",
        lambda _fields, identity, service: UnadvertiseService(identity, service),
    ),
    "service_response": ("service", _response),
    "send_action_goal": ("action", _goal),
    "cancel_action_goal": (
        "action",
        lambda _fields, identity, action: CancelActionGoal(identity, action),
    ),
    "set_level": (
        "",
        lambda fields, identity, _name: SetLevel(
            identity, fields.choice("level", (*LEVELS, "none"), "none")
        ),
    ),
    "auth": ("", lambda _fields, identity, _name: Authenticate(identity)),
}
"""Parsers by operation: the key of its subject's name, and the function."""
