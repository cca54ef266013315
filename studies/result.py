"""Result of a study: values only, independent of numpy; pictures are drawn later."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple

Better = Literal["less", "more", ""]


class Figure(NamedTuple):
    """A number for comparison with that of another report."""

    name: str
    """Name, unique within a study."""
    value: float | None
    """Value; None if it does not exist, for example the delay of a missing response."""
    unit: str = ""
    better: Better = "less"
    """Direction of improvement; empty: neither is better."""
    spread: float | None = 0.0
    """Expected variation between equal runs; None: measured only once."""
    published: float | None = None


class Table(NamedTuple):
    """Table whose cells are text."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


class Drawn(NamedTuple):
    """A picture that is drawn and not yet saved."""

    name: str
    """File name without its extension."""
    title: str
    figure: Any
    """Figure object of matplotlib."""


class Result(NamedTuple):
    """Result of one study."""

    how: str
    """Method of the measurement: clock, drives, processes."""
    tables: tuple[Table, ...]
    figures: tuple[Figure, ...]
    draw: Callable[[], Iterable[Drawn]] | None = None
    """Draws the pictures one by one; needs the extra "evaluate"."""
    seeds: tuple[str, ...] = ()
    """Seeds, each with its use."""
    shortened: tuple[str, ...] = ()
    """Parts that --quick made shorter or left out."""
    left_out: tuple[str, ...] = ()
    """Parts that this computer cannot run, and why."""


def table_of(title: str, markdown: str, note: str = "") -> Table:
    """Convert a Markdown table."""
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    cells = [tuple(cell.strip() for cell in line[1:-1].split("|")) for line in lines]
    return Table(title, cells[0], tuple(cells[2:]), note)


def spread_of(values: Iterable[float], least: float = 0.0) -> float:
    """Spread of repeated values, at least `least`."""
    known = [value for value in values if value == value]
    return max(least, max(known) - min(known)) if known else least


def known(value: float | None) -> float | None:
    """Return None for a value that is not finite."""
    return None if value is None or value != value or abs(value) == float("inf") else value
