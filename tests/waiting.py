"""Waiting for what another thread or process does, with a bound."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

WITHIN_S = 40.0
"""A machine with other work to do starts processes slowly."""
PERIOD_S = 0.002

_T = TypeVar("_T")


def until(found: Callable[[], _T], what: str = "it", within_s: float = WITHIN_S) -> _T:
    """What `found` gives, once it gives something that is true."""
    deadline_s = time.monotonic() + within_s
    while not (answer := found()):
        assert time.monotonic() < deadline_s, f"{what} did not happen"
        threading.Event().wait(PERIOD_S)
    return answer
