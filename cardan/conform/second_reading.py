"""Cross-check of the codec against an independent description of the protocol: scapy layers, if
the plug-in cardan-dissect is installed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cardan.common.extras import missing_extra
from cardan.common.plugins import entry_points
from cardan.conform.requirements import (
    NOTHING,
    Verdict,
    failed,
    passed,
    some,
)
from cardan.conform.timeline import N

ENTRY_POINT_GROUP = "cardan.second_descriptions"

COMPARED = 60
"""Messages that are read twice, spread over the timeline: scapy takes a millisecond for each."""


def second_description(name: str) -> Any:
    """Return the module of layers of the entry point `name`. Raises ExtraMissingError if it is
    absent, or a package for its import is missing."""
    try:
        for point in entry_points(ENTRY_POINT_GROUP):
            if point.name == name:
                return point.load()
        raise ModuleNotFoundError(f"no second description of {name} is installed")
    except ModuleNotFoundError as error:
        raise missing_extra(
            "a second description of the protocol", "cardan-dissect", "dissect", error
        ) from None


def read_twice(
    found: Sequence[N],
    name: str,
    differs: Callable[[N, Any], str],
    what: str,
    nothing: str = NOTHING,
    compared: int = COMPARED,
) -> Verdict:
    """Check if the layers `name` and the codec decode a sample of `found` alike. `what` is their
    plural noun; `differs` returns the difference in words; empty: none."""
    some(found, nothing)
    layers = second_description(name)
    chosen = found[:: max(1, len(found) // compared)]
    for each in chosen:
        if why := differs(each, layers):
            return failed(why, [each.number])
    return passed(f"{len(chosen)} {what} read twice")


def differing(value: Any, layer: Any, names: Mapping[str, str]) -> str:
    """Return the first field of a codec's named tuple that a layer has with another value, in
    words; empty: none. `names`: layer's name of a field, if it differs."""
    for name, known in value._asdict().items():
        read = getattr(layer, names.get(name, name), known)
        read = read.decode() if isinstance(read, bytes) and isinstance(known, str) else read
        if (tuple(read) if isinstance(known, tuple) else read) != known:
            return f"another {name}"
    return ""


def refused(layers: Any, layer: Any) -> str:
    """Return the reason why the layers refuse a message; empty: they accept it."""
    wrong = layers.malformed(layer)
    return f"the layers refuse it: {wrong}" if wrong is not None else ""
