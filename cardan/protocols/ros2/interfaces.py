"""ROS 2 interfaces: fields of the messages, services and actions that Cardan knows.

`definitions` has their ``.msg``, ``.srv`` and ``.action`` files (docs.ros.org, "Interfaces"). This
module makes the types that rosidl derives from a service or an action (``..._Request``,
``..._SendGoal_Response``, ...).
"""

from __future__ import annotations

import re
from functools import cache
from typing import NamedTuple

from cardan.protocols.ros2.definitions import FEEDBACK_SINCE_KILTED, TEXT

FILES = {
    name: text
    for name, _, text in (each.partition("\n") for each in TEXT.removeprefix("@").split("\n@"))
}
"""Text of each interface's file, by its full name."""

SINCE_KILTED = "SinceKilted"
"""Suffix of a type's name for its revision of Kilted and later; the wire has the plain name."""

_FOLLOW = "control_msgs/action/FollowJointTrajectory"
_REVISED = {
    _FOLLOW + SINCE_KILTED: f"{FILES[_FOLLOW].rpartition('---')[0]}---\n{FEEDBACK_SINCE_KILTED}"
}

DUMMY_MEMBER = "structure_needs_at_least_one_member"
"""The single byte of a message without fields."""

INTEGERS = {
    "int8": (-(1 << 7), (1 << 7) - 1),
    "uint8": (0, (1 << 8) - 1),
    "char": (0, (1 << 8) - 1),
    "byte": (0, (1 << 8) - 1),
    "int16": (-(1 << 15), (1 << 15) - 1),
    "uint16": (0, (1 << 16) - 1),
    "int32": (-(1 << 31), (1 << 31) - 1),
    "uint32": (0, (1 << 32) - 1),
    "int64": (-(1 << 63), (1 << 63) - 1),
    "uint64": (0, (1 << 64) - 1),
}
"""Lowest and highest value of the integer types."""

FLOATS = ("float32", "float64")
PRIMITIVES = frozenset({*INTEGERS, *FLOATS, "bool", "string"})


class InterfaceError(ValueError):
    """There is no such interface, or its file cannot be parsed; the message tells which."""


class Field(NamedTuple):
    """A field of a message, in wire order."""

    name: str
    base: str
    """Name of a primitive type, or full name of a message ("geometry_msgs/msg/Point")."""
    array: str = ""
    """"": one value, "fixed": `length` values, "bounded": at most `length`, "sequence": any
    number."""
    length: int = 0
    most_characters: int = 0
    """Bound of a string; 0: none."""
    default: str = ""
    """Default as in the file; empty: the type's zero."""

    @property
    def nested(self) -> bool:
        """True if it is a message of its own."""
        return self.base not in PRIMITIVES

    @property
    def type_text(self) -> str:
        """Type as in .msg files, a message by package and name."""
        base = two_part(self.base) if self.nested else self.base
        bound = f"<={self.most_characters}" if self.most_characters else ""
        mark = {"": "", "fixed": f"[{self.length}]", "bounded": f"[<={self.length}]"}
        return base + bound + mark.get(self.array, "[]")


class Constant(NamedTuple):
    """A constant of a message; it is not on the wire."""

    name: str
    base: str
    value: str


class MessageDefinition(NamedTuple):
    """A message's fields and constants."""

    name: str
    """Full name: "geometry_msgs/msg/Pose", "std_srvs/srv/Trigger_Request"."""
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()

    @property
    def text(self) -> str:
        """Definition as in a .msg file, without comments."""
        lines = [f"{each.base} {each.name}={each.value}" for each in self.constants]
        lines += [" ".join(filter(None, (f.type_text, f.name, f.default))) for f in self.fields]
        return "".join(f"{line}\n" for line in lines)


class ServiceType(NamedTuple):
    """A service: the names of its two messages."""

    name: str

    @property
    def request(self) -> str:
        """Name of the request's message."""
        return f"{self.name}_Request"

    @property
    def response(self) -> str:
        """Name of the response's message."""
        return f"{self.name}_Response"


class ActionType(NamedTuple):
    """An action: its messages, and the services and the topic that carry it."""

    name: str

    @property
    def goal(self) -> str:
        """Name of the goal's message."""
        return f"{self.name}_Goal"

    @property
    def result(self) -> str:
        """Name of the result's message."""
        return f"{self.name}_Result"

    @property
    def feedback(self) -> str:
        """Name of the message of the feedback topic: goal_id and feedback."""
        return f"{self.name}_FeedbackMessage"

    @property
    def send_goal(self) -> ServiceType:
        """The service that sends a goal."""
        return ServiceType(f"{self.name}_SendGoal")

    @property
    def get_result(self) -> ServiceType:
        """The service that waits for a goal's result."""
        return ServiceType(f"{self.name}_GetResult")


def full_name(name: str, kind: str = "msg") -> str:
    """Return a type's three-part name: "geometry_msgs/Pose" and "geometry_msgs/msg/Pose" are the
    same.

    Raises InterfaceError if it is no name of a type.
    """
    parts = name.split("/")
    if len(parts) == 2:
        parts.insert(1, kind)
    if len(parts) != 3 or parts[1] not in ("msg", "srv", "action") or not all(map(_is_name, parts)):
        raise InterfaceError(f"{name[:80]!r} is not a type such as geometry_msgs/msg/Pose")
    return "/".join(parts)


def two_part(name: str) -> str:
    """Return a type's name without its kind: "geometry_msgs/Pose"."""
    package, _, last = name.split("/")
    return f"{package}/{last}"


def name_on_the_wire(name: str) -> str:
    """Return a type's name on the wire, the same for all its revisions."""
    return name.replace(SINCE_KILTED, "")


@cache
def revised(name: str) -> str:
    """Return the later revision of a type; empty if there is none."""
    later = (each for each in _REVISED if f"{name}_".startswith(f"{name_on_the_wire(each)}_"))
    return next((each + name.removeprefix(name_on_the_wire(each)) for each in later), "")


def known_types() -> tuple[str, ...]:
    """Return the full names of all messages, services and actions that have a file, sorted."""
    return tuple(sorted(FILES))


@cache
def message_type(name: str) -> MessageDefinition:
    """Return the message called `name`, also of services and actions. Raises InterfaceError."""
    name = full_name(name)
    package, kind, last = name.split("/")
    if kind == "msg":
        return parse_message(name, _text_of(package, kind, last))
    if kind == "srv":
        base, _, part = last.rpartition("_")
        if part == "Event":
            return _event(f"{package}/srv/{base}")
        sections = {"Request": 0, "Response": 1}
    else:
        if made := _made_of_action(package, last):
            return made
        base, _, part = last.rpartition("_")
        sections = {"Goal": 0, "Result": 1, "Feedback": 2}
    if not base or part not in sections:
        raise InterfaceError(f"{name} is not a message; allowed: {', '.join(sections)} after _")
    section = _sections(package, kind, base, len(sections))[sections[part]]
    return parse_message(name, section)


@cache
def service_type(name: str) -> ServiceType:
    """Return the service called `name`. Raises InterfaceError."""
    service = ServiceType(full_name(name, "srv"))
    message_type(service.request)
    return service


@cache
def action_type(name: str) -> ActionType:
    """Return the action called `name`. Raises InterfaceError."""
    action = ActionType(full_name(name, "action"))
    message_type(action.goal)
    return action


@cache
def referenced(name: str) -> tuple[str, ...]:
    """Return the full names of all messages that `name` contains, directly or nested, sorted."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        for field in message_type(waiting.pop()).fields:
            if field.nested and field.base not in found:
                found.add(field.base)
                waiting.append(field.base)
    return tuple(sorted(found))


def full_text(name: str) -> str:
    """Return the definition of a message with those that it contains, as in rosbag2 and rosapi:
    each after a line of ``=`` and a line ``MSG: PACKAGE/NAME``."""
    parts = [message_type(name).text]
    parts += [
        f"{'=' * 80}\nMSG: {two_part(each)}\n{message_type(each).text}" for each in referenced(name)
    ]
    return "".join(parts)


# -- files ----------------------------------------------------------------------------------------

_TYPE = re.compile(
    r"(?P<base>[A-Za-z]\w*(?:/[A-Za-z]\w*){0,2})(?:<=(?P<characters>\d{1,9}))?"
    r"(?:\[(?P<bounded><=)?(?P<count>\d{0,9})\])?\Z"
)
_LINE = re.compile(
    r"(?P<type>\S+)\s+(?P<name>[A-Za-z]\w*)\s*(?:(?P<equals>=)\s*)?(?P<value>.*?)\s*\Z"
)


def parse_message(name: str, text: str) -> MessageDefinition:
    """Parse the `text` of a .msg file. Raises InterfaceError with the line."""
    package = name.split("/", 1)[0]
    fields: list[Field] = []
    constants: list[Constant] = []
    for line in text.splitlines():
        said = _without_comment(line).strip()
        if not said:
            continue
        match = _LINE.match(said)
        if match is None:
            raise InterfaceError(f"{name}: cannot be understood: {said[:80]!r}")
        kind, value = _TYPE.match(match["type"]), match["value"]
        if kind is None:
            raise InterfaceError(f"{name}: {match['type'][:80]!r} is not a type")
        if match["equals"]:
            constants.append(Constant(match["name"], kind["base"], value))
        else:
            fields.append(_field(package, kind, match["name"], value))
    if not fields:
        fields.append(Field(DUMMY_MEMBER, "uint8"))
    return MessageDefinition(name, tuple(fields), tuple(constants))


def _field(package: str, kind: re.Match[str], name: str, default: str) -> Field:
    base = kind["base"]
    if base not in PRIMITIVES:
        base = "std_msgs/msg/Header" if base == "Header" else base
        base = full_name(base if "/" in base else f"{package}/{base}")
    array, count = "", 0
    if kind["count"] is not None:
        array = "bounded" if kind["bounded"] else "fixed" if kind["count"] else "sequence"
        count = int(kind["count"] or 0)
    return Field(name, base, array, count, int(kind["characters"] or 0), default)


def _without_comment(line: str) -> str:
    """Return `line` up to a # that is not in quotes."""
    quote = ""
    for index, character in enumerate(line):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == "#":
            return line[:index]
    return line


def _is_name(part: str) -> bool:
    return part.isidentifier() and part.isascii()


def _text_of(package: str, kind: str, last: str) -> str:
    name = f"{package}/{kind}/{last}"
    text = FILES.get(name, _REVISED.get(name))
    if text is None:
        raise InterfaceError(f"{name} is not a type that Cardan knows")
    return text


def _sections(package: str, kind: str, base: str, count: int) -> list[str]:
    text = _text_of(package, kind, base)
    sections = re.split(r"^---[ \t]*$", text, flags=re.MULTILINE)
    if len(sections) != count:
        raise InterfaceError(f"{package}/{kind}/{base}: {len(sections)} parts, not {count}")
    return sections


def _event(service: str) -> MessageDefinition:
    """Make the event type of a service's introspection, which is part of the service's type
    hash."""
    fields = (
        Field("info", "service_msgs/msg/ServiceEventInfo"),
        Field("request", f"{service}_Request", "bounded", 1),
        Field("response", f"{service}_Response", "bounded", 1),
    )
    return MessageDefinition(f"{service}_Event", fields)


def _made_of_action(package: str, last: str) -> MessageDefinition | None:
    """Make the messages that every action has around its goal, result and feedback."""
    uuid = Field("goal_id", "unique_identifier_msgs/msg/UUID")
    full = f"{package}/action/{last}"
    for suffix, fields_of in (
        ("_SendGoal_Request", lambda own: (uuid, Field("goal", f"{own}_Goal"))),
        (
            "_SendGoal_Response",
            lambda _own: (
                Field("accepted", "bool"),
                Field("stamp", "builtin_interfaces/msg/Time"),
            ),
        ),
        ("_GetResult_Request", lambda _own: (uuid,)),
        (
            "_GetResult_Response",
            lambda own: (Field("status", "int8"), Field("result", f"{own}_Result")),
        ),
        ("_FeedbackMessage", lambda own: (uuid, Field("feedback", f"{own}_Feedback"))),
    ):
        if last.endswith(suffix):
            return MessageDefinition(full, fields_of(full.removesuffix(suffix)))
    for suffix in ("_SendGoal_Event", "_GetResult_Event"):
        if last.endswith(suffix):
            return _event(full.removesuffix("_Event"))
    return None
