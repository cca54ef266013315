"""Recorded requests of programs: :mod:`cardan.recording.replay_requests` repeats them.

A record has the requests that act on the arm, at the moment of their effect, between its ticks:
work before that (inverse kinematics, checks) is not repeated.
"""

from __future__ import annotations

import enum
import json
from typing import Any, NamedTuple


class CommandHeader(NamedTuple):
    """Sender, number and times of a streamed command."""

    owner: str
    """Owner of the stream; empty: nameless."""
    sequence: int | None
    stamp_s: float | None
    """Time of sending by the sender's clock, s."""
    heard_s: float
    """Time of reception, robot's clock, s."""


def _plain(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return value.value
    raise TypeError(f"{type(value).__name__} is not recorded")


_encode = json.JSONEncoder(separators=(",", ":"), default=_plain).encode


def argument_text(*values: Any) -> str:
    """Encode the values of a request as text that reads back to the same bits."""
    return _encode(values)
