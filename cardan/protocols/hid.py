"""Result for HID reports that cannot be decoded, for any device."""

from __future__ import annotations

from typing import NamedTuple

EMPTY = "empty"
UNKNOWN_ID = "of an unknown id"
TOO_SHORT = "too short"
BAD_VALUE = "with an impossible value"


class MalformedReport(NamedTuple):
    """A report that cannot be decoded."""

    reason: str
    """One of a few fixed phrases, suitable for counting."""
    report_id: int
    """Report id; -1 for an empty report."""
