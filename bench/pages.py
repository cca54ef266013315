"""The measured parts of pages: what stands between `<!-- name -->` and `<!-- end -->`."""

from __future__ import annotations

from pathlib import Path

END = "<!-- end -->"


def begin(name: str) -> str:
    """The marker before the part of that name."""
    return f"<!-- {name} -->"


def marked(name: str, body: str) -> str:
    """The part as it stands in a page, markers and all."""
    return f"{begin(name)}\n\n{body.strip()}\n\n{END}"


def replaced(page: str, name: str, body: str) -> str:
    """The page with another body in the part of that name. ValueError: it has none, or two."""
    before, *after = page.split(begin(name))
    if len(after) != 1 or END not in after[0]:
        raise ValueError(f"not one part between {begin(name)} and {END}")
    return before + marked(name, body) + after[0].split(END, 1)[1]


def rewrite(path: Path, parts: dict[str, str]) -> None:
    """Replace all those parts of a page. ValueError: one is not there; nothing is written then."""
    page = path.read_text(encoding="utf-8")
    for name, body in parts.items():
        page = replaced(page, name, body)
    path.write_text(page, encoding="utf-8")
