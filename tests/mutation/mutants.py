"""Mutants of a source file: small changes that some test should detect."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]

OPERATORS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.BitXor: (ast.BitAnd,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.USub: (ast.UAdd,),
}
"""Replacements of each operator: moved border of a comparison, or reversed sense."""

NAMES = {"min": "max", "max": "min", "any": "all", "all": "any"}

SYMMETRIC = frozenset({"min", "max", "suppress", "compare_digest", "hypot", "dist", "dot"})
"""Functions with interchangeable arguments, like `add` of vectors, which is no method."""

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


class Mutant(NamedTuple):
    """Change of a file."""

    path: str
    """Relative to the repository."""
    line: int
    function: str
    """Qualified name; empty: outside functions, where it acts when the module is imported."""
    change: str
    """The statement before and after: "if a < b -> if a <= b"."""
    statement: int
    """Index of its statement in `ast.walk`."""
    node: int
    """Index of the changed node in `ast.walk`."""
    variant: int

    @property
    def name(self) -> str:
        """Identify it in the list of equivalent mutants; independent of line numbers."""
        return f"{self.path}::{self.function}: {self.change}"


def variants(node: ast.AST) -> Iterator[ast.AST]:
    """Yield `node` with each possible change."""

    def changed(**fields: object) -> ast.AST:
        new = copy.copy(node)
        for name, value in fields.items():
            setattr(new, name, value)
        return new

    if isinstance(node, ast.Compare):
        for index, operator in enumerate(node.ops):
            for other in OPERATORS[type(operator)]:
                yield changed(ops=[*node.ops[:index], other(), *node.ops[index + 1 :]])
    elif isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp, ast.UnaryOp)):
        for other in OPERATORS.get(type(node.op), ()):
            yield changed(op=other())
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield changed(operand=ast.UnaryOp(ast.Not(), node.operand))
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            yield changed(value=not node.value)
        elif isinstance(node.value, int):
            yield changed(value=node.value + 1)
        elif isinstance(node.value, float):
            yield changed(value=node.value * 2.0 if node.value * 2.0 != node.value else 1.0)
    elif isinstance(node, (ast.If, ast.IfExp)):
        yield changed(test=ast.Constant(False))
        if isinstance(node, ast.IfExp):
            yield changed(test=ast.Constant(True))
    elif isinstance(node, ast.match_case):
        yield changed(guard=ast.Constant(False))
        if node.guard is not None:
            yield changed(guard=ast.Constant(True))
    elif isinstance(node, ast.MatchOr):
        for index in range(len(node.patterns)):  # removes a pattern by repeating another
            other = node.patterns[index - 1]
            yield changed(patterns=[*node.patterns[:index], other, *node.patterns[index + 1 :]])
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield changed(value=ast.Constant(None))
    elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute):
        yield changed(targets=[ast.Name("_left_out", ast.Store())])
    elif isinstance(node, ast.Call):
        args = node.args
        called = ast.unparse(node.func).rpartition(".")[2]
        starred = any(isinstance(each, ast.Starred) for each in args[:2])
        same = len(args) > 1 and ast.dump(args[0]) == ast.dump(args[1])
        symmetric = called in SYMMETRIC or ast.unparse(node.func) == "add"
        if len(args) > 1 and not (starred or same or symmetric):
            yield changed(args=[args[1], args[0], *args[2:]])
        if isinstance(node.func, ast.Name) and node.func.id in NAMES:
            yield changed(func=ast.Name(NAMES[node.func.id], ast.Load()))


def header(statement: ast.stmt) -> str:
    """Return a statement in one line, without nested statements."""
    if isinstance(statement, (ast.If, ast.While)):
        return f"{type(statement).__name__.lower()} {ast.unparse(statement.test)}"
    if isinstance(statement, FUNCTIONS):
        return f"def {statement.name}({ast.unparse(statement.args)})"
    return ast.unparse(statement).partition("\n")[0]


def shown(node: ast.AST) -> str:
    """Return the text of an expression; of a case without its body."""
    text = ast.unparse(node).strip()
    return text.partition("\n")[0] if isinstance(node, ast.match_case) else text


def without_effect(node: ast.AST, field: str) -> bool:
    """Return whether a change of `field` cannot change results: texts of errors and logs,
    annotations, decorators and `strict` of zip()."""
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return True
    if isinstance(node, ast.Raise) or field in ("annotation", "returns", "decorator_list"):
        return True
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return True
    return isinstance(node, ast.Expr) and ast.unparse(node).startswith("_log.")


def mutants_of(path: str) -> list[Mutant]:
    """Return all mutants of the file at `path`, relative to the repository."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    index = {id(node): number for number, node in enumerate(ast.walk(tree))}
    found: list[Mutant] = []

    def visit(node: ast.AST, statement: ast.stmt | None, scope: str, function: str) -> None:
        if isinstance(node, ast.stmt):
            statement = node
        if statement is not None and not without_effect(node, ""):
            for number, new in enumerate(variants(node)):
                before = header(statement)
                saved = dict(vars(node))
                vars(node).update(vars(new))
                after = header(statement)
                vars(node).update(saved)
                if after == before:  # the change is inside a nested block
                    before, after = shown(node), shown(new)
                change = f"{before} -> {after}"
                where = index[id(statement)], index[id(node)]
                placed = node.pattern if isinstance(node, ast.match_case) else node
                line = getattr(placed, "lineno", statement.lineno)
                found.append(Mutant(path, line, function, change, *where, number))
        inside = scope
        if isinstance(node, (*FUNCTIONS, ast.ClassDef)):
            inside = f"{scope}.{node.name}" if scope else node.name
        for field, value in ast.iter_fields(node):
            # Only code in a function's body runs at its call.
            body = isinstance(node, FUNCTIONS) and field == "body"
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and not without_effect(node, field):
                    visit(child, statement, inside, inside if body else function)

    visit(tree, None, "", "")
    return found


def mutated(mutant: Mutant) -> ast.Module:
    """Return the file's syntax tree with the change."""
    tree = ast.parse((ROOT / mutant.path).read_text(encoding="utf-8"))
    node = list(ast.walk(tree))[mutant.node]
    new = list(variants(node))[mutant.variant]
    vars(node).update(vars(new))
    return ast.fix_missing_locations(tree)


def instrumented(path: str) -> ast.Module:
    """Return the file's syntax tree with a call of `_mutant_hit(path, index)` before each statement
    of each function."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    index = {id(node): number for number, node in enumerate(ast.walk(tree))}

    def reported(statements: list[ast.stmt], documented: bool) -> list[ast.stmt]:
        new: list[ast.stmt] = []
        for number, each in enumerate(statements):
            is_words = isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
            if not (documented and number == 0 and is_words):
                args: list[ast.expr] = [ast.Constant(path), ast.Constant(index[id(each)])]
                call = ast.Expr(ast.Call(ast.Name("_mutant_hit", ast.Load()), args, []))
                new.append(ast.copy_location(call, each))
            new.append(each)
        return new

    def visit(node: ast.AST, inside: bool) -> None:
        within = isinstance(node, FUNCTIONS) or (inside and not isinstance(node, ast.ClassDef))
        for child in ast.iter_child_nodes(node):
            visit(child, within)
        if within:
            for field, value in ast.iter_fields(node):
                if isinstance(value, list) and value and isinstance(value[0], ast.stmt):
                    setattr(node, field, reported(value, isinstance(node, FUNCTIONS)))

    visit(tree, False)
    return ast.fix_missing_locations(tree)
