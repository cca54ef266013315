"""A second description of a protocol, which shares nothing with the codec, as a second judge: scapy
layers, where the plug-in cardan-dissect is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from cardan.common.extras import missing_extra
from cardan.common.plugins import entry_points
from cardan.conform.requirements import NOTHING, Verdict, failed, not_applicable, not_seen, passed
from cardan.conform.timeline import N
from cardan.errors import ExtraMissingError

ENTRY_POINT_GROUP = "cardan.second_descriptions"

COMPARED = 60
"""Messages that are read twice, from all over the timeline: scapy takes a millisecond for one."""


def second_description(name: str) -> Any:
    """The module of layers that the entry point `name` gives. Raises ExtraMissingError where there
    is none, or where it cannot be imported for want of a package."""
    try:
        for point in entry_points(ENTRY_POINT_GROUP):
            if point.name == name:
                return point.load()
        raise ModuleNotFoundError(f"nothing installed describes {name} a second time")
    except ModuleNotFoundError as error:
        raise missing_extra(
            "a second description of the protocol", "cardan-dissect", "dissect", error
        ) from None


def read_twice(
    found: Sequence[N],
    differs: Callable[[N], str],
    what: str,
    nothing: str = NOTHING,
    compared: int = COMPARED,
) -> Verdict:
    """Whether layers and codec read some of `found`, which are called `what`, alike. `differs`
    asks for the layers, and says what they read otherwise; empty: nothing."""
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
