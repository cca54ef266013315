"""libHD as seen by a program: every function with its types, of the simulated library."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from ctypes import (
    c_char_p,
    c_double,
    c_float,
    c_int,
    c_int32,
    c_long,
    c_ubyte,
    c_uint,
    c_uint64,
    c_ulong,
    c_ushort,
    c_void_p,
)
from pathlib import Path
from typing import Any

import pytest

from cardan_omni.peer import available, library_path

needs_library = pytest.mark.skipif(not available(), reason="the C parts were not compiled")

CALLBACK = ctypes.CFUNCTYPE(c_uint, c_void_p)
DONE, CONTINUE = 0, 1
CHECK_STATUS, INFINITE = 0, 1
INVALID_HANDLE = 0xFFFFFFFF
DEFAULT_PRIORITY = 32767
IMPULSE_N = 0.6
"""Step between two ticks that is too small for the device's impulse limit."""


class ErrorInfo(ctypes.Structure):
    """The struct HDErrorInfo."""

    _fields_ = (("code", c_uint), ("internal", c_int), ("handle", c_uint))


Double3 = c_double * 3


class Truth(ctypes.Structure):
    """The struct SimTruth."""

    _fields_ = (
        ("time_s", c_double),
        ("ticks", c_uint64),
        ("position_m", Double3),
        ("velocity_m_s", Double3),
        ("hand_target_m", Double3),
        ("hand_force_n", Double3),
        ("commanded_n", Double3),
        ("delivered_n", Double3),
        ("delivered_j", c_double),
        ("hand_j", c_double),
        ("lost_j", c_double),
        ("kinetic_j", c_double),
        ("temperature", Double3),
        ("buttons", c_int32),
        ("docked", c_int32),
        ("gripped", c_int32),
        ("amplifier", c_int32),
        ("calibrated", c_int32),
        ("script_done", c_int32),
    )


SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "hdInitDevice": (c_uint, (c_char_p,)),
    "hdDisableDevice": (None, (c_uint,)),
    "hdMakeCurrentDevice": (None, (c_uint,)),
    "hdGetCurrentDevice": (c_uint, ()),
    "hdBeginFrame": (None, (c_uint,)),
    "hdEndFrame": (None, (c_uint,)),
    "hdGetBooleanv": (None, (c_uint, c_void_p)),
    "hdGetIntegerv": (None, (c_uint, c_void_p)),
    "hdGetFloatv": (None, (c_uint, c_void_p)),
    "hdGetDoublev": (None, (c_uint, c_void_p)),
    "hdGetLongv": (None, (c_uint, c_void_p)),
    "hdSetBooleanv": (None, (c_uint, c_void_p)),
    "hdSetIntegerv": (None, (c_uint, c_void_p)),
    "hdSetFloatv": (None, (c_uint, c_void_p)),
    "hdSetDoublev": (None, (c_uint, c_void_p)),
    "hdSetLongv": (None, (c_uint, c_void_p)),
    "hdGetString": (c_char_p, (c_uint,)),
    "hdEnable": (None, (c_uint,)),
    "hdDisable": (None, (c_uint,)),
    "hdIsEnabled": (c_ubyte, (c_uint,)),
    "hdGetError": (ErrorInfo, ()),
    "hdGetErrorString": (c_char_p, (c_uint,)),
    "hdCheckCalibration": (c_uint, ()),
    "hdUpdateCalibration": (None, (c_uint,)),
    "hdCheckCalibrationStyle": (c_uint, ()),
    "hdUpdateCalibrationMessage": (None, (c_uint,)),
    "hdScaleGimbalAngles": (None, (c_double, c_double, c_double, c_void_p)),
    "hdStartScheduler": (None, ()),
    "hdStopScheduler": (None, ()),
    "hdSetSchedulerRate": (None, (c_ulong,)),
    "hdScheduleAsynchronous": (c_ulong, (CALLBACK, c_void_p, c_ushort)),
    "hdScheduleSynchronous": (None, (CALLBACK, c_void_p, c_ushort)),
    "hdUnschedule": (None, (c_ulong,)),
    "hdWaitForCompletion": (c_ubyte, (c_ulong, c_uint)),
    "hdGetSchedulerTimeStamp": (c_double, ()),
    "hdDeploymentLicense": (c_ubyte, (c_char_p, c_char_p, c_char_p)),
    "simConfigure": (c_int, (c_char_p,)),
    "simProblem": (c_char_p, ()),
    "simStep": (c_int, (c_int,)),
    "simNow": (c_double, ()),
    "simTruth": (None, (ctypes.POINTER(Truth),)),
    "simHand": (None, (Double3, Double3, c_int, Double3, c_int, c_int)),
    "simPush": (None, (Double3,)),
    "simFault": (c_int, (c_char_p, c_double)),
}

GETTERS = {
    c_ubyte: "Boolean",
    c_int: "Integer",
    c_float: "Float",
    c_double: "Double",
    c_long: "Long",
}


def load(path: Path) -> ctypes.CDLL:
    """Load the library and declare the types of all its functions."""
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


class LibHD:
    """A program that uses libHD, with the library's functions as attributes."""

    def __init__(self) -> None:
        self._library = load(library_path())
        self._retained: list[Any] = []
        self.handle = INVALID_HANDLE

    def __getattr__(self, name: str) -> Any:
        return getattr(self._library, name)

    def configure(self, *lines: str, clock: str = "virtual") -> None:
        assert self.simConfigure("\n".join((f"clock {clock}", *lines)).encode()) == 0, (
            self.simProblem()
        )

    def init(self, *lines: str, clock: str = "virtual", force: bool = True) -> int:
        """Start a device with these settings."""
        self.configure(*lines, clock=clock)
        self.handle = self.hdInitDevice(None)
        assert self.handle != INVALID_HANDLE
        if force:
            self.hdEnable(0x4000)
        assert self.errors() == []
        return self.handle

    def close(self) -> None:
        self.hdStopScheduler()
        if self.handle != INVALID_HANDLE:
            self.hdDisableDevice(self.handle)
            self.handle = INVALID_HANDLE
        assert self.simConfigure(b"") == 0
        self._retained.clear()

    def errors(self) -> list[int]:
        """Pop all error codes, newest first."""
        return list(iter(lambda: self.hdGetError().code, 0))

    def get(self, name: int, count: int = 3, type_: Any = c_double) -> list[Any]:
        values = (type_ * count)()
        getattr(self, f"hdGet{GETTERS[type_]}v")(name, values)
        return list(values)

    def get1(self, name: int, type_: Any = c_double) -> Any:
        return self.get(name, 1, type_)[0]

    def set(self, name: int, *values: float, type_: Any = c_double) -> None:
        getattr(self, f"hdSet{GETTERS[type_]}v")(name, (type_ * len(values))(*values))

    def schedule(self, body: Callable[[], int | None], priority: int = DEFAULT_PRIORITY) -> int:
        """Schedule a callback that continues unless it returns DONE."""
        callback = self.keep(body)
        return int(self.hdScheduleAsynchronous(callback, None, priority))

    def keep(self, body: Callable[[], int | None]) -> Any:
        def run(_user: object) -> int:
            code = body()
            return CONTINUE if code is None else code

        callback = CALLBACK(run)
        self._retained.append(callback)
        return callback

    def servo(self, body: Callable[[], object]) -> int:
        """Schedule a callback of the highest priority whose body runs within a frame."""

        def run() -> None:
            self.hdBeginFrame(self.handle)
            body()
            self.hdEndFrame(self.handle)

        return self.schedule(run, 65535)

    def push_with(self, *force_n: float) -> int:
        """Schedule a constant force, which is reached after some ticks: see IMPULSE_N."""
        values = Double3()

        def approach() -> None:
            away_n = math.dist(values, force_n)
            part = min(1.0, IMPULSE_N / away_n) if away_n else 1.0
            for i, wanted in enumerate(force_n):
                values[i] = wanted if part == 1.0 else values[i] + part * (wanted - values[i])
            self.hdSetDoublev(0x2700, values)

        return self.servo(approach)

    def truth(self) -> Truth:
        truth = Truth()
        self.simTruth(ctypes.byref(truth))
        return truth

    def hand(
        self,
        target_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        gripped: bool = True,
        push_n: tuple[float, float, float] = (0.0, 0.0, 0.0),
        buttons: int = 0,
        docked: bool = False,
    ) -> None:
        self.simHand(
            Double3(*target_m), Double3(*turn_rad), gripped, Double3(*push_n), buttons, docked
        )


def program() -> Iterator[LibHD]:
    """Generator for a fixture: the library as just loaded, restored afterwards."""
    hd = LibHD()
    hd.close()
    try:
        yield hd
    finally:
        hd.close()
