"""Messages as users write them: missing fields take their defaults, wrong ones are reported."""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

from cardan.errors import shown
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.interfaces import (
    DUMMY_MEMBER,
    FLOATS,
    INTEGERS,
    Field,
    message_type,
    referenced,
)

MAX_ELEMENTS = 100_000
"""Longest array that is accepted; messages that Cardan uses have at most a few hundred elements."""

_BYTES = ("uint8", "char", "byte")


class MessageError(ValueError):
    """A value does not fit the type; the text names the field and its allowed values."""


class Stamp(NamedTuple):
    """A time since the epoch, as in ``builtin_interfaces/msg/Time``."""

    sec: int
    nanosec: int

    @classmethod
    def of_ns(cls, since_epoch_ns: int) -> Stamp:
        """Convert a time in nanoseconds."""
        return cls(*divmod(since_epoch_ns, 1_000_000_000))


def default_message(name: str) -> Message:
    """Return a message with the defaults of its type. Raises InterfaceError."""
    return {field.name: _default(field) for field in message_type(name).fields}


def completed(name: str, given: Any, now: Stamp | None = None) -> Message:
    """Complete a message of the type `name` from a program's JSON values.

    Missing fields take their defaults. Integers are accepted as floats; None is NaN; bytes may be
    base64 text or numbers; a time may have ``secs`` and ``nsecs``. With `now`, a header without a
    stamp gets it, and a stamp may be ``"now"``. Raises MessageError, which names the field. The
    argument is not changed.
    """
    return _message(name, given, "", now)


_TIME = "builtin_interfaces/msg/Time"
_TIMES = (_TIME, "builtin_interfaces/msg/Duration")
_HEADER = "std_msgs/msg/Header"


def _message(name: str, given: Any, path: str, now: Stamp | None) -> Message:
    if name == _TIME and given == "now" and now is not None:
        return now._asdict()
    if not isinstance(given, Mapping):
        raise MessageError(f"{path or name}: takes an object, not {shown(given)}")
    fields = message_type(name).fields
    if name in _TIMES and ("secs" in given or "nsecs" in given):
        given = {_ROS1_TIME.get(key, key): value for key, value in given.items()}
    elif name == _HEADER and now is not None and "stamp" not in given:
        given = {"stamp": now._asdict(), **given}
    known = {field.name for field in fields}
    for key in given:
        if key not in known:
            raise MessageError(
                f"{_joined(path, str(key)[:60])}: {name} has no such field; it has "
                f"{', '.join(field.name for field in fields)}"
            )
    return {
        field.name: _value(field, given[field.name], _joined(path, field.name), now)
        if field.name in given
        else _default(field, now)
        for field in fields
    }


_ROS1_TIME = {"secs": "sec", "nsecs": "nanosec"}


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _value(field: Field, given: Any, path: str, now: Stamp | None) -> Any:
    if not field.array:
        return _single(field, given, path, now)
    if field.base in _BYTES:
        return _bytes(field, given, path)
    if not isinstance(given, (list, tuple)):
        raise MessageError(f"{path}: takes a list, not {shown(given)}")
    _check_count(field, len(given), path)
    return [_single(field, each, f"{path}[{index}]", now) for index, each in enumerate(given)]


def _is_unicode(text: str) -> bool:
    """True if UTF-8 can encode the text: JSON allows lone surrogates (RFC 8259, 8.2)."""
    if text.isascii():
        return True
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _check_count(field: Field, count: int, path: str) -> None:
    if field.array == "fixed" and count != field.length:
        raise MessageError(f"{path}: takes {field.length} elements, not {count}")
    most = field.length if field.array == "bounded" else MAX_ELEMENTS
    if field.array != "fixed" and count > most:
        raise MessageError(f"{path}: takes {most} elements at most, not {count}")


def _bytes(field: Field, given: Any, path: str) -> bytes:
    if isinstance(given, str):
        try:
            given = base64.b64decode(given, validate=True)
        except (ValueError, binascii.Error):
            raise MessageError(f"{path}: {shown(given)} is not base64") from None
    elif isinstance(given, (list, tuple)):
        given = bytes(_single(field, each, path, None) for each in given)
    if not isinstance(given, (bytes, bytearray, memoryview)):
        raise MessageError(f"{path}: takes base64 or a list of numbers, not {shown(given)}")
    _check_count(field, len(given), path)
    return bytes(given)


def _single(field: Field, given: Any, path: str, now: Stamp | None) -> Any:
    base = field.base
    if field.nested:
        return _message(base, given, path, now)
    if base == "string":
        if not isinstance(given, str) or "\0" in given:
            raise MessageError(f"{path}: takes a text without NUL, not {shown(given)}")
        if not _is_unicode(given):
            raise MessageError(f"{path}: takes Unicode without lone surrogates, not {given!a:.80}")
        if field.most_characters and len(given.encode()) > field.most_characters:
            raise MessageError(f"{path}: takes {field.most_characters} bytes at most")
        return given
    if base == "bool":
        if not isinstance(given, bool):
            raise MessageError(f"{path}: takes true or false, not {shown(given)}")
        return given
    if base in FLOATS:
        if given is None:
            return math.nan
        if isinstance(given, bool) or not isinstance(given, (int, float)):
            raise MessageError(f"{path}: takes a number, not {shown(given)}")
        try:
            return float(given)
        except OverflowError:
            raise MessageError(f"{path}: the number is too large") from None
    lowest, highest = INTEGERS[base]
    if isinstance(given, bool) or not isinstance(given, int) or not lowest <= given <= highest:
        raise MessageError(
            f"{path}: takes a whole number from {lowest} to {highest}, not {shown(given)}"
        )
    return given


@cache
def _plain_default(field: Field) -> Any:
    """Return the default of a single primitive value."""
    text = field.default
    if field.base == "string":
        return text.strip("\"'")
    if field.base == "bool":
        return text.lower() in ("true", "1")
    if field.base in FLOATS:
        return float(text or 0.0)
    return int(text or 0)


def _default(field: Field, now: Stamp | None = None) -> Any:
    if not field.array:
        if field.base == _HEADER and now is not None:
            return {**default_message(_HEADER), "stamp": now._asdict()}
        return default_message(field.base) if field.nested else _plain_default(field)
    count = field.length if field.array == "fixed" else 0
    if field.base in _BYTES:
        return bytes(count)
    if field.nested:
        return [default_message(field.base) for _ in range(count)]
    return [_plain_default(field._replace(default=""))] * count


# -- to JSON --------------------------------------------------------------------------------------


def json_text(name: str, message: Message) -> str:
    """Encode a message of the type `name` as one line of JSON: bytes are base64, floats that are
    not finite are null, the byte of a message without fields is left out."""
    if _has_dummies(name):
        message = _finite(message)
    try:
        return _JSON.encode(message)
    except ValueError:  # A float that JSON does not have.
        return _JSON.encode(_finite(message))


def _base64(value: Any) -> str:
    if isinstance(value, (bytes, bytearray, memoryview)):
        return base64.b64encode(value).decode("ascii")
    raise TypeError(f"{type(value).__name__} cannot be part of a message")


_JSON = json.JSONEncoder(separators=(",", ":"), allow_nan=False, default=_base64)


def _finite(value: Any) -> Any:
    """Return `value` with null for numbers that are not finite, and without the bytes of empty
    messages."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items() if key != DUMMY_MEMBER}
    if isinstance(value, list):
        return [_finite(each) for each in value]
    return value


@cache
def _has_dummies(name: str) -> bool:
    """True if a message has no fields, or contains one without."""
    types = map(message_type, (name, *referenced(name)))
    return any(each.fields[0].name == DUMMY_MEMBER for each in types)
