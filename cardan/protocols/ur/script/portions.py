"""Long computations in portions: coroutines with pauses, without an event loop."""

from __future__ import annotations

import types
from collections.abc import Coroutine, Generator
from typing import Any, TypeVar

T = TypeVar("T")


@types.coroutine
def pause() -> Generator[None, None, None]:
    """End a portion; `send(None)` starts the next."""
    yield


def whole(work: Coroutine[Any, Any, T]) -> T:
    """Run all portions and return the result."""
    while True:
        try:
            work.send(None)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
