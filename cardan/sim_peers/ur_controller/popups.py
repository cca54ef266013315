"""Popups of programs; a user at the pendant or a client of the dashboard closes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Popup(NamedTuple):
    """Shown popup."""

    number: int
    title: str
    text: str
    warning: bool
    error: bool
    blocking: bool


class Popups:
    """Open popups; the newest is shown, and closing closes all."""

    def __init__(self, tell: Callable[[Popup], None]) -> None:
        self._tell = tell
        self._count = 0
        self._closed = 0
        self.shown: Popup | None = None

    def show(self, text: str, title: str, warning: bool, error: bool, blocking: bool) -> int:
        """Show a popup; return its number."""
        self._count += 1
        self.shown = Popup(self._count, title, text, warning, error, blocking)
        self._tell(self.shown)
        return self._count

    def close(self) -> None:
        """Close the shown popups."""
        self._closed = self._count
        self.shown = None

    def closed(self, number: int) -> bool:
        """Return True if a popup was closed."""
        return number <= self._closed
