"""Codes of the messages that an operator must act on, with cause and remedy: troubles.toml.

A message is recognized by its fixed words, so that its source needs no code. The search takes some
0.02 ms: it is for messages shown to people, never in a control cycle.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from cardan.errors import ConfigurationError, shown

FILE = Path(__file__).with_suffix(".toml")

AREAS = {
    "S": "Settings and the command line",
    "D": "Operator devices",
    "R": "Robots and their links",
    "M": "Motion, authority, arming",
    "F": "Force feedback",
    "N": "Network, daemon, records",
}
"""Areas by the letter of their codes."""

_HISTORY = re.compile(r"stopped before: .*?(?:; |$)")

GAP = "..."
"""Placeholder for a value in the words of a message."""

KEY = ": "
"""Prefix of words at the beginning of a message, or after the key that it is about."""


class Trouble(NamedTuple):
    """An entry of the table."""

    code: str
    words: tuple[str, ...]
    """Variants of the message."""
    cause: str
    now: str
    """Present behavior of the program."""
    do: str
    page: str
    """Page of the documentation, relative to docs/."""


@functools.cache
def troubles() -> Mapping[str, Trouble]:
    """Return all entries by code, in the order of the file."""
    from cardan.common.tables import parse_toml

    tables = parse_toml(FILE.read_text(encoding="utf-8"), FILE.name)
    return {
        code: Trouble(code, tuple(table["words"]), *(table[key] for key in Trouble._fields[2:]))
        for code, table in tables.items()
        if isinstance(table, dict)
    }


@functools.cache
def sayings() -> tuple[tuple[str, str, str], ...]:
    """Return each variant of a message, the longest of its fixed parts, and its code."""
    return tuple(
        (words, max(_parts(words), key=len), trouble.code)
        for trouble in troubles().values()
        for words in trouble.words
    )


@functools.cache
def pattern(words: str) -> re.Pattern[str]:
    """Return the pattern that finds a message with these words."""
    text = ".*?".join(map(re.escape, _parts(words)))
    # Words that begin with a letter do not begin within a word.
    begin = "(?:^|: )" if words.startswith(KEY) else r"\b" if words[0].isalpha() else ""
    return re.compile(begin + text)


def _parts(words: str) -> list[str]:
    return words.removeprefix(KEY).strip(". ").split(GAP)


def codes_of(message: str) -> list[str]:
    """Return the codes in a message, in its order; without those of an earlier stop if the message
    has others."""
    found = sorted(
        (match.start(), -len(match[0]), code)
        for words, part, code in sayings()
        if part in message and (match := pattern(words).search(message))
    )
    if history := _HISTORY.search(message):
        begin, end = history.span()
        found = [each for each in found if not begin <= each[0] < end] or found
    codes, end = [], 0
    for begin, length, code in found:
        if begin >= end:
            codes.append(code)
            end = begin - length
    return list(dict.fromkeys(codes))


def code_of(message: str) -> str | None:
    """Return the first of `codes_of` a message; None: there is none."""
    return next(iter(codes_of(message)), None)


def coded(message: str) -> str:
    """Return `message` with the codes of each of its lines, for people: "... [S004]"."""
    return "\n".join(map(_line_coded, message.split("\n")))


def _line_coded(line: str) -> str:
    codes = f" [{', '.join(codes_of(line))}]"
    return line if codes == " []" or line.endswith(codes) else f"{line}{codes}"


def explained(asked: str) -> Trouble:
    """Return the entry of a code, or of a message. Raises ConfigurationError if there is none."""
    import difflib

    table = troubles()
    code = asked.strip(" []").upper()
    if code not in table:
        code = code_of(asked) or ""
    if code:
        return table[code]
    near = difflib.get_close_matches(asked.strip(" []").upper(), table, n=3, cutoff=0.5)
    words = {each.lower(): trouble.code for trouble in table.values() for each in trouble.words}
    near += [words[each] for each in difflib.get_close_matches(asked.lower(), words, n=3)]
    listed = f"; near it: {', '.join(dict.fromkeys(near))}" if near else ""
    raise ConfigurationError("", f"no entry is known for {shown(asked)}{listed}")
