"""The ranges in the annotations of options and tables, and what tests draw from them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

from cardan.bounds import Range

Strategy = st.SearchStrategy[Any]


def _found(hint: Any) -> Iterator[tuple[Range, bool]]:
    """Each range in an annotation, and whether its numbers are whole."""
    inner = get_args(hint)
    if get_origin(hint) is Annotated:
        for note in inner[1:]:
            if isinstance(note, Range):
                yield note, inner[0] is int
    for each in inner:
        yield from _found(each)


def ranges(kind: type[Any]) -> dict[str, Range]:
    """The first range of each field that has one, by the field's name."""
    found = {
        name: next(_found(hint), None)
        for name, hint in get_type_hints(kind, include_extras=True).items()
    }
    return {name: each[0] for name, each in found.items() if each is not None}


def numbers(allowed: Range, whole: bool = False) -> Strategy:
    """Any number that is allowed, its ends often."""
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
    """Values of some or all of these fields."""
    hints = get_type_hints(kind, include_extras=True)
    return st.fixed_dictionaries(
        {}, optional={name: numbers(*next(_found(hints[name]))) for name in names}
    )
