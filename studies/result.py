"""Result of a study: values only, without numpy and without pictures drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple

Better = Literal["less", "more", ""]


class Figure(NamedTuple):
    """A number that another report's is compared with."""

    name: str
    """Of one study each once."""
    value: float | None
    """None: there was none, for example a delay of what never came."""
    unit: str = ""
    better: Better = "less"
    """The better direction; empty: neither is better."""
    spread: float | None = 0.0
    """By so much it may differ when nothing has changed; None: it was measured once."""
    published: float | None = None


class Table(NamedTuple):
    """Cells are text."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


class Drawn(NamedTuple):
    """A picture, drawn and not yet saved."""

    name: str
    """Of its file, without an ending."""
    title: str
    figure: Any
    """matplotlib's."""


class Result(NamedTuple):
    """Of one study."""

    how: str
    """Method of the measurement: clock, drives, processes."""
    tables: tuple[Table, ...]
    figures: tuple[Figure, ...]
    draw: Callable[[], Iterable[Drawn]] | None = None
    """Draws the pictures, one after the other; needs the extra "evaluate"."""
    seeds: tuple[str, ...] = ()
    """Each with what it is of."""
    shortened: tuple[str, ...] = ()
    """Parts that --quick made shorter or left out."""
    left_out: tuple[str, ...] = ()
    """Parts that this computer cannot run, and why."""


def table_of(title: str, markdown: str, note: str = "") -> Table:
    """A table that is there as Markdown."""
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    cells = [tuple(cell.strip() for cell in line[1:-1].split("|")) for line in lines]
    return Table(title, cells[0], tuple(cells[2:]), note)


def spread_of(values: Iterable[float], least: float = 0.0) -> float:
    """Spread of repetitions; at least `least`."""
    known = [value for value in values if value == value]
    return max(least, max(known) - min(known)) if known else least


def known(value: float | None) -> float | None:
    """None for what is not finite."""
    return None if value is None or value != value or abs(value) == float("inf") else value
