"""Lexer of URScript."""

from __future__ import annotations

import re
import sys
from typing import Final, NamedTuple

from cardan.protocols.ur.script.portions import pause

LARGEST: Final = 128 * 1024
"""Most bytes of a program."""
LARGEST_WHOLE: Final = 2**31 - 1
"""Largest integer: 32 bits."""

WORDS: Final = frozenset(
    [
        "and",
        "break",
        "case",
        "continue",
        "def",
        "default",
        "elif",
        "else",
        "end",
        "enter_critical",
        "exit_critical",
        "False",
        "global",
        "halt",
        "if",
        "join",
        "kill",
        "local",
        "not",
        "or",
        "pass",
        "return",
        "run",
        "sec",
        "switch",
        "thread",
        "True",
        "while",
        "xor",
    ]
)

_SPACE = r"[ \t\r]*(?:\#[^\n]*)?"
_TOKEN = re.compile(
    _SPACE
    + r"""(?:(?P<newline>\n)
      | (?P<number>0[xX][0-9a-fA-F]+|(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?)
      | (?P<text>"[^"\n]*"|'[^'\n]*')
      | (?P<name>[A-Za-z_]\w*)
      | (?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:.]))""",
    re.VERBOSE,
)
_LAST = re.compile(_SPACE)
_PORTION: Final = 500
"""Tokens between two pauses."""


class Token(NamedTuple):
    """A token of a program."""

    kind: str
    """Kind: newline, number, text, name; for keywords and signs, the token itself; empty at the
    end."""
    text: str
    line: int


class WrongError(Exception):
    """A part of a program is not understood."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line, self.reason = line, reason


class TokenList:
    """Tokens of a program in three lists: an object per token would keep the garbage collector
    busy."""

    def __init__(self) -> None:
        self.kinds: list[str] = []
        self.texts: list[str] = []
        self.lines: list[int] = []

    def __getitem__(self, at: int) -> Token:
        return Token(self.kinds[at], self.texts[at], self.lines[at])


async def words(text: str) -> TokenList:
    """Split a program into tokens, without comments and white space. Raises WrongError."""
    found = TokenList()
    kinds, texts, lines, match = found.kinds, found.texts, found.lines, _TOKEN.match
    at, line, pause_at = 0, 1, _PORTION
    while (word := match(text, at)) is not None:
        at = word.end()
        kind = word.lastgroup
        assert kind is not None
        what = sys.intern(word[kind])
        lines.append(line)
        if kind == "newline":
            what = "the end of the line"
            line += 1
        elif kind == "sign" or (kind == "name" and what in WORDS):
            kind = what
        kinds.append(kind)
        texts.append(what)
        if len(lines) > pause_at:
            pause_at += _PORTION
            await pause()
    rest = _LAST.match(text, at)
    assert rest is not None
    if rest.end() < len(text):
        raise WrongError(line, f"{text[rest.end()]!r} is not understood")
    kinds.append("")
    texts.append("the end of the program")
    lines.append(line)
    return found
