"""Loads the compiled parts: plain shared libraries, the same for all Pythons."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, c_size_t
from pathlib import Path
from typing import Any

from cardan.errors import CardanError


def advice(distribution: str) -> str:
    """Instructions for a distribution of which a compiled part is missing."""
    return (
        "install a C compiler (Debian: apt-get install gcc libc6-dev) and install "
        f"{distribution} anew, or run tools/native in its sources"
    )


ADVICE = advice("cardan")


class NativePartError(CardanError):
    """A compiled part is missing, cannot be loaded, or was compiled from other sources."""


def load_library(
    path: Path, what: str, layout: str, expected: Sequence[int], distribution: str = "cardan"
) -> Any:
    """The library at `path`, whose function `layout` must give the sizes and offsets `expected`.

    Its functions hold the interpreter's lock: each is far shorter than releasing and acquiring it.
    Raises NativePartError that says what to do.
    """
    todo = advice(distribution)
    if not path.exists():
        raise NativePartError(f"{what} {path.name} is not there: {todo}")
    try:
        loaded: Any = ctypes.PyDLL(str(path))
        function = getattr(loaded, layout)
    except (OSError, AttributeError) as error:
        raise NativePartError(f"{what} cannot be loaded ({error}): {todo}") from None
    function.argtypes, function.restype = (POINTER(POINTER(c_size_t)),), c_size_t
    values = POINTER(c_size_t)()
    count = function(ctypes.byref(values))
    if values[:count] != list(expected):
        raise NativePartError(f"{what} is of other sources: {todo}")
    return loaded
