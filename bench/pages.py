"""The measured parts of pages: the text between `<!-- name -->` and `<!-- end -->`."""

from __future__ import annotations

from pathlib import Path

END = "<!-- end -->"


def begin(name: str) -> str:
    """The marker before the part of that name."""
    return f"<!-- {name} -->"


def marked(name: str, body: str) -> str:
    """Return the part as it stands in a page, including its markers."""
    return f"{begin(name)}\n\n{body.strip()}\n\n{END}"


def replaced(page: str, name: str, body: str) -> str:
    """Return the page with a new body in the part of that name. Raises ValueError unless it has
    exactly one."""
    before, *after = page.split(begin(name))
    if len(after) != 1 or END not in after[0]:
        raise ValueError(f"not one part between {begin(name)} and {END}")
    return before + marked(name, body) + after[0].split(END, 1)[1]


def rewrite(path: Path, parts: dict[str, str]) -> None:
    """Replace all parts of a page. Raises ValueError if one is missing; nothing is written then."""
    page = path.read_text(encoding="utf-8")
    for name, body in parts.items():
        page = replaced(page, name, body)
    path.write_text(page, encoding="utf-8")
