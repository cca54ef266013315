"""One readable line of a simple message, in the units of the wire."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from cardan.dissect.simple_message import (
    CHECK_QUEUE_CNT,
    COMM_TYPES,
    COMMANDS,
    NAMES,
    REPLY,
    REPLY_CODES,
    SUCCESS,
    VALID_FIELDS,
    DhLink,
    IoErrorReply,
    MotionReply,
    RecordsField,
    SimpleMessage,
    result_name,
    subcode_name,
)

UNITS = {
    "time_s": "s",
    "duration_s": "s",
    "positions": "rad or m",
    "velocities": "rad/s or m/s",
    "accelerations": "rad/s² or m/s²",
    "v_max": "rad/s or m/s",
    "a_max": "rad/s² or m/s²",
    "pos_min": "rad or m",
    "pos_max": "rad or m",
}
"""The arm's model decides between the two; the wire does not say it."""


def describe(layer: SimpleMessage) -> str:
    """Every value of a message that is not broken."""
    title = f"{message_name(layer.msg_type)} {COMM_TYPES.get(layer.comm_type, layer.comm_type)}"
    if layer.comm_type == REPLY or layer.reply_code:
        title += f" {REPLY_CODES.get(layer.reply_code, layer.reply_code)}"
    digits = 7 if layer.real_bytes == 4 else 8
    return " | ".join((title, *_body(layer, digits)))


def message_name(number: int) -> str:
    """Name of a message type or a command."""
    return COMMANDS.get(number) or NAMES.get(number) or str(number)


def _body(layer: SimpleMessage, digits: int) -> Iterator[str]:
    words: list[str] = []
    for field in layer.body_fields:
        value = layer.getfieldval(field.name)
        if isinstance(field, RecordsField):
            if words:
                yield " ".join(words)
            yield from _records(layer, value, digits)
            return
        text = _value(layer, field, value, digits)
        if isinstance(value, list):
            if words:
                yield " ".join(words)
            words = []
            yield text
        else:
            words.append(text)
    if words:
        yield " ".join(words)


def _value(layer: SimpleMessage, field: Any, value: Any, digits: int) -> str:
    name = field.name
    if isinstance(value, list | float):
        return _reals(name, value if isinstance(value, list) else [value], digits)
    if name == "valid_fields":
        return f"valid {valid_fields(value)}"
    if name == "command_code":
        return f"command {message_name(value)}"
    if isinstance(layer, MotionReply | IoErrorReply):
        if name == "result":
            return result_name(layer)
        if name == "subcode":
            counted = isinstance(layer, MotionReply) and (
                (layer.command_code, layer.result) == (CHECK_QUEUE_CNT, SUCCESS)
            )
            return f"{value} increments queued" if counted else f"subcode {subcode_name(layer)}"
    names = getattr(field, "i2s", None) or {}
    return f"{name} {names.get(value, value)}"


def _reals(name: str, values: Iterable[float], digits: int) -> str:
    shown = " ".join(f"{value:.{digits}g}" for value in values)
    return f"{name.removesuffix('_s')} {shown} {UNITS.get(name, '')}".rstrip()


def valid_fields(bits: int) -> str:
    """The names of the bits."""
    names = [name for bit, name in VALID_FIELDS.items() if bits & bit]
    rest = bits & ~sum(VALID_FIELDS)
    return "+".join([*names, *([hex(rest)] if rest else [])]) or "none"


def _records(layer: SimpleMessage, records: list[Any], digits: int) -> Iterator[str]:
    if records and isinstance(records[0], DhLink):
        for index, link in enumerate(records):
            if any(link):
                shown = " ".join(f"{value:.{digits}g}" for value in link)
                yield f"group {index // 8} link {index % 8} theta d a alpha {shown}"
        return
    for record in records[: layer.group_count]:
        parts = []
        for name, value in zip(record._fields, record, strict=True):
            if name == "valid_fields":
                parts.append(f"valid {valid_fields(value)}")
            elif isinstance(value, int):
                parts.append(f"{name} {value}")
            else:
                parts.append(_reals(name, value if isinstance(value, tuple) else [value], digits))
        yield ", ".join(parts)
