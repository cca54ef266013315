"""Requests of programs as a record has them: :mod:`cardan.recording.replay_requests` repeats them.

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
    """Empty: nameless."""
    sequence: int | None
    stamp_s: float | None
    """By the sender's clock."""
    heard_s: float
    """When it came, the robot's time."""


def _plain(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return value.value
    raise TypeError(f"{type(value).__name__} is not recorded")


_encode = json.JSONEncoder(separators=(",", ":"), default=_plain).encode


def argument_text(*values: Any) -> str:
    """The values of a request, which read back to the same bits."""
    return _encode(values)
