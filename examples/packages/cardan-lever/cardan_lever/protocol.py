r"""Protocol of the lever, as bytes and as values: 50 lines a second, 115200 baud, 8N1.

``L 0.120 -0.030 0.000 1\n``: the letter, deflection forward, to the left and counter-clockwise as
seen from above, each -1..1, and whether the trigger is pulled.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

BAUD = 115200
PERIOD_S = 0.02

_NUMBER = rb"(-?[01]\.\d{3})"
_LINE = re.compile(rb"L %b %b %b ([01])" % (_NUMBER, _NUMBER, _NUMBER))
_LONGEST = 64
"""Largest number of bytes kept without an end of line; all valid lines are shorter."""


class Report(NamedTuple):
    """A line of the lever; deflections are -1..1."""

    forward: float
    left: float
    twist: float
    trigger: bool


def encode(report: Report) -> bytes:
    """Return the line of a report, including its end."""
    forward, left, twist, trigger = report
    return f"L {forward:.3f} {left:.3f} {twist:.3f} {trigger:d}\n".encode()


def decode(line: bytes) -> Report | None:
    """Return the report in a line without its end; None for an invalid line."""
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    forward, left, twist = (float(number) for number in found.groups()[:3])
    if max(abs(forward), abs(left), abs(twist)) > 1.0:
        return None
    return Report(forward, left, twist, found[4] == b"1")


class LineReader:
    """Reader that splits a byte stream into reports. Bytes before the first end of line are
    ignored, because a port is opened in the middle of a line."""

    def __init__(self) -> None:
        self._rest = b""
        self._in_step = False

    def feed(self, data: bytes) -> Iterator[Report | None]:
        """Return the reports completed by `data`; None for an invalid line."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if self._in_step:
                yield decode(line)
            self._in_step = True
        if len(self._rest) > _LONGEST:
            self._rest, self._in_step = b"", False
            yield None
