"""Parser of URScript tokens to a syntax tree."""

from __future__ import annotations

import math
from typing import Final, Literal as OneOf, cast

from cardan.protocols.ur.script.lexer import (
    LARGEST,
    LARGEST_WHOLE,
    WORDS,
    Token,
    TokenList,
    WrongError,
    words,
)
from cardan.protocols.ur.script.portions import pause, whole
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
    ParseFailure,
    PoseLiteral,
    Program,
    Run,
    Statement,
    Switch,
    Unary,
    While,
)

DEEPEST: Final = 50
"""Most levels of brackets and blocks."""
MOST_PARAMETERS: Final = 100
"""Most parameters of a function."""
LONGEST_CHAIN: Final = 100
"""Most consecutive operators without brackets."""
_UNNAMED: Final = "unnamed"
"""Name of a program for a single command."""
_POSE: Final = 6
_LINE_ENDS: Final = WORDS.union(("newline", "")) - {
    *("and", "not", "or", "xor"),
    *("True", "False", "def", "sec"),
}
_PORTION: Final = 150
"""Tokens between two pauses."""
_NOT: Final = 4
_LEVELS: Final = {
    "or": 1,
    "xor": 2,
    "and": 3,
    **dict.fromkeys(("==", "!=", "<", "<=", ">", ">="), 5),
    **dict.fromkeys(("+", "-"), 6),
    **dict.fromkeys(("*", "/", "%"), 7),
}
"""Precedence of operators; `not`: 4."""
_SIMPLE: Final = frozenset(("number", "text", "name"))
_GOES_ON: Final = frozenset((*_LEVELS, "[", ".", "("))
"""Tokens that continue the preceding value."""


def parse(text: str) -> Program | ParseFailure:
    """Parse the program in `text`, or return why it is refused; a command is a one-line program."""
    return whole(parsed(text))


async def parsed(text: str) -> Program | ParseFailure:
    """Parse like `parse`, in portions."""
    if len(text) > LARGEST:
        return ParseFailure(1, f"the program has {len(text)} characters; {LARGEST} are the most")
    try:
        return await _Parser(await words(text)).program()
    except WrongError as wrong:
        return ParseFailure(wrong.line, wrong.reason)


class _Parser:
    def __init__(self, found: TokenList) -> None:
        self._tokens = found
        self._kinds = found.kinds
        self._literals: dict[str, Literal] = {}
        self._at = 0
        self._depth = 0
        self._pause_at = _PORTION

    async def _portion(self) -> None:
        self._pause_at = self._at + _PORTION
        await pause()

    async def program(self) -> Program:
        self._skip_lines()
        secondary = self._taken("sec")
        if secondary or self._taken("def"):
            name = self._name()
            for sign in ("(", ")", ":"):
                self._expect(sign)
            made = Program(name, await self._ended_block(), secondary)
        else:
            made = Program(_UNNAMED, tuple(map(_put_out, await self._statement())))
        self._skip_lines()
        token = self._next
        if token.kind:
            raise WrongError(token.line, f"{token.text!r} comes after the end of the program")
        return made

    # -- tokens --

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    @property
    def _line(self) -> int:
        return self._tokens.lines[self._at]

    def _is(self, *texts: str) -> bool:
        return self._kinds[self._at] in texts

    def _taken(self, text: str) -> bool:
        if self._kinds[self._at] != text:
            return False
        self._at += 1
        return True

    def _expect(self, text: str) -> None:
        if not self._taken(text):
            token = self._next
            raise WrongError(token.line, f"`{text}` is expected, not {token.text!r}")

    def _close(self, sign: str) -> None:
        """Parse closing brackets, which may be on another line."""
        line = self._line
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
        """Parse a member's name, which may be a keyword: `time().sec`."""
        if self._next.kind in WORDS:
            self._at += 1
            return self._tokens[self._at - 1].text
        return self._name()

    def _skip_lines(self) -> None:
        kinds = self._kinds
        while kinds[self._at] == "newline":
            self._at += 1

    def _deeper(self, by: int) -> None:
        self._depth += by
        if by > 0 and self._depth > DEEPEST:
            raise WrongError(self._next.line, f"more than {DEEPEST} levels")

    # -- statements --

    async def _block(self, *until: str) -> tuple[Statement, ...]:
        self._deeper(1)
        found: list[Statement] = []
        while True:
            self._skip_lines()
            if self._at >= self._pause_at:
                await self._portion()
            kind = self._kinds[self._at]
            if not kind:
                raise WrongError(self._line, f"`{until[-1]}` is missing")
            if kind in until:
                self._deeper(-1)
                return tuple(found)
            found += await self._statement()

    async def _ended_block(self) -> tuple[Statement, ...]:
        block = await self._block("end")
        self._expect("end")
        return block

    async def _statement(self) -> tuple[Statement, ...]:
        """Parse a statement; empty for `pass`."""
        word, line = self._kinds[self._at], self._line
        if word not in WORDS:
            return (await self._assignment(""),)
        self._at += 1
        if word in ("global", "local"):
            return (await self._assignment(cast('OneOf["global", "local"]', word)),)
        if word == "if":
            return (await self._if(line),)
        if word == "while":
            condition = await self._condition()
            return (While(condition, await self._ended_block(), line),)
        if word == "switch":
            return (await self._switch(line),)
        if word in ("def", "thread"):
            return (await self._define(word == "thread", line),)
        found: Statement
        if word in ("break", "continue", "halt"):
            found = Leave(word, None, line)
        elif word == "return":
            ends = self._next.kind in ("newline", "")
            found = Leave(word, None if ends else await self._expression(), line)
        elif word in ("join", "kill"):
            found = Await(word, await self._expression(), line)
        elif word in ("enter_critical", "exit_critical"):
            found = Critical(word == "enter_critical", line)
        elif word == "run":
            found = Do(await self._run(line), line)
        elif word == "pass":
            self._end_of_line()
            return ()
        else:
            raise WrongError(line, f"a statement is expected, not {word!r}")
        self._end_of_line()
        return (found,)

    async def _assignment(self, scope: OneOf["", "global", "local"]) -> Assign | Do:
        """Parse an assignment, or a call as a statement."""
        line = self._line
        name = self._name()
        found: Assign | Do
        if not scope and self._is("("):
            found = Do(await self._call(name, line), line)
        else:
            path: list[tuple[Expression, ...] | str] = []
            while self._is("[", "."):
                if len(path) == LONGEST_CHAIN:
                    raise WrongError(line, f"more than {LONGEST_CHAIN} elements and members")
                if self._taken("."):
                    path.append(self._member())
                else:
                    self._expect("[")
                    path.append(await self._indices())
            self._expect("=")
            found = Assign(name, tuple(path), await self._expression(), scope, line)
        self._end_of_line()
        return found

    async def _condition(self) -> Expression:
        condition = await self._expression()
        self._expect(":")
        return condition

    async def _if(self, line: int) -> If:
        branches = []
        while True:
            condition = await self._condition()
            branches.append((condition, await self._block("elif", "else", "end")))
            if not self._taken("elif"):
                break
        otherwise: tuple[Statement, ...] = ()
        if self._taken("else"):
            self._expect(":")
            otherwise = await self._block("end")
        self._expect("end")
        return If(tuple(branches), otherwise, line)

    async def _switch(self, line: int) -> Switch:
        value = await self._condition()
        self._skip_lines()
        cases = []
        while self._taken("case"):
            case = await self._condition()
            cases.append((case, await self._block("case", "default", "end")))
        otherwise: tuple[Statement, ...] = ()
        if self._taken("default"):
            self._expect(":")
            otherwise = await self._block("end")
        self._expect("end")
        return Switch(value, tuple(cases), otherwise, line)

    async def _define(self, thread: bool, line: int) -> Define:
        name = self._name()
        self._expect("(")
        parameters: list[tuple[str, Expression | None]] = []
        while not self._taken(")"):
            if len(parameters) == MOST_PARAMETERS:
                raise WrongError(line, f"{name}() has more than {MOST_PARAMETERS} parameters")
            if parameters:
                self._expect(",")
            self._skip_lines()
            parameter = self._name()
            if parameter in dict(parameters):
                raise WrongError(line, f"{name}() has two parameters {parameter}")
            default = await self._expression() if self._taken("=") else None
            if default is None and parameters and parameters[-1][1] is not None:
                raise WrongError(line, f"{parameter} needs a default, as those before it have one")
            parameters.append((parameter, default))
            self._skip_lines()
        self._expect(":")
        return Define(name, tuple(parameters), await self._ended_block(), thread, line)

    def _end_of_line(self) -> None:
        """Accept the end of a line, or a keyword that begins a statement or ends a block: existing
        programs have no line end there."""
        if self._kinds[self._at] not in _LINE_ENDS:
            token = self._next
            raise WrongError(token.line, f"the line should end before {token.text!r}")

    # -- expressions --

    async def _expression(self) -> Expression:
        if (simple := self._simple()) is not None:
            return simple
        if self._at >= self._pause_at:
            await self._portion()
        self._deeper(1)
        found = await self._operators(1)
        self._deeper(-1)
        return found

    def _simple(self) -> Expression | None:
        """Parse a number, a text or a variable without any suffix, the usual case."""
        kinds, at = self._kinds, self._at
        kind = kinds[at]
        if kind not in _SIMPLE or kinds[at + 1] in _GOES_ON:
            return None
        self._at = at + 1
        if kind == "name":
            return Name(self._tokens.texts[at], self._tokens.lines[at])
        return self._literal(at)

    def _literal(self, at: int) -> Literal:
        """Return a number or a text, one object for all of the same spelling."""
        found = self._literals.get(self._tokens.texts[at])
        if found is None:
            token = self._tokens[at]
            found = _number(token) if token.kind == "number" else Literal(token.text[1:-1])
            self._literals[token.text] = found
        return found

    async def _operators(self, least: int) -> Expression:
        """Parse values with operators between them of at least this precedence."""
        self._skip_lines()
        if self._kinds[self._at] == "not" and least <= _NOT:
            line = self._line
            self._at += 1
            self._deeper(1)
            found: Expression = Unary("not", await self._operators(_NOT), line)
            self._deeper(-1)
        else:
            found = self._simple() or await self._signed()
        count = 0
        while True:
            sign, line = self._kinds[self._at], self._line
            level = _LEVELS.get(sign, 0)
            if level < least:
                return found
            self._at += 1
            count += 1
            if count > LONGEST_CHAIN:
                raise WrongError(line, f"more than {LONGEST_CHAIN} operators in a row")
            found = Binary(sign, found, await self._operators(level + 1), line)

    async def _signed(self) -> Expression:
        self._skip_lines()
        line = self._line
        if self._is("-", "+"):
            negative = self._taken("-")
            self._at += not negative
            self._deeper(1)
            found = self._simple() or await self._signed()
            self._deeper(-1)
            return Unary("-", found, line) if negative else found
        found, count = await self._value(), 0
        while self._is("[", "."):
            count += 1
            if count > LONGEST_CHAIN:
                raise WrongError(line, f"more than {LONGEST_CHAIN} elements and members")
            if self._taken("["):
                found = Element(found, await self._indices(), line)
            else:
                self._expect(".")
                found = Member(found, self._member(), line)
        return found

    async def _indices(self) -> tuple[Expression, ...]:
        line = self._next.line
        found = await self._items("]")
        if len(found) not in (1, 2):
            raise WrongError(line, f"{len(found)} indices; 1 or 2 are possible")
        return found

    async def _value(self) -> Expression:
        self._skip_lines()
        token = self._next
        line = token.line
        if self._taken("("):
            inner = await self._expression()
            self._close(")")
            return inner
        if self._taken("["):
            return Listed(await self._items("]"), line)
        self._at += 1
        if token.kind in ("number", "text"):
            return self._literal(self._at - 1)
        if token.kind in ("True", "False"):
            return Literal(token.kind == "True")
        if token.kind == "run":
            return await self._run(line)
        if token.kind == "name":
            if self._is("("):
                return await self._call(token.text, line)
            if token.text == "p" and self._is("["):
                return await self._pose(line)
            return Name(token.text, line)
        raise WrongError(line, f"a value is expected, not {token.text!r}")

    async def _pose(self, line: int) -> PoseLiteral | Element:
        """Parse `p[...]`: six items are a pose; fewer are indices of a variable named `p`."""
        self._expect("[")
        items = await self._items("]")
        if len(items) == _POSE:
            return PoseLiteral(items, line)
        if len(items) in (1, 2):
            return Element(Name("p", line), items, line)
        raise WrongError(line, f"a pose has {_POSE} numbers, not {len(items)}")

    async def _run(self, line: int) -> Run:
        name = self._name()
        return Run(await self._call(name, line), line)

    async def _items(self, closing: str) -> tuple[Expression, ...]:
        found: list[Expression] = []
        self._skip_lines()
        if self._taken(closing):
            return ()
        while True:
            if self._at >= self._pause_at:
                await self._portion()
            found.append(self._simple() or await self._expression())
            if not self._goes_on(closing):
                return tuple(found)

    def _goes_on(self, closing: str) -> bool:
        """Return True if another item follows."""
        at = self._at
        self._skip_lines()
        if self._taken(","):
            self._skip_lines()
            return True
        self._at = at
        self._close(closing)
        return False

    async def _call(self, name: str, line: int) -> Call:
        self._expect("(")
        values: list[Expression] = []
        named: list[tuple[str, Expression]] = []
        self._skip_lines()
        if self._taken(")"):
            return Call(name, (), (), line)
        while True:
            if self._at >= self._pause_at:
                await self._portion()
            at = self._at
            if self._kinds[at] == "name" and self._kinds[at + 1] == "=":
                self._at += 2
                named.append((self._tokens.texts[at], await self._expression()))
            elif named:
                raise WrongError(
                    self._line, "an argument without a name comes after one with a name"
                )
            else:
                values.append(self._simple() or await self._expression())
            if not self._goes_on(")"):
                return Call(name, tuple(values), tuple(named), line)


def _put_out(found: Statement) -> Statement:
    """Parse `digital_out[n] = b`, a command that is older than `set_digital_out` and still in
    use."""
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
