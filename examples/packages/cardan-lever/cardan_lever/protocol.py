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
"""Bytes without the end of a line that are kept: no line of a lever's is longer."""


class Report(NamedTuple):
    """A line of the lever; deflections are -1..1."""

    forward: float
    left: float
    twist: float
    trigger: bool


def encode(report: Report) -> bytes:
    """Return the line of a report, with its end."""
    forward, left, twist, trigger = report
    return f"L {forward:.3f} {left:.3f} {twist:.3f} {trigger:d}\n".encode()


def decode(line: bytes) -> Report | None:
    """Return the report in a line without its end; None: not a line of a lever."""
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    forward, left, twist = (float(number) for number in found.groups()[:3])
    if max(abs(forward), abs(left), abs(twist)) > 1.0:
        return None
    return Report(forward, left, twist, found[4] == b"1")


class LineReader:
    """Makes reports of bytes, however they are cut. A port is opened in the middle of a line, so
    what comes before the first end of one is left out."""

    def __init__(self) -> None:
        self._rest = b""
        self._in_step = False

    def feed(self, data: bytes) -> Iterator[Report | None]:
        """The reports that `data` completes; None for a line that is none of a lever's."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if self._in_step:
                yield decode(line)
            self._in_step = True
        if len(self._rest) > _LONGEST:
            self._rest, self._in_step = b"", False
            yield None
