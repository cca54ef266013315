"""From the words of a URScript program to its tree."""

from __future__ import annotations

import math
from typing import Final, Literal as OneOf, cast

from cardan.protocols.ur.script.lexer import (
    LARGEST,
    LARGEST_WHOLE,
    WORDS,
    Token,
    WrongError,
    tokens,
)
from cardan.protocols.ur.script.tree import (
    Assign,
    Await,
    Binary,
    Call,
    Critical,
    Define,
    Do,
    Element,
    Expression,
    If,
    Leave,
    Listed,
    Literal,
    Member,
    Name,
    Posed,
    Program,
    Refused,
    Run,
    Statement,
    Switch,
    Unary,
    While,
)

DEEPEST: Final = 50
"""Levels of brackets and blocks."""
LONGEST_CHAIN: Final = 100
"""Operators one after the other, without brackets."""
_UNNAMED: Final = "unnamed"
"""A command that came without a program."""
_POSE: Final = 6
_NEW_STATEMENT: Final = tuple(WORDS - {"and", "not", "or", "xor", "True", "False", "def", "sec"})
_NOT: Final = 4
_LEVELS: Final = {
    "or": 1,
    "xor": 2,
    "and": 3,
    **dict.fromkeys(("==", "!=", "<", "<=", ">", ">="), 5),
    **dict.fromkeys(("+", "-"), 6),
    **dict.fromkeys(("*", "/", "%"), 7),
}
"""How closely operators bind; `not`: 4."""


def parse(text: str) -> Program | Refused:
    """The program in `text`, or why it is refused; a single command is a program of one line."""
    if len(text) > LARGEST:
        return Refused(1, f"the program has {len(text)} characters; {LARGEST} are the most")
    try:
        return _Parser(tokens(text)).program()
    except WrongError as wrong:
        return Refused(wrong.line, wrong.reason)


class _Parser:
    def __init__(self, found: list[Token]) -> None:
        self._tokens = found
        self._at = 0
        self._depth = 0

    def program(self) -> Program:
        self._skip_lines()
        secondary = self._taken("sec")
        if secondary or self._taken("def"):
            name = self._name()
            for sign in ("(", ")", ":"):
                self._expect(sign)
            made = Program(name, self._ended_block(), secondary)
        else:
            made = Program(_UNNAMED, tuple(map(_put_out, self._statement())))
        self._skip_lines()
        token = self._next
        if token.kind != "end":
            raise WrongError(token.line, f"{token.text!r} comes after the end of the program")
        return made

    # -- tokens --

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    def _is(self, *texts: str) -> bool:
        kind, text, _ = self._tokens[self._at]
        return text in texts and kind in ("word", "sign")

    def _taken(self, text: str) -> bool:
        kind, found, _ = self._tokens[self._at]
        if found != text or kind not in ("word", "sign"):
            return False
        self._at += 1
        return True

    def _expect(self, text: str) -> int:
        token = self._next
        if not self._taken(text):
            raise WrongError(token.line, f"`{text}` is expected, not {token.text!r}")
        return token.line

    def _close(self, sign: str) -> None:
        """The end of brackets, maybe on another line."""
        line = self._next.line
        self._skip_lines()
        if not self._taken(sign):
            raise WrongError(line, f"`{sign}` is expected, not {self._next.text!r}")

    def _name(self) -> str:
        token = self._next
        if token.kind != "name":
            raise WrongError(token.line, f"a name is expected, not {token.text!r}")
        self._at += 1
        return token.text

    def _member(self) -> str:
        """A member's name, which may be a word of the language: `time().sec`."""
        if self._next.kind == "word":
            self._at += 1
            return self._tokens[self._at - 1].text
        return self._name()

    def _skip_lines(self) -> None:
        tokens = self._tokens
        while tokens[self._at][0] == "newline":
            self._at += 1

    def _deeper(self, by: int) -> None:
        self._depth += by
        if by > 0 and self._depth > DEEPEST:
            raise WrongError(self._next.line, f"more than {DEEPEST} levels")

    # -- statements --

    def _block(self, *until: str) -> tuple[Statement, ...]:
        self._deeper(1)
        found: list[Statement] = []
        while True:
            self._skip_lines()
            token = self._next
            if token.kind == "end":
                raise WrongError(token.line, f"`{until[-1]}` is missing")
            if token.kind == "word" and token.text in until:
                self._deeper(-1)
                return tuple(found)
            found += self._statement()

    def _ended_block(self) -> tuple[Statement, ...]:
        block = self._block("end")
        self._expect("end")
        return block

    def _statement(self) -> tuple[Statement, ...]:
        """One; none for `pass`."""
        token = self._next
        if token.kind != "word":
            return (self._assignment(""),)
        word, line = token.text, token.line
        self._at += 1
        if word in ("global", "local"):
            return (self._assignment(cast('OneOf["global", "local"]', word)),)
        if word == "if":
            return (self._if(line),)
        if word == "while":
            condition = self._condition()
            return (While(condition, self._ended_block(), line),)
        if word == "switch":
            return (self._switch(line),)
        if word in ("def", "thread"):
            return (self._define(word == "thread", line),)
        found: Statement
        if word in ("break", "continue", "halt"):
            found = Leave(word, None, line)
        elif word == "return":
            ends = self._next.kind in ("newline", "end")
            found = Leave(word, None if ends else self._expression(), line)
        elif word in ("join", "kill"):
            found = Await(word, self._expression(), line)
        elif word in ("enter_critical", "exit_critical"):
            found = Critical(word == "enter_critical", line)
        elif word == "run":
            found = Do(self._run(line), line)
        elif word == "pass":
            self._end_of_line()
            return ()
        else:
            raise WrongError(line, f"a statement is expected, not {word!r}")
        self._end_of_line()
        return (found,)

    def _assignment(self, scope: OneOf["", "global", "local"]) -> Assign | Do:
        """Or a call of its own."""
        line = self._next.line
        name = self._name()
        found: Assign | Do
        if not scope and self._is("("):
            found = Do(self._call(name, line), line)
        else:
            path: list[tuple[Expression, ...] | str] = []
            while self._is("[", "."):
                if len(path) == LONGEST_CHAIN:
                    raise WrongError(line, f"more than {LONGEST_CHAIN} elements and members")
                if self._taken("."):
                    path.append(self._member())
                else:
                    self._expect("[")
                    path.append(self._indices())
            self._expect("=")
            found = Assign(name, tuple(path), self._expression(), scope, line)
        self._end_of_line()
        return found

    def _condition(self) -> Expression:
        condition = self._expression()
        self._expect(":")
        return condition

    def _if(self, line: int) -> If:
        branches = []
        while True:
            condition = self._condition()
            branches.append((condition, self._block("elif", "else", "end")))
            if not self._taken("elif"):
                break
        otherwise: tuple[Statement, ...] = ()
        if self._taken("else"):
            self._expect(":")
            otherwise = self._block("end")
        self._expect("end")
        return If(tuple(branches), otherwise, line)

    def _switch(self, line: int) -> Switch:
        value = self._condition()
        self._skip_lines()
        cases = []
        while self._taken("case"):
            case = self._condition()
            cases.append((case, self._block("case", "default", "end")))
        otherwise: tuple[Statement, ...] = ()
        if self._taken("default"):
            self._expect(":")
            otherwise = self._block("end")
        self._expect("end")
        return Switch(value, tuple(cases), otherwise, line)

    def _define(self, thread: bool, line: int) -> Define:
        name = self._name()
        self._expect("(")
        parameters: list[tuple[str, Expression | None]] = []
        while not self._taken(")"):
            if parameters:
                self._expect(",")
            self._skip_lines()
            parameter = self._name()
            if parameter in dict(parameters):
                raise WrongError(line, f"{name}() has two parameters {parameter}")
            default = self._expression() if self._taken("=") else None
            if default is None and parameters and parameters[-1][1] is not None:
                raise WrongError(line, f"{parameter} needs a default, as those before it have one")
            parameters.append((parameter, default))
            self._skip_lines()
        self._expect(":")
        return Define(name, tuple(parameters), self._ended_block(), thread, line)

    def _end_of_line(self) -> None:
        """Or a word with which a statement begins, or a block ends: there programs in use have
        no end of the line."""
        token = self._next
        if token.kind not in ("newline", "end") and not self._is(*_NEW_STATEMENT):
            raise WrongError(token.line, f"the line should end before {token.text!r}")

    # -- expressions --

    def _expression(self) -> Expression:
        self._deeper(1)
        found = self._operators(1)
        self._deeper(-1)
        return found

    def _operators(self, least: int) -> Expression:
        """Values, with operators between them that bind at least so closely."""
        self._skip_lines()
        token = self._next
        if token.text == "not" and token.kind == "word" and least <= _NOT:
            self._at += 1
            self._deeper(1)
            found: Expression = Unary("not", self._operators(_NOT), token.line)
            self._deeper(-1)
        else:
            found = self._signed()
        count = 0
        while True:
            sign = self._next
            level = _LEVELS.get(sign.text, 0) if sign.kind in ("sign", "word") else 0
            if level < least:
                return found
            self._at += 1
            count += 1
            if count > LONGEST_CHAIN:
                raise WrongError(sign.line, f"more than {LONGEST_CHAIN} operators in a row")
            found = Binary(sign.text, found, self._operators(level + 1), sign.line)

    def _signed(self) -> Expression:
        self._skip_lines()
        line = self._next.line
        if self._is("-", "+"):
            negative = self._taken("-")
            self._at += not negative
            self._deeper(1)
            found = self._signed()
            self._deeper(-1)
            return Unary("-", found, line) if negative else found
        found, count = self._value(), 0
        while self._is("[", "."):
            count += 1
            if count > LONGEST_CHAIN:
                raise WrongError(line, f"more than {LONGEST_CHAIN} elements and members")
            if self._taken("["):
                found = Element(found, self._indices(), line)
            else:
                self._expect(".")
                found = Member(found, self._member(), line)
        return found

    def _indices(self) -> tuple[Expression, ...]:
        line = self._next.line
        found = self._items("]")
        if len(found) not in (1, 2):
            raise WrongError(line, f"{len(found)} indices; 1 or 2 are possible")
        return found

    def _value(self) -> Expression:
        self._skip_lines()
        token = self._next
        line = token.line
        if self._taken("("):
            inner = self._expression()
            self._close(")")
            return inner
        if self._taken("["):
            return Listed(self._items("]"), line)
        self._at += 1
        if token.kind == "number":
            return _number(token)
        if token.kind == "text":
            return Literal(token.text[1:-1])
        if token.kind == "word" and token.text in ("True", "False"):
            return Literal(token.text == "True")
        if token.kind == "word" and token.text == "run":
            return self._run(line)
        if token.kind == "name":
            if self._is("("):
                return self._call(token.text, line)
            if token.text == "p" and self._is("["):
                return self._pose(line)
            return Name(token.text, line)
        raise WrongError(line, f"a value is expected, not {token.text!r}")

    def _pose(self, line: int) -> Posed | Element:
        """Six are a pose; fewer are indices of a variable that is called `p`."""
        self._expect("[")
        items = self._items("]")
        if len(items) == _POSE:
            return Posed(items, line)
        if len(items) in (1, 2):
            return Element(Name("p", line), items, line)
        raise WrongError(line, f"a pose has {_POSE} numbers, not {len(items)}")

    def _run(self, line: int) -> Run:
        name = self._name()
        return Run(self._call(name, line), line)

    def _items(self, closing: str) -> tuple[Expression, ...]:
        found: list[Expression] = []
        self._skip_lines()
        if self._taken(closing):
            return ()
        while True:
            found.append(self._expression())
            if not self._goes_on(closing):
                return tuple(found)

    def _goes_on(self, closing: str) -> bool:
        """Whether another item follows."""
        at = self._at
        self._skip_lines()
        if self._taken(","):
            return True
        self._at = at
        self._close(closing)
        return False

    def _call(self, name: str, line: int) -> Call:
        self._expect("(")
        values: list[Expression] = []
        named: list[tuple[str, Expression]] = []
        self._skip_lines()
        if self._taken(")"):
            return Call(name, (), (), line)
        while True:
            self._skip_lines()
            token = self._next
            if token.kind == "name" and self._tokens[self._at + 1][:2] == ("sign", "="):
                self._at += 2
                named.append((token.text, self._expression()))
            elif named:
                raise WrongError(
                    token.line, "an argument without a name comes after one with a name"
                )
            else:
                values.append(self._expression())
            if not self._goes_on(")"):
                return Call(name, tuple(values), tuple(named), line)


def _put_out(found: Statement) -> Statement:
    """`digital_out[n] = b`, a command of its own: older than `set_digital_out`, and still sent."""
    if not isinstance(found, Assign) or found.name != "digital_out" or len(found.path) != 1:
        return found
    index = found.path[0]
    if isinstance(index, str) or len(index) != 1:
        return found
    call = Call("set_digital_out", (index[0], found.value), (), found.line)
    return Do(call, found.line)


def _number(token: Token) -> Literal:
    text = token.text
    if text[:2] in ("0x", "0X"):
        whole = int(text, 16)
        if whole > 2 * LARGEST_WHOLE + 1:
            raise WrongError(token.line, "a number is too large")
        return Literal(whole if whole <= LARGEST_WHOLE else whole - 2**32)
    number = float(text)
    if math.isinf(number):
        raise WrongError(token.line, "a number is too large")
    return Literal(int(text) if text.isdigit() and number <= LARGEST_WHOLE else number)
