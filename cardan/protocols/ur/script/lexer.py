"""The words of URScript."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

LARGEST: Final = 128 * 1024
"""Bytes of a program."""
LARGEST_WHOLE: Final = 2**31 - 1
"""Of whole numbers; they have 32 bits."""

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

_TOKEN = re.compile(
    r"""(?P<space>[ \t\r]+|\#[^\n]*)
      | (?P<newline>\n)
      | (?P<number>0[xX][0-9a-fA-F]+|(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?)
      | (?P<text>"[^"\n]*"|'[^'\n]*')
      | (?P<name>[A-Za-z_]\w*)
      | (?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:.])""",
    re.VERBOSE,
)


class Token(NamedTuple):
    """A word of a program."""

    kind: str
    """newline, number, text, name, word, sign; end for what comes after the last."""
    text: str
    line: int


class WrongError(Exception):
    """What of a program is not understood."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line, self.reason = line, reason


def tokens(text: str) -> list[Token]:
    """The words of a program, without comments and what is between them. Raises WrongError."""
    found: list[Token] = []
    make, keep = tuple.__new__, found.append
    at, line = 0, 1
    for match in _TOKEN.finditer(text):
        if match.start() != at:
            break
        at = match.end()
        kind = match.lastgroup
        if kind == "space":
            continue
        if kind == "newline":
            keep(make(Token, ("newline", "the end of the line", line)))
            line += 1
            continue
        word = match.group()
        keep(make(Token, ("word" if kind == "name" and word in WORDS else kind, word, line)))
    if at < len(text):
        raise WrongError(line, f"{text[at]!r} is not understood")
    found.append(Token("end", "the end of the program", line))
    return found
