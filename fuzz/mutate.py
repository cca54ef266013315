"""Damages input: as bytes, as words, as a JSON tree, as a sequence of packets.

Every decision comes from one ``random.Random``, so that a number gives the same inputs again.
"""

from __future__ import annotations

import copy
import json
import re
import struct
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

from fuzz.target import MOST_PACKETS, Form, Input, Target, packets_of

_WHOLE = (0, 1, 2, 3, 4, 7, 8, 15, 16, 31, 32, 63, 64, 100, 127, 128, 255)
_EDGES = tuple(
    (value % (1 << bits)).to_bytes(bits // 8, order)
    for bits in (16, 32, 64)
    for value in (
        *(0, 1, 2, -1, -2, 1 << (bits - 1), (1 << (bits - 1)) - 1, (1 << (bits - 1)) + 1),
        *(0x7F, 0x80, 0xFF, 0x100, 0xFFFF, 1000, 4096),
    )
    for order in ("little", "big")
)  # fmt: skip
_FLOATS = tuple(
    struct.pack(form, value)
    for form in ("<f", ">f", "<d", ">d")
    for value in (
        *(float("nan"), float("inf"), float("-inf"), 0.0, -0.0, 1.0, -1.0, 1e-40, 3.4e38, -3.4e38),
        *(1e30, 1e-30, 0.5),
    )
)
_DOUBLES = tuple(
    struct.pack(form, value)
    for form in ("<d", ">d")
    for value in (1.7976931348623157e308, 5e-324, -1.7976931348623157e308, 1e200)
)
_PIECES = _EDGES + _FLOATS + _DOUBLES

_TEXTS = (
    *("", " ", "0", "-0", "-1", "1", "1.5", "nan", "inf", "-inf", "1e308", "1e999", "-1e999"),
    *("1e-320", "9" * 30, "9" * 400, "9" * 5000, "0x10", "1_000", "+1", "true", "false", "null"),
    *("\x00", "\x1b[2J", "\u202e", "\ufeff", "\U0001f916", "é", "%", "%00", "%ff", "..", "/"),
    *("../../etc/passwd", "~", "*", "**", "a" * 300, '"', "'", "\\", "[", "]", "{", "}", "<", ">"),
    *("&", ";", ":", ",", "=", "#", "$", "@", "\n", "\r\n", "\t", "٣", "²", "½", "١٢"),
)
_TEXT_PIECES = tuple(each.encode() for each in _TEXTS)

_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 255, 256, 65535, 65536, 2**31 - 1, 2**31, -(2**31)),
    *(2**32, 2**53, 2**63 - 1, 2**63, -(2**63) - 1, 2**64, 10**30, 10**400, -(10**400)),
    *(0.0, -0.0, 0.5, 1.5, -1.5, 1e-320, 1e30, 1e200, 1.7e308, -1.7e308),
    *(float("nan"), float("inf"), float("-inf")),
    *(
        "",
        "a",
        "0",
        "1",
        "nan",
        "inf",
        "-inf",
        "\ud800",
        "\udcff",
        "\x00",
        "\x1b]0;x\x07",
        "/",
        "%",
    ),
    *("a" * 200, "\u202e", "\ufeff", "🤖", "é", "now", "true", "null"),
    *([], {}, [[]], [{}], {"": {}}, [None], [0], [0.0] * 7, ["a", 1, None], [1e308] * 6),
)
_DEEP = 50_000
"""Levels that no recursion follows."""

_JSON_VALUE = re.compile(
    rb'(?<=[:,\[])\s*("(?:[^"\\]|\\.)*"|[-0-9.eE+]+|true|false|null)(?=\s*[,\]}])'
)

_TOKENS = re.compile(rb"[A-Za-z_]+|[0-9.eE+-]+|\s+|.", re.DOTALL)


class Mutator:
    """Makes inputs of one target."""

    def __init__(self, target: Target, rng: Random, population: Sequence[Input]) -> None:
        self._target, self._rng = target, rng
        self.population = list(population)
        """Inputs to damage; the caller may add to them."""
        self._pieces = (*_PIECES, *target.words, *target.words, *target.words)
        self._words = (*_TEXT_PIECES, *target.words, *target.words)
        damage: dict[Form, Callable[[Any], Any]] = {
            Form.BYTES: self._bytes,
            Form.TEXT: self._text,
            Form.JSON: self._json,
            Form.PACKETS: self._packets,
            Form.JSON_PACKETS: self._packets,
        }
        self._damage = damage[target.form]
        self._packet = self._json if target.form is Form.JSON_PACKETS else self._bytes

    def next(self) -> Input:
        """An input."""
        given = self._damage(self._some(self.population))
        if packets_of(self._target):
            room, packets = self._target.longest, []
            for each in given[:MOST_PACKETS]:
                packets.append(each[:room])
                room -= len(packets[-1])
            return tuple(packets)
        return bytes(given[: self._target.longest])

    def _some(self, items: Sequence[Any]) -> Any:
        return items[int(self._rng.random() * len(items))]

    def _other(self) -> bytes:
        """Bytes of another input, or of one of its packets."""
        other = self._some(self.population)
        return self._some(other or (b"",)) if isinstance(other, tuple) else other

    def _below(self, most: int) -> int:
        return int(self._rng.random() * most)

    # -- bytes -----------------------------------------------------------------------------------

    def _bytes(self, given: bytes) -> bytes:
        data = bytearray(given)
        chance = self._rng.random
        for _ in range(1 + int(4 * chance() * chance())):
            self._damage_bytes(data, int(chance() * 14))
        return bytes(data)

    def _damage_bytes(self, data: bytearray, way: int) -> None:
        size = len(data)
        at = self._below(size + 1)
        if not size or way == 0:
            data[at:at] = self._rng.randbytes(1 + self._below(16))
        elif way <= 2:
            at = self._below(size)
            data[at] ^= 1 << self._below(8)
        elif way == 3:
            data[self._below(size)] = self._below(256)
        elif way == 4:
            data[self._below(size)] = self._some(_WHOLE)
        elif way <= 6:
            piece = self._some(self._pieces)
            data[at : at + len(piece)] = piece
        elif way == 7:
            piece = self._some(self._pieces)
            data[at:at] = piece
        elif way == 8:
            del data[at:]
        elif way == 9:
            del data[at : at + 1 + self._below(8)]
        elif way == 10:
            end = at + 1 + self._below(min(size, 64))
            times = self._target.longest if self._below(200) == 0 else 1 + self._below(8)
            piece = bytes(data[at:end])
            data[at:at] = piece * min(times, self._target.longest // max(1, len(piece)))
        elif way == 11:
            other = self._other()
            cut = self._below(len(other) + 1)
            data[at:] = other[cut:]
        elif way == 12:
            at, to = self._below(size), self._below(size)
            data[at], data[to] = data[to], data[at]
        else:
            at = self._below(size)
            data[at] = (data[at] + self._some((1, -1, 2, -2, 4, -4, 16))) & 0xFF

    # -- words -----------------------------------------------------------------------------------

    def _text(self, given: bytes) -> bytes:
        if self._below(4) == 0:
            return self._bytes(given)
        if self._below(4) == 0:
            return self._lines(given)
        tokens = _TOKENS.findall(given)
        for _ in range(1 + self._below(3)):
            if not tokens:
                return self._some(self._words)
            at, way = self._below(len(tokens)), self._below(7)
            if way <= 2:
                tokens[at] = self._some(self._words)
            elif way == 3:
                tokens.insert(at, self._some(self._words))
            elif way == 4:
                del tokens[at : at + 1 + self._below(4)]
            elif way == 5:
                to = self._below(len(tokens))
                tokens[at], tokens[to] = tokens[to], tokens[at]
            else:
                times = self._target.longest if self._below(200) == 0 else self._below(9)
                piece = tokens[at : at + 1 + self._below(12)]
                size = max(1, sum(map(len, piece)))
                tokens[at:at] = piece * min(times, self._target.longest // size)
        return b"".join(tokens)

    def _lines(self, given: bytes) -> bytes:
        lines = given.split(b"\n")
        at, way = self._below(len(lines)), self._below(5)
        if way == 0:
            del lines[at]
        elif way == 1:
            lines.insert(self._below(len(lines) + 1), lines[at])
        elif way == 2:
            to = self._below(len(lines))
            lines[at], lines[to] = lines[to], lines[at]
        elif way == 3:
            lines.insert(at, self._some(self._other().split(b"\n")))
        else:
            key, equals, _ = lines[at].partition(b"=")
            lines[at] = key + equals + b" " + self._some(self._words)
        return b"\n".join(lines)

    # -- JSON ------------------------------------------------------------------------------------

    def _json(self, given: bytes) -> bytes:
        way = self._below(8)
        if way == 0:
            return self._bytes(given)
        if way == 1:
            return self._text(given) if self._below(8) else self._deep(given)
        try:
            tree = json.loads(given)
        except (ValueError, RecursionError):
            return self._text(given)
        try:
            for _ in range(1 + self._below(2)):
                tree = self._tree(tree)
            return json.dumps(tree, ensure_ascii=self._below(4) > 0).encode(
                "utf-8", "surrogatepass"
            )
        except RecursionError:
            return given

    def _deep(self, given: bytes) -> bytes:
        """A value in the place of another that has levels upon levels: as many as may just be read,
        or more than any recursion follows."""
        opens, closes = self._some(
            ((b"[", b"]"), (b'{"a":', b"}"), (b"[{},", b"]"), (b"[[", b"]]"))
        )
        levels = self._some((20, 40, 100, 300, 900 + self._below(100), 2000, _DEEP))
        deep = opens * levels + b"1" + closes * levels
        values = [match.span() for match in _JSON_VALUE.finditer(given)]
        begin, end = self._some(values) if values else (0, len(given))
        return given[:begin] + deep + given[end:]

    def _tree(self, tree: Any) -> Any:
        places: list[tuple[Any, Any]] = []
        waiting = [tree]
        while waiting and len(places) < 200:
            node = waiting.pop()
            if isinstance(node, dict):
                places += [(node, key) for key in node]
                waiting += node.values()
            elif isinstance(node, list):
                places += [(node, index) for index in range(min(len(node), 50))]
                waiting += node[:50]
        if not places or self._below(30) == 0:
            return self._value()
        node, key = self._some(places)
        way = self._below(8)
        if way <= 2:
            node[key] = self._value()
        elif way == 3:
            node.pop(key)
        elif way == 4:
            other, its = self._some(places)
            if (isinstance(other, list) and its < len(other)) or isinstance(other, dict):
                node[key] = copy.deepcopy(other[its])
        elif way == 5:
            if isinstance(node, dict):
                node[self._word()] = node.pop(key) if self._below(2) else self._value()
            else:
                node.insert(key, self._value())
        elif way == 6:
            node[key] = [
                copy.deepcopy(node[key]) for _ in range(self._some((0, 1, 2, 3, 6, 7, 100)))
            ]
        elif isinstance(node[key], str):
            word = self._word()
            node[key] = self._some((word, node[key] + word, node[key][: self._below(9)]))
        elif isinstance(node[key], (int, float)) and not isinstance(node[key], bool):
            node[key] = self._some((node[key] + 1, node[key] - 1, -node[key], float(node[key] % 7)))
        else:
            node[key] = self._value()
        return tree

    def _value(self) -> Any:
        return copy.deepcopy(self._some(_VALUES))

    def _word(self) -> str:
        return self._some(self._words).decode("utf-8", "replace")

    # -- packets ---------------------------------------------------------------------------------

    def _packets(self, given: tuple[bytes, ...]) -> list[bytes]:
        packets = list(given)
        for _ in range(1 + self._below(3)):
            at, way = self._below(len(packets) + 1), self._below(9)
            if not packets or way == 0:
                packets.insert(at, self._packet(self._other()))
            elif way <= 4:
                at = self._below(len(packets))
                packets[at] = self._packet(packets[at])
            elif way == 5:
                del packets[at : at + 1 + self._below(3)]
            elif way == 6:
                packets[at:at] = packets[at : at + 3] * (1 + self._below(4))
            elif way == 7:
                to = self._below(len(packets))
                at = self._below(len(packets))
                packets[at], packets[to] = packets[to], packets[at]
            else:
                other = self._some(self.population)
                packets[at:] = other[self._below(len(other) + 1) :]
        return packets
