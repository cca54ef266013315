"""Ranges in the annotations of options and tables, and values that tests draw from them."""

from __future__ import annotations

from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

from cardan.common.bounds import Range

Strategy = st.SearchStrategy[Any]


def found_in(hint: Any) -> Iterator[tuple[Range, bool]]:
    """Yield each range in an annotation, and whether its numbers are integers."""
    inner = get_args(hint)
    if get_origin(hint) is Annotated:
        for note in inner[1:]:
            if isinstance(note, Range):
                yield note, inner[0] is int
    for each in inner:
        yield from found_in(each)


def ranges(kind: type[Any]) -> dict[str, Range]:
    """Return the first range of each field that has one, by field name."""
    found = {
        name: next(found_in(hint), None)
        for name, hint in get_type_hints(kind, include_extras=True).items()
    }
    return {name: each[0] for name, each in found.items() if each is not None}


def numbers(allowed: Range, whole: bool = False) -> Strategy:
    """Return a strategy for allowed numbers, often the ends of the range."""
    if whole:
        return st.integers(int(allowed.lowest), int(allowed.highest))
    ends = [end for end in (allowed.lowest, allowed.highest) if end in allowed]
    return st.sampled_from(ends) | st.floats(
        allowed.lowest,
        allowed.highest,
        exclude_min=allowed.above,
        exclude_max=allowed.below,
    )


def drawn(kind: type[Any], *names: str) -> Strategy:
    """Return a strategy for values of some or all of these fields."""
    hints = get_type_hints(kind, include_extras=True)
    return st.fixed_dictionaries(
        {}, optional={name: numbers(*next(found_in(hints[name]))) for name in names}
    )


def spoilt(hint: Any, bad: float) -> list[Any]:
    """Yield values of this type with `bad` in the place of each number; none if it has no
    numbers."""
    origin, inner = get_origin(hint), get_args(hint)
    if hint in (int, float):
        return [bad]
    if origin is Annotated:
        return spoilt(inner[0], bad)
    if origin in (Union, UnionType):
        return [value for each in inner if each is not NoneType for value in spoilt(each, bad)]
    if origin is tuple and inner[-1] is Ellipsis:
        return [(value,) for value in spoilt(inner[0], bad)]
    if origin is tuple:
        whole = [next(iter(spoilt(each, 0.5)), None) for each in inner]
        return [
            (*whole[:place], value, *whole[place + 1 :])
            for place, each in enumerate(inner)
            for value in spoilt(each, bad)
        ]
    return []
