"""URScript's operators on its values.

Numbers, booleans, texts, lists (of lists: matrices), poses and structs. All have value semantics: a
list is never changed in place, and its holders keep the old one.

Source: UR's script manual, 5.x: numbers, variables and types; matrix and array expressions.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from cardan.protocols.ur.script import LARGEST_WHOLE
from cardan.sim_peers.ur_controller.language import ELEMENT_STEPS, PRODUCT_STEPS
from cardan.sim_peers.ur_controller.values import UrPose, is_number

LONGEST_TEXT: Final = 1023
"""Characters; from the script manual's str_cat."""
LONGEST_LIST: Final = 10_000
_DEEPEST: Final = 4
"""Deepest nesting of structs."""

Operator = Callable[[Any, Any], Any]


class Struct(dict[str, Any]):
    """Members by name."""

    depth = 1


def struct(members: Mapping[str, Any]) -> Struct:
    """Return a struct of these members. Raises ValueError."""
    made = Struct(members)
    inner = [each.depth for each in members.values() if isinstance(each, Struct)]
    made.depth = 1 + max(inner, default=0)
    if made.depth > _DEEPEST:
        raise ValueError(f"more than {_DEEPEST} structs in each other")
    return made


def listed(items: list[Any]) -> list[Any]:
    """Return a list of these. Raises ValueError if it is not a list of the language."""
    count = 0
    for each in items:
        count += len(each) if isinstance(each, list) else 1
        if count > LONGEST_LIST:
            raise ValueError(f"a list has more than {LONGEST_LIST} elements")
        if isinstance(each, list):
            if any(isinstance(inner, (list, Struct)) for inner in each):
                raise ValueError("a matrix has two dimensions")
        elif isinstance(each, Struct):
            raise ValueError("a list has no structs")
    return items


def pose(items: Sequence[Any]) -> UrPose:
    """Return a pose of six numbers. Raises ValueError."""
    for each in items:
        if not is_number(each):
            raise ValueError(f"{text(each)} in a pose is not a number")
    return UrPose(map(float, items))


def text(value: Any) -> str:
    """Format a value as `textmsg` and `to_str` do, cut at the longest length of a text."""
    return _written(value)[: LONGEST_TEXT + 1]


def _written(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, UrPose):
        return "p[" + _joined(map(_written, value)) + "]"
    if isinstance(value, list):
        return "[" + _joined(map(_written, value)) + "]"
    if isinstance(value, Struct):
        return "struct(" + _joined(f"{k}={_written(v)}" for k, v in value.items()) + ")"
    return str(value)


def _joined(parts: Iterable[str]) -> str:
    """Join with commas, up to the longest length of a text."""
    found, size = [], 0
    for each in parts:
        found.append(each)
        size += len(each) + 2
        if size > LONGEST_TEXT:
            break
    return ", ".join(found)


# -- arithmetic ------------------------------------------------------------------------------------


def _modulo(left: Any, right: Any) -> Any:
    found = math.fmod(left, right)
    return int(found) if isinstance(left, int) and isinstance(right, int) else found


NUMBERS: Final[Mapping[str, Operator]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": _modulo,
}
ORDERS: Final[Mapping[str, Operator]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def _arithmetic(sign: str, do: Operator) -> Operator:
    def numbers(left: Any, right: Any) -> Any:
        if not (is_number(left) and is_number(right)):
            raise ValueError(f"{text(right if is_number(left) else left)!r} is not a number")
        found = do(left, right)
        if found.__class__ is int and not -LARGEST_WHOLE - 1 <= found <= LARGEST_WHOLE:
            raise ValueError("a whole number has more than 32 bits")
        return found

    def worked(left: Any, right: Any) -> Any:
        kinds = left.__class__, right.__class__
        if list not in kinds and UrPose not in kinds:
            return numbers(left, right)
        rows, columns = _is_matrix(left), _is_matrix(right)
        if sign == "*" and rows and isinstance(right, list):
            return _product(left, right) if columns else _applied(left, right)
        if isinstance(left, (list, UrPose)) and isinstance(right, (list, UrPose)):
            if len(left) != len(right):
                raise ValueError(f"lists of {len(left)} and {len(right)} do not go together")
            found = [worked(a, b) for a, b in zip(left, right, strict=True)]
        elif isinstance(left, (list, UrPose)):
            found = [worked(a, right) for a in left]
        else:
            found = [worked(left, b) for b in right]
        return UrPose(found) if UrPose in kinds else found

    return worked


def _is_matrix(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], list)


def elements(found: list[Any]) -> int:
    """Return the number of elements of a list or a matrix."""
    if _is_matrix(found):
        return sum(len(each) if isinstance(each, list) else 1 for each in found)
    return len(found)


def work_of(sign: str, left: Any, right: Any) -> int:
    """Return the cost of an operator on lists in steps."""
    ours = elements(left) if isinstance(left, list) else 1
    if sign == "*" and _is_matrix(left) and isinstance(right, list):
        columns = len(right[0]) if _is_matrix(right) else 1
        return ours * columns * PRODUCT_STEPS
    return ELEMENT_STEPS * max(ours, elements(right) if isinstance(right, list) else 1)


def work_of_change(found: list[Any]) -> int:
    """Return the cost of changing an element in steps: a list is copied, a matrix checked."""
    return elements(found) if _is_matrix(found) else len(found) // 8


def _product(left: list[Any], right: list[Any]) -> list[Any]:
    if any(len(row) != len(right[0]) for row in right if isinstance(row, list)):
        raise ValueError("the rows of a matrix have several lengths")
    columns = [[row[n] for row in right] for n in range(len(right[0]))]
    return [[_dot(row, column) for column in columns] for row in left]


def _applied(left: list[Any], right: list[Any]) -> list[Any]:
    return [_dot(row, right) for row in left]


def _dot(left: Any, right: Any) -> Any:
    if not isinstance(left, list) or len(left) != len(right):
        raise ValueError("the sizes of the matrices do not go together")
    total: Any = 0
    for a, b in zip(left, right, strict=True):
        total = OPERATORS["+"](total, OPERATORS["*"](a, b))
    return total


def _ordered(do: Operator) -> Operator:
    def worked(left: Any, right: Any) -> bool:
        for each in (left, right):
            if not is_number(each):
                raise ValueError(f"{text(each)!r} is not a number")
        return bool(do(left, right))

    return worked


def _equal(left: Any, right: Any) -> bool:
    if isinstance(left, Struct) or isinstance(right, Struct):
        raise ValueError("structs cannot be compared")
    return bool(left == right)


OPERATORS: Final[Mapping[str, Operator]] = {
    **{sign: _arithmetic(sign, do) for sign, do in NUMBERS.items()},
    **{sign: _ordered(do) for sign, do in ORDERS.items()},
    "==": _equal,
    "!=": lambda left, right: not _equal(left, right),
}
"""Operators with two values. They raise ValueError and ArithmeticError."""


def negative(value: Any) -> Any:
    """Return `-value`. Raises ValueError."""
    return OPERATORS["*"](value, -1)


def truth(value: Any) -> bool:
    """Return True if a condition holds; nonzero numbers do. Raises ValueError."""
    if isinstance(value, (bool, int, float)):
        return bool(value)
    raise ValueError(f"{text(value)!r} is neither True nor False")


# -- elements --------------------------------------------------------------------------------------


def element(of: Any, *at: Any) -> Any:
    """Return an element of a list, a pose, a text or a matrix. Raises ValueError."""
    for each in at:
        of = of[_index(of, each)]
    return of


def with_element(of: Any, path: Sequence[Any], value: Any) -> Any:
    """Return `of` with another value at the path of indices and members. Raises ValueError."""
    step, rest = path[0], path[1:]
    if isinstance(step, str):
        if not isinstance(of, Struct) or step not in of:
            raise ValueError(f"there is no member {step}")
        return struct({**of, step: with_element(of[step], rest, value) if rest else value})
    at = _index(of, step)
    inner: Any = with_element(of[at], rest, value) if rest else value
    if isinstance(of, UrPose):
        return pose((*of[:at], inner, *of[at + 1 :]))
    if isinstance(of, str):
        raise ValueError("a text has no elements that change")
    changed = list(of)
    changed[at] = inner
    if not isinstance(inner, (list, Struct)):
        return changed
    if not _is_matrix(of):
        raise ValueError("an element of a list is not a list")
    return listed(changed)


def _index(of: Any, at: Any) -> int:
    if not isinstance(of, (list, UrPose, str)):
        raise ValueError(f"{text(of)!r} is not a list")
    if type(at) is not int or not 0 <= at < len(of):
        raise ValueError(f"a list of {len(of)} has no element {text(at)}")
    return at
