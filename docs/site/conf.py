"""The documentation as a site (``make docs``), by Sphinx.

The pages stay as they are read in the repository: its root is the folder of the sources, so that
links between pages, examples and code are the same in both. Tables that are declared in code are
made here (tests/site_tables.py); in the repository a line stands in their place. The navigation is
docs/index.md: each of its sections is one of the navigation's, with the pages that it links, in
their order.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

import reference  # noqa: E402

from cardan import __version__  # noqa: E402
from tests import site_tables  # noqa: E402

project = "Cardan"
copyright = "the authors of Cardan, Apache-2.0"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
root_doc = "docs/index"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
include_patterns = [
    "*.md",
    "docs/**",
    "examples/**/README.md",
    "plugins/**/README.md",
]
exclude_patterns = ["docs/site", "docs/images", "build", "dist", ".venv*", "console", "**/.git"]
suppress_warnings = [
    "myst.header",  # A page may leave out a level of headings.
    "ref.python",  # A driver and its simulated peer have one name; each page links its own.
]
myst_heading_anchors = 4

html_theme = "furo"
html_title = f"Cardan {release}"
html_copy_source = False
html_show_sphinx = False
html_additional_pages = {"index": "first.html"}
templates_path = ["templates"]

# Docstrings are plain text: what one backtick encloses is code, as in Markdown.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}

SECTION = re.compile(r"^## (.+)\n((?:(?!^## ).*\n?)*)", re.MULTILINE)
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#\s]+)(#[^)]*)?\)")
MADE = {"Write programs": ["api/index"]}
"""Pages of a section of docs/index.md that are in no repository."""


def navigation(text: str) -> str:
    """A section of the navigation for each of the text's: the pages that it links."""
    made = ""
    for title, section in SECTION.findall(text):
        targets = [found[1] for found in LINK.findall(section)]
        pages = [target.removesuffix(".md") for target in targets if target.endswith(".md")]
        pages += MADE.get(title, [])
        entries = "\n".join(dict.fromkeys(pages))
        made += f"\n```{{toctree}}\n:caption: {title}\n:hidden:\n\n{entries}\n```\n"
    return made


def listed(page: Path) -> Any:
    """What replaces a link to a folder: its pages' index, or its files one by one."""

    def replacement(found: re.Match[str]) -> str:
        words, target = found[1], found[2]
        folder = page.parent / target
        if "://" in target or not folder.is_dir():
            return found[0]
        files = sorted(path for path in folder.iterdir() if path.is_file())
        links = ", ".join(f"[`{each.name}`]({target.rstrip('/')}/{each.name})" for each in files)
        return f"{words} ({links})"

    return replacement


def read(app: Any, name: str, source: list[str]) -> None:
    """What the site adds to a page, or says otherwise, than the repository does."""
    page = Path(app.env.doc2path(name))
    if page.suffix == ".md":
        source[0] = site_tables.filled(page.relative_to(ROOT).as_posix(), source[0])
        source[0] = LINK.sub(listed(page), source[0])
    if name == root_doc:
        source[0] += navigation(source[0])


PLAIN = re.compile(r"(``[^`]*``|`[^`]*`)|(?<=\w)(_)(?!\w)|(\|)")


def plain(_app: Any, _kind: str, _name: str, _value: Any, _options: Any, lines: list[str]) -> None:
    """Docstrings are plain text: ``HD_`` is no reference, and ``|v|`` no substitution."""
    lines[:] = [PLAIN.sub(lambda found: found[1] or f"\\{found[0]}", line) for line in lines]


def setup(app: Any) -> None:
    """Add what the pages alone have not: navigation and reference."""
    app.connect("config-inited", lambda *_: reference.write())
    app.connect("source-read", read)
    app.connect("autodoc-process-docstring", plain)
