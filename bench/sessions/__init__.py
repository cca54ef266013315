"""Number of sessions of 250 Hz that a computer runs, and their cost: `python -m bench sessions`.

    python -m bench sessions [COUNT]... [--pages] [--seconds=15]

By default 1, 4, 8, 16, 24 and 32 sessions of one `cardan daemon run`, each with the model of a GoFa
driven over EGM and a SpaceMouse that moves it; then, by bisection, the largest number of sessions
that miss at most 0.1 % of their control instants. Robots and mice are played by one process in C
(crowd.c), which measures the arrival of each answer from outside. Five minutes at most. `--pages`
writes the table into docs/measurements.md.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from bench import pages
from bench.sessions.lab import Lab, Row, lab
from cardan.errors import CardanError

PAGE = Path(__file__).parents[2] / "docs/measurements.md"
PART = "sessions"

COUNTS = (1, 4, 8, 16, 24, 32)
WARM_UP_S, SECONDS = 4.0, 15.0
BOUND_S = 280.0
"""Time budget of the search: a measurement that would end later is not started."""

ALLOWED_SHARE = 0.001
"""Largest share of control instants that may be missed."""

SPREAD = 0.15
"""Limit for the relative deviation of a session's cost from its mean over all numbers of
sessions."""


AIM_COST, AIM_SESSIONS, AIM_MEMORY_MB = 0.045, 32, 30.0
"""Share of a processor per session; number of sessions on two processors; memory per further
session."""


def good(row: Row) -> bool:
    """Return True if the computer runs this number of sessions in time."""
    return row.played.missed_share <= ALLOWED_SHARE


def search(
    measure: Callable[[int], Row], counts: tuple[int, ...], in_time: Callable[[], bool]
) -> list[Row]:
    """Return the rows for `counts` and for numbers between the last good and the first bad one, as
    far as time allows, sorted by number."""
    rows: dict[int, Row] = {}
    for count in counts:
        if rows and not in_time():
            break
        rows[count] = measure(count)
    while in_time():
        best, worse = bounds(rows)
        if worse is None or worse - best < 2:
            break
        middle = (best + worse) // 2
        rows[middle] = measure(middle)
    return [rows[count] for count in sorted(rows)]


def bounds(rows: dict[int, Row]) -> tuple[int, int | None]:
    """Return the largest number below every bad one (0 without one), and the smallest bad one."""
    worse = min((count for count, row in rows.items() if not good(row)), default=None)
    fine = [count for count in rows if worse is None or count < worse]
    return max(fine, default=0), worse


def spread(rows: list[Row]) -> tuple[float, float]:
    """Return the mean cost of a session over all good numbers of sessions, and the largest relative
    deviation from it."""
    means = [row.mean for row in rows if good(row)]
    if not means:
        return 0.0, 0.0
    mean = sum(means) / len(means)
    return mean, max(abs(each - mean) for each in means) / mean


def further_mb(rows: list[Row]) -> float | None:
    """Memory that each further session takes, including its share in the daemon."""
    first, last = rows[0], rows[-1]
    if last.sessions == first.sessions:
        return None
    return (last.memory_in_all_mb - first.memory_in_all_mb) / (last.sessions - first.sessions)


def verdicts(rows: list[Row]) -> list[str]:
    """Compare the results with the aims."""
    best, worse = bounds({row.sessions: row for row in rows})
    mean, _ = spread(rows)
    tried = best >= AIM_SESSIONS or worse is not None
    found = [f"{AIM_SESSIONS} sessions: {_verdict(best >= AIM_SESSIONS) if tried else 'not tried'}"]
    if mean:
        words = f"{AIM_COST:.1%} of a processor for a session: {_verdict(mean <= AIM_COST)}"
        found.insert(0, words)
    further = further_mb(rows)
    if further is not None:
        met = _verdict(further <= AIM_MEMORY_MB)
        found.append(f"{AIM_MEMORY_MB:g} MB for a further session: {met}, {further:.0f} MB")
    return found


def _verdict(met: bool) -> str:
    return "met" if met else "missed"


def table(rows: list[Row], conditions: str) -> str:
    """Return the table of docs/measurements.md."""
    lines = [
        "| sessions | each session | daemon | robots and mice | everything else | missed "
        "| of the worst | moved | answer p50 / p99 | memory of a session |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        played = row.played
        lowest, highest = min(row.each), max(row.each)
        lines.append(
            f"| {row.sessions} | {row.mean:.1%} ({lowest:.1%} to {highest:.1%}) | {row.daemon:.1%} "
            f"| {row.crowd:.1%} | {row.others:.1%} | {played.missed} of {played.sent} "
            f"({played.missed_share:.2%}) | {played.worst} | {played.moved / played.sent:.0%} "
            f"| {played.p50_s * 1e3:.2f} / {played.p99_s * 1e3:.2f} ms | {row.memory_mb:.0f} MB |"
        )
    best, worse = bounds({row.sessions: row for row in rows})
    if worse is None:
        largest = f"at least {best}, more were not tried"
    elif worse - best > 1:
        largest = f"{best} to {worse - 1}"
    else:
        largest = str(best)
    mean, deviation = spread(rows)
    lines += [
        "",
        f"Largest number of sessions with no more than {ALLOWED_SHARE:.1%} missed: **{largest}**.",
    ]
    if mean:
        verdict = "met" if deviation <= SPREAD else "missed"
        lines.append(
            f"Up to there a session costs {mean:.1%} of a processor, ±{deviation:.0%} (aim: "
            f"±{SPREAD:.0%}, {verdict})."
        )
    lines.append(f"Aims: {'; '.join(verdicts(rows))}.")
    late_s = max(row.played.late_p99_s for row in rows)
    skipped = sum(row.played.skipped for row in rows)
    lines.append(
        f"The robots' process was up to {late_s * 1e3:.2f} ms late (p99), and left out {skipped} "
        "instants."
    )
    return "\n".join(lines) + "\n\n" + conditions


def measure_all(counts: tuple[int, ...], seconds: float) -> str:
    """Measure, printing each row; return the table."""
    load = os.getloadavg()[0]
    began_s = time.monotonic()
    longest_s = 0.0

    def in_time() -> bool:
        return time.monotonic() - began_s + longest_s < BOUND_S

    with (
        tempfile.TemporaryDirectory(prefix="cardan-sessions-") as folder,
        lab(Path(folder), max(counts)) as measured,
    ):

        def measure(count: int) -> Row:
            nonlocal longest_s
            start_s = time.monotonic()
            row = _again(measured, count, seconds)
            longest_s = max(longest_s, time.monotonic() - start_s)
            print(
                f"{count} sessions: {row.mean:.1%} each, daemon {row.daemon:.1%}, missed "
                f"{row.played.missed_share:.2%}, p99 {row.played.p99_s * 1e3:.2f} ms, "
                f"{row.others:.0%} of a processor by others",
                file=sys.stderr,
                flush=True,
            )
            return row

        rows = search(measure, counts, in_time)
        scheduling = measured.scheduling()
        played = measured.crowd.scheduling
        servo = measured.servo
    conditions = (
        f"{seconds:g} s each, {os.cpu_count()} processors; servo: {servo}; sessions: {scheduling}, "
        f"robots: {played}. Load in the minute before: {load:.1f}; "
        f"{time.monotonic() - began_s:.0f} s in all."
    )
    return table(rows, conditions)


def _again(measured: Lab, count: int, seconds: float) -> Row:
    """Measure; retry once if a session did not start in time."""
    try:
        return measured.measure(count, WARM_UP_S, seconds)
    except CardanError as error:
        print(f"{count} sessions, once more: {error}", file=sys.stderr)
        return measured.measure(count, WARM_UP_S, seconds)


def main() -> None:
    """Measure and print; with `--pages`, write the table into the page."""
    words = sys.argv[1:]
    counts = tuple(sorted({int(word) for word in words if word.isdecimal()})) or COUNTS
    given = [word.partition("=")[2] for word in words if word.startswith("--seconds=")]
    body = measure_all(counts, float(given[-1]) if given else SECONDS)
    print(pages.marked(PART, body), flush=True)
    if "--pages" in words:
        pages.rewrite(PAGE, {PART: body})
        print(f"docs/{PAGE.name} has these numbers")
