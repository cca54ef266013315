"""URScript's functions of sockets.

A function that reads waits until the requested data is there. After a time-out, or if the socket is
closed, it returns the script manual's value for a failure, in the next frame at the earliest.

Source: UR's script manual, module interfaces.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from cardan.sim_peers.ur_controller.checks import number, truth, whole, words
from cardan.sim_peers.ur_controller.language import Action, Function, Pending
from cardan.sim_peers.ur_controller.operators import LONGEST_TEXT, text
from cardan.sim_peers.ur_controller.sockets import ProgramSocket, ProgramSockets
from cardan.sim_peers.ur_controller.values import is_number

OPEN_S: Final = 2.0
"""Longest time of opening a socket."""
MOST_VALUES: Final = 255
"""Most values that one call reads."""
_READ_S: Final = 2.0
_NAME: Final = "socket_0"
_NUMBERS: Final = re.compile(rb"\(([^()]*)\)")
_LONGEST_NUMBERS: Final = 32
"""Most bytes of one number as text."""
_ESCAPES: Final = re.compile(r"\\(n|r|t|\\|x[0-9a-fA-F]{2})")
_ESCAPED: Final = {"n": "\n", "r": "\r", "t": "\t", "\\": "\\"}

_Take = Callable[[bytearray], Any]
"""Extracts the value of a read function from the received bytes; None if it is incomplete."""


def socket_functions(sockets: ProgramSockets) -> Mapping[str, Function]:
    """Return the functions by name."""

    def open_one(address: Any, port: Any, name: Any) -> Action | bool:
        opening = sockets.open(
            words("address", address), whole("port", port, 1, 65535), words("socket_name", name)
        )
        if opening is None:
            return False

        def failed() -> bool:
            sockets.close(name)
            return False

        def poll() -> bool | None:
            return opening.open if opening.open is not False else failed()

        return Pending(poll, OPEN_S, failed)

    def close(name: Any) -> None:
        sockets.close(words("socket_name", name))

    def send(data: bytes, name: Any) -> bool:
        return sockets.send(words("socket_name", name), data)

    def send_int(value: Any, name: Any) -> bool:
        written = whole("value", value, -(2**31), 2**31 - 1)
        return send(written.to_bytes(4, "big", signed=True), name)

    def send_byte(value: Any, name: Any) -> bool:
        return send(bytes([whole("value", value, -128, 255) & 0xFF]), name)

    def read(name: Any, timeout: Any, take: _Take, otherwise: Any) -> Action | Any:
        return _read(
            sockets, words("socket_name", name), number("timeout", timeout), take, otherwise
        )

    def read_bytes(size: int, signed: bool) -> Callable[[Any, Any, Any], Any]:
        def reads(count: Any, name: Any, timeout: Any) -> Any:
            wanted = whole("number", count, 1, MOST_VALUES)
            failure = [0, *([-1] * wanted)]
            return read(name, timeout, _integers(wanted, size, signed), failure)

        return reads

    def read_floats(count: Any, name: Any, timeout: Any) -> Any:
        wanted = whole("number", count, 1, MOST_VALUES)
        failure = [0, *([math.nan] * wanted)]
        return read(name, timeout, lambda data: _floats(data, wanted, failure), failure)

    def read_string(name: Any, prefix: Any, suffix: Any, escape: Any, timeout: Any) -> Any:
        begin, end = words("prefix", prefix), words("suffix", suffix)
        if truth("interpret_escape", escape):
            begin, end = _unescaped(begin), _unescaped(end)
        take = _between(begin.encode("latin-1", "replace"), end.encode("latin-1", "replace"))
        return read(name, timeout, take, "")

    def get_var(variable: Any, name: Any) -> Any:
        wanted = words("name", variable).encode("latin-1", "replace")
        if not send(b"GET " + wanted + b"\n", name):
            return 0
        return read(name, _READ_S, lambda data: _answer(data, wanted), 0)

    def set_var(variable: Any, value: Any, name: Any) -> bool:
        written = whole("value", value, -(2**31), 2**31 - 1)
        return send(f"SET {words('name', variable)} {written}\n".encode("latin-1", "replace"), name)

    last = {"socket_name": _NAME}
    timed = {**last, "timeout": _READ_S}
    reads = ("number", "socket_name", "timeout")
    return {
        "socket_open": Function(
            ("address", "port", "socket_name"), last, open_one, takes_time=True
        ),
        "socket_close": Function(("socket_name",), last, close),
        "socket_send_string": Function(
            ("str", "socket_name"), last, lambda value, name: send(_encoded(value), name)
        ),
        "socket_send_line": Function(
            ("str", "socket_name"), last, lambda value, name: send(_encoded(value) + b"\n", name)
        ),
        "socket_send_int": Function(("value", "socket_name"), last, send_int),
        "socket_send_byte": Function(("value", "socket_name"), last, send_byte),
        "socket_read_binary_integer": Function(reads, timed, read_bytes(4, True), takes_time=True),
        "socket_read_byte_list": Function(reads, timed, read_bytes(1, False), takes_time=True),
        "socket_read_ascii_float": Function(reads, timed, read_floats, takes_time=True),
        "socket_read_string": Function(
            ("socket_name", "prefix", "suffix", "interpret_escape", "timeout"),
            {**timed, "prefix": "", "suffix": "", "interpret_escape": False},
            read_string,
            takes_time=True,
        ),
        "socket_read_line": Function(
            ("socket_name", "timeout"),
            timed,
            lambda name, timeout: read(name, timeout, _between(b"", b"\n"), ""),
            takes_time=True,
        ),
        "socket_get_var": Function(("name", "socket_name"), last, get_var, takes_time=True),
        "socket_set_var": Function(("name", "value", "socket_name"), last, set_var),
    }


def _read(
    sockets: ProgramSockets, name: str, timeout_s: float, take: _Take, otherwise: Any
) -> Action | Any:
    found = sockets.get(name)
    if found is None:
        return Pending(lambda: None, 0.0, lambda: otherwise)
    there = take(found.unread)
    if there is not None:
        return there
    if not found.open:
        return Pending(lambda: None, 0.0, lambda: otherwise)
    waits_s = timeout_s if timeout_s > 0.0 else math.inf
    return Pending(lambda: _now(found, take, otherwise), waits_s, lambda: otherwise)


def _now(found: ProgramSocket, take: _Take, otherwise: Any) -> Any:
    there = take(found.unread)
    return otherwise if there is None and not found.open else there


def _encoded(value: Any) -> bytes:
    return (value if isinstance(value, str) else text(value)).encode("latin-1", "replace")


def _integers(count: int, size: int, signed: bool) -> _Take:
    def take(data: bytearray) -> list[int] | None:
        if len(data) < count * size:
            return None
        found = [
            int.from_bytes(data[n * size : (n + 1) * size], "big", signed=signed)
            for n in range(count)
        ]
        del data[: count * size]
        return [count, *found]

    return take


def _floats(data: bytearray, count: int, failure: list[Any]) -> list[Any] | None:
    """Return the numbers in parentheses, separated by commas."""
    found = _NUMBERS.search(data)
    if found is None:
        if len(data) > (count + 1) * _LONGEST_NUMBERS:
            data.clear()
            return failure
        return None
    parts = found.group(1).split(b",")
    del data[: found.end()]
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        return failure
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        return failure
    return [count, *numbers]


def _between(prefix: bytes, suffix: bytes) -> _Take:
    """Return a reader of text between prefix and suffix; without both, of all received text."""

    def take(data: bytearray) -> str | None:
        begin = data.find(prefix) if prefix else 0
        if begin < 0 or not data:
            return None
        begin += len(prefix)
        end = data.find(suffix, begin) if suffix else min(len(data), begin + LONGEST_TEXT)
        if end < 0:
            if len(data) - begin <= LONGEST_TEXT:
                return None
            end, skipped = begin + LONGEST_TEXT, 0
        else:
            skipped = len(suffix)
        found = bytes(data[begin:end][:LONGEST_TEXT]).decode("latin-1")
        del data[: end + skipped]
        return found

    return take


def _answer(data: bytearray, wanted: bytes) -> int | None:
    """Return the value in the reply to `GET name`: `name value` and the end of the line."""
    end = data.find(b"\n")
    if end < 0:
        if len(data) > LONGEST_TEXT:
            data.clear()
        return None
    name, _, value = bytes(data[:end]).strip().partition(b" ")
    del data[: end + 1]
    if name != wanted or not re.fullmatch(rb"[+-]?\d{1,10}", value.strip()):
        return None
    found = int(value)
    return found if is_number(found) and -(2**31) <= found < 2**31 else None


def _unescaped(value: str) -> str:
    def one(found: re.Match[str]) -> str:
        code = found.group(1)
        return _ESCAPED.get(code) or chr(int(code[1:], 16))

    return _ESCAPES.sub(one, value)
