"""Syntax tree of a URScript program. Lines are counted from 1."""

from __future__ import annotations

from typing import Literal as OneOf, NamedTuple


class ParseFailure(NamedTuple):
    """A part of a program that is not understood."""

    line: int
    reason: str


# -- expressions -----------------------------------------------------------------------------------


class Literal(NamedTuple):
    """A number, text or boolean."""

    value: float | int | bool | str


class Name(NamedTuple):
    """A variable."""

    name: str
    line: int


class Listed(NamedTuple):
    """A list."""

    items: tuple[Expression, ...]
    line: int


class PoseLiteral(NamedTuple):
    """A pose, `p[x, y, z, rx, ry, rz]`."""

    items: tuple[Expression, ...]
    line: int


class Element(NamedTuple):
    """An element of a list, a pose or a text; with two indices, one of a matrix."""

    of: Expression
    at: tuple[Expression, ...]
    line: int


class Member(NamedTuple):
    """A member of a struct."""

    of: Expression
    name: str
    line: int


class Call(NamedTuple):
    """A function call with its arguments; named ones have their names."""

    name: str
    arguments: tuple[Expression, ...]
    named: tuple[tuple[str, Expression], ...]
    line: int


class Run(NamedTuple):
    """Start of a thread; the value is the thread's handle."""

    call: Call
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


Expression = Literal | Name | Listed | PoseLiteral | Element | Member | Call | Run | Unary | Binary


# -- statements ------------------------------------------------------------------------------------


class Assign(NamedTuple):
    """Assignment to a variable, or to the part of it at a path of indices and members."""

    name: str
    path: tuple[tuple[Expression, ...] | str, ...]
    """Path from the variable to the assigned part: indices, or a member's name."""
    value: Expression
    scope: OneOf["", "global", "local"]
    line: int


class Do(NamedTuple):
    """A call as a statement."""

    call: Call | Run
    line: int


class If(NamedTuple):
    """Conditions with their blocks, in order, and the block of `else`."""

    branches: tuple[tuple[Expression, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]
    line: int


class While(NamedTuple):
    """A block repeated while a condition holds."""

    condition: Expression
    block: tuple[Statement, ...]
    line: int


class Switch(NamedTuple):
    """The block of the first case that equals a value, or of `default`."""

    value: Expression
    cases: tuple[tuple[Expression, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]
    line: int


class Leave(NamedTuple):
    """`break`, `continue`, `return` or `halt`."""

    how: str
    value: Expression | None
    """Value that `return` gives."""
    line: int


class Await(NamedTuple):
    """`join` or `kill` a thread."""

    how: str
    thread: Expression
    line: int


class Critical(NamedTuple):
    """`enter_critical` or `exit_critical`."""

    enter: bool
    line: int


class Define(NamedTuple):
    """A function, or a thread, inside the program."""

    name: str
    parameters: tuple[tuple[str, Expression | None], ...]
    """Parameters with their defaults."""
    block: tuple[Statement, ...]
    thread: bool
    line: int


Statement = Assign | Do | If | While | Switch | Leave | Await | Critical | Define


class Program(NamedTuple):
    """A parsed program."""

    name: str
    block: tuple[Statement, ...]
    secondary: bool = False
    """True: a secondary program, which runs beside another one and takes no time (`sec`)."""
