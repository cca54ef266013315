"""Sentences of docstrings, comments and messages, and bad beginnings of them."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator

ENDS = re.compile(r"(?<=[.!?])\s+(?=[A-Z`'\"(])")
_BEGINS = (
    r"(?:What(?:ever)?|Who(?:ever|se)?|Somebody|Other people|"
    r"One (?:that|who|which|whose|is|has|does|may|can|must|cannot|with|without))\b(?![\w-])"
)
PRONOUN = re.compile(rf"(?:^|(?<=[.:;!?]\s)){_BEGINS}[^.?]*")
"""A sentence, or a part after a colon or semicolon, whose subject is a pronoun."""
MAYBE = re.compile(rf'(?:"|#|[.:;!?]\s)\s*{_BEGINS}')
"""Quick test of a source, which finds all that need parsing."""
NO_NOUN = re.compile(r"\s*(?:As|Of|Where|Whose)\b")
"""Beginning of a docstring that should begin with an imperative or a noun."""
LONGEST = 120
"""Limit on a sentence in a message, characters."""


def sentences(text: str) -> list[str]:
    """Split a text into sentences, each on one line."""
    return ENDS.split(text)


def begun_with_a_pronoun(text: str) -> list[str]:
    """Return the sentences of a text that begin with a pronoun, except for questions."""
    flat = " ".join(text.split())
    found = PRONOUN.finditer(flat)
    return [each[0] for each in found if not flat.startswith("?", each.end())]


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of the docstrings of a module, its classes, functions and attributes."""
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for each in body if isinstance(body, list) else ():
            value = each.value if isinstance(each, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield each.lineno, value.value


def comments(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of comments that are sentences; consecutive lines count as one text."""
    begin, joined, last = 0, "", 0
    for each in tokenize.generate_tokens(io.StringIO(source).readline):
        if each.type != tokenize.COMMENT:
            continue
        line, column = each.start
        alone = not each.line[:column].strip()
        if joined and not (alone and line == last + 1):
            yield begin, joined
            joined = ""
        begin = begin if joined else line
        joined += f" {each.string.strip('# ')}"
        last = line if alone else 0
    if joined:
        yield begin, joined


def strings(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string in a module: docstrings, messages, help texts."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
