"""What decoding HID reports gives for those that cannot be used, whatever the device."""

from __future__ import annotations

from typing import NamedTuple

EMPTY = "empty"
UNKNOWN_ID = "of an unknown id"
TOO_SHORT = "too short"
BAD_VALUE = "with an impossible value"


class MalformedReport(NamedTuple):
    """A report that says nothing we can use."""

    reason: str
    """One of a few fixed phrases, fit for counting by."""
    report_id: int
    """-1 for a report without any byte."""
