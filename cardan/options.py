"""Options are dataclasses whose annotations say what a value may be; errors name the key.

A ``Literal`` or an enum lists the choices, a :class:`cardan.bounds.Range` bounds a number::

    @dataclass(frozen=True, kw_only=True)
    class Options:
        transport: Literal["hidraw", "socket"] = "hidraw"
        dead_zone: Annotated[float, bounds.DEAD_ZONE] = 0.05

        def __post_init__(self) -> None:
            check_options(self)
            require(self.dead_zone or self.transport == "hidraw", "dead_zone", 0.0, "above 0")
"""

from __future__ import annotations

import enum
from collections.abc import Hashable
from dataclasses import fields
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from cardan.bounds import Range
from cardan.errors import OptionError

_PLAIN: dict[Any, tuple[tuple[type, ...], str]] = {
    bool: ((bool,), "true or false"),
    int: ((int,), "a whole number"),
    float: ((int, float), "a number"),
    str: ((str,), "a text without a NUL"),
}


def check_options(options: Any) -> None:
    """Raise OptionError for the first field of a dataclass that its annotation does not allow.

    Looks at plain types, choices, ranges, what may be None, and the length and the elements of
    tuples; an annotation of another kind allows everything.
    """
    hints = _hints(options.__class__)
    for field in fields(options):
        value = getattr(options, field.name)
        if allowed := refusal(hints[field.name], value):
            raise OptionError(field.name, value, allowed)


def require(good: object, key: str, value: object, allowed: str) -> None:
    """Raise OptionError, with what is `allowed` in words, unless `good`."""
    if not good:
        raise OptionError(key, value, allowed)


def choices(hint: Any) -> tuple[Any, ...]:
    """The values that a ``Literal`` or an enum has; of any other annotation none."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return tuple(hint)
    return ()


def refusal(hint: Any, value: object) -> str:
    """What an annotation allows, in words, where `value` is not allowed; empty where it is."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        for note in inner[1:]:
            if isinstance(note, Range):
                whole = inner[0] is int
                if value not in note or (whole and not isinstance(value, int)):
                    return f"{note}{', whole' if whole else ''}: {note.reason}"
                return ""
        return refusal(inner[0], value)
    if origin in (Union, UnionType):
        if value is None and NoneType in inner:
            return ""
        refusals = [refusal(each, value) for each in inner if each is not NoneType]
        return "" if not all(refusals) else " or ".join(refusals)
    if hint in _PLAIN:
        kinds, words = _PLAIN[hint]
        good = isinstance(value, kinds) and (hint is bool or not isinstance(value, bool))
        return "" if good and not (isinstance(value, str) and "\0" in value) else words
    if allowed := choices(hint):
        # 1 == True, and an enum of texts equals its texts.
        good = any(value == each and type(value) is type(each) for each in allowed)
        return "" if good else f"one of {', '.join(str(_shown(each)) for each in allowed)}"
    if origin is tuple:
        return _refused_elements(inner, value)
    return ""


def _refused_elements(hints: tuple[Any, ...], value: object) -> str:
    if not isinstance(value, (tuple, list)):
        return "several values"
    if hints[-1] is Ellipsis:
        hints = hints[:1] * len(value)
    if len(hints) != len(value):
        return f"{len(hints)} values"
    return next(filter(None, map(refusal, hints, value)), "")


def _shown(choice: Any) -> Any:
    choice = choice.value if isinstance(choice, enum.Enum) else choice
    return choice if choice != "" else '""'


@cache
def _hints(kind: Hashable) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)
