"""Compiled control law of the force feedback; tick.h describes it and its guarantees.

Calls here never wait for a step in progress, and the step never waits for them.
"""

from __future__ import annotations

import ctypes
import math
import struct
import threading

from cardan.common.haptics import MAX_FIXTURES, HapticCommand, HapticState, Matrix3, OperatingState
from cardan.errors import CommandError, DriverError
from cardan.types import Vector3
from cardan_omni.driver.limits import TickLimits
from cardan_omni.driver.native import kinematics, tick_library
from cardan_omni.driver.structures import CCommand, COutput, CSample, CSnapshot, c_limits
from cardan_omni.driver.values import (
    STATES,
    StylusSample,
    TickDetails,
    haptic_state,
    pack_command,
    pack_sample,
    tick_details,
)

_ENABLE, _DISABLE, _PAUSE, _RESUME = range(4)
_TAKEN, _DROPPED = 0, 1
_WRONG = {
    2: "a number in it is not finite",
    3: "a rotation in it is not a rotation (orthonormal, determinant +1)",
    4: f"it has more than {MAX_FIXTURES} fixtures",
    5: "a plane's normal or a cylinder's axis is not of length 1",
    6: "a length, stiffness, damping, cap or scale in it is negative",
}
_STAMP_IN_FUTURE = 8
_NO_MATRIX: Matrix3 = (0.0,) * 9


class Tick:
    """Control law of the force feedback, compiled.

    A single thread steps it: libHD's through a :class:`Servo`, or the caller's through step(). The
    other methods may be called from any thread. Raises NativeMissingError if it was not compiled.
    """

    def __init__(self, limits: TickLimits | None = None) -> None:
        self._library = tick_library()
        self._writing, self._reading = threading.Lock(), threading.Lock()
        self._command = bytearray(ctypes.sizeof(CCommand))
        self._snapshot = bytearray(ctypes.sizeof(CSnapshot))
        self._sample = bytearray(ctypes.sizeof(CSample))
        self._output = COutput()
        # Addresses of the buffers, which live as long as this object.
        self._command_at = _address(self._command)
        self._snapshot_at = _address(self._snapshot)
        self._sample_at = _address(self._sample)
        self._output_at = ctypes.addressof(self._output)
        self._jacobian_of: Vector3 | None = None
        self._jacobian: Matrix3 = _NO_MATRIX
        limits = limits or TickLimits()
        self._pointer = self._library.tick_create(ctypes.byref(c_limits(limits)))
        if not self._pointer:
            raise DriverError(f"the force loop does not accept {limits}")
        self.limits = limits
        """Limits in force."""

    def set_limits(self, limits: TickLimits) -> None:
        """Apply `limits` from the next step on."""
        with self._writing:
            if self._library.tick_set_limits(self.pointer(), ctypes.byref(c_limits(limits))):
                raise DriverError(f"the force loop does not accept {limits}")
            self.limits = limits

    def command(self, command: HapticCommand, now_s: float | None = None) -> bool:
        """Render `command` from the next step on; return False if it is stale and was dropped.
        `now_s`: the present time if the caller knows it; otherwise the newest step's time counts.
        Raises CommandError for values that are not finite, not a rotation, negative where that is
        impossible, too large, or stamped in the future; the previous command then stays in force.
        """
        if len(command.fixtures) > MAX_FIXTURES:
            raise CommandError(f"a haptic command is refused: {_WRONG[4]}")
        with self._writing:
            tick = self.pointer()
            try:
                pack_command(self._command, command)
            except (struct.error, TypeError, OverflowError) as error:
                raise CommandError(f"a haptic command is refused: {error}") from None
            result: int = self._library.tick_command(
                tick, self._command_at, math.nan if now_s is None else now_s
            )
        if result == _STAMP_IN_FUTURE:
            raise CommandError(
                f"a haptic command is refused: its stamp, {command.stamp_s:.3f} s, is in "
                "the future: stamps are of the monotonic clock, time.monotonic()"
            )
        if result > _DROPPED:
            raise CommandError(f"a haptic command is refused: {_WRONG[result]}")
        return result == _TAKEN

    def step(self, sample: StylusSample) -> Vector3:
        """Step the control law at the caller's time; return the force to send, N, hand frame."""
        if sample.joints_rad != self._jacobian_of:
            self._jacobian_of = sample.joints_rad
            self._jacobian = kinematics(sample.joints_rad)[1]
        pack_sample(self._sample, sample, self._jacobian)
        self._library.tick_step(self.pointer(), self._sample_at, self._output_at)
        x, y, z = self._output.force
        return Vector3(x, y, z)

    def snapshot(self) -> HapticState:
        """Return the newest snapshot. Its maxima are since the previous call."""
        with self._reading:
            tick = self.pointer()
            self._library.tick_snapshot(tick, self._snapshot_at)
            dropped: int = self._library.tick_dropped(tick)
            return haptic_state(self._snapshot, dropped)

    def details(self) -> TickDetails:
        """Return the remaining values of the snapshot that snapshot() read last."""
        with self._reading:
            return tick_details(self._snapshot)

    @property
    def state(self) -> OperatingState:
        """Return the present operating state."""
        return STATES[self._library.tick_state(self.pointer()) & 0xFF]

    def enable(self) -> None:
        """Enable force, after a fault too. Raises CommandError when paused."""
        self._request(_ENABLE, "enable")

    def disable(self) -> None:
        """Disable force until enable()."""
        self._request(_DISABLE, "disable")

    def pause(self) -> None:
        """Pause force until resume(). Raises CommandError unless enabled or paused."""
        self._request(_PAUSE, "pause")

    def resume(self) -> None:
        """Resume after a pause. Raises CommandError unless paused."""
        self._request(_RESUME, "resume")

    def lose(self) -> None:
        """Latch a fault, in any state, because nothing steps the tick any more."""
        self._library.tick_lose(self.pointer())

    def allow(self, allowed: bool) -> None:
        """Set whether the motors are on; initially they are. While they are off the tick sends no
        force, and afterwards the force engages by its ramp: motors are switched at zero force only.
        """
        self._library.tick_allow(self.pointer(), allowed)

    def _request(self, verb: int, name: str) -> None:
        if self._library.tick_request(self.pointer(), verb):
            raise CommandError(f"{name} is not possible in state {self.state.value}")

    def close(self) -> None:
        """Free the tick. Nothing may step it any more: its Servo must be closed before."""
        with self._writing, self._reading:
            pointer, self._pointer = self._pointer, None
        if pointer:
            self._library.tick_destroy(pointer)

    def pointer(self) -> int:
        """Return the address of the C structure, for the functions of tick.h. Raises DriverError
        after close()."""
        pointer: int | None = self._pointer
        if not pointer:
            raise DriverError("the tick was closed")
        return pointer


def _address(buffer: bytearray) -> int:
    return ctypes.addressof((ctypes.c_char * len(buffer)).from_buffer(buffer))
