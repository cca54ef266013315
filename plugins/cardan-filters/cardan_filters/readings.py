"""Sensor datagrams as values: proximity readings and image centroids. No I/O, no clock. Invalid
datagrams are values too: a :class:`Malformed` with the reason, never an exception."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

MAX_DATAGRAM_BYTES = 1024
"""Longest datagram accepted, bytes; the skin's text has about 460."""

MAX_VALUES = 256
"""Most plain numbers in one proximity reading."""

BOARDS = (b"I", b"J", b"K")
"""The boards of the AMOR arm's skin, 16 sensors each."""

WORDS_PER_BOARD = 16
_DIGITS_PER_WORD = 3
_NO_VALUE = 0xFFF

_AXIS_LINE = re.compile(rb"([XYZ])([0-9A-Fa-f]{%d})" % (WORDS_PER_BOARD * _DIGITS_PER_WORD))
_NUMBER = re.compile(rb"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")


class Malformed(NamedTuple):
    """Datagram that cannot be decoded, and the reason."""

    reason: str


class Centroid(NamedTuple):
    """Position of the target in the image, each -1 to 1 from edge to edge, 0 the middle."""

    x: float
    """Offset to the right, -1 to 1."""
    y: float
    """Offset downwards, -1 to 1."""


def _quoted(data: bytes) -> str:
    return repr(data[:16])[1:] + ("..." if len(data) > 16 else "")


def _numbers(words: list[bytes]) -> tuple[float, ...] | Malformed:
    values = []
    for word in words:
        value = float(word) if _NUMBER.fullmatch(word) else math.nan
        if not math.isfinite(value):
            return Malformed(f"{_quoted(word)} is not a number")
        values.append(value)
    return tuple(values)


def decode_proximity(data: bytes) -> tuple[float, ...] | Malformed:
    """Decode a reading of all proximity sensors; the larger a value, the nearer an object.

    Either the text of the AMOR skin, 48 values: three boards ``I``, ``J``, ``K`` in any order,
    each followed by its axes X, Y and Z, a letter and 16 words of three hexadecimal digits; a
    sensor's value is the mean of its three axes, where FFF (no value) counts as 0. Or 1 to 256
    plain numbers, none negative, between spaces, line ends or commas.
    """
    if len(data) > MAX_DATAGRAM_BYTES:
        return Malformed(f"it is longer than {MAX_DATAGRAM_BYTES} bytes")
    words = data.split()
    if words and words[0] in BOARDS:
        return _decode_skin(words)
    words = data.replace(b",", b" ").split()
    if not 1 <= len(words) <= MAX_VALUES:
        return Malformed(f"it has {len(words)} numbers; allowed: 1 to {MAX_VALUES}")
    values = _numbers(words)
    if not isinstance(values, Malformed) and min(values) < 0.0:
        return Malformed(f"{min(values):g} is negative")
    return values


def _decode_skin(words: list[bytes]) -> tuple[float, ...] | Malformed:
    if len(words) != 4 * len(BOARDS):
        return Malformed(f"the skin's text has {len(words)} lines instead of {4 * len(BOARDS)}")
    boards: dict[bytes, list[float]] = {}
    any_value = False
    for start in range(0, len(words), 4):
        board = words[start]
        if board not in BOARDS or board in boards:
            return Malformed(f"{_quoted(board)} is not the expected one of the boards I, J, K")
        sums = [0.0] * WORDS_PER_BOARD
        for axis, line in zip(b"XYZ", words[start + 1 : start + 4], strict=True):
            found = _AXIS_LINE.fullmatch(line)
            if found is None or line[0] != axis:
                return Malformed(
                    f"board {board.decode()}: {_quoted(line)} is not {axis:c} and "
                    f"{WORDS_PER_BOARD} words of {_DIGITS_PER_WORD} hexadecimal digits"
                )
            digits = found[2]
            for index in range(WORDS_PER_BOARD):
                at = index * _DIGITS_PER_WORD
                value = int(digits[at : at + _DIGITS_PER_WORD], 16)
                if value != _NO_VALUE:
                    any_value = True
                    sums[index] += value
        boards[board] = sums
    if not any_value:
        # Zeros would mean free space all around, from a skin that senses nothing.
        return Malformed("every word of the skin is FFF: no sensor delivers a value")
    return tuple(total / 3.0 for board in BOARDS for total in boards[board])


def decode_centroid(data: bytes) -> Centroid | Malformed:
    """Decode the target's position in the image from two numbers, ``cx cy``, each -1 to 1."""
    if len(data) > MAX_DATAGRAM_BYTES:
        return Malformed(f"it is longer than {MAX_DATAGRAM_BYTES} bytes")
    words = data.split()
    if len(words) != 2:
        return Malformed(f"it has {len(words)} words instead of two numbers, cx and cy")
    values = _numbers(words)
    if isinstance(values, Malformed):
        return values
    for value in values:
        if not -1.0 <= value <= 1.0:
            return Malformed(f"{value:g} is outside of the image; allowed: -1 to 1")
    return Centroid(*values)
