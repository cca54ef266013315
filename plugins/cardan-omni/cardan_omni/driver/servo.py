"""Callback for libHD's scheduler, which steps a tick in the library's own thread."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from ctypes import c_void_p

from cardan.errors import DriverError
from cardan_omni.driver.native import tick_library
from cardan_omni.driver.tick import Tick

FUNCTIONS = (
    "hdBeginFrame",
    "hdEndFrame",
    "hdGetBooleanv",
    "hdGetIntegerv",
    "hdGetDoublev",
    "hdGetLongv",
    "hdSetDoublev",
    "hdCheckCalibration",
    "hdGetError",
)
"""Functions of libHD that the servo calls, in the order of ServoFunctions."""


class _ServoFunctions(ctypes.Structure):
    _fields_ = [(name, c_void_p) for name in FUNCTIONS]


class Servo:
    """Callback for libHD's scheduler, which steps a tick in the library's own thread.

    `functions` are the addresses of libHD's functions by name (FUNCTIONS), `handle` the device's.
    `joint_torque`: drive it by joint torques. `clock`: address of a ``double now(void)`` in s; 0 is
    the monotonic clock. `realtime`: the first tick requests SCHED_FIFO for its thread.
    """

    def __init__(
        self,
        tick: Tick,
        functions: Mapping[str, int],
        handle: int,
        *,
        joint_torque: bool = False,
        clock: int = 0,
        realtime: bool = True,
    ) -> None:
        missing = [name for name in FUNCTIONS if not functions.get(name)]
        if missing:
            raise DriverError(f"the library has no {', '.join(missing)}")
        self._library = tick_library()
        table = _ServoFunctions(*(functions[name] for name in FUNCTIONS))
        self._pointer = self._library.servo_create(
            tick.pointer(), ctypes.byref(table), handle, joint_torque, clock or None, realtime
        )
        if not self._pointer:
            raise DriverError("no memory for the force loop")
        self.tick = tick
        self.callback: int = ctypes.cast(self._library.servo_callback, c_void_p).value or 0
        """Address of the callback, for hdScheduleAsynchronous."""
        self.user: int = self._pointer
        """The callback's pUserData."""
        _scheduled.add(self)

    def stop(self) -> None:
        """Make the next tick send no force and end the loop."""
        if self._pointer:
            self._library.servo_stop(self._pointer)

    def close(self) -> None:
        """Free the servo. The callback must not be scheduled any more."""
        pointer, self._pointer = self._pointer, None
        if pointer:
            self._library.servo_destroy(pointer)
        _scheduled.discard(self)


_scheduled: set[Servo] = set()
"""Servos that are not closed, kept alive with their ticks because libHD may call them."""
