"""Runs a URScript program, statement by statement, in the controller's own time.

A statement takes no time unless it calls a function that does: such a call gives an `Action`, which
the controller does, frame by frame, before it lets the program go on.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from cardan.protocols.ur import script as ur
from cardan.sim_peers.ur_controller.actions import Action

MOST_STATEMENTS: Final = 5_000
"""In one frame; a controller whose program takes more time loses its schedule."""


class ProgramError(Exception):
    """The program cannot go on."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(f"line {line}: {reason}")
        self.line, self.reason = line, reason


class Function(NamedTuple):
    """A function of the controller."""

    parameters: tuple[str, ...]
    defaults: Mapping[str, Any]
    do: Callable[..., Any]
    """Gives a value; a ValueError says why it cannot."""
    takes_time: bool = False
    """`do` gives an `Action`."""


_BINARY: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": math.fmod,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


class _HaltError(Exception):
    pass


class _BreakError(Exception):
    pass


class _ContinueError(Exception):
    pass


class Interpreter:
    """One run of a program."""

    def __init__(self, program: ur.Program, functions: Mapping[str, Function]) -> None:
        self.name = program.name
        self.variables: dict[str, Any] = {}
        self._functions = functions
        self.line = 0
        """Of the statement that lets time pass."""
        self._statements = 0
        self._run = self._whole(program.block)

    def go_on(self) -> Action | None:
        """Run until time has to pass; None: the program has ended. Raises ProgramError."""
        self._statements = 0
        return next(self._run, None)

    def _whole(self, block: Sequence[ur.Statement]) -> Generator[Action, None, None]:
        try:
            yield from self._block(block)
        except _HaltError:
            return
        except (_BreakError, _ContinueError):
            raise ProgramError(1, "`break` or `continue` outside of `while`") from None

    def _block(self, block: Sequence[ur.Statement]) -> Generator[Action, None, None]:
        for statement in block:
            self._statements += 1
            if self._statements > MOST_STATEMENTS:
                raise ProgramError(
                    statement.line, "the program runs on without letting time pass: call sync()"
                )
            if isinstance(statement, ur.Assign):
                self._assign(statement)
            elif isinstance(statement, ur.Do):
                action = self._called(statement.call, True)
                if isinstance(action, Action):
                    self.line = statement.line
                    yield action
            elif isinstance(statement, ur.If):
                yield from self._if(statement)
            elif isinstance(statement, ur.While):
                yield from self._while(statement)
            elif statement.how == "break":
                raise _BreakError
            elif statement.how == "continue":
                raise _ContinueError
            else:
                raise _HaltError

    def _if(self, statement: ur.If) -> Generator[Action, None, None]:
        for condition, block in statement.branches:
            if self._truth(condition, statement.line):
                yield from self._block(block)
                return
        yield from self._block(statement.otherwise)

    def _while(self, statement: ur.While) -> Generator[Action, None, None]:
        while self._truth(statement.condition, statement.line):
            self._statements += 1
            if self._statements > MOST_STATEMENTS:
                raise ProgramError(
                    statement.line, "the program runs on without letting time pass: call sync()"
                )
            try:
                yield from self._block(statement.block)
            except _BreakError:
                return
            except _ContinueError:
                continue

    def _assign(self, statement: ur.Assign) -> None:
        value = self._value(statement.value)
        if statement.at is None:
            # Lists are values: a copy does not change with what it was copied from.
            self.variables[statement.name] = list(value) if isinstance(value, list) else value
            return
        of = self._variable(statement.name, statement.line)
        of[self._index(of, statement.at, statement.line)] = value

    # -- values -----------------------------------------------------------------------------------

    def _value(self, expression: ur.Expression) -> Any:
        if isinstance(expression, ur.Name):
            return self._variable(expression.name, expression.line)
        if isinstance(expression, ur.Literal):
            return expression.value
        if isinstance(expression, ur.Element):
            of = self._value(expression.of)
            return of[self._index(of, expression.at, expression.line)]
        if isinstance(expression, ur.Binary):
            return self._binary(expression)
        if isinstance(expression, ur.Call):
            return self._called(expression, False)
        if isinstance(expression, ur.Listed):
            return [self._value(each) for each in expression.items]
        if expression.operator == "not":
            return not self._truth(expression.value, expression.line)
        return -self._number(expression.value, expression.line)

    def _binary(self, found: ur.Binary) -> Any:
        sign, line = found.operator, found.line
        if sign == "and":
            return self._truth(found.left, line) and self._truth(found.right, line)
        if sign == "or":
            return self._truth(found.left, line) or self._truth(found.right, line)
        if sign in ("==", "!="):
            same = self._value(found.left) == self._value(found.right)
            return same if sign == "==" else not same
        try:
            value = _BINARY[sign](self._number(found.left, line), self._number(found.right, line))
        except (ArithmeticError, ValueError) as error:
            raise ProgramError(line, str(error)) from None
        if isinstance(value, int) and abs(value) > ur.LARGEST_WHOLE:
            raise ProgramError(line, "a whole number has more than 32 bits")
        return value

    def _variable(self, name: str, line: int) -> Any:
        if name not in self.variables:
            raise ProgramError(line, f"{name} has no value")
        return self.variables[name]

    def _truth(self, expression: ur.Expression, line: int) -> bool:
        value = self._value(expression)
        if not isinstance(value, bool):
            raise ProgramError(line, f"{value!r} is neither True nor False")
        return value

    def _number(self, expression: ur.Expression, line: int) -> float:
        value = self._value(expression)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ProgramError(line, f"{value!r} is not a number")
        return value

    def _index(self, of: Any, index: ur.Expression, line: int) -> int:
        at = self._value(index)
        if not isinstance(of, list):
            raise ProgramError(line, f"{of!r} is not a list")
        if isinstance(at, bool) or not isinstance(at, int) or not 0 <= at < len(of):
            raise ProgramError(line, f"a list of {len(of)} has no element {at!r}")
        return at

    def _called(self, call: ur.Call, alone: bool) -> Any:
        function = self._functions.get(call.name)
        if function is None:
            raise ProgramError(call.line, f"{call.name}() is not supported")
        if function.takes_time and not alone:
            raise ProgramError(call.line, f"{call.name}() gives no value")
        given = dict(function.defaults)
        if len(call.arguments) > len(function.parameters):
            raise ProgramError(call.line, f"{call.name}() has {len(function.parameters)} arguments")
        for name, value in zip(function.parameters, call.arguments, strict=False):
            given[name] = self._value(value)
        for name, value in call.named:
            if name not in function.parameters:
                raise ProgramError(call.line, f"{call.name}() has no argument {name}")
            given[name] = self._value(value)
        missing = [name for name in function.parameters if name not in given]
        if missing:
            raise ProgramError(call.line, f"{call.name}(): {missing[0]} is missing")
        try:
            return function.do(*(given[name] for name in function.parameters))
        except (ValueError, TypeError, IndexError, OverflowError) as error:
            raise ProgramError(call.line, f"{call.name}(): {error}") from None
