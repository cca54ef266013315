"""Base of classes that are opened and closed, also by ``with``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import TypeVar

_O = TypeVar("_O", bound="Openable")


class Openable(ABC):
    """``with`` opens it and closes it again."""

    @abstractmethod
    def open(self) -> None:
        """Open it; opening twice is fine."""

    @abstractmethod
    def close(self) -> None:
        """Close it. Never raises; closing twice is fine."""

    def __enter__(self: _O) -> _O:
        self.open()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
