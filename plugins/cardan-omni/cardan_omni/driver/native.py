"""Loads the compiled tick and declares its functions."""

from __future__ import annotations

import ctypes
import functools
from ctypes import c_double, c_int32, c_uint32, c_void_p
from pathlib import Path
from typing import Any

from cardan.common.haptics import Matrix3
from cardan.common.native import NativePartError, load_library
from cardan.errors import DriverError
from cardan.types import Vector3
from cardan_omni.driver.structures import C_MATRIX3, C_VECTOR3, expected_layout


class NativeMissingError(DriverError):
    """The compiled tick is missing, or was compiled from other sources."""


def library_path() -> Path:
    """Return the path of the compiled tick, whether or not it exists."""
    return Path(__file__).with_name("libcardan_omni.so")


def available() -> bool:
    """Return True if the compiled tick exists and can be used."""
    try:
        tick_library()
    except NativeMissingError:
        return False
    return True


@functools.cache
def tick_library() -> Any:
    """Load the compiled tick once. Raises NativeMissingError, which names what to install."""
    try:
        loaded = load_library(
            library_path(), "the compiled tick", "tick_layout", expected_layout(), "cardan-omni"
        )
    except NativePartError as error:
        raise NativeMissingError(str(error)) from None
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
    """Return position (hand frame, m) and Jacobian (m/rad, row by row) of an Omni's three
    joints."""
    position, jacobian = C_VECTOR3(), C_MATRIX3()
    tick_library().omni_kinematics(C_VECTOR3(*joints_rad), position, jacobian)
    x, y, z = position[:]
    a, b, c, d, e, f, g, h, i = jacobian[:]
    return Vector3(x, y, z), (a, b, c, d, e, f, g, h, i)
