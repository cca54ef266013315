"""Sentences of docstrings and messages, and those that begin as none should."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

ENDS = re.compile(r"(?<=[.!?])\s+(?=[A-Z`'\"(])")
_BEGINS = (
    r"(?:What(?:ever)?|Who(?:ever|se)?|Somebody|Other people|"
    r"One (?:that|who|which|whose|is|has|does|may|can|must|cannot|with|without))\b(?![\w-])"
)
PRONOUN = re.compile(rf"(?:^|(?<=[.:;!?]\s)){_BEGINS}[^.?]*")
"""A sentence, or a part after a colon or semicolon, whose subject is a pronoun."""
MAYBE = re.compile(rf'(?:"|[.:;!?]\s)\s*{_BEGINS}')
"""In a source that may have one: others need not be parsed."""
LONGEST = 120
"""Of a sentence in a message, characters."""


def sentences(text: str) -> list[str]:
    """Those of a text on one line."""
    return ENDS.split(text)


def begun_with_a_pronoun(text: str) -> list[str]:
    """Sentences of a text that have one, but for questions."""
    flat = " ".join(text.split())
    found = PRONOUN.finditer(flat)
    return [each[0] for each in found if not flat.startswith("?", each.end())]


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of the docstrings of a module, its classes, functions and attributes."""
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for each in body if isinstance(body, list) else ():
            value = each.value if isinstance(each, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield each.lineno, value.value
