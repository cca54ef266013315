"""From the tables of a configuration file to the options that they describe, and back.

A table is a dataclass. Its annotations say what is allowed (:mod:`cardan.options`), its defaults
what holds where a key is left out, and its ``__post_init__`` what must fit together. A field may be
a table of its own, several of them, or one of several kinds that a key tells apart (:class:`Tag`).
"""

from __future__ import annotations

import contextlib
import enum
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin

from cardan.bounds import ANGLE_DEG, COORDINATE_M, DIRECTION, LENGTH_M
from cardan.errors import ConfigurationError, OptionError
from cardan.options import choices, hints, refusal, suggestion

Length = Annotated[float, LENGTH_M]
Coordinate = Annotated[float, COORDINATE_M]
Angle = Annotated[float, ANGLE_DEG]
Component = Annotated[float, DIRECTION]

Bounds = tuple[Coordinate, Coordinate]
Point = tuple[Coordinate, Coordinate, Coordinate]
Angles = tuple[Angle, Angle, Angle]
Direction = tuple[Component, Component, Component]

CODE_ONLY = {"from_file": False}
"""Metadata of a field that programs set and files do not."""

OTHER_KEYS = {"other_keys": True}
"""Metadata of the field that takes all keys that no other field has."""

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class DriverTable:
    """A driver's name; all other keys are that driver's options."""

    driver: str
    options: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)


@dataclass(frozen=True)
class FilterTable:
    """A filter's name; all other keys are that filter's options."""

    filter: str
    options: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)


class Tag(NamedTuple):
    """The key that tells which of several tables one is: ``Annotated[Sphere | Box, Tag("shape")]``.

    Each of the tables has a field of that name, a ``Literal`` of one text.
    """

    key: str
    default: str = ""
    """Holds where the key is left out; empty: it must be given."""


class AtMost(NamedTuple):
    """How many tables there may be: ``Annotated[tuple[Fixture, ...], AtMost(8)]``."""

    most: int


def read_table(kind: type[Kind], table: object, key: str = "") -> Kind:
    """The `kind`, a dataclass, that `table` describes.

    Lists become tuples, and texts the members of an enum. ConfigurationError names the first key
    that is wrong, below `key`, and says how many more there are.
    """
    reader = _Reader()
    made: Kind = reader.table(kind, table, key)
    if reader.errors:
        first, more = reader.errors[0], len(reader.errors) - 1
        if more:
            raise ConfigurationError(first.key, f"{first.message} (and {more} more)")
        raise first
    return made


def as_table(options: Any) -> dict[str, Any]:
    """The table that describes `options`, as JSON has it: read_table makes the same of it."""
    table: dict[str, Any] = {}
    for each in fields(options):
        value = getattr(options, each.name)
        if each.metadata == OTHER_KEYS:
            table |= value
        elif _from_file(each):
            table[each.name] = _plain(value)
    return table


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return as_table(value)
    if isinstance(value, (tuple, list)):
        return [_plain(each) for each in value]
    return value.value if isinstance(value, enum.Enum) else value


def _from_file(each: Field[Any]) -> bool:
    return each.init and each.metadata != CODE_ONLY


def keys_of(kind: type[Any]) -> dict[str, Field[Any]]:
    """The keys of a table, and the fields that they set."""
    return {
        each.name: each for each in fields(kind) if _from_file(each) and each.metadata != OTHER_KEYS
    }


class _Reader:
    """Collects what is wrong, each with its whole key. What it makes of a wrong table is None."""

    def __init__(self) -> None:
        self.errors: list[ConfigurationError] = []

    def table(self, kind: Any, table: object, key: str, tag: str = "") -> Any:
        """`tag` says in words which of several tables this is."""
        if not isinstance(table, Mapping):
            return self._wrong(key, f"{table!r} is not a table")
        before, keys, allowed = len(self.errors), keys_of(kind), hints(kind)
        others = next((each.name for each in fields(kind) if each.metadata == OTHER_KEYS), "")
        unknown = {name: table[name] for name in table if name not in keys}
        values: dict[str, Any] = {others: unknown} if others else {}
        for name in () if others else unknown:
            self._wrong(
                _below(key, name),
                f"there is no such key{tag and f' with {tag}'}; allowed: {', '.join(keys)}"
                + suggestion(name, keys),
            )
        for name, each in keys.items():
            if name in table:
                values[name] = self._value(allowed[name], table[name], _below(key, name))
            elif each.default is MISSING and each.default_factory is MISSING:
                self._wrong(_below(key, name), f"is missing{tag and f': {tag} needs it'}")
        if len(self.errors) > before:
            return None
        try:
            return kind(**values)
        except ConfigurationError as error:
            self.errors.append(error.below(key))
        except ValueError as error:
            self._wrong(key, str(error))
        return None

    def _wrong(self, key: str, message: str) -> Any:
        self.errors.append(ConfigurationError(key, message))
        return None

    def _value(self, hint: Any, value: object, key: str) -> Any:
        """What `value` is as `hint` has it."""
        before = len(self.errors)
        found = self._converted(hint, value, key)
        if len(self.errors) == before and (allowed := refusal(hint, found)):
            near = suggestion(value, _words(hint)) if isinstance(value, str) else ""
            self.errors.append(OptionError(key, value, allowed + near))
        return found

    def _converted(self, hint: Any, value: Any, key: str) -> Any:
        origin, inner = get_origin(hint), get_args(hint)
        if origin is Annotated:
            note = inner[1]
            if isinstance(note, Tag):
                return self._tagged(get_args(inner[0]), note, value, key)
            several = isinstance(note, AtMost) and isinstance(value, (list, tuple))
            if several and len(value) > note.most:
                return self._wrong(key, f"{len(value)} are too many; allowed: at most {note.most}")
            return self._converted(inner[0], value, key)
        if origin in (Union, UnionType):
            kinds = [each for each in inner if each is not NoneType]
            if value is None and len(kinds) < len(inner):
                return None
            if len(kinds) == 1:
                return self._converted(kinds[0], value, key)
            tried = ((each, self._converted(each, value, key)) for each in kinds)
            return next((found for each, found in tried if not refusal(each, found)), value)
        if is_dataclass(hint):
            return self.table(hint, value, key)
        if origin is tuple:
            return self._several(inner, value, key)
        if isinstance(hint, type) and issubclass(hint, enum.Enum):
            with contextlib.suppress(ValueError):
                return hint(value)
        if hint is float and type(value) is int:
            with contextlib.suppress(OverflowError):
                return float(value)
        return value

    def _several(self, inner: tuple[Any, ...], value: Any, key: str) -> Any:
        tables = inner[-1] is Ellipsis and _is_table(inner[0])
        if not isinstance(value, (list, tuple)):
            if tables:
                self._wrong(key, f"one table for each of them, under the heading [[{key}]]")
            return value
        each = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        if len(each) != len(value):
            return value
        return tuple(
            self._converted(hint, element, _below(key, str(index)) if tables else key)
            for index, (hint, element) in enumerate(zip(each, value, strict=True))
        )

    def _tagged(self, kinds: tuple[Any, ...], tag: Tag, table: Any, key: str) -> Any:
        if not isinstance(table, Mapping):
            return self._wrong(key, f"{table!r} is not a table")
        by_name = {name: kind for kind in kinds for name in choices(hints(kind)[tag.key])}
        name = table.get(tag.key, tag.default)
        if name == "" and tag.key not in table:
            return self._wrong(_below(key, tag.key), "is missing")
        if not isinstance(name, str) or name not in by_name:
            allowed = f"one of {', '.join(by_name)}"
            near = suggestion(name, by_name) if isinstance(name, str) else ""
            self.errors.append(OptionError(_below(key, tag.key), name, allowed + near))
            return None
        return self.table(by_name[name], table, key, f'{tag.key} = "{name}"')


def _below(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _is_table(hint: Any) -> bool:
    """Whether `hint` is a table, or one of several that a Tag tells apart."""
    notes = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    return is_dataclass(hint) or any(isinstance(note, Tag) for note in notes)


def _words(hint: Any) -> list[str]:
    """The values of an enum or a Literal, by itself or in a union."""
    found = [str(each.value if isinstance(each, enum.Enum) else each) for each in choices(hint)]
    if get_origin(hint) in (Union, UnionType):
        found += [word for each in get_args(hint) for word in _words(each)]
    return found
