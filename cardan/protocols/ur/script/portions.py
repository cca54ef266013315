"""Long computing in portions: coroutines that pause now and then, and need no event loop."""

from __future__ import annotations

import types
from collections.abc import Coroutine, Generator
from typing import Any, TypeVar

T = TypeVar("T")


@types.coroutine
def pause() -> Generator[None, None, None]:
    """A portion ends here; `send(None)` goes on with the next."""
    yield


def whole(work: Coroutine[Any, Any, T]) -> T:
    """The result of all portions."""
    while True:
        try:
            work.send(None)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
