"""Runs in processes of their own, several at a time: virtual time has the same figures then."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, TypeVar

Found = TypeVar("Found")


def side_by_side(
    function: Callable[..., Found], calls: Iterable[tuple[Any, ...]], at_once: int = 0
) -> list[Found]:
    """Return a module function's results for each call's arguments, in order. `at_once`: calls at
    a time; 0: one per processor. An exception of a call is raised."""
    rows = list(calls)
    count = min(len(rows), at_once or os.cpu_count() or 1)
    if count <= 1:
        return [function(*row) for row in rows]
    # A child of a fork would have the locks of this process's threads.
    with ProcessPoolExecutor(count, get_context("spawn")) as pool:
        return list(pool.map(function, *zip(*rows, strict=True)))
