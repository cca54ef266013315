"""A document as values, rendered as Markdown or one HTML page. Texts may have `code` and
**bold**."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from studies.result import Table


class Heading(NamedTuple):
    """Heading; level 1 is the title."""

    level: int
    text: str


class Paragraph(NamedTuple):
    """Paragraph of running text."""

    text: str


class Points(NamedTuple):
    """Bulleted list."""

    texts: tuple[str, ...]


class Picture(NamedTuple):
    """Picture next to the document; `name` has no extension, because it exists as SVG and PNG."""

    name: str
    title: str


Block = Heading | Paragraph | Points | Picture | Table

STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 0.8rem 0; font-size: 13px; }
th, td { border: 1px solid #bbb; padding: 0.15rem 0.5rem; text-align: left; vertical-align: top; }
th { background: #eee; }
.table { overflow-x: auto; }
figure { margin: 1rem 0; } figure img { max-width: 100%; } figcaption { color: #555; }
code { background: #f2f2f2; }
@media print { body { max-width: none; font-size: 11px; } table { font-size: 9px; }
  h2 { break-before: page; } tr, figure { break-inside: avoid; } .table { overflow: visible; } }
"""
_INLINE = re.compile(r"`([^`]*)`|\*\*(.+?)\*\*")
_SPECIAL = re.compile(r"([\\|<>_])")


def markdown(blocks: Sequence[Block]) -> str:
    """Return the document as Markdown, with PNG pictures, which all converters to PDF can read."""
    parts: list[str] = []
    for block in blocks:
        if isinstance(block, Heading):
            parts.append(f"{'#' * block.level} {_marked(block.text)}")
        elif isinstance(block, Paragraph):
            parts.append(_marked(block.text))
        elif isinstance(block, Points):
            parts.append("\n".join(f"- {_marked(text)}" for text in block.texts))
        elif isinstance(block, Picture):
            parts.append(f"![{_marked(block.title)}]({block.name}.png)")
        else:
            parts += _markdown_table(block)
    return "\n\n".join(parts) + "\n"


def _markdown_table(table: Table) -> list[str]:
    rows = [table.columns, tuple("---" for _ in table.columns)]
    lines = [f"| {' | '.join(_marked(cell) for cell in row)} |" for row in rows]
    lines += [f"| {' | '.join(_marked(cell) for cell in row)} |" for row in table.rows]
    parts = [f"**{_marked(table.title)}**", "\n".join(lines)]
    return [*parts, _marked(table.note)] if table.note else parts


def _marked(text: str) -> str:
    """Escape Markdown except code and bold."""
    line = " ".join(text.split())
    pieces = re.split(r"(`[^`]*`)", line)
    return "".join(
        piece.replace("|", "\\|") if piece.startswith("`") else _SPECIAL.sub(r"\\\1", piece)
        for piece in pieces
    )


def page(title: str, blocks: Sequence[Block], folder: Path) -> str:
    """Return the document as one self-contained HTML page; pictures of `folder` are embedded."""
    body = "\n".join(_html(block, folder) for block in blocks)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def _html(block: Block, folder: Path) -> str:
    if isinstance(block, Heading):
        return f"<h{block.level}>{_inline(block.text)}</h{block.level}>"
    if isinstance(block, Paragraph):
        return f"<p>{_inline(block.text)}</p>"
    if isinstance(block, Points):
        return "<ul>\n" + "\n".join(f"<li>{_inline(text)}</li>" for text in block.texts) + "\n</ul>"
    if isinstance(block, Picture):
        data = base64.b64encode((folder / f"{block.name}.svg").read_bytes()).decode("ascii")
        title = html.escape(block.title)
        image = f'<img alt="{title}" src="data:image/svg+xml;base64,{data}">'
        return f"<figure>{image}<figcaption>{title}</figcaption></figure>"
    head = "".join(f"<th>{_inline(cell)}</th>" for cell in block.columns)
    rows = "\n".join(
        "<tr>" + "".join(f"<td>{_inline(cell)}</td>" for cell in row) + "</tr>"
        for row in block.rows
    )
    note = f"\n<p>{_inline(block.note)}</p>" if block.note else ""
    return (
        f'<h3>{_inline(block.title)}</h3>\n<div class="table"><table>\n<thead><tr>{head}</tr>'
        f"</thead>\n<tbody>\n{rows}\n</tbody>\n</table></div>{note}"
    )


def _inline(text: str) -> str:
    return _INLINE.sub(
        lambda found: (
            f"<code>{found[1]}</code>" if found[1] is not None else f"<strong>{found[2]}</strong>"
        ),
        html.escape(text, quote=False),
    )
