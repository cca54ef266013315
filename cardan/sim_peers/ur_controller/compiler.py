"""Compiler from a program's syntax tree to code for a machine: each expression and statement
becomes a function of the variables of its function, and a generator only if it may take time.

Global variables are known beforehand: those of the program's own level, however declared, and those
declared `global` anywhere. A function's other variables are local; nested functions see its
functions but not its variables.

Source: UR's script manual, scoping rules.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeAlias

from cardan.protocols.ur.script import LARGEST_WHOLE, pause, tree
from cardan.sim_peers.ur_controller import operators
from cardan.sim_peers.ur_controller.language import (
    CALL_STEPS,
    DEEPEST_CALLS,
    TOO_MUCH_TIME,
    UNSET,
    Function,
    HaltError,
    Joined,
    ProgramError,
    Running,
    Runtime,
)
from cardan.sim_peers.ur_controller.values import UrPose

_Locals: TypeAlias = "list[Any]"
_Do: TypeAlias = "Callable[[_Locals], Any]"

_BREAK: Final = "break"
_CONTINUE: Final = "continue"
_RETURN: Final = "return"
_RESULT: Final = 0
"""Index of a function's result among its variables."""
_QUICK: Final = frozenset("+-*/")
_PLAIN: Final = (float, int)
"""Classes of numbers; booleans have another class."""
_LEAVES: Final = (tree.Literal, tree.Name)
_PORTION: Final = 60
"""Parts of a program between two pauses."""
_WRONG: Final = (ValueError, TypeError, IndexError, KeyError, ArithmeticError)


class _Code(NamedTuple):
    """Compiled expression or statement."""

    do: _Do
    takes_time: bool = False
    """`do` returns a generator."""
    constant: Any = UNSET
    """Constant value of `do`, if it has one."""


@dataclass(eq=False)
class _Scope:
    """Function, or the program itself."""

    define: tree.Define | None
    around: _Scope | None
    block: Sequence[tree.Statement]
    functions: dict[str, _Scope] = field(default_factory=dict)
    own: dict[str, int] = field(default_factory=dict)
    """Indexes of its variables."""
    declared: set[str] = field(default_factory=set)
    """Its parameters and the variables it declares `local`."""
    calls: set[str] = field(default_factory=set)
    """Names of functions."""
    assigns: set[tuple[str, str]] = field(default_factory=set)
    """Variables, each with its kind of declaration."""
    joins: bool = False
    """True if it waits for threads."""
    takes_time: bool = False
    body: _Do | None = None
    defaults: dict[int, _Do] = field(default_factory=dict)

    def find(self, name: str) -> _Scope | None:
        """Find a function by its name."""
        scope: _Scope | None = self
        while scope is not None:
            if name in scope.functions:
                return scope.functions[name]
            scope = scope.around
        return None

    def place(self, name: str) -> int:
        """Return the index of one of its variables."""
        return self.own.setdefault(name, len(self.own) + 1)

    def fresh(self) -> _Locals:
        """Return the variables for a call of it."""
        made: _Locals = [UNSET] * (len(self.own) + 1)
        made[_RESULT] = None
        return made


class Compiler:
    """Compiler of one program, for one machine; in portions."""

    def __init__(
        self, program: tree.Program, functions: Mapping[str, Function], machine: Runtime
    ) -> None:
        self._functions = functions
        self._machine = machine
        self._steps = machine.steps
        self._scopes: list[_Scope] = []
        self._globals: dict[str, int] = {}
        self._loops = 0
        self._weight = 0
        """Steps of the block that is being compiled."""
        self._nodes = 0
        self._constants: dict[tuple[type, object], _Code] = {}
        """Constants: numbers and texts; equal ones are shared."""
        self._program = _Scope(None, None, program.block)

    async def compiled(self) -> tuple[Mapping[str, int], _Locals, _Do]:
        """Return the indexes of the global variables, the program's variables, and the program.
        Raises ProgramError."""
        try:
            await self._survey()
            self._find_globals()
            self._find_what_takes_time()
            for scope in self._scopes:
                await self._compile(scope)
        except RecursionError:
            raise ProgramError(1, "too many levels") from None
        self._machine.globals += [UNSET] * len(self._globals)
        body = self._program.body
        assert body is not None
        return self._globals, self._program.fresh(), body

    # -- scopes of names ------------------------------------------------------------------------

    async def _survey(self) -> None:
        """Find all functions, and the names that each of them assigns, calls and waits for."""
        self._scopes.append(self._program)
        for scope in self._scopes:  # The list grows meanwhile.
            pending: list[Any] = [scope.block]
            while pending:
                await self._portion()
                each = pending.pop()
                kind = each.__class__
                if kind is tree.Define:
                    inner = scope.functions[each.name] = _Scope(each, scope, each.block)
                    self._scopes.append(inner)
                    continue
                if kind is tree.Run:
                    each = each.call
                elif kind is tree.Call:
                    scope.calls.add(each.name)
                elif kind is tree.Assign:
                    scope.assigns.add((each.name, each.scope))
                elif kind is tree.Await:
                    scope.joins = scope.joins or each.how == "join"
                pending += [
                    part
                    for part in each
                    if isinstance(part, tuple) and part.__class__ not in _LEAVES
                ]

    async def _portion(self) -> None:
        self._nodes += 1
        if self._nodes % _PORTION == 0:
            await pause()

    def _find_globals(self) -> None:
        for scope in self._scopes:
            if scope.define is not None:
                scope.declared.update(name for name, _ in scope.define.parameters)
                for name, _ in scope.define.parameters:
                    scope.place(name)
            for name, declared in scope.assigns:
                if scope.define is None or declared == "global":
                    self._globals.setdefault(name, len(self._globals))
                elif declared == "local":
                    scope.declared.add(name)

    def _find_what_takes_time(self) -> None:
        callers: dict[_Scope, list[_Scope]] = {}
        for scope in self._scopes:
            scope.takes_time = scope.joins
            for name in scope.calls:
                found = scope.find(name)
                if found is not None:
                    callers.setdefault(found, []).append(scope)
                elif name in self._functions and self._functions[name].takes_time:
                    scope.takes_time = True
        pending = [scope for scope in self._scopes if scope.takes_time]
        while pending:
            for caller in callers.get(pending.pop(), ()):
                if not caller.takes_time:
                    caller.takes_time = True
                    pending.append(caller)

    async def _compile(self, scope: _Scope) -> None:
        self._loops = 0
        define = scope.define
        if define is not None:
            for name, default in define.parameters:
                if default is not None:
                    code = await self._expression(default, scope)
                    scope.defaults[scope.own[name]] = (
                        _raises(define.line, f"{name}: its default takes time")
                        if code.takes_time
                        else code.do
                    )
        code = await self._block(scope.block, scope)
        # The program itself and threads are resumed, even if they take no time.
        resumed = scope.takes_time or define is None or define.thread
        scope.body = _as_generator(code.do) if resumed and not code.takes_time else code.do

    # -- statements -------------------------------------------------------------------------------

    async def _block(
        self, block: Sequence[tree.Statement], scope: _Scope, weight: int = 1
    ) -> _Code:
        """Compile a sequence of statements; the code returns how it was left, None: at its end.

        `weight`: steps that it costs in addition to its statements.
        """
        parts: list[_Code] = []
        plain: list[_Do] = []
        outer, self._weight = self._weight, weight
        for each in block:
            if isinstance(each, (tree.Define, tree.Critical)):
                continue
            await self._portion()
            self._weight += 1
            code = await self._statement(each, scope)
            if code.takes_time:
                parts += [_Code(self._in_order(plain, self._weight, each.line)), code]
                plain, self._weight = [], 1
            else:
                plain.append(code.do)
        weight, self._weight = self._weight, outer
        line = block[-1].line if block else 1
        if not parts:
            return _Code(self._in_order(plain, weight, line))
        parts.append(_Code(self._in_order(plain, weight, line)))

        def run(own: _Locals) -> Running:
            for part in parts:
                left = (yield from part.do(own)) if part.takes_time else part.do(own)
                if left is not None:
                    return left

        return _Code(run, takes_time=True)

    def _in_order(self, plain: Sequence[_Do], weight: int, line: int) -> _Do:
        steps = self._steps

        def run(own: _Locals) -> Any:
            steps[0] -= weight
            if steps[0] < 0:
                raise ProgramError(line, TOO_MUCH_TIME)
            for each in plain:
                left = each(own)
                if left is not None:
                    return left
            return None

        return run

    def _spend(self, line: int, steps: int) -> None:
        self._steps[0] -= steps
        if self._steps[0] < 0:
            raise ProgramError(line, TOO_MUCH_TIME)

    async def _statement(self, found: tree.Statement, scope: _Scope) -> _Code:
        if isinstance(found, tree.Assign):
            return await self._assign(found, scope)
        if isinstance(found, tree.Do):
            return self._alone(await self._expression(found.call, scope))
        if isinstance(found, tree.If):
            self._weight += len(found.branches) - 1
            return await self._if(found.branches, found.otherwise, scope)
        if isinstance(found, tree.While):
            return await self._while(found, scope)
        if isinstance(found, tree.Switch):
            return await self._switch(found, scope)
        if isinstance(found, tree.Await):
            return await self._await(found, scope)
        assert isinstance(found, tree.Leave)
        return await self._leave(found, scope)

    def _alone(self, code: _Code) -> _Code:
        do = code.do
        if code.takes_time:

            def wait(own: _Locals) -> Running:
                yield from do(own)

            return _Code(wait, takes_time=True)

        def run(own: _Locals) -> None:
            do(own)

        return _Code(run)

    async def _assign(self, found: tree.Assign, scope: _Scope) -> _Code:
        line = found.line
        value = await self._expression(found.value, scope)
        called = found.value.name if isinstance(found.value, tree.Call) else "that"
        put = self._put(found.name, found.scope, scope)
        if found.path:
            steps: list[str | list[_Code]] = []
            for each in found.path:
                if isinstance(each, str):
                    steps.append(each)
                else:
                    steps.append([await self._expression(index, scope) for index in each])
            return await self._assign_inside(found, value, steps, put, scope)

        def given(own: _Locals, result: Any) -> None:
            if result is None:
                raise ProgramError(line, f"{called}() returns no value")
            put(own, result)

        if value.takes_time:

            def wait(own: _Locals) -> Running:
                given(own, (yield from value.do(own)))

            return _Code(wait, takes_time=True)
        do = value.do
        place, values = self._where(found.name, found.scope, scope)
        if values is None:

            def run_own(own: _Locals) -> None:
                result = do(own)
                if result is None:
                    raise ProgramError(line, f"{called}() returns no value")
                own[place] = result

            return _Code(run_own)

        def run(own: _Locals) -> None:
            result = do(own)
            if result is None:
                raise ProgramError(line, f"{called}() returns no value")
            values[place] = result

        return _Code(run)

    async def _assign_inside(
        self,
        found: tree.Assign,
        value: _Code,
        steps: Sequence[str | list[_Code]],
        put: Callable[[_Locals, Any], None],
        scope: _Scope,
    ) -> _Code:
        line, budget = found.line, self._steps
        read = self._name(found.name, line, scope, found.scope)
        codes = [value, *(code for step in steps if isinstance(step, list) for code in step)]

        def change(own: _Locals, given: Sequence[Any]) -> None:
            result, *indices = given
            path: list[Any] = []
            for step in steps:
                if isinstance(step, str):
                    path.append(step)
                else:
                    path += [indices.pop(0) for _ in step]
            if result is None:
                raise ProgramError(line, "there is no value")
            of = read(own)
            if of.__class__ is list:
                budget[0] -= operators.work_of_change(of)
            try:
                put(own, operators.with_element(of, path, result))
            except _WRONG as error:
                raise ProgramError(line, str(error)) from None

        return self._alone(_together(codes, change))

    def _where(self, name: str, declared: str, scope: _Scope) -> tuple[int, _Locals | None]:
        """Return a variable's index and list; None: the list of the function itself."""
        own = name in scope.declared or (scope.define is not None and declared == "local")
        if declared == "global" or (not own and name in self._globals):
            return self._globals[name], self._machine.globals
        return scope.place(name), None

    def _put(self, name: str, declared: str, scope: _Scope) -> Callable[[_Locals, Any], None]:
        place, values = self._where(name, declared, scope)

        def put(own: _Locals, value: Any) -> None:
            (own if values is None else values)[place] = value

        return put

    async def _if(
        self,
        branches: Sequence[tuple[tree.Expression, Sequence[tree.Statement]]],
        otherwise: Sequence[tree.Statement],
        scope: _Scope,
    ) -> _Code:
        made = [
            (await self._condition(condition, scope), await self._block(block, scope))
            for condition, block in branches
        ]
        last = await self._block(otherwise, scope) if otherwise else None
        codes = [code for pair in made for code in pair] + ([last] if last else [])
        if any(code.takes_time for code in codes):

            def wait(own: _Locals) -> Running:
                for condition, block in made:
                    check, do = condition.do, block.do
                    if (yield from check(own)) if condition.takes_time else check(own):
                        return (yield from do(own)) if block.takes_time else do(own)
                if last is None:
                    return None
                return (yield from last.do(own)) if last.takes_time else last.do(own)

            return _Code(wait, takes_time=True)
        pairs = [(condition.do, block.do) for condition, block in made]
        else_do = None if last is None else last.do

        def run(own: _Locals) -> Any:
            for condition, block in pairs:
                if condition(own):
                    return block(own)
            return None if else_do is None else else_do(own)

        return _Code(run)

    async def _while(self, found: tree.While, scope: _Scope) -> _Code:
        before = self._weight
        condition = await self._condition(found.condition, scope)
        self._loops += 1
        block = await self._block(found.block, scope, 1 + self._weight - before)
        self._loops -= 1
        check, do = condition.do, block.do
        if condition.takes_time or block.takes_time:

            def wait(own: _Locals) -> Running:
                while True:
                    holds = (yield from check(own)) if condition.takes_time else check(own)
                    if not holds:
                        return None
                    left = (yield from do(own)) if block.takes_time else do(own)
                    if left is _RETURN:
                        return left
                    if left is _BREAK:
                        return None

            return _Code(wait, takes_time=True)

        def run(own: _Locals) -> Any:
            while check(own):
                left = do(own)
                if left is _RETURN:
                    return left
                if left is _BREAK:
                    return None
            return None

        return _Code(run)

    async def _switch(self, found: tree.Switch, scope: _Scope) -> _Code:
        """Compile as `if` and `elif`, with the value in a variable that no program can name."""
        name = f" switch {id(found)}"
        scope.declared.add(name)
        keep = tree.Assign(name, (), found.value, "", found.line)
        branches = [
            (tree.Binary("==", tree.Name(name, found.line), case, found.line), block)
            for case, block in found.cases
        ]
        first, then = (
            await self._assign(keep, scope),
            await self._if(branches, found.otherwise, scope),
        )
        if not first.takes_time and not then.takes_time:

            def run(own: _Locals) -> Any:
                first.do(own)
                return then.do(own)

            return _Code(run)

        def wait(own: _Locals) -> Running:
            if first.takes_time:
                yield from first.do(own)
            else:
                first.do(own)
            return (yield from then.do(own)) if then.takes_time else then.do(own)

        return _Code(wait, takes_time=True)

    async def _await(self, found: tree.Await, scope: _Scope) -> _Code:
        machine, line = self._machine, found.line
        code = await self._expression(found.thread, scope)
        if code.takes_time:
            return _Code(_raises(line, "a thread is a variable"))
        value = code.do

        def handle(own: _Locals) -> int:
            given = value(own)
            if given.__class__ is not int:
                raise ProgramError(line, f"{found.how}: {operators.text(given)!r} is not a thread")
            return int(given)

        if found.how == "kill":

            def kill(own: _Locals) -> None:
                machine.kill(handle(own))

            return _Code(kill)

        def join(own: _Locals) -> Running:
            wanted = handle(own)
            if machine.lives(wanted):
                machine.line = line
                yield Joined(wanted)

        return _Code(join, takes_time=True)

    async def _leave(self, found: tree.Leave, scope: _Scope) -> _Code:
        if found.how == "halt":

            def halt(own: _Locals) -> None:
                raise HaltError

            return _Code(halt)
        if found.how == "return":
            if found.value is None:
                return _Code(lambda own: _RETURN)

            def give(own: _Locals, values: Sequence[Any]) -> str:
                own[_RESULT] = values[0]
                return _RETURN

            return _together([await self._expression(found.value, scope)], give)
        if not self._loops:
            return _Code(_raises(found.line, f"`{found.how}` outside of `while`"))
        how = _BREAK if found.how == "break" else _CONTINUE
        return _Code(lambda own: how)

    # -- expressions ------------------------------------------------------------------------------

    async def _expression(self, found: tree.Expression, scope: _Scope) -> _Code:
        self._weight += 1
        await self._portion()
        if isinstance(found, tree.Name):
            return _Code(self._name(found.name, found.line, scope))
        if isinstance(found, tree.Literal):
            key = found.value.__class__, found.value
            if key not in self._constants:
                self._constants[key] = _constant(found.value)
            return self._constants[key]
        if isinstance(found, tree.Binary):
            return await self._binary(found, scope)
        if isinstance(found, tree.Unary):
            return await self._unary(found, scope)
        if isinstance(found, tree.Element):
            return await self._element(found, scope)
        if isinstance(found, tree.Call):
            return await self._call(found, scope)
        if isinstance(found, tree.Run):
            return await self._run(found, scope)
        if isinstance(found, tree.Member):
            return await self._member(found, scope)
        line = found.line
        make = operators.pose if isinstance(found, tree.PoseLiteral) else operators.listed

        def made(own: _Locals, values: list[Any]) -> Any:
            if None in values:
                raise ProgramError(line, "a list of expressions without a value")
            try:
                return make(values)
            except _WRONG as error:
                raise ProgramError(line, str(error)) from None

        if all(each.__class__ is tree.Literal for each in found.items):
            self._weight += len(found.items)
            values = [each.value for each in found.items]  # type: ignore[union-attr]
        else:
            codes = [await self._expression(each, scope) for each in found.items]
            values = [code.constant for code in codes]
            if UNSET in values:
                return _together(codes, made)
        try:
            return _constant(make(values))
        except _WRONG as error:
            return _Code(_raises(line, str(error)))

    def _name(self, name: str, line: int, scope: _Scope, declared: str = "") -> _Do:
        place, values = self._where(name, declared, scope)
        if values is None:

            def read_own(own: _Locals) -> Any:
                value = own[place]
                if value is UNSET:
                    raise ProgramError(line, f"{name} has no value")
                return value

            return read_own

        def read(own: _Locals) -> Any:
            value = values[place]
            if value is UNSET:
                raise ProgramError(line, f"{name} has no value")
            return value

        return read

    async def _condition(self, found: tree.Expression, scope: _Scope) -> _Code:
        code = await self._expression(found, scope)
        line = getattr(found, "line", 1)
        do = code.do

        def as_truth(value: Any) -> bool:
            try:
                return operators.truth(value)
            except ValueError as error:
                raise ProgramError(line, str(error)) from None

        if code.takes_time:

            def wait(own: _Locals) -> Running:
                return as_truth((yield from do(own)))

            return _Code(wait, takes_time=True)

        def run(own: _Locals) -> bool:
            value = do(own)
            return value if value is True or value is False else as_truth(value)

        return _Code(run)

    async def _binary(self, found: tree.Binary, scope: _Scope) -> _Code:
        sign, line, spend = found.operator, found.line, self._spend
        if sign in ("and", "or"):
            return await self._both(found, scope)
        value_of = self._condition if sign == "xor" else self._expression
        left, right = await value_of(found.left, scope), await value_of(found.right, scope)
        work = operators.OPERATORS["!=" if sign == "xor" else sign]

        def worked(own: _Locals, values: Sequence[Any]) -> Any:
            if any(each.__class__ is list for each in values):
                spend(line, operators.work_of(sign, *values))
            try:
                return work(*values)
            except _WRONG as error:
                raise ProgramError(line, str(error)) from None

        if left.takes_time or right.takes_time:
            return _together([left, right], worked)
        if left.constant.__class__ in _PLAIN and right.constant.__class__ in _PLAIN:
            with contextlib.suppress(*_WRONG):
                return _constant(work(left.constant, right.constant))
        left_do, right_do = left.do, right.do
        if sign in operators.ORDERS:
            order = operators.ORDERS[sign]

            def compare(own: _Locals) -> Any:
                a, b = left_do(own), right_do(own)
                if a.__class__ in _PLAIN and b.__class__ in _PLAIN:
                    return order(a, b)
                return worked(own, (a, b))

            return _Code(compare)
        if sign not in _QUICK:
            return _Code(lambda own: worked(own, (left_do(own), right_do(own))))
        quick, adds = operators.NUMBERS[sign], sign != "/"

        def run(own: _Locals) -> Any:
            a, b = left_do(own), right_do(own)
            if a.__class__ in _PLAIN and b.__class__ in _PLAIN and (b or adds):
                result = quick(a, b)
                if result.__class__ is float or -LARGEST_WHOLE <= result <= LARGEST_WHOLE:
                    return result
            return worked(own, (a, b))

        return _Code(run)

    async def _both(self, found: tree.Binary, scope: _Scope) -> _Code:
        left, right = (
            await self._condition(found.left, scope),
            await self._condition(found.right, scope),
        )
        enough = found.operator == "or"
        left_do, right_do = left.do, right.do
        if left.takes_time or right.takes_time:

            def wait(own: _Locals) -> Running:
                first = (yield from left_do(own)) if left.takes_time else left_do(own)
                if first is enough:
                    return enough
                return (yield from right_do(own)) if right.takes_time else right_do(own)

            return _Code(wait, takes_time=True)
        if enough:
            return _Code(lambda own: left_do(own) or right_do(own))
        return _Code(lambda own: left_do(own) and right_do(own))

    async def _unary(self, found: tree.Unary, scope: _Scope) -> _Code:
        line = found.line
        if found.operator == "not":
            return _together(
                [await self._condition(found.value, scope)], lambda own, values: not values[0]
            )

        def negative(own: _Locals, values: Sequence[Any]) -> Any:
            value = values[0]
            if value.__class__ is float:
                return -value
            try:
                return operators.negative(value)
            except _WRONG as error:
                raise ProgramError(line, str(error)) from None

        if isinstance(found.value, tree.Literal):
            number = found.value.value
            if isinstance(number, (int, float)) and not isinstance(number, bool):
                self._weight += 1
                return _constant(-number)
        return _together([await self._expression(found.value, scope)], negative)

    async def _element(self, found: tree.Element, scope: _Scope) -> _Code:
        line = found.line
        of = await self._expression(found.of, scope)
        at = [await self._expression(each, scope) for each in found.at]

        def picked(own: _Locals, values: Sequence[Any]) -> Any:
            try:
                return operators.element(*values)
            except _WRONG as error:
                raise ProgramError(line, str(error)) from None

        if of.takes_time or len(at) > 1 or at[0].takes_time:
            return _together([of, *at], picked)
        of_do, at_do = of.do, at[0].do

        def run(own: _Locals) -> Any:
            value, index = of_do(own), at_do(own)
            if value.__class__ is list and index.__class__ is int and 0 <= index < len(value):
                return value[index]
            try:
                return operators.element(value, index)
            except _WRONG as error:
                raise ProgramError(line, str(error)) from None

        return _Code(run)

    async def _member(self, found: tree.Member, scope: _Scope) -> _Code:
        name, line = found.name, found.line

        def picked(own: _Locals, values: Sequence[Any]) -> Any:
            of = values[0]
            if not isinstance(of, operators.Struct) or name not in of:
                raise ProgramError(line, f"there is no member {name}")
            return of[name]

        return _together([await self._expression(found.of, scope)], picked)

    # -- calls ------------------------------------------------------------------------------------

    async def _call(self, call: tree.Call, scope: _Scope) -> _Code:
        target = scope.find(call.name)
        if target is not None:
            return await self._call_own(call, target, scope)
        if call.name == "struct":
            return await self._struct(call, scope)
        function = self._functions.get(call.name)
        if function is None:
            return _Code(_raises(call.line, f"compile_error_name_not_found:{call.name}:"))
        bound = _bound(call, function.parameters, function.defaults)
        if isinstance(bound, str):
            return _Code(_raises(call.line, bound))
        codes = [
            await self._expression(bound[name], scope)
            if name in bound
            else _constant(function.defaults[name])
            for name in function.parameters
        ]
        return self._call_function(call, function, codes)

    def _call_function(self, call: tree.Call, function: Function, codes: list[_Code]) -> _Code:
        name, line, do, steps = call.name, call.line, function.do, function.steps
        spend, machine = self._spend, self._machine

        def called(values: Sequence[Any]) -> Any:
            spend(line, steps)
            try:
                result = do(*values)
            except _WRONG as error:
                raise ProgramError(line, f"{name}(): {error}") from None
            for each in (result, *values):
                if each.__class__ is list:
                    spend(line, operators.elements(each))
            return result

        if function.takes_time:

            def wait(own: _Locals) -> Running:
                values = yield from _values(codes, own)
                machine.line = line
                result = called(values)
                if isinstance(result, tuple) and not isinstance(result, UrPose):
                    result = yield result
                return result

            return _Code(wait, takes_time=True)
        return _together(codes, lambda own, values: called(values))

    async def _call_own(self, call: tree.Call, target: _Scope, scope: _Scope) -> _Code:
        line, machine = call.line, self._machine
        define = target.define
        assert define is not None
        if define.thread:
            return _Code(_raises(line, f"{call.name} is a thread, which is run"))
        bound = await self._arguments(call, target, scope)
        if isinstance(bound, str):
            return _Code(_raises(line, bound))
        places, codes = bound

        def entered(values: Sequence[Any]) -> _Locals:
            stack = machine.stack
            if len(stack) > DEEPEST_CALLS:
                raise ProgramError(line, f"more than {DEEPEST_CALLS} functions call each other")
            made = self._frame(target, places, values, line)
            stack.append(made)
            return made

        if target.takes_time:

            def wait(own: _Locals) -> Running:
                values = yield from _values(codes, own)
                frame = entered(values)
                assert target.body is not None
                yield from target.body(frame)
                machine.stack.pop()
                return frame[_RESULT]

            return _Code(wait, takes_time=True)

        def run(own: _Locals, values: Sequence[Any]) -> Any:
            frame = entered(values)
            target.body(frame)  # type: ignore[misc]  # functions are compiled before they run
            machine.stack.pop()
            return frame[_RESULT]

        return _together(codes, run)

    async def _run(self, found: tree.Run, scope: _Scope) -> _Code:
        self._weight += 1
        call, line, machine, budget = found.call, found.line, self._machine, self._steps
        target = scope.find(call.name)
        if target is None or target.define is None or not target.define.thread:
            return _Code(_raises(line, f"there is no thread {call.name}"))
        bound = await self._arguments(call, target, scope)
        if isinstance(bound, str):
            return _Code(_raises(line, bound))
        places, codes = bound

        def run(own: _Locals, values: Sequence[Any]) -> int:
            budget[0] -= CALL_STEPS
            assert target.body is not None
            try:
                frame = self._frame(target, places, values, line)
                return machine.start(call.name, frame, target.body)
            except ValueError as error:
                raise ProgramError(line, str(error)) from None

        return _together(codes, run)

    def _frame(
        self, target: _Scope, places: Sequence[int], values: Sequence[Any], line: int
    ) -> _Locals:
        made = target.fresh()
        for place, value in zip(places, values, strict=True):
            if value is None:
                raise ProgramError(line, "an argument has no value")
            made[place] = value
        for place, default in target.defaults.items():
            if made[place] is UNSET:
                made[place] = default(made)
        return made

    async def _arguments(
        self, call: tree.Call, target: _Scope, scope: _Scope
    ) -> tuple[list[int], list[_Code]] | str:
        define = target.define
        assert define is not None
        parameters = tuple(name for name, _ in define.parameters)
        defaults = {name: value for name, value in define.parameters if value is not None}
        bound = _bound(call, parameters, defaults)
        if isinstance(bound, str):
            return bound
        places = [target.own[name] for name in bound]
        return places, [await self._expression(each, scope) for each in bound.values()]

    async def _struct(self, call: tree.Call, scope: _Scope) -> _Code:
        line = call.line
        names = [name for name, _ in call.named]
        if call.arguments or len(set(names)) != len(names):
            return _Code(_raises(line, "a struct has members with names of their own"))

        def made(own: _Locals, values: Sequence[Any]) -> Any:
            if None in values:
                raise ProgramError(line, "a member has no value")
            try:
                return operators.struct(dict(zip(names, values, strict=True)))
            except _WRONG as error:
                raise ProgramError(line, str(error)) from None

        return _together([await self._expression(value, scope) for _, value in call.named], made)


def _constant(value: Any) -> _Code:
    return _Code(lambda own: value, constant=value)


def _raises(line: int, reason: str) -> _Do:
    def raises(own: _Locals) -> Any:
        raise ProgramError(line, reason)

    return raises


def _as_generator(do: _Do) -> _Do:
    def run(own: _Locals) -> Running:
        return do(own)
        yield  # A generator that never waits.

    return run


def _values(codes: Sequence[_Code], own: _Locals) -> Generator[Any, Any, list[Any]]:
    found = []
    for code in codes:
        value = (yield from code.do(own)) if code.takes_time else code.do(own)
        found.append(value)
    return found


def _together(codes: Sequence[_Code], work: Callable[[_Locals, list[Any]], Any]) -> _Code:
    """Apply `work` to the values of expressions, evaluated in this order."""
    if any(code.takes_time for code in codes):

        def wait(own: _Locals) -> Running:
            return work(own, (yield from _values(codes, own)))

        return _Code(wait, takes_time=True)
    plain = [code.do for code in codes]
    if len(plain) == 1:
        (only,) = plain
        return _Code(lambda own: work(own, [only(own)]))
    return _Code(lambda own: work(own, [do(own) for do in plain]))


def _bound(
    call: tree.Call, parameters: Sequence[str], defaults: Mapping[str, Any]
) -> dict[str, tree.Expression] | str:
    """Return the arguments by their parameters, or the error in them."""
    if len(call.arguments) > len(parameters):
        return f"{call.name}() has {len(parameters)} arguments"
    bound = dict(zip(parameters, call.arguments, strict=False))
    for name, value in call.named:
        if name not in parameters:
            return f"{call.name}() has no argument {name}"
        if name in bound:
            return f"{call.name}(): {name} is given twice"
        bound[name] = value
    for name in parameters:
        if name not in bound and name not in defaults:
            return f"{call.name}(): {name} is missing"
    return bound
