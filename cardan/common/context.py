"""Context managers for classes with `open()` and `close()`, which use the two functions as their
``__enter__`` and ``__exit__``."""

from __future__ import annotations

from typing import Protocol, TypeVar


class Openable(Protocol):
    """Object that is opened and closed. Doing either twice is fine; `close()` never raises."""

    def open(self) -> None: ...

    def close(self) -> None: ...


_O = TypeVar("_O", bound=Openable)


def enter(opened: _O) -> _O:
    """Open it, and return it."""
    opened.open()
    return opened


def leave(opened: Openable, *_: object) -> None:
    """Close it; an exception propagates."""
    opened.close()
