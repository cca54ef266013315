"""Copying the report of a run into a page."""

from __future__ import annotations

import json
from pathlib import Path

from bench import pages
from bench.soak.report import markdown
from bench.soak.rules import Violation

PAGE = Path(__file__).parents[2] / "docs" / "measurements.md"


def violations_of(folder: Path) -> list[Violation]:
    """Return the violations of the run in a folder."""
    lines = (folder / "violations.jsonl").read_text().splitlines()
    return [Violation(**json.loads(line)) for line in lines]


def rewrite_page(folder: Path, page: Path = PAGE) -> None:
    """Put the report of the run in `folder` into the page. Raises ValueError if the page has no
    place for it."""
    table = json.loads((folder / "report.json").read_text())
    pages.rewrite(page, {"soak": markdown(table, violations_of(folder))})
