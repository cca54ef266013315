"""Runs in subprocesses, several at a time; in virtual time this does not change the results."""

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
    """Call a module's function with each call's arguments; return the results in order. `at_once`:
    number of parallel calls; 0: one per processor. Re-raises an exception of a call."""
    rows = list(calls)
    count = min(len(rows), at_once or os.cpu_count() or 1)
    if count <= 1:
        return [function(*row) for row in rows]
    # A forked child would inherit locks held by this process's threads.
    with ProcessPoolExecutor(count, get_context("spawn")) as pool:
        return list(pool.map(function, *zip(*rows, strict=True)))
