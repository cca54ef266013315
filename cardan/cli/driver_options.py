"""Driver options for tables, from a dataclass and the text below each of its fields."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from cardan.cli.options_from_dataclass import texts_below
from cardan.common.bounds import Range
from cardan.common.options import hints


class DriverOption(NamedTuple):
    """Key of a configuration's `[device]` or `[robot]`."""

    name: str
    default: str
    """Default in TOML; `none`: the key may be left out."""
    allowed: str
    meaning: str


def driver_options(options: type) -> list[DriverOption]:
    """Return the fields of an options dataclass, in their order."""
    kinds, texts = hints(options), texts_below(options)
    return [
        DriverOption(
            each.name, _default(each), _allowed(kinds[each.name]), texts.get(each.name, "")
        )
        for each in dataclasses.fields(options)
    ]


def _default(field: dataclasses.Field[Any]) -> str:
    factory = field.default_factory
    return _written(field.default if factory is dataclasses.MISSING else factory())


def _written(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_written, value))}]"
    if isinstance(value, float):
        return str(round(value, 12))
    return f'"{value}"' if isinstance(value, str) else str(value)


def _allowed(hint: Any) -> str:
    """Describe the allowed values: choices, the first range, and the form of a text."""
    notes = list(_notes(hint))
    first = next((note for note in notes if isinstance(note, Range)), None)
    words = [note for note in notes if isinstance(note, str)]
    if first is not None:  # The unit is in the option's name or description.
        words.append(str(dataclasses.replace(first, unit="", zero="")))
        words += [f"0: {first.zero}"] if first.zero else []
    return ", ".join(dict.fromkeys(words))


def _notes(hint: Any) -> Iterator[str | Range]:
    """Yield the choices and ranges that an annotation allows."""
    if get_origin(hint) is Literal:
        yield from map(_written, get_args(hint))
        return
    if get_origin(hint) is Annotated:
        kind, *notes = get_args(hint)
        yield from _notes(kind)
        for note in notes:
            if isinstance(note, Range):
                yield note
            elif words := getattr(note, "words", ""):
                yield words
        return
    for inner in get_args(hint):
        yield from _notes(inner)
