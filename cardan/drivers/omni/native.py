"""Loads the compiled tick and declares its functions."""

from __future__ import annotations

import ctypes
import functools
from ctypes import POINTER, c_double, c_int32, c_size_t, c_uint32, c_void_p
from pathlib import Path
from typing import Any

from cardan.drivers.omni.structures import C_MATRIX3, C_VECTOR3, expected_layout
from cardan.errors import DriverError
from cardan.haptics import Matrix3
from cardan.types import Vector3


class NativeMissingError(DriverError):
    """The compiled tick is missing, or was compiled from other sources."""


def library_path() -> Path:
    """Path of the compiled tick, whether or not it exists."""
    return Path(__file__).with_name("libcardan_omni.so")


def available() -> bool:
    """Whether the compiled tick is there and can be used."""
    try:
        tick_library()
    except NativeMissingError:
        return False
    return True


@functools.cache
def tick_library() -> Any:
    """The compiled tick, loaded once. Raises NativeMissingError, saying what to install."""
    path = library_path()
    advice = (
        "install a C compiler (Debian: apt-get install gcc libc6-dev) and install cardan anew, or "
        "run tools/native in its sources"
    )
    if not path.exists():
        raise NativeMissingError(f"the compiled tick {path.name} is not there: {advice}")
    try:
        # PyDLL: each call is far shorter than letting go of the interpreter and taking it back.
        loaded: Any = ctypes.PyDLL(str(path))
        layout = loaded.tick_layout
    except (OSError, AttributeError) as error:
        raise NativeMissingError(
            f"the compiled tick cannot be loaded ({error}): {advice}"
        ) from None
    layout.argtypes, layout.restype = (POINTER(POINTER(c_size_t)),), c_size_t
    values = POINTER(c_size_t)()
    count = layout(ctypes.byref(values))
    if values[:count] != expected_layout():
        raise NativeMissingError(f"the compiled tick is of other sources: {advice}")
    for name, result, arguments in (
        ("tick_create", c_void_p, (c_void_p,)),
        ("tick_destroy", None, (c_void_p,)),
        ("tick_set_limits", ctypes.c_int, (c_void_p, c_void_p)),
        ("tick_command", ctypes.c_int, (c_void_p, c_void_p, c_double)),
        ("tick_lose", None, (c_void_p,)),
        ("tick_allow", None, (c_void_p, ctypes.c_int)),
        ("tick_dropped", c_uint32, (c_void_p,)),
        ("tick_request", ctypes.c_int, (c_void_p, ctypes.c_int)),
        ("tick_state", ctypes.c_int, (c_void_p,)),
        ("tick_step", None, (c_void_p, c_void_p, c_void_p)),
        ("tick_snapshot", None, (c_void_p, c_void_p)),
        ("tick_error", None, (c_void_p, c_uint32, c_int32, c_double)),
        ("tick_fatal", None, (c_void_p, c_uint32, c_int32)),
        (
            "servo_create",
            c_void_p,
            (c_void_p, c_void_p, c_uint32, ctypes.c_int, c_void_p, ctypes.c_int),
        ),
        ("servo_destroy", None, (c_void_p,)),
        ("servo_stop", None, (c_void_p,)),
        ("servo_callback", ctypes.c_uint, (c_void_p,)),
        ("omni_kinematics", None, (C_VECTOR3, C_VECTOR3, C_MATRIX3)),
    ):
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


def kinematics(joints_rad: Vector3) -> tuple[Vector3, Matrix3]:
    """Position (hand frame, m) and Jacobian (m/rad, row by row) of an Omni's three joints."""
    position, jacobian = C_VECTOR3(), C_MATRIX3()
    tick_library().omni_kinematics(C_VECTOR3(*joints_rad), position, jacobian)
    x, y, z = position[:]
    a, b, c, d, e, f, g, h, i = jacobian[:]
    return Vector3(x, y, z), (a, b, c, d, e, f, g, h, i)
