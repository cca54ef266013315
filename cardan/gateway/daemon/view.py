"""Sessions and servers of the daemon for people: the table of ``cardan daemon ps`` and ``cardan
daemon top``. Each has a line, and below it further ones if needed: why its arm does not move, why
it does not run, its endpoint, the delay of its device."""

from __future__ import annotations

import re
import textwrap
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.text import Text

from cardan.common.text_sanitizer import printable
from cardan.common.troubles import coded
from cardan.gateway.session.live_display import LivePanel

COLUMNS: Final = ("name", "state", "for", "arm", "moved by", "device", "robot", "cpu")
RIGHT: Final = frozenset({"for", "cpu"})
"""Columns of figures."""

MAY_SHRINK: Final = ("robot", "device", "name", "moved by", "for")
"""Columns that are cut if the terminal is too narrow, the longest first."""

SHORTEST_CELLS: Final = 6
"""Width below which no column is cut."""

STYLES: Final = {
    "running": "green", "waiting": "yellow", "ending": "yellow", "failed": "bold red",
    "stopped": "dim",
    "moving": "bold green", "holding": "green", "braking": "yellow", "recovering": "yellow",
    "no robot": "red",
}  # fmt: skip

_GAP = "  "
_BELOW = "  ↳ "
_AMISS = ("(lost)", "(stale)", "(fault)")

Row = Mapping[str, Any]


def sorted_rows(rows: Iterable[Row]) -> list[Row]:
    """Return sessions, then servers, each by name; `ur5-9` precedes `ur5-10`."""

    def key(row: Row) -> tuple[bool, list[tuple[int, int, str]]]:
        parts = re.findall(r"\d+|\D+", row["name"])
        name = [(0, int(each), "") if each.isdecimal() else (1, 0, each) for each in parts]
        return row["kind"] == "server", name

    return sorted(rows, key=key)


def table(rows: Iterable[Row], width: int | None = None) -> Text:
    """Return the table of all rows, at most `width` cells wide; None: as wide as needed."""
    ordered = sorted_rows(rows)
    cells = [_cells(row) for row in ordered]
    widths = _widths([COLUMNS, *cells], width)
    lines = [_cut(_line(COLUMNS, widths, heading=True), width)]
    for row, each in zip(ordered, cells, strict=True):
        lines.append(_cut(_line(each, widths), width))
        style = "yellow" if row["state"] in ("running", "stopped") else STYLES.get(row["state"], "")
        if row["kind"] == "server" and row["state"] == "running":
            style = "dim"
        for words, shown in ((why(row), style), (way(row.get("device_metrics", {})), "dim")):
            if words:
                lines += _below(words, shown, width)
    return Text("\n").join(lines)


def why(row: Row) -> str:
    """Return why it does not run or its arm does not move, waiting changes, and its endpoint."""
    words = [row["reason"] or row.get("why", "")]
    if row.get("changes_wait"):
        waits = ", ".join(row["changes_wait"])
        words.append(f"changes wait until no source has its arm: {waits}")
    if row["state"] == "running" and row.get("endpoint"):
        words.append(f"at {row['endpoint']}")
    return coded(printable("; ".join(filter(None, words))))


def way(metrics: Mapping[str, float | None]) -> str:
    """Return the figures of the link to a device on another computer; else empty."""
    names = ("delay_s", "jitter_s", "loss", "age_s")
    delay_s, jitter_s, loss, age_s = map(metrics.get, names)
    if delay_s is None or jitter_s is None or loss is None or age_s is None:
        return ""
    return (
        f"device: delay {1e3 * delay_s:.0f} ms, jitter {1e3 * jitter_s:.0f} ms, "
        f"loss {loss:.1%}, age at the arm {1e3 * age_s:.0f} ms"
    )


def frame(rows: Sequence[Row], width: int | None) -> Text:
    """Return a frame of ``cardan daemon top``."""
    counts = [
        f"{len(found)} {kind}{'s' * (len(found) != 1)}"
        for kind in ("session", "server")
        if (found := [row for row in rows if row["kind"] == kind])
    ]
    idle = [
        f"{row['name']} {row['state']}" for row in sorted_rows(rows) if row["state"] != "running"
    ]
    head = f"cardan  {time.strftime('%H:%M:%S')}  {', '.join(counts) or 'nothing runs'}"
    return Text("\n").join(
        [_cut(Text("; ".join([head, *idle])), width), Text(), table(rows, width)]
    )


def show(rows: Sequence[Row], console: Console, panel: LivePanel) -> None:
    """Show the rows in the panel, or, if that is not on a terminal, as lines."""
    if panel.drawn:
        panel.update(frame(rows, width_of(console)))
    else:
        console.print(frame(rows, None), "", sep="\n", soft_wrap=True)


def width_of(console: Console) -> int | None:
    """Return the width of a terminal; None: a program or a file reads the output, and takes any
    width."""
    return console.width if console.is_terminal else None


def _cells(row: Row) -> tuple[str, ...]:
    server = row["kind"] == "server"
    cells = (
        row["name"],
        row["state"],
        _span(row["since_s"]),
        "" if server else row["phase"] or ("starting" if row["state"] == "running" else ""),
        "" if server else row["authority"],
        f"server {row['server']}" if server else _linked(row["device"], row["device_link"]),
        "" if server else _linked(row["robot"], row["robot_link"]),
        "" if row["cpu"] is None else f"{100.0 * row['cpu']:.1f}%",
    )
    return tuple(map(printable, cells))


def _widths(lines: Iterable[Sequence[str]], width: int | None) -> list[int]:
    widths = [max(map(cell_len, column)) for column in zip(*lines, strict=True)]
    room = None if width is None else width - len(_GAP) * (len(COLUMNS) - 1)
    while room is not None and sum(widths) > room:
        widest = max(map(COLUMNS.index, MAY_SHRINK), key=lambda index: widths[index])
        if widths[widest] <= SHORTEST_CELLS:
            break
        widths[widest] -= 1
    return widths


def _line(cells: Sequence[str], widths: Sequence[int], *, heading: bool = False) -> Text:
    found = []
    for name, cell, width in zip(COLUMNS, cells, widths, strict=True):
        if cell_len(cell) > width:
            cell = set_cell_size(cell, width - 1) + "…"
        space = " " * (width - cell_len(cell))
        style = "bold" if heading else STYLES.get(cell, "")
        if name not in ("state", "arm") and not heading:
            style = "red" if cell.endswith(_AMISS) else ""
        found.append(Text(space + cell if name in RIGHT else cell + space, style))
    line = Text(_GAP).join(found)
    line.rstrip()
    return line


def _below(words: str, style: str, width: int | None) -> list[Text]:
    room = len(words) if width is None else max(width - len(_BELOW), SHORTEST_CELLS)
    # The advice stands last: nothing is cut.
    pieces = textwrap.wrap(words, max(room, 1))
    return [
        _cut(Text((" " * len(_BELOW) if index else _BELOW) + piece, style), width)
        for index, piece in enumerate(pieces)
    ]


def _cut(line: Text, width: int | None) -> Text:
    if width is not None:
        line.truncate(width, overflow="ellipsis")
    return line


def _linked(driver: str, link: str) -> str:
    return f"{driver} ({link})" if link and link != "live" else driver


def _span(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.0f} h"
