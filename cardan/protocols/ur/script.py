"""URScript, the part of it that Cardan's own program and its simulated controller need.

`parse` turns a program's text into statements, or says what of it is not understood and where.
Known are: one `def NAME(): ... end`, `global` and `local`, assignments also to an element of a
list, `if`/`elif`/`else`, `while`, `break`, `continue`, `return`, `halt`, calls as statements and in
expressions, numbers, texts, True and False, lists, and the operators
``+ - * / % == != < <= > >= not and or``. Threads, poses `p[...]`, functions inside the program,
`for`, `switch` and `sec` programs are refused by name.

Source: UR's script manual (public).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Final, NamedTuple

LARGEST: Final = 65536
"""Bytes of a program."""
LARGEST_WHOLE: Final = 2**31 - 1
"""Of whole numbers; they have 32 bits."""
DEEPEST: Final = 50
"""Levels of brackets and blocks."""


class Refused(NamedTuple):
    """What of a program is not understood."""

    line: int
    """Counted from 1."""
    reason: str


# -- expressions -----------------------------------------------------------------------------------


class Literal(NamedTuple):
    """A number, a text or a truth."""

    value: float | int | bool | str


class Name(NamedTuple):
    """A variable."""

    name: str
    line: int


class Listed(NamedTuple):
    """A list."""

    items: tuple[Expression, ...]


class Element(NamedTuple):
    """An element of a list."""

    of: Expression
    at: Expression
    line: int


class Call(NamedTuple):
    """A function and its arguments; those that were named have their names."""

    name: str
    arguments: tuple[Expression, ...]
    named: tuple[tuple[str, Expression], ...]
    line: int


class Unary(NamedTuple):
    """`-` or `not`."""

    operator: str
    value: Expression
    line: int


class Binary(NamedTuple):
    """An operator between two values."""

    operator: str
    left: Expression
    right: Expression
    line: int


Expression = Literal | Name | Listed | Element | Call | Unary | Binary


# -- statements ------------------------------------------------------------------------------------


class Assign(NamedTuple):
    """A variable, or an element of its list, gets a value."""

    name: str
    at: Expression | None
    """The index of the element; None: the whole variable."""
    value: Expression
    line: int


class Do(NamedTuple):
    """A call of its own."""

    call: Call
    line: int


class If(NamedTuple):
    """Conditions with their blocks, in order, and the block of `else`."""

    branches: tuple[tuple[Expression, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]
    line: int


class While(NamedTuple):
    """A block, as long as a condition holds."""

    condition: Expression
    block: tuple[Statement, ...]
    line: int


class Leave(NamedTuple):
    """`break`, `continue`, `return` or `halt`."""

    how: str
    line: int


Statement = Assign | Do | If | While | Leave


class Program(NamedTuple):
    """A program that was understood."""

    name: str
    block: tuple[Statement, ...]


_TOKEN = re.compile(
    r"""(?P<space>[ \t\r]+|\#[^\n]*)
      | (?P<newline>\n)
      | (?P<number>(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?)
      | (?P<text>"[^"\n]*")
      | (?P<name>[A-Za-z_]\w*)
      | (?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:])""",
    re.VERBOSE,
)

_REFUSED_WORDS = frozenset(
    [
        "thread",
        "run",
        "join",
        "kill",
        "sec",
        "for",
        "switch",
        "case",
        "default",
        "enter_critical",
        "exit_critical",
        "xor",
        "struct",
    ]
)
_WORDS = frozenset(
    [
        "def",
        "end",
        "if",
        "elif",
        "else",
        "while",
        "break",
        "continue",
        "return",
        "halt",
        "global",
        "local",
        "and",
        "or",
        "not",
        "True",
        "False",
    ]
)
_COMPARISONS = frozenset(("==", "!=", "<", "<=", ">", ">="))


class _Token(NamedTuple):
    kind: str
    text: str
    line: int


class _WrongError(Exception):
    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line, self.reason = line, reason


def parse(text: str) -> Program | Refused:
    """The program in `text`, or why it is refused."""
    if len(text) > LARGEST:
        return Refused(1, f"the program has {len(text)} characters; {LARGEST} are the most")
    try:
        return _Parser(_tokens(text)).program()
    except _WrongError as wrong:
        return Refused(wrong.line, wrong.reason)


def _tokens(text: str) -> list[_Token]:
    found, at, line = [], 0, 1
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _WrongError(line, f"{text[at]!r} is not understood")
        kind, word = str(match.lastgroup), match.group()
        at = match.end()
        if kind == "newline":
            found.append(_Token("newline", "the end of the line", line))
            line += 1
        elif kind == "name" and word in _REFUSED_WORDS:
            raise _WrongError(line, f"`{word}` is not supported")
        elif kind != "space":
            found.append(_Token("word" if word in _WORDS else kind, word, line))
    found.append(_Token("end", "the end of the program", line))
    return found


class _Parser:
    def __init__(self, tokens: list[_Token]) -> None:
        self._tokens = tokens
        self._at = 0
        self._depth = 0

    def program(self) -> Program:
        self._skip_lines()
        self._expect("def")
        name = self._name()
        for sign in ("(", ")", ":"):
            self._expect(sign)
        block = self._block(("end",))
        self._expect("end")
        self._skip_lines()
        token = self._next
        if token.kind != "end":
            raise _WrongError(token.line, f"{token.text!r} comes after the end of the program")
        return Program(name, block)

    # -- tokens --

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _is(self, text: str) -> bool:
        token = self._next
        return token.text == text and token.kind in ("word", "sign")

    def _taken(self, text: str) -> bool:
        if not self._is(text):
            return False
        self._at += 1
        return True

    def _expect(self, text: str) -> int:
        token = self._next
        if not self._taken(text):
            raise _WrongError(token.line, f"`{text}` is expected, not {token.text!r}")
        return token.line

    def _name(self) -> str:
        token = self._next
        if token.kind != "name":
            raise _WrongError(token.line, f"a name is expected, not {token.text!r}")
        self._at += 1
        return token.text

    def _skip_lines(self) -> None:
        while self._next.kind == "newline":
            self._at += 1

    def _deeper(self, by: int) -> None:
        self._depth += by
        if self._depth > DEEPEST:
            raise _WrongError(self._next.line, f"more than {DEEPEST} levels")

    # -- statements --

    def _block(self, until: tuple[str, ...]) -> tuple[Statement, ...]:
        self._deeper(1)
        found: list[Statement] = []
        while True:
            self._skip_lines()
            token = self._next
            if token.kind == "end":
                raise _WrongError(token.line, f"`{until[-1]}` is missing")
            if token.kind == "word" and token.text in until:
                self._deeper(-1)
                return tuple(found)
            found.append(self._statement())

    def _statement(self) -> Statement:
        token = self._next
        line = token.line
        if self._taken("if"):
            return self._if(line)
        if self._taken("while"):
            condition = self._expression()
            self._expect(":")
            block = self._block(("end",))
            self._expect("end")
            return While(condition, block, line)
        if token.kind == "word" and token.text in ("break", "continue", "return", "halt"):
            self._at += 1
            self._end_of_line()
            return Leave(token.text, line)
        if token.text == "def":
            raise _WrongError(line, "a function inside the program is not supported")
        if not self._taken("global"):
            self._taken("local")
        name = self._name()
        if self._is("("):
            call = self._call(name, line)
            self._end_of_line()
            return Do(call, line)
        index = None
        if self._taken("["):
            index = self._expression()
            self._expect("]")
        self._expect("=")
        value = self._expression()
        self._end_of_line()
        return Assign(name, index, value, line)

    def _if(self, line: int) -> If:
        branches = []
        while True:
            condition = self._expression()
            self._expect(":")
            branches.append((condition, self._block(("elif", "else", "end"))))
            if not self._taken("elif"):
                break
        otherwise: tuple[Statement, ...] = ()
        if self._taken("else"):
            self._expect(":")
            otherwise = self._block(("end",))
        self._expect("end")
        return If(tuple(branches), otherwise, line)

    def _end_of_line(self) -> None:
        token = self._next
        if token.kind not in ("newline", "end"):
            raise _WrongError(token.line, f"the line should end before {token.text!r}")

    # -- expressions, the loosest operator first --

    def _expression(self) -> Expression:
        self._deeper(1)
        found = self._binary(("or",), lambda: self._binary(("and",), self._negated))
        self._deeper(-1)
        return found

    def _negated(self) -> Expression:
        line = self._next.line
        if self._taken("not"):
            self._deeper(1)
            found = Unary("not", self._negated(), line)
            self._deeper(-1)
            return found
        return self._binary(tuple(_COMPARISONS), self._sum)

    def _sum(self) -> Expression:
        return self._binary(("+", "-"), lambda: self._binary(("*", "/", "%"), self._signed))

    def _binary(self, signs: tuple[str, ...], operand: Callable[[], Expression]) -> Expression:
        found = operand()
        while self._next.text in signs and self._next.kind in ("word", "sign"):
            sign = self._next
            self._at += 1
            found = Binary(sign.text, found, operand(), sign.line)
        return found

    def _signed(self) -> Expression:
        line = self._next.line
        if self._taken("-"):
            self._deeper(1)
            negative = Unary("-", self._signed(), line)
            self._deeper(-1)
            return negative
        found = self._value()
        while self._is("["):
            self._expect("[")
            index = self._expression()
            self._expect("]")
            found = Element(found, index, line)
        return found

    def _value(self) -> Expression:
        token = self._next
        if self._taken("("):
            inner = self._expression()
            self._expect(")")
            return inner
        if self._taken("["):
            return Listed(self._items("]"))
        self._at += 1
        if token.kind == "number":
            number = float(token.text)
            if math.isinf(number):
                raise _WrongError(token.line, "a number is too large")
            whole = token.text.isdigit() and number <= LARGEST_WHOLE
            return Literal(int(token.text) if whole else number)
        if token.kind == "text":
            return Literal(token.text[1:-1])
        if token.kind == "word" and token.text in ("True", "False"):
            return Literal(token.text == "True")
        if token.kind == "name":
            if token.text == "p" and self._is("["):
                raise _WrongError(token.line, "poses `p[...]` are not supported")
            if self._is("("):
                return self._call(token.text, token.line)
            return Name(token.text, token.line)
        raise _WrongError(token.line, f"a value is expected, not {token.text!r}")

    def _items(self, closing: str) -> tuple[Expression, ...]:
        found: list[Expression] = []
        if self._taken(closing):
            return ()
        while True:
            found.append(self._expression())
            if not self._taken(","):
                self._expect(closing)
                return tuple(found)

    def _call(self, name: str, line: int) -> Call:
        self._expect("(")
        values: list[Expression] = []
        named: list[tuple[str, Expression]] = []
        if self._taken(")"):
            return Call(name, (), (), line)
        while True:
            token = self._next
            if token.kind == "name" and self._tokens[self._at + 1][:2] == ("sign", "="):
                self._at += 2
                named.append((token.text, self._expression()))
            elif named:
                raise _WrongError(
                    token.line, "an argument without a name comes after one with a name"
                )
            else:
                values.append(self._expression())
            if not self._taken(","):
                self._expect(")")
                return Call(name, tuple(values), tuple(named), line)
