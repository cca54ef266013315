"""Fast reader of a controller's feedback, by the equal layout of its datagrams (half the time).

A datagram whose tags, lengths and widths of numbers equal those of one read by protobuf differs
only in its values. A learned layout therefore reads further datagrams by one masked comparison and
one ``struct`` call. Any other datagram is left to
:func:`cardan.protocols.egm.decode.decode_feedback`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from cardan.protocols.egm import schema
from cardan.protocols.egm.decode import decode_feedback
from cardan.protocols.egm.messages import EgmFeedback, MalformedEgmMessage
from cardan.protocols.egm.units import MM_PER_M, RAD_PER_DEG
from cardan.types import Quaternion, Vector3

_LAYOUTS_MAX = 64
"""Most layouts kept: a controller's datagrams have some ten lengths."""

_VARINT_MAX = 5
"""Bytes of the longest number that is read: sequence numbers and seconds fit in."""

_new = tuple.__new__
_from_bytes = int.from_bytes
_isfinite = math.isfinite


class DatagramLayout(NamedTuple):
    """Layout of a datagram of a certain length."""

    mask: int
    """Mask of the bits that must be equal; little-endian, like `fixed`."""
    fixed: int
    values: struct.Struct
    states: tuple[int, int, int]
    """States, part of the layout because they change rarely."""
    forces: int
    """Count of forces, which are the last values."""
    has_rate: bool
    places: tuple[tuple[int, int], ...]
    """First byte and number of bytes of each value, in order."""


class FeedbackReader:
    """`decode_feedback` for a stream of datagrams that mostly repeat an earlier layout."""

    def __init__(self) -> None:
        self._layouts: dict[int, DatagramLayout | None] = {}
        """Layouts by the length of the datagram; None if it is too unusual to learn."""
        self._unlearned: tuple[bytes, EgmFeedback] | None = None
        self._sec_bytes, self._sec_us = b"", 0
        """Cache of the clock's last seconds, which repeat often."""

    def read(self, data: bytes) -> EgmFeedback | MalformedEgmMessage:
        """Decode `data` like `decode_feedback`."""
        layout = self._layouts.get(len(data))
        if layout is not None:
            mask, fixed, values, states, forces, has_rate, _ = layout
            if _from_bytes(data, "little") & mask == fixed:
                found = values.unpack(data)
                seqno, tm, j1, j2, j3, j4, j5, j6, x, y, z, u0, u1, u2, u3, sec, usec = found[:17]
                later = found[17:]
                if sec != self._sec_bytes:
                    self._sec_us = 1_000_000 * number(sec)
                    self._sec_bytes = sec
                if _isfinite(sum(found[2:15]) + sum(later)):
                    return _new(
                        EgmFeedback,
                        (
                            number(seqno) & 0xFFFFFFFF,
                            number(tm) & 0xFFFFFFFF,
                            (
                                j1 * RAD_PER_DEG,
                                j2 * RAD_PER_DEG,
                                j3 * RAD_PER_DEG,
                                j4 * RAD_PER_DEG,
                                j5 * RAD_PER_DEG,
                                j6 * RAD_PER_DEG,
                            ),
                            _new(Vector3, (x / MM_PER_M, y / MM_PER_M, z / MM_PER_M)),
                            _new(Quaternion, (u0, u1, u2, u3)),
                            (),
                            self._sec_us + number(usec),
                            states,
                            later[:forces],
                            later[forces] if has_rate else None,
                        ),
                    )
        feedback = decode_feedback(data)
        if (
            not isinstance(feedback, MalformedEgmMessage)
            and self._layouts.get(len(data), 0) is not None
        ):
            self._unlearned = (data, feedback)
        return feedback

    def learn(self) -> None:
        """Learn the layout of the last datagram, if it was new. Slow: call it when there is
        time."""
        if self._unlearned is None:
            return
        data, feedback = self._unlearned
        self._unlearned = None
        if len(self._layouts) >= _LAYOUTS_MAX:
            self._layouts.clear()
        self._layouts[len(data)] = _learned(data, feedback)


def number(varint: bytes) -> int:
    """Return the value of a varint of at most five bytes."""
    n = _from_bytes(varint, "little")
    low = n & 0x7F | n >> 1 & 0x3F80 | n >> 2 & 0x1F_C000
    if n < 0x100_0000:
        return low
    return low | n >> 3 & 0xFE0_0000 | n >> 4 & 0x7_F000_0000


# Paths of field numbers in EgmRobot.
_REQUIRED = [
    (1, 1),
    (1, 2),
    *[(2, 1, 1)] * 6,
    *[(2, 2, 1, n) for n in (1, 2, 3)],
    *[(2, 2, 2, n) for n in (1, 2, 3, 4)],
    (2, 4, 1),
    (2, 4, 2),
]
_FORCE = (9, 2)
"""Path of RobotWare 7's force; the full decoder reads RobotWare 6's layout."""
_RATE = (10,)
_READ = {*_REQUIRED, _FORCE, _RATE}
_CONSTANT = {(1, 3), (4, 1), (5, 1), (8, 1)}
"""mtype and the three states."""
_UNREADABLE = (2, 3, 1)
"""feedBack's external axes."""

_VARINT, _DOUBLE, _MESSAGE = 0, 1, 2
"""Wire types of protobuf."""


class UnusualError(Exception):
    """A layout is valid, but too unusual to learn."""


def _learned(data: bytes, feedback: EgmFeedback) -> DatagramLayout | None:
    """Learn the layout of `data`, which protobuf read as `feedback`; None if it is unusual."""
    mask = bytearray(b"\xff" * len(data))
    read: list[Leaf] = []
    try:
        for leaf in leaves(data, schema.Robot.DESCRIPTOR):
            path, at, size, is_double = leaf
            if path == _UNREADABLE:
                return None
            if is_double:
                mask[at : at + size] = bytes(size)
            elif path not in _CONSTANT:
                mask[at : at + size] = b"\x80" * size
            if path in _READ:
                read.append(leaf)
    except (UnusualError, IndexError):
        return None
    paths = [leaf.path for leaf in read]
    count = len(_REQUIRED)
    has_rate = paths[-1:] == [_RATE]
    forces = paths[count : len(paths) - has_rate]
    if paths[:count] != _REQUIRED or forces != [_FORCE] * len(feedback.force):
        return None
    form, end = "<", 0
    for _, at, size, is_double in read:
        form += f"{at - end}x" + ("d" if is_double else f"{size}s")
        end = at + size
    values = struct.Struct(f"{form}{len(data) - end}x")
    ones = _from_bytes(mask, "little")
    fixed = _from_bytes(data, "little") & ones
    places = tuple((leaf.at, leaf.size) for leaf in read)
    return DatagramLayout(ones, fixed, values, feedback.states, len(forces), has_rate, places)


class Leaf(NamedTuple):
    """A number in a datagram."""

    path: tuple[int, ...]
    """Field numbers, from the outermost message on."""
    at: int
    size: int
    is_double: bool
    """True: eight bytes; False: a varint."""


def leaves(data: bytes, message: Any) -> Iterator[Leaf]:
    """Yield the numbers in `data`, which protobuf has read as a `message` (a descriptor), in order.

    Raises UnusualError for unknown fields, and for known ones of another type.
    """
    return _walk(data, 0, len(data), message, ())


def _walk(data: bytes, at: int, end: int, message: Any, path: tuple[int, ...]) -> Iterator[Leaf]:
    while at < end:
        tag = data[at]
        at += 1
        field = message.fields_by_number.get(tag >> 3)
        if tag >= 0x80 or field is None:
            raise UnusualError
        here = (*path, tag >> 3)
        wire = tag & 7
        start = at
        if wire == _MESSAGE and field.message_type is not None:
            at = _after_varint(data, at)
            start, at = at, at + number(data[start:at])
            yield from _walk(data, start, at, field.message_type, here)
        elif wire == _DOUBLE and field.type == field.TYPE_DOUBLE:
            at += 8
            yield Leaf(here, start, 8, True)
        elif wire == _VARINT and field.message_type is None and field.type != field.TYPE_DOUBLE:
            at = _after_varint(data, at)
            yield Leaf(here, start, at - start, False)
        else:
            raise UnusualError


def _after_varint(data: bytes, at: int) -> int:
    """Return the end of the varint at `at`."""
    end = at
    while data[end] >= 0x80:
        end += 1
    if end - at >= _VARINT_MAX:
        raise UnusualError
    return end + 1
