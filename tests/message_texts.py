"""Messages in the sources: string literals that are no docstrings, with a mark for each value."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
VALUE = "\N{OBJECT REPLACEMENT CHARACTER}"


def sources() -> list[Path]:
    """Return the modules of Cardan and of its plug-ins, without tests."""
    plugins = ROOT.glob("plugins/cardan-*/cardan_*/**/*.py")
    return sorted([*(ROOT / "cardan").rglob("*.py"), *plugins])


def text_of(node: ast.AST) -> str | None:
    """Return the text of a string literal; None for other nodes."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(text_of(each) or VALUE for each in values)
        case ast.BinOp(op=ast.Add(), left=left, right=right):
            parts = text_of(left), text_of(right)
            return None if parts == (None, None) else "".join(each or VALUE for each in parts)
    return None


def texts_of(node: ast.AST) -> Iterator[str]:
    """Yield the texts below `node`: each f-string as a whole, and then the texts inside its
    values."""
    match node:
        case ast.Expr(value=ast.Constant()):
            return
        case _ if text := text_of(node):
            yield text
            if isinstance(node, ast.Constant):
                return
    within = [node.value] if isinstance(node, ast.FormattedValue) else ast.iter_child_nodes(node)
    for below in within:
        if not (isinstance(node, (ast.JoinedStr, ast.BinOp)) and text_of(below)):
            yield from texts_of(below)


def messages() -> dict[str, str]:
    """Return every text, with a module that contains it."""
    return {
        " ".join(text.split()): str(path.relative_to(ROOT))
        for path in sources()
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
    }
