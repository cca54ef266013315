"""The scapy layers as a second judge, where scapy is installed: a second description of a protocol,
which shares nothing with the codec."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cardan.conform.requirements import NOTHING, Verdict, failed, not_applicable, not_seen, passed
from cardan.conform.timeline import N
from cardan.errors import ExtraMissingError

COMPARED = 60
"""Messages that are read twice, from all over the timeline: scapy takes a millisecond for one."""


def read_twice(
    found: Sequence[N],
    differs: Callable[[N], str],
    what: str,
    nothing: str = NOTHING,
    compared: int = COMPARED,
) -> Verdict:
    """Whether layers and codec read some of `found`, which are called `what`, alike. `differs`
    imports the layers, and says what they read otherwise; empty: nothing."""
    if not found:
        return not_seen(nothing)
    chosen = found[:: max(1, len(found) // compared)]
    try:
        for each in chosen:
            if why := differs(each):
                return failed(why, [each.number])
    except ExtraMissingError as missing:
        return not_applicable(str(missing))
    return passed(f"{len(chosen)} {what} read twice")


def refused(wrong: str | None) -> str:
    """That the layers refuse a message, where they find something `wrong` with it."""
    return f"the layers refuse it: {wrong}" if wrong is not None else ""
