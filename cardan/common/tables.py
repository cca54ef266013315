"""Conversion between the tables of a configuration file and options.

A table is a dataclass. Its annotations give the allowed values (:mod:`cardan.common.options`), its
defaults those of keys that are left out, its ``__post_init__`` checks that they fit together, and
its ``RENAMED``, if any, has the new names of keys that an earlier version took, and of values, as
"key = 'value'". A field may be a table, several tables, or one of several kinds that a key
distinguishes (:class:`Tag`).
"""

from __future__ import annotations

import contextlib
import enum
import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

from cardan.common import files
from cardan.common.bounds import Located
from cardan.common.options import CODE_ONLY, OTHER_KEYS, choices, hints, refusal, suggestion
from cardan.common.places import at, given_twice, line_of
from cardan.errors import ConfigurationError, OptionError, below, shown, together

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")

_REMEDIES = (
    ("\0", "there is a NUL character (U+0000): the file is not text, or was not written whole"),
    ("[\u201c\u201d\u201e\u2018\u2019\u201a\u00ab\u00bb]", 'write quotes as " and no others'),
    ("[\u00a0\u202f\u2007]", "there is a no-break space: write a space"),
    (r"=\s*[-+]?[0-9]+,[0-9]", "write the decimal point as ., not as a comma"),
    (r"=\s*(True|False|TRUE|FALSE)\b", "write true and false in small letters"),
    (
        r"\A(Unescaped '\\'|Invalid hex value|Escaped character is not a Unicode)",
        "write a path in single quotes, or with / for \\",
    ),
)
"""Common mistakes by the parser's message or the line, and what to write instead."""

_SAID = re.compile(
    r"(?P<what>.*) \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)", re.DOTALL
)
_TWICE = re.compile("^(Cannot (overwrite|declare|mutate|redefine)|Duplicate)")
"""Messages of the TOML parser about a key that is given twice."""

Kind = TypeVar("Kind")


class Tag(NamedTuple):
    """Key that distinguishes several kinds of tables: ``Annotated[Sphere | Box, Tag("shape")]``.
    Each of the tables has a field of that name, a ``Literal`` of one text."""

    key: str
    default: str = ""
    """Value if the key is left out; empty: it must be given."""


class AtMost(NamedTuple):
    """Largest number of tables: ``Annotated[tuple[Fixture, ...], AtMost(8)]``."""

    most: int


def read_text(path: Path, most_bytes: int = files.TEXT_BYTES, declared: bool = False) -> str:
    """Read the text of a file by :func:`cardan.common.files.read_text`. Raises
    ConfigurationError."""
    try:
        return files.read_text(path, most_bytes, declared)
    except OSError as error:
        raise ConfigurationError("", f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:  # Not UTF-8, or a path that is none.
        raise ConfigurationError("", f"cannot read {path}: {error}") from None


def parse_toml(text: str, of: object) -> dict[str, Any]:
    """Return the tables in `text`; `of` names its origin in errors."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_error(text, of, str(error)) from None
    except RecursionError:
        raise ConfigurationError("", "is nested too deeply").placed(str(of)) from None
    except ValueError as error:  # A number of more digits than Python reads.
        why = str(error).partition(";")[0]
        raise ConfigurationError("", f"cannot read {of}: {why}") from None


def _syntax_error(text: str, of: object, said: str) -> ConfigurationError:
    """Return the error for a `text` with the parser's message `said`, and what to write instead."""
    found = _SAID.fullmatch(said)
    assert found is not None, said
    lines = text.split("\n")
    line = int(found["line"] or len(lines))
    column = int(found["column"] or len(lines[-1]) + 1)
    offset = sum(len(each) + 1 for each in lines[: line - 1]) + column - 1
    if _TWICE.search(found["what"]) and (twice := given_twice(text[:offset])):
        key, first, again = twice
        error = ConfigurationError(key, f"is given twice; first in line {line_of(text, first)}")
        return error.placed(at(of, text, again))
    seen = f"{found['what']}\n{lines[line - 1]}"
    remedy = next((f": {words}" for pattern, words in _REMEDIES if re.search(pattern, seen)), "")
    return ConfigurationError("", f"is not TOML: {found['what']}{remedy}").placed(
        at(of, text, offset)
    )


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a file. Raises ConfigurationError."""
    return parse_toml(read_text(path), path)


def as_toml(tables: Mapping[str, Any]) -> str:
    """Return the text of a file with these tables; all results of `read_toml` are allowed."""
    return "".join(f"{_toml_key(key)} = {_toml(value)}\n" for key, value in tables.items())


def _toml_key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _toml(key)


def _toml(value: object) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(as_toml({key: each}).rstrip() for key, each in value.items())}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower()  # Numbers as Python has them, but true, false, inf and nan.


def keys_of(kind: type[Any], from_file: bool = True) -> dict[str, Field[Any]]:
    """Return the keys of a table, and the fields that they set. Without `from_file` the table goes
    from one program to another, and includes the keys that only programs set."""
    others = (OTHER_KEYS, CODE_ONLY) if from_file else (OTHER_KEYS,)
    return {each.name: each for each in fields(kind) if each.init and each.metadata not in others}


def read_table(kind: type[Kind], table: object, key: str = "", from_file: bool = True) -> Kind:
    """Make the `kind`, a dataclass, that `table` describes; `from_file` as in :func:`keys_of`.

    Lists become tuples, and texts the members of an enum. ConfigurationError names the keys that
    are wrong, below `key`.
    """
    reader = _Reader(from_file)
    made: Kind = reader.table(kind, table, key)
    if reader.errors:
        raise together(reader.errors)
    return made


def resolved(kind: Any, table: Any, file: Path, key: str = "") -> Any:
    """Return `table`, a `kind`'s in `file`, with absolute paths
    (:class:`~cardan.common.bounds.Located`): they are relative to the file, with ~ and variables of
    the environment. A `kind` whose other keys are the options of another class names it by a class
    method `kind_of_others`. ConfigurationError names a key below `key` whose file is missing.
    """
    if not isinstance(table, Mapping):
        return table
    known, allowed = keys_of(kind), hints(kind)
    named = {name: each for name, each in table.items() if name in known}
    found = {
        name: _resolved(allowed[name], each, file, _below(key, name))
        for name, each in named.items()
    }
    others = {name: each for name, each in table.items() if name not in known}
    words_of_others = getattr(kind, "kind_of_others", None)
    if others and words_of_others is not None and (other := words_of_others(table)) is not None:
        others = resolved(other, others, file, key)
    return {name: {**found, **others}[name] for name in table}


def _resolved(hint: Any, value: Any, file: Path, key: str) -> Any:
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        for note in inner[1:]:
            if isinstance(note, Located) and isinstance(value, str):
                return _absolute(note, value, file, key)
            if isinstance(note, Tag) and isinstance(value, Mapping):
                name = value.get(note.key, note.default)
                kinds = get_args(inner[0])
                kind = next(
                    (each for each in kinds if name in choices(hints(each)[note.key])), None
                )
                return value if kind is None else resolved(kind, value, file, key)
        return _resolved(inner[0], value, file, key)
    if origin in (Union, UnionType):
        for each in inner:
            value = _resolved(each, value, file, key)
        return value
    if origin is tuple and inner and isinstance(value, list):
        return [
            _resolved(inner[0], each, file, _below(key, str(index)))
            for index, each in enumerate(value)
        ]
    return resolved(hint, value, file, key) if is_dataclass(hint) else value


def _absolute(note: Located, value: str, file: Path, key: str) -> str:
    """Return the text of a file with the path in it absolute."""
    if (found := re.fullmatch(note.pattern, value)) is None:
        return value
    with below(key):
        path = files.expanded(found["path"])
    if path.is_absolute() or not note.is_met:
        folder = file.parent.absolute()
        if note.is_read and not path.is_absolute() and not (folder / path).exists():
            raise ConfigurationError(
                key,
                f"cannot read {found['path']!r}: there is none in {folder}, the folder of the file "
                "that names it",
            )
        path = folder / path
    return f"{value[: found.start('path')]}{path}{value[found.end('path') :]}"


def as_table(options: Any, from_file: bool = True) -> dict[str, Any]:
    """Return the table that describes `options`, in JSON's types: read_table is the inverse.
    `from_file` as in :func:`keys_of`."""
    kind = type(options)
    table = {key: plain(getattr(options, key), from_file) for key in keys_of(kind, from_file)}
    others: dict[str, Any] = plain(getattr(options, _others(kind), {}), from_file)
    return table | others


def plain(value: Any, from_file: bool = True) -> Any:
    """Convert a value of options to JSON's types; `from_file` as in :func:`keys_of`."""
    if is_dataclass(value):
        return as_table(value, from_file)
    if isinstance(value, Mapping):
        return {key: plain(each, from_file) for key, each in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(each, from_file) for each in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value.value if isinstance(value, enum.Enum) else value


def _others(kind: Any) -> str:
    """Return the field for all keys that no other field has; empty: there is none."""
    return next((each.name for each in fields(kind) if each.metadata == OTHER_KEYS), "")


def _below(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


class _Reader:
    """Reader that collects errors, each with its whole key. A wrong table is read as None."""

    def __init__(self, from_file: bool) -> None:
        self._from_file = from_file
        self.errors: list[ConfigurationError] = []

    def _wrong(self, key: str, message: str) -> None:
        self.errors.append(ConfigurationError(key, message))

    def table(self, kind: Any, table: object, key: str, tag: str = "") -> Any:
        """Read a table; `tag` describes which of several tables it is."""
        if not isinstance(table, Mapping):
            return self._wrong(key, f"{shown(table)} is not a table")
        before, keys = len(self.errors), keys_of(kind, self._from_file)
        allowed = hints(kind)
        values: dict[str, Any] = {}
        renamed = getattr(kind, "RENAMED", {})
        unknown = {name: value for name, value in table.items() if name not in keys}
        if others := _others(kind):
            values[others] = unknown
        else:
            words = f"there is no such key{tag and f' with {tag}'}"
            listed = ", ".join(keys)
            for name in [each for each in unknown if each in renamed]:
                self._wrong(_below(key, name), f"is now: {renamed[name]}; rename it")
                del unknown[name]
            for number, name in enumerate(unknown):
                near = suggestion(name, keys)
                words_of_others = f"{near} Allowed: {listed}" if near else f"; allowed: {listed}"
                self._wrong(_below(key, name), words + (near if number else words_of_others))
        for name, each in keys.items():
            if name in table and (former := f"{name} = {shown(table[name])}") in renamed:
                self._wrong(_below(key, name), f"is now: {renamed[former]}; rename it")
            elif name in table:
                values[name] = self._value(allowed[name], table[name], _below(key, name))
            elif each.default is each.default_factory is MISSING:
                self._wrong(_below(key, name), f"is missing{tag and f': {tag} needs it'}")
        if len(self.errors) == before:
            try:
                return kind(**values)
            except ConfigurationError as error:
                self.errors.append(error.below(key))
            except ValueError as error:  # The options belong to another package.
                self._wrong(key, str(error))
        return None

    def _value(self, hint: Any, value: object, key: str) -> Any:
        """Convert `value` to `hint`."""
        before = len(self.errors)
        found = self._converted(hint, value, key)
        if len(self.errors) == before and (allowed := refusal(hint, found)):
            self.errors.append(OptionError(key, value, allowed))
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
            if value is None:
                return None
            kinds = (each for each in inner if each is not NoneType)
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
        if isinstance(value, Mapping):
            return self._wrong(key, f"one table for each of them, under the heading [[{key}]]")
        if not isinstance(value, (list, tuple)):
            return value
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        each = enumerate(zip(kinds, value, strict=False))
        found = [self._converted(*pair, _below(key, str(index))) for index, pair in each]
        return (*found, *value[len(found) :])

    def _tagged(self, kinds: tuple[Any, ...], tag: Tag, table: Any, key: str) -> Any:
        if not isinstance(table, Mapping):
            return self._wrong(key, f"{shown(table)} is not a table")
        by_name = {choices(hints(kind)[tag.key])[0]: kind for kind in kinds}
        name = table.get(tag.key, tag.default)
        if name == "" and tag.key not in table:
            return self._wrong(_below(key, tag.key), "is missing")
        if allowed := refusal(Literal[tuple(by_name)], name):
            self.errors.append(OptionError(_below(key, tag.key), name, allowed))
            return None
        return self.table(by_name[name], table, key, f'{tag.key} = "{name}"')
