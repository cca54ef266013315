"""Watchdogs of a program on inputs that RTDE has to write in time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

ACTIONS: Final = ("ignore", "pause", "stop")


@dataclass
class _Watchdog:
    period_s: float
    action: str
    fed_s: float


class RtdeWatchdogs:
    """Watchdogs of the running program, by the inputs' names."""

    def __init__(self) -> None:
        self._found: dict[str, _Watchdog] = {}

    def add(self, variable: str, period_s: float, action: str, now_s: float) -> None:
        """Watch an input from now on."""
        self._found[variable] = _Watchdog(period_s, action, now_s)

    def fed(self, variables: Iterable[str], now_s: float) -> None:
        """Feed the watchdogs of inputs that a client has written."""
        if self._found:
            for each in variables:
                if each in self._found:
                    self._found[each].fed_s = now_s

    def clear(self) -> None:
        """Remove all watchdogs at the end of a program."""
        self._found.clear()

    def expired(self, now_s: float) -> tuple[str, str] | None:
        """Return an input that was not written in time, and its action; its time restarts."""
        for name, each in self._found.items():
            if now_s - each.fed_s > each.period_s + 1e-9:
                each.fed_s = now_s
                return name, each.action
        return None
