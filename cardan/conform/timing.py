"""Checks of arrival times: jitter, gaps in a hold, torn messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Protocol

from cardan.conform.requirements import (
    Findings,
    Verdict,
    Words,
    at_most,
    failed,
    met,
    not_seen,
    passed,
    some,
)
from cardan.conform.timeline import NumberedItem, TimelinePhase


class Timed(NumberedItem, Protocol):
    """A received item with its time."""

    @property
    def time_s(self) -> float: ...


def never_silent(
    held: Iterable[tuple[TimelinePhase | None, Sequence[Timed]]], most_s: float
) -> Verdict:
    """Check if items came at most `most_s` apart from the beginning to the end of each phase. A
    phase that the scenario did not reach is None."""
    longest, wrong, count = 0.0, [], 0
    for phase, found in held:
        if phase is None:
            continue
        times = [phase.start_s, *(each.time_s for each in found), phase.end_s]
        count += 1
        for n, (a, b) in enumerate(pairwise(times)):
            longest = max(longest, b - a)
            if b - a > most_s:
                at = found[min(n, len(found) - 1)].number if found else phase.first
                wrong.append((at, f"{(b - a) * 1e3:.0f} ms"))
    if wrong:
        said = f"{len(wrong)} silences: {wrong[0][1]}"
        return failed(said, (n for n, _ in wrong), longest * 1e3, "ms")
    if not count:
        return not_seen("it was never held deflected")
    return passed(f"longest {longest * 1e3:.0f} ms", longest * 1e3, "ms")


def mostly_within(
    times: Iterable[tuple[float, int]], share: float, most_s: float, said: str, nothing: str
) -> Verdict:
    """Check if this share of `times`, s, each with its event's number, is at most `most_s`. ``{}``
    in `said` is the longest time of the share, ms; without any: not seen, `nothing`."""
    found = sorted(some([*times], nothing))
    longest_s, number = found[int(share * (len(found) - 1))]
    figure = 1e3 * longest_s
    return at_most(1e3 * most_s, figure, "ms", said.format(figure), [number])


class Begun(Timed, Protocol):
    """A received item, possibly in pieces."""

    @property
    def begun_s(self) -> float:
        """Arrival of its first bytes."""


WHOLE_WITHIN_S = 0.0005


def not_torn(found: Iterable[Begun], good: str) -> Findings:
    """Check if each was complete half a millisecond after its first bytes, except for 1 %."""
    for each in found:
        took_s = each.time_s - each.begun_s
        yield each.number, f"{took_s * 1e3:.1f} ms" if took_s > WHOLE_WITHIN_S else ""
    return Words(good, few=0.01)


STEADY_SHARE = 0.95


def steady(off: Sequence[tuple[float, int]], most: float, unit: str, nothing: str) -> Verdict:
    """Check if 95 % of the items came within `most` of their time. `off` has each item's deviation
    and its event's number."""
    some(off, nothing)
    figure = sorted(error for error, _ in off)[int(STEADY_SHARE * (len(off) - 1))]
    said = f"95 % within {figure:.2f} {unit}"
    late = [number for error, number in off if error > most]
    return met(len(late) <= (1.0 - STEADY_SHARE) * len(off), said, late, figure, unit)
