"""Loads the compiled servo and declares its functions."""

from __future__ import annotations

import ctypes
import functools
from ctypes import POINTER, c_double, c_int32, c_size_t, c_void_p
from pathlib import Path
from typing import Any

from cardan.common.native import load_own_library
from cardan.gateway.servo.kernel_layout import expected_layout


def library_path() -> Path:
    """Return the path of the compiled servo, whether or not it exists."""
    return Path(__file__).with_name("libcardan_servo.so")


@functools.cache
def kernel_library() -> Any:
    """Return the compiled servo, loaded once. Raises NativePartError, with advice."""
    loaded = load_own_library(library_path(), "the compiled servo", "kernel", expected_layout())
    numbers = POINTER(c_double)
    for name, result, arguments in (
        (
            "kernel_create",
            c_void_p,
            (c_void_p, c_void_p, c_void_p, c_size_t, c_void_p, c_size_t, POINTER(c_int32)),
        ),
        ("kernel_destroy", None, (c_void_p,)),
        ("kernel_state", c_void_p, (c_void_p,)),
        ("kernel_set_tool", c_int32, (c_void_p, numbers, numbers)),
        ("kernel_place", c_int32, (c_void_p, numbers)),
        ("kernel_move_at", c_int32, (c_void_p, numbers)),
        ("kernel_move", c_int32, (c_void_p, c_size_t, c_size_t, c_void_p, c_void_p)),
        ("kernel_tick_joints", c_double, (c_void_p, c_double)),
        ("kernel_brake", None, (c_void_p, c_double)),
        ("kernel_pose", None, (c_void_p,)),
        ("kernel_pose_at", None, (c_void_p,)),
        ("kernel_motion", None, (c_void_p,)),
        ("kernel_status", None, (c_void_p,)),
        ("kernel_keep_past", None, (c_void_p, c_double, c_int32)),
        ("kernel_kinematics", None, (c_void_p, numbers, numbers, numbers, numbers)),
        ("kernel_distances", None, (c_void_p, numbers, numbers, numbers)),
        ("kernel_program", c_int32, (c_void_p,)),
        ("kernel_smallest_eigenvalue", c_double, (numbers, c_int32)),
    ):
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


def numbers(values: Any) -> Any:
    """Convert `values` to a C array of doubles."""
    given = [float(value) for value in values]
    return (ctypes.c_double * len(given))(*given)
