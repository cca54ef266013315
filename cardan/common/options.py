"""Options: dataclasses whose annotations give the allowed values; errors name the key. A
``Literal`` or an enum lists the choices, a :class:`cardan.common.bounds.Range` bounds a number, a
:class:`cardan.common.bounds.Text` gives the form of a text, a
:class:`cardan.common.bounds.Directed` excludes zero vectors::

    @dataclass(frozen=True, kw_only=True)
    class DeviceOptions(Options):
        transport: Literal["hidraw", "socket"] = "hidraw"
        dead_zone: Annotated[float, bounds.DEAD_ZONE] = 0.05

        def __post_init__(self) -> None:
            super().__post_init__()
            require(self.dead_zone or self.transport == "hidraw", "dead_zone", 0.0, "above 0")
"""

from __future__ import annotations

import enum
import math
import os
import re
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import fields
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from cardan.common.bounds import Directed, Range, Text
from cardan.errors import OptionError

_PLAIN: dict[Any, tuple[tuple[type, ...], str]] = {
    bool: ((bool,), "true or false"),
    int: ((int,), "a whole number"),
    float: ((int, float), "a number"),
    str: ((str,), "a text, in quotes"),
}


_NUMBER = re.compile(r"\s*[-+]?\.?[0-9][0-9.]*(?:[eE][-+]?[0-9]+)?\s*(.*)", re.DOTALL)
"""A text that begins with a number; its group is the unit."""

_UNCHANGEABLE = frozenset({bool, int, float, str, NoneType})

CODE_ONLY = {"from_file": False}
"""Metadata of a field that only programs can set, not configuration files."""

OTHER_KEYS = {"other_keys": True}
"""Metadata of the field that takes all keys that no other field has."""


def check_options(options: Any) -> None:
    """Raise OptionError for the first field of a dataclass that its annotation does not allow.

    Checks types, choices, ranges, whether None is allowed, the length and the elements of tuples,
    and the keys and values of mappings; an annotation of another kind allows everything.

    Checked values cannot be changed: the options then have tuples for lists, and copies of
    mappings. A path (`os.PathLike`) is accepted as a text, and converted.
    """
    allowed_types = hints(options.__class__)
    for field in fields(options):
        check_field(options, field.name, allowed_types[field.name])


def check_field(options: Any, name: str, hint: Any) -> None:
    """Check one field, by `hint`, as :func:`check_options` does."""
    given = getattr(options, name)
    value = given if type(given) in _UNCHANGEABLE else frozen(hint, given)
    if allowed := refusal(hint, value):
        raise OptionError(name, given, allowed)
    if value is not given:
        object.__setattr__(options, name, value)  # They are frozen.


class Options:
    """Base of dataclasses that are checked by :func:`check_options` on creation. Overridden
    ``__post_init__`` methods must call this one first."""

    def __post_init__(self) -> None:
        check_options(self)


class FrozenMapping(Mapping[Any, Any]):
    """An immutable mapping: unlike a dict hashable, unlike a MappingProxyType copyable and
    picklable."""

    def __init__(self, items: Mapping[Any, Any]) -> None:
        self._items = dict(items)

    def __getitem__(self, key: Any) -> Any:
        return self._items[key]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __hash__(self) -> int:
        return hash(frozenset(self._items.items()))

    def __repr__(self) -> str:
        return repr(self._items)


def frozen(hint: Any, value: Any) -> Any:
    """Return `value` in the form in which options keep it by `hint`: tuples, copies, texts for
    paths."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return frozen(inner[0], value)
    if origin in (Union, UnionType):
        found = ((each, frozen(each, value)) for each in inner)
        return next((made for each, made in found if not refusal(each, made)), value)
    if hint is str and isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (tuple, list)):
        if origin is tuple:
            kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
            return _frozen_elements(kinds, value, tuple)
        if _is_class(hint) and hasattr(hint, "_fields"):  # a NamedTuple
            return _frozen_elements(tuple(hints(hint).values()), value, hint._make)
    if origin is Mapping and isinstance(value, Mapping):
        return FrozenMapping({key: frozen(inner[1], each) for key, each in value.items()})
    return value


def _frozen_elements(kinds: tuple[Any, ...], value: Any, made: Callable[[Any], Any]) -> Any:
    if len(kinds) != len(value):
        return value
    elements = [frozen(*each) for each in zip(kinds, value, strict=True)]
    same = all(new is old for new, old in zip(elements, value, strict=True))
    return value if same and isinstance(value, tuple) else made(elements)


def check_value(key: str, value: object, hint: Any) -> None:
    """Raise OptionError unless `hint`, an annotation, allows `value`."""
    if allowed := refusal(hint, value):
        raise OptionError(key, value, allowed)


def require(good: object, key: str, value: object, allowed: str) -> None:
    """Raise OptionError, with a description of the `allowed` values, unless `good`."""
    if not good:
        raise OptionError(key, value, allowed)


def require_each(options: Any, *rules: tuple[str, object, str]) -> None:
    """Call `require` for several fields: each with its key, whether it is good, and its allowed
    values."""
    for key, good, allowed in rules:
        require(good, key, getattr(options, key), allowed)


def choices(hint: Any) -> tuple[Any, ...]:
    """Return the values of a ``Literal`` or an enum; none for any other annotation."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    if _is_class(hint) and issubclass(hint, enum.Enum):
        return tuple(hint)
    return ()


def _is_class(hint: Any) -> bool:
    # Python 3.10 takes list[int] for a class, and later ones Any.
    return isinstance(hint, type) and get_origin(hint) is None and hint is not Any


@cache
def hints(kind: Hashable) -> dict[str, Any]:
    """Return the annotations of a class by name, ranges included."""
    return get_type_hints(kind, include_extras=True)


def refusal(hint: Any, value: object) -> str:
    """Return a description of the values that an annotation allows if `value` is not allowed; empty
    if it is."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _refused_by_notes(inner, value)
    if origin in (Union, UnionType):
        if value is None and NoneType in inner:
            return ""
        refusals = [refusal(each, value) for each in inner if each is not NoneType]
        return "" if not all(refusals) else " or ".join(dict.fromkeys(refusals))
    if hint in _PLAIN:
        kinds, words = _PLAIN[hint]
        good = isinstance(value, kinds) and (hint is bool or not isinstance(value, bool))
        if isinstance(value, str):
            if good and "\0" in value:
                return "a text without a NUL"
        elif isinstance(value, float):
            good = good and not math.isnan(value)
        elif hint is float and isinstance(value, int):
            good = good and abs(value) <= sys.float_info.max
        return "" if good else f"{words}{_quoted(hint, value)}"
    if allowed := choices(hint):
        # 1 == True, and an enum of texts equals its texts.
        good = any(value == each and type(value) is type(each) for each in allowed)
        return "" if good else _one_of([str(_shown(each)) for each in allowed], value)
    if origin is tuple:
        return _refused_elements(inner, value)
    if _is_class(hint) and hasattr(hint, "_fields"):  # a NamedTuple
        return _refused_elements(tuple(hints(hint).values()), value)
    if origin in (Mapping, dict):
        return _refused_items(inner, value)
    if _is_class(hint) and not isinstance(value, hint):
        return f"of type {hint.__name__}"
    return ""


def _one_of(words: list[str], value: object) -> str:
    near = suggestion(value, words) if isinstance(value, str) and value not in words else ""
    return f"one of {', '.join(words)}{near}"


def _quoted(hint: Any, value: object) -> str:
    """Return how to write a number if `value` is one in quotes and `hint` allows numbers."""
    number = hint in (int, float) and isinstance(value, str) and _NUMBER.fullmatch(value)
    return (f", without quotes{' and unit' if number[1] else ''}") if number else ""


def _refused_by_notes(inner: tuple[Any, ...], value: object) -> str:
    for note in inner[1:]:
        if isinstance(note, Text) and value not in note:
            return str(note)
        if isinstance(note, Range):
            whole = inner[0] is int
            if value not in note or (whole and not isinstance(value, int)):
                quoted = _quoted(inner[0], value)
                quoted = f"a number{quoted}: " if quoted else ""
                reason = f": {note.reason}" if note.reason else ""
                return f"{quoted}{note}{', whole' if whole else ''}{reason}"
            return ""
    if (allowed := refusal(inner[0], value)) == "":
        directed = (note for note in inner[1:] if isinstance(note, Directed))
        allowed = next((str(note) for note in directed if value not in note), "")
    return allowed


def _refused_elements(allowed: tuple[Any, ...], value: object) -> str:
    if not isinstance(value, (tuple, list)):
        return "several values" if allowed[-1] is Ellipsis else f"{len(allowed)} values"
    if allowed[-1] is Ellipsis:
        allowed = allowed[:1] * len(value)
    if len(allowed) != len(value):
        return f"{len(allowed)} values"
    return next(filter(None, map(refusal, allowed, value)), "")


def _refused_items(allowed: tuple[Any, ...], value: object) -> str:
    if not isinstance(value, Mapping):
        return "values by name"
    return next(filter(None, (_refused_elements(allowed, each) for each in value.items())), "")


def _shown(choice: Any) -> Any:
    choice = choice.value if isinstance(choice, enum.Enum) else choice
    return choice if choice != "" else '""'


FORMER = {
    "felt": "reaction",
    "kept-inputs": "stale-inputs",
    "leap": "jump",
    "led-untold": "led-unreported",
    "mask-kept": "mask-ignored",
    "replug-untold": "replug-unreported",
    "unplug-untold": "unplug-unreported",
}
"""Present names of values and faults by those of earlier versions."""


def suggestion(word: str, allowed: Iterable[str]) -> str:
    """Return the present name of a former one, or else the nearest of `allowed`, as the end of a
    sentence; empty when none is near."""
    from difflib import get_close_matches

    allowed = tuple(allowed)
    if (now := FORMER.get(word)) in allowed:
        return f"; {word!r} is now {now!r}"
    # Of names that differ in nothing else, capitals and the hyphen for _ are not told apart.
    spelled = {_spelling(each): each for each in allowed}
    near = [spelled[each] for each in get_close_matches(_spelling(word), list(spelled), 1)]
    return f"; did you mean {near[0]!r}?" if near else ""


def _spelling(word: str) -> str:
    return word.lower().replace("-", "_")
