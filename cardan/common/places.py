"""Position of a key in a TOML file, which the parsed tables do not have. It is searched only if a
key is wrong. The text is scanned again then: it is valid TOML up to the key at least, and the scan
relies on that."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator
from pathlib import Path

from cardan.common import files
from cardan.errors import ConfigurationError

_TOKEN = re.compile(
    r"""(?P<skip>[ \t\r]+|\#[^\n]*)
    |(?P<text>\"{3}(?:\\[\s\S]|[^\\])*?\"{3}\"{0,2}|'{3}[\s\S]*?'{3}'{0,2}
        |"(?:\\.|[^"\\\n])*"|'[^'\n]*')
    |(?P<mark>[=\[\]{},.\n])
    |(?P<bare>[^\s\#"'=\[\]{},.]+)""",
    re.VERBOSE,
)
_Path = tuple[str, ...]


class _Scan:
    """The dotted keys of a text, those in arrays by their numbers, and the offsets of each."""

    def __init__(self, text: str) -> None:
        self.found: dict[str, int] = {}
        self.given: list[tuple[str, int]] = []
        """Whole keys of assignments and tables in order, with their offsets."""
        self._tokens = [
            (each[0], each.start()) for each in _TOKEN.finditer(text) if each.lastgroup != "skip"
        ]
        self._next = 0
        self._lengths: dict[_Path, int] = {}
        """Lengths of the arrays of tables, up to the present offset."""
        table: _Path = ()
        while self._next < len(self._tokens):
            if self._token == "\n":
                self._next += 1
            elif self._token == "[":
                table = self._header()
            else:
                self._assignment(table)

    @property
    def _token(self) -> str:
        """Return the next token; empty at the end of the text."""
        return self._tokens[self._next][0] if self._next < len(self._tokens) else ""

    def _note(self, path: _Path, offset: int) -> None:
        self.found.setdefault(".".join(path), offset)

    def _key(self, end: str) -> list[str]:
        """Return the parts of a key up to `end`, which is consumed."""
        parts = []
        while (token := self._token) not in (end, ""):
            self._next += 1
            if token != ".":
                parts.append(_plain(token))
        self._next += 1
        return parts

    def _header(self) -> _Path:
        offset = self._tokens[self._next][1]
        self._next += 1
        if several := self._token == "[":
            self._next += 1
        *outer, last = self._key("]")
        path: _Path = ()
        for part in outer:
            path = (*path, part)
            self._note(path, offset)
            if path in self._lengths:
                path = (*path, str(self._lengths[path] - 1))
        path = (*path, last)
        self._note(path, offset)
        self.given.append((".".join(path), offset))
        if several:
            self._next += 1
            number = self._lengths.get(path, 0)
            self._lengths[path] = number + 1
            path = (*path, str(number))
            self._note(path, offset)
        return path

    def _assignment(self, table: _Path) -> None:
        offset = self._tokens[self._next][1]
        path = table
        for part in self._key("="):
            path = (*path, part)
            self._note(path, offset)
        self.given.append((".".join(path), offset))
        self._value(path)

    def _value(self, path: _Path) -> None:
        opening = self._token
        if opening not in ("[", "{"):
            while self._token not in (",", "]", "}", "\n", ""):
                self._next += 1
            return
        self._next += 1
        closing, number = "]" if opening == "[" else "}", 0
        while self._token not in (closing, ""):
            if self._token in (",", "\n"):
                self._next += 1
            elif opening == "{":
                self._assignment(path)
            else:
                element = (*path, str(number))
                self._note(element, self._tokens[self._next][1])
                self._value(element)
                number += 1
        self._next += 1


def _plain(token: str) -> str:
    """Return a part of a key without its quotes."""
    if token[0] == "'":
        return token[1:-1]
    with contextlib.suppress(ValueError):
        return str(json.loads(token)) if token[0] == '"' else token
    return token[1:-1]


def place_of(path: Path, key: str) -> str:
    """Return `path` with line and column of a dotted key, such as "cell.toml:3:5"; for a missing
    key, those of its table. `path` alone if that is missing, too."""
    try:
        text = files.read_text(path)
        found = _Scan(text).found
    except (OSError, ValueError, RecursionError):
        return str(path)
    while key and key not in found:
        key = key.rpartition(".")[0]
    return at(path, text, found[key]) if key else str(path)


def given_twice(text: str) -> tuple[str, int, int] | None:
    """Return the last key in `text` that was given before, and the offsets of both, or its table,
    if that was given as a value; None: none was. `text` ends at the key or in its value."""
    scan = _Scan(text)
    for key, offset in reversed(scan.given):
        if scan.found[key] < offset:
            return key, scan.found[key], offset
    key, offset = scan.given[-1] if scan.given else ("", 0)
    while key := key.rpartition(".")[0]:
        if key in dict(scan.given):
            return key, scan.found[key], offset
    return None


def at(path: object, text: str, offset: int) -> str:
    """Return `path` with the line and the column of `offset` in its text."""
    return f"{path}:{line_of(text, offset)}:{offset - text.rfind(chr(10), 0, offset)}"


def line_of(text: str, offset: int) -> int:
    """Return the line of `offset`."""
    return text.count("\n", 0, offset) + 1


@contextlib.contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Add the place in the file to errors of keys raised inside."""
    try:
        yield
    except ConfigurationError as error:

        def placed(error: ConfigurationError) -> ConfigurationError:
            unplaced = error.key and not error.place
            return error.placed(place_of(path, error.key)) if unplaced else error

        raise error.each(placed) from None
