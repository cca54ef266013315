"""URScript's functions of numbers, lists and texts.

Source: UR's script manual, modules urmath and interfaces.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from typing import Any, Final

from cardan.sim_peers.ur_controller.checks import number, numbers, truth, whole, words
from cardan.sim_peers.ur_controller.language import Function
from cardan.sim_peers.ur_controller.operators import LONGEST_TEXT, text
from cardan.sim_peers.ur_controller.values import UrPose, is_number

_BITS: Final = 32
_LARGEST_INVERTED: Final = 12
"""Largest number of rows of a matrix to invert."""


def math_functions(chance: random.Random) -> Mapping[str, Function]:
    """Return the functions by name."""
    one = {
        "acos": math.acos,
        "asin": math.asin,
        "atan": math.atan,
        "ceil": math.ceil,
        "cos": math.cos,
        "d2r": math.radians,
        "floor": math.floor,
        "r2d": math.degrees,
        "sin": math.sin,
        "sqrt": math.sqrt,
        "tan": math.tan,
    }
    return {
        **{name: Function(("f",), {}, _of_a_number(do)) for name, do in one.items()},
        "atan2": Function(("x", "y"), {}, lambda x, y: math.atan2(number("x", x), number("y", y))),
        "pow": Function(
            ("base", "exponent"),
            {},
            lambda base, exponent: math.pow(number("base", base), number("exponent", exponent)),
        ),
        "log": Function(("b", "f"), {}, lambda b, f: math.log(number("f", f), number("b", b))),
        "random": Function((), {}, chance.random),
        "norm": Function(("a",), {}, _norm),
        "normalize": Function(("v",), {}, _normalize),
        "length": Function(("v",), {}, _length),
        "get_list_length": Function(("v",), {}, _length),
        "size": Function(("v",), {}, _size),
        "transpose": Function(("m",), {}, _transpose),
        "binary_list_to_integer": Function(("l",), {}, _to_integer),
        "integer_to_binary_list": Function(("x",), {}, _to_binary),
        "str_at": Function(("src", "index"), {}, _str_at),
        "str_cat": Function(("op1", "op2"), {}, _str_cat),
        "str_empty": Function(("str",), {}, lambda src: not words("str", src)),
        "str_find": Function(("src", "target", "start_from"), {"start_from": 0}, _str_find),
        "str_len": Function(("str",), {}, lambda src: len(words("str", src))),
        "str_sub": Function(("src", "index", "len"), {"len": LONGEST_TEXT}, _str_sub),
        "to_num": Function(("str",), {}, _to_num),
        "to_str": Function(("val",), {}, lambda value: _not_too_long(text(value))),
    }


def _of_a_number(do: Callable[[float], Any]) -> Callable[[Any], Any]:
    return lambda value: do(number("f", value))


def _norm(value: Any) -> float:
    if isinstance(value, (list, UrPose)):
        return math.hypot(*numbers("a", value))
    return abs(number("a", value))


def _normalize(value: Any) -> list[float]:
    size = math.hypot(*numbers("v", value))
    if size == 0.0:
        raise ValueError("v has no direction")
    return [each / size for each in value]


def _length(value: Any) -> int:
    if not isinstance(value, (list, UrPose, str)):
        raise ValueError(f"{text(value)} has no length")
    return len(value)


def _matrix(value: Any) -> list[list[float]]:
    if not isinstance(value, list) or not value or not isinstance(value[0], list):
        raise ValueError(f"{text(value)} is not a matrix")
    rows = [numbers("m", row) for row in value]
    if any(len(row) != len(rows[0]) for row in rows):
        raise ValueError("the rows of a matrix have several lengths")
    return rows


def _size(value: Any) -> Any:
    if isinstance(value, list) and value and isinstance(value[0], list):
        rows = _matrix(value)
        return [len(rows), len(rows[0])]
    return _length(value)


def _transpose(value: Any) -> list[list[Any]]:
    _matrix(value)
    return [list(column) for column in zip(*value, strict=True)]


def inverse_matrix(value: Any) -> list[list[float]]:
    """Return the inverse of a square matrix, by Gauss-Jordan elimination."""
    rows = _matrix(value)
    count = len(rows)
    if count != len(rows[0]) or count > _LARGEST_INVERTED:
        raise ValueError(f"the matrix is not square, or has more than {_LARGEST_INVERTED} rows")
    both = [[*row, *(float(n == at) for n in range(count))] for at, row in enumerate(rows)]
    for at in range(count):
        pivot = max(range(at, count), key=lambda row: abs(both[row][at]))
        both[at], both[pivot] = both[pivot], both[at]
        if both[at][at] == 0.0:
            raise ValueError("the matrix has no inverse")
        both[at] = [each / both[at][at] for each in both[at]]
        for other in range(count):
            if other != at:
                share = both[other][at]
                both[other] = [a - share * b for a, b in zip(both[other], both[at], strict=True)]
    return [row[count:] for row in both]


def _to_integer(value: Any) -> int:
    """Return the integer of a list of bits, the lowest first."""
    if not isinstance(value, list) or len(value) > _BITS:
        raise ValueError(f"{text(value)} is not a list of at most {_BITS} truths")
    found = sum(truth("l", each) << n for n, each in enumerate(value))
    return found if found < 2 ** (_BITS - 1) else found - 2**_BITS


def _to_binary(value: Any) -> list[bool]:
    bits = whole("x", value, -(2 ** (_BITS - 1)), 2 ** (_BITS - 1) - 1)
    return [bool(bits >> n & 1) for n in range(_BITS)]


# -- texts -----------------------------------------------------------------------------------------


def _not_too_long(found: str) -> str:
    if len(found) > LONGEST_TEXT:
        raise ValueError(f"a text has more than {LONGEST_TEXT} characters")
    return found


def _str_at(src: Any, index: Any) -> str:
    return words("src", src)[whole("index", index, 0, len(src) - 1)]


def _str_cat(first: Any, second: Any) -> str:
    return _not_too_long(text(first) + text(second))


def _str_find(src: Any, target: Any, start: Any) -> int:
    return words("src", src).find(words("target", target), whole("start_from", start, 0, 2**31))


def _str_sub(src: Any, index: Any, count: Any) -> str:
    at = whole("index", index, 0, len(words("src", src)))
    return str(src[at : at + whole("len", count, 0, LONGEST_TEXT)])


def _to_num(value: Any) -> float | int:
    if is_number(value):
        return value  # type: ignore[no-any-return]
    found = words("str", value).strip()
    try:
        if found.lstrip("+-").isdecimal() and len(found) <= 11:
            return whole("str", int(found), -(2**31), 2**31 - 1)
        return number("str", float(found))
    except ValueError:
        raise ValueError(f"{found!r} is not a number") from None
