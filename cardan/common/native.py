"""Loading of the compiled parts: plain shared libraries, the same for all Pythons."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from ctypes import POINTER, c_char_p, c_size_t, c_void_p, py_object
from pathlib import Path
from typing import Any, TypeVar

import cardan
from cardan.errors import CardanError


def advice(distribution: str) -> str:
    """Return instructions for a distribution with a missing compiled part."""
    return (
        "install a C compiler (Debian: apt-get install gcc libc6-dev) and reinstall "
        f"{distribution}, or run tools/native in its sources"
    )


ADVICE = advice("cardan")


class NativePartError(CardanError):
    """A compiled part is missing, cannot be loaded, or was compiled from other sources."""


def layout_of(*structures: type[ctypes.Structure]) -> list[int]:
    """Return sizes and field offsets of structures, which a library's layout function must
    match."""
    expected = []
    for structure in structures:
        expected.append(ctypes.sizeof(structure))
        expected += [getattr(structure, field[0]).offset for field in structure._fields_]
    return expected


def load_library(
    path: Path, what: str, layout: str, expected: Sequence[int], distribution: str = "cardan"
) -> Any:
    """Load the library at `path`, whose function `layout` must give the sizes and offsets
    `expected`. Its functions hold the interpreter's lock: each is far shorter than releasing and
    acquiring it. Raises NativePartError with advice.
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


def load_own_library(path: Path, what: str, prefix: str, expected: Sequence[int]) -> Any:
    """Load a library of this package: its functions `prefix`_layout and `prefix`_version must match
    this version."""
    loaded = load_library(path, what, f"{prefix}_layout", expected)
    function = getattr(loaded, f"{prefix}_version")
    function.restype, function.argtypes = c_char_p, ()
    version = function().decode()
    if version != cardan.__version__:
        raise NativePartError(
            f"{what} is of version {version}, cardan of {cardan.__version__}: {ADVICE}"
        )
    return loaded


def native_call(library: Any, symbol: str, *held: object) -> Callable[..., Any]:
    """Return the function of the PyMethodDef `symbol`, with its data as `self`. It is called like
    Python's own: a call costs a tenth of that by ctypes."""
    make = ctypes.PYFUNCTYPE(py_object, c_void_p, py_object, py_object)(
        ("PyCFunction_NewEx", ctypes.pythonapi)
    )
    definition = ctypes.addressof(ctypes.c_char.in_dll(library, symbol))
    made: Callable[..., Any] = make(definition, held, __name__)
    return made


_StructureT = TypeVar("_StructureT", bound=ctypes.Structure)


def allotted(kind: type[_StructureT]) -> tuple[_StructureT, bytearray]:
    """Return a structure of zeros, and its memory, of fixed size."""
    memory = bytearray(ctypes.sizeof(kind))
    return kind.from_buffer(memory), memory
