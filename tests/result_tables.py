"""Tables of results that take a run, each in a file below tests/results.

The run writes it, tests compare it with fresh runs, and the site has it in its page
(site_tables), some of them with a few rows before it (docs_tables).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from cardan.conform import registry as suites

ROOT = Path(__file__).parents[1]
FOLDER = Path("tests") / "results"


class Results(NamedTuple):
    """Table or tables of a run."""

    name: str
    page: str
    """Page of the site with the table and the meaning of its columns, relative to the
    repository."""
    command: str
    """Command that rewrites the file."""

    @property
    def file(self) -> str:
        """Path relative to the repository."""
        return (FOLDER / f"{self.name}.md").as_posix()

    @property
    def head(self) -> str:
        """Paragraph before the table."""
        return f"Written by `{self.command}`; [{self.page}](../../{self.page}) says what it means."

    def read(self) -> str:
        return (ROOT / self.file).read_text(encoding="utf-8").partition("\n\n")[2]

    def write(self, made: str) -> None:
        """Replace the table in the file."""
        text = f"{self.head}\n\n{made.strip()}\n"
        (ROOT / self.file).write_text(text, encoding="utf-8")

    def rows(self, section: str = "") -> list[list[str]]:
        """Return the cells of the table below that heading, or before the first one, with column
        names first."""
        found = re.split(r"^#+ (.*)\n", self.read(), flags=re.MULTILINE)
        text = dict(zip(["", *found[1::2]], found[::2], strict=True))[section]
        lines = [line for line in text.splitlines() if line.startswith("| ")]
        return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


FAULTS = Results("faults", "docs/faults.md", "make fault-table")
REMOTE_FAULTS = Results("remote-faults", "docs/faults.md", "make fault-table")
PROCESS_FAULTS = Results("process-faults", "docs/faults.md", "make fault-table-processes")
FLOODS = Results("floods", "docs/faults.md", "make flood-table")
PUBLISHED_ARMS = Results("published-arms", "docs/robots.md", "python -m tests.published_arms")


def of_suite(name: str) -> Results:
    """Return the results about a suite: requirements that catch each fault of its simulated peer.

    Their page is in the plug-in that contains the suite.
    """
    package = type(suites.load(name)).__module__.partition(".")[0]
    page = "docs/conformance.md"
    if package != "cardan":
        page = f"plugins/{package.replace('_', '-')}/README.md"
    return Results(f"conformance-{name}", page, "python -m tests.conformance_tables")
