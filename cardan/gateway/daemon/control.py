"""The daemon's control protocol: one JSON object a line, both ways, over a local socket.

A request is ``{"id": 1, "do": "start", "name": "gofa"}``; its answer ``{"id": 1, "result": ...}``
or ``{"id": 1, "error": "..."}``. Continuing requests (``watch``, ``log``, ``ask``) are answered by
any number of ``{"id": 1, "event": ...}``. A client whose endless motion is under way sends
``{"id": 2, "do": "beat"}`` every BEAT_PERIOD_S, which has no answer: the motion ends when nothing
has come from it for CLIENT_SILENCE_S. No I/O; malformed lines raise ControlError.
"""

from __future__ import annotations

import json
from typing import Any, Final, NamedTuple

from cardan.errors import CardanError, shown
from cardan.gateway.servers.tokens import Role

CLIENT_SILENCE_S: Final = 0.5
"""Longest silence of a client whose endless motion is under way, as for a session's supervisor."""

MAX_LINE_BYTES: Final = 64 * 1024
"""Longest line of a request: one of a verb has 4 kB. Answers may be longer."""

NEEDS: Final = {
    **dict.fromkeys(
        ("units", "devices", "snapshot", "figures", "version", "watch", "log", "events", "beat"),
        Role.VIEWER,
    ),
    **dict.fromkeys(("start", "stop", "restart", "switch", "ask"), Role.OPERATOR),
    "reload": Role.ADMIN,
}
"""The lowest role for each request."""

VIEWERS_VERBS: Final = frozenset({"stat", "status", "get_parameter", "get_parameters", "stop"})
"""Verbs of an arm that a viewer may request: they change nothing, or stop the arm, which needs no
authority. They do not wait in the queue of other verbs."""

_LARGEST_ID: Final = 1 << 53

MOST_LEVELS: Final = 32
"""Deepest nesting of lists and objects in a line; a verb's has 4. A deeper line can be read, but
not shown or passed on: each level takes one of Python's stack."""


class ControlError(CardanError):
    """Error: the daemon refuses a request; `request` is its id, None if it has none."""

    def __init__(self, message: str, request: int | None = None) -> None:
        super().__init__(message)
        self.request = request


class Ask(NamedTuple):
    """Request to the daemon."""

    id: int
    do: str
    name: str = ""
    """Name of a session or a server; empty: none, or all."""
    value: Any = None


class Response(NamedTuple):
    """Response of the daemon to a request."""

    id: int | None
    kind: str
    """Kind: ``result``, ``error`` or ``event``."""
    value: Any


def refusal(ask: Ask, role: Role) -> str:
    """Return why a client with this role may not send this request; empty if it may."""
    needed, what = NEEDS[ask.do], ask.do
    if ask.do == "ask" and isinstance(ask.value, dict) and isinstance(ask.value.get("verb"), str):
        what = ask.value["verb"]
        needed = Role.VIEWER if what in VIEWERS_VERBS else needed
    if role >= needed:
        return ""
    return (
        f"{what:.40} takes the role {needed.word}, and you have {role.word} here: the daemon's "
        "user may do everything, others what its group_role says"
    )


def encode_ask(ask: Ask) -> bytes:
    """Encode as a line."""
    table: dict[str, Any] = {"id": ask.id, "do": ask.do}
    if ask.name:
        table["name"] = ask.name
    if ask.value is not None:
        table["value"] = ask.value
    return _line(table)


def decode_ask(line: bytes) -> Ask:
    """Decode from a line. Raises ControlError."""
    table = _table(line)
    number = table.pop("id", None)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number <= _LARGEST_ID:
        raise ControlError(f"id: {number!r:.60} is not a whole number from 0 to {_LARGEST_ID}")
    do, name, value = table.pop("do", None), table.pop("name", ""), table.pop("value", None)
    if not isinstance(do, str) or do not in NEEDS:
        raise ControlError(f"do: there is no {do!r:.60}; allowed: {', '.join(NEEDS)}", number)
    if not isinstance(name, str):
        raise ControlError(f"name: {name!r:.60} is not text", number)
    if table:
        raise ControlError(f"there is no key {next(iter(table))!r:.60}", number)
    return Ask(number, do, name, value)


def encode_response(response: Response) -> bytes:
    """Encode as a line."""
    return _line({"id": response.id, response.kind: response.value})


def decode_response(line: bytes) -> Response:
    """Decode from a line. Raises ControlError."""
    table = _table(line)
    for kind in ("result", "error", "event"):
        if kind in table:
            return Response(table.get("id"), kind, table[kind])
    raise ControlError(f"not a reply of the daemon: {line!r:.80}")


def _line(table: dict[str, Any]) -> bytes:
    return json.dumps(table, separators=(",", ":")).encode() + b"\n"


def _table(line: bytes) -> dict[str, Any]:
    try:
        table = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ControlError(f"it is not JSON: {error}") from None
    if not isinstance(table, dict):
        raise ControlError(f"it is not an object: {shown(table)}")
    if not _is_flat(table, MOST_LEVELS):
        raise ControlError(f"it has more than {MOST_LEVELS} lists and objects within each other")
    return table


def _is_flat(value: Any, levels: int) -> bool:
    if isinstance(value, dict):
        return levels > 0 and all(_is_flat(each, levels - 1) for each in value.values())
    if isinstance(value, list):
        return levels > 0 and all(_is_flat(each, levels - 1) for each in value)
    return True


class LineReader:
    """Splits a stream into lines."""

    def __init__(self, most_bytes: int = MAX_LINE_BYTES) -> None:
        self._left = b""
        self._most = most_bytes

    def take(self, data: bytes) -> list[bytes]:
        """Return the lines that `data` completes. Raises ControlError if one is too long."""
        *lines, self._left = (self._left + data).split(b"\n")
        if any(len(each) > self._most for each in (*lines, self._left)):
            raise ControlError(f"a line has at most {self._most} bytes")
        return [each for each in lines if each.strip()]
