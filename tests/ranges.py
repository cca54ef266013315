"""What the ranges of options and tables let tests draw from."""

from __future__ import annotations

from typing import Annotated, Any, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

from cardan.bounds import Range

Strategy = st.SearchStrategy[Any]


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


def range_of(options: type[Any], name: str) -> tuple[Range, bool]:
    """The range in the annotation of a field, and whether its numbers are whole."""
    hint = get_type_hints(options, include_extras=True)[name]
    while get_origin(hint) is not Annotated:
        hint = get_args(hint)[0]
    kind, *notes = get_args(hint)
    return next(note for note in notes if isinstance(note, Range)), kind is int


def drawn(options: type[Any], *names: str) -> Strategy:
    """Values of some or all of these fields."""
    return st.fixed_dictionaries(
        {}, optional={name: numbers(*range_of(options, name)) for name in names}
    )
