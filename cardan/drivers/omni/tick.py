"""The compiled tick of the force feedback, and its place in libHD's own thread.

tick.h says what the law is and what it guarantees; this is its face in Python. Nothing here waits
for the tick, and the tick waits for nothing here.
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import math
import struct
import threading
from collections.abc import Mapping
from ctypes import POINTER, c_double, c_int32, c_int64, c_size_t, c_uint32, c_uint64, c_void_p
from pathlib import Path
from typing import Any, NamedTuple

from cardan.drivers.omni.limits import TickLimits, UncheckedLimits
from cardan.errors import CommandError, DriverError
from cardan.haptics import (
    IDENTITY3,
    MAX_FIXTURES,
    Box,
    Calibration,
    Cylinder,
    Fixture,
    HapticCommand,
    HapticState,
    Matrix3,
    OperatingState,
    Plane,
    Sphere,
    Spring,
    Viscous,
)
from cardan.types import NEVER_S, ZERO3, Pose, Quaternion, Vector3

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
"""What the servo needs of libHD, in the order of ServoFunctions."""


class NativeMissingError(DriverError):
    """The compiled tick is not there, or is not the one of these sources."""


class StylusSample(NamedTuple):
    """What the tick needs to know of the device at one instant. SI units, hand frame."""

    now_s: float
    position: Vector3 = ZERO3
    """Of the gimbal's centre."""
    velocity: Vector3 = ZERO3
    """As the library has it: only the velocity gate looks at it."""
    rotation: Matrix3 = IDENTITY3
    joints_rad: Vector3 = ZERO3
    """Turret, thigh, shin: what joint torques are made with."""
    gimbal_rad: Vector3 = ZERO3
    temperature: float = 0.0
    buttons: int = 0
    """Levels, bit 0 is button 1."""
    inkwell: bool = False
    calibrated: bool = True
    encoders: tuple[int, int, int, int, int, int] = (0, 0, 0, 0, 0, 0)
    joint_torque: bool = False
    """The device is driven by joint torques, so their limit counts."""
    unsound: bool = False
    """Readings failed: nothing else in it counts but the time."""


class TickDetails(NamedTuple):
    """What a snapshot has beside HapticState, for a diagnosis."""

    encoders: tuple[int, int, int, int, int, int]
    """Counts as the library has them: three of the joints, three of the gimbal."""
    torques_n_m: Vector3
    """The force as torques of the joints."""
    buzzes: int
    errors: int
    """Of the library, all that the tick has seen."""
    force_errors: int
    error: int
    """The newest of them: a code of HDAPI, 0 before the first."""
    internal_error: int
    realtime: bool | None
    """Whether the library's thread has real-time scheduling; None: not asked for."""
    finished: bool
    """The servo has asked for no more ticks."""
    bad_readings: int
    """Ticks whose sample was unsound."""


# ---------------------------------------------------------------------------------------------
# C


def _structure(name: str, fields: list[tuple[str, Any]]) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": fields})


_V3, _M3 = c_double * 3, c_double * 9
_LIMIT_NAMES: tuple[tuple[str, Any], ...] = (
    ("clamp_n", c_double),
    ("slew_rise_n_s", c_double),
    ("slew_fall_n_s", c_double),
    ("release_s", c_double),
    ("engage_ramp_s", c_double),
    ("engage_below_n", c_double),
    ("hold_s", c_double),
    ("pause_s", c_double),
    ("measured_hold_s", c_double),
    ("velocity_gate_m_s", c_double),
    ("damping_n_s_m", c_double),
    ("velocity_cutoff_hz", c_double),
    ("continuous_n", c_double),
    ("continuous_window_s", c_double),
    ("squeeze_s", c_double),
    ("temperature_limit", c_double),
    ("alpha_max_n_s_m", c_double),
    ("energy_budget_j", c_double),
    ("prediction_error_m", c_double),
    ("leak_s", c_double),
    ("workspace_lower_m", _V3),
    ("workspace_upper_m", _V3),
    ("edge_stiffness_n_m", c_double),
    ("extrapolate_s", c_double),
    ("overrun_gap_s", c_double),
    ("pause_gap_s", c_double),
    ("buzz_window_s", c_double),
    ("buzz_speed_m_s", c_double),
    ("force_error_wait_s", c_double),
    ("torque_limit_n_m", c_double),
    ("lowest_rate_hz", c_double),
    ("engage_ticks", c_int32),
    ("buzz_changes", c_int32),
    ("passivity", c_int32),
)

_Limits = _structure("TickLimits", [*_LIMIT_NAMES, ("unchecked", c_int32)])
_Fixture = _structure(
    "TickFixture",
    [
        ("kind", c_int32),
        ("inside", c_int32),
        ("point", _V3),
        ("axis", _V3),
        ("rotation", _M3),
        ("radius_m", c_double),
        ("stiffness_n_m", c_double),
        ("cap_n", c_double),
        ("damping_n_s_m", c_double),
    ],
)
_Command = _structure(
    "TickCommand",
    [
        ("sequence", c_uint64),
        ("stamp_s", c_double),
        ("engaged", c_int32),
        ("fixture_count", c_int32),
        ("has_measured", c_int32),
        ("has_torques", c_int32),
        ("linear", _M3),
        ("offset", _V3),
        ("rotation", _M3),
        ("force", _V3),
        ("force_scale", c_double),
        ("torques_n_m", _V3),
        ("measured_force", _V3),
        ("measured_stamp_s", c_double),
        ("measured_rate_n_s", _V3),
        ("measured_position", _V3),
        ("measured_stiffness_n_m", c_double),
        ("fixtures", _Fixture * MAX_FIXTURES),
    ],
)
_Sample = _structure(
    "TickSample",
    [
        ("now_s", c_double),
        ("position", _V3),
        ("velocity", _V3),
        ("rotation", _M3),
        ("joints_rad", _V3),
        ("gimbal_rad", _V3),
        ("jacobian", _M3),
        ("temperature", c_double),
        ("cost_s", c_double),
        ("encoders", c_int64 * 6),
        ("buttons", c_int32),
        ("inkwell", c_int32),
        ("calibrated", c_int32),
        ("calibration", c_int32),
        ("by_torque", c_int32),
        ("unsound", c_int32),
    ],
)
_Output = _structure(
    "TickOutput",
    [("force", _V3), ("torques_n_m", _V3), ("torque_mode", c_int32), ("state", c_int32)],
)
_Snapshot = _structure(
    "TickSnapshot",
    [
        ("stamp_s", c_double),
        ("ticks", c_uint64),
        ("state", c_int32),
        ("reason", c_int32),
        ("position", _V3),
        ("velocity", _V3),
        ("rotation", _M3),
        ("joints_rad", _V3),
        ("gimbal_rad", _V3),
        ("commanded", _V3),
        ("force", _V3),
        ("torques_n_m", _V3),
        ("energy_j", c_double),
        ("delivered_j", c_double),
        ("alpha_n_s_m", c_double),
        ("squeeze", c_double),
        ("temperature", c_double),
        ("command_sequence", c_uint64),
        ("command_age_s", c_double),
        ("force_age_s", c_double),
        ("gap_s", c_double),
        ("cost_s", c_double),
        ("rate_hz", c_double),
        ("encoders", c_int64 * 6),
        ("buttons", c_int32),
        ("inkwell", c_int32),
        ("calibrated", c_int32),
        ("calibration", c_int32),
        ("presses", c_uint32 * 2),
        ("late_ticks", c_uint32),
        ("stale_commands", c_uint32),
        ("faults", c_uint32),
        ("buzzes", c_uint32),
        ("errors", c_uint32),
        ("force_errors", c_uint32),
        ("error", c_uint32),
        ("internal_error", c_int32),
        ("realtime", c_int32),
        ("finished", c_int32),
        ("peak_n", c_double),
        ("given_peak_j", c_double),
        ("rendering", c_int32),
        ("bad_readings", c_uint32),
    ],
)
_Functions = _structure("ServoFunctions", [(name, c_void_p) for name in FUNCTIONS])

# The same structures as flat numbers: packing them so is many times faster than field by field.
_COMMAND = struct.Struct("=Qd4i9d3d9d3dd3d3dd3d3dd")
_FIXTURE = struct.Struct("=2i3d3d9d4d")
_SAMPLE = struct.Struct("=d3d3d9d3d3d9dd")
_SAMPLE_REST = struct.Struct("=d6q6i")
_SNAPSHOT = struct.Struct("=dQ2i3d3d9d3d3d3d3d3d5dQ5d6q4i2I7Ii2i2diI")

_STATES = (
    OperatingState.DISABLED,
    OperatingState.ENABLED,
    OperatingState.PAUSED,
    OperatingState.FAULT,
)
_ENABLE, _DISABLE, _PAUSE, _RESUME = range(4)
_TAKEN, _DROPPED = 0, 1
_WRONG = {
    2: "a number in it is not finite",
    3: "a rotation in it is no rotation (orthonormal, determinant +1)",
    4: f"it has more than {MAX_FIXTURES} fixtures",
    5: "a plane's normal or a cylinder's axis is not of length 1",
    6: "a length, stiffness, damping, cap or scale in it is negative",
}
_OF_THE_FUTURE = 8
_TICK_NEVER = -1e300
_CALIBRATIONS = {
    0x5000: Calibration.OK,
    0x5001: Calibration.NEEDS_UPDATE,
    0x5002: Calibration.NEEDS_MANUAL_INPUT,
}
_REASONS = (
    "",
    "not enabled",
    "paused on request",
    "paused: commands stopped coming",
    "paused: the force loop stood still",
    "paused: commands or ticks are too irregular",
    "paused: it buzzed; disengage, or resume",
    "fault: a number was not finite",
    "fault: the stylus flew under force",
    "fault: three force errors of the library within 10 s",
    "fault: the device is lost",
    "fault: the device's readings fail",
    "the motors are not on",
    "the force loop is too slow for force",
    "the device could not be read",
    "not calibrated",
    "the stylus is in its inkwell",
    "no command yet",
    "commands stopped coming",
    "not engaged",
    "the commanded force is too large to engage with: move to where it is small",
    "engaging",
    "the tick was late",
    "waiting after a force error of the library",
    "it buzzed: force reduced",
    "limited to stay passive",
    "limited to spare the motors",
    "limited to the largest force",
    "",  # slewing: on its way there
)


def library_path() -> Path:
    """Where the compiled tick is, or would be."""
    return Path(__file__).with_name("libcardan_omni.so")


def available() -> bool:
    """Whether the compiled tick is there and can be used."""
    try:
        _library()
    except NativeMissingError:
        return False
    return True


@functools.cache
def _library() -> Any:
    path = library_path()
    advice = (
        "install a C compiler (Debian: apt-get install gcc libc6-dev) and install cardan anew, or "
        "run tools/native in its sources"
    )
    if not path.exists():
        raise NativeMissingError(f"the compiled tick {path.name} is not there: {advice}")
    try:
        # PyDLL: each call is far shorter than letting go of the interpreter and taking it back.
        library: Any = ctypes.PyDLL(str(path))
        layout = library.tick_layout
    except (OSError, AttributeError) as error:
        raise NativeMissingError(
            f"the compiled tick cannot be loaded ({error}): {advice}"
        ) from None
    layout.argtypes, layout.restype = (POINTER(POINTER(c_size_t)),), c_size_t
    values = POINTER(c_size_t)()
    count = layout(ctypes.byref(values))
    if values[:count] != _expected_layout():
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
        ("omni_kinematics", None, (_V3, _V3, _M3)),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _expected_layout() -> list[int]:
    expected = []
    for structure in (_Limits, _Fixture, _Command, _Sample, _Output, _Snapshot):
        expected.append(ctypes.sizeof(structure))
        expected += [getattr(structure, field[0]).offset for field in structure._fields_]
    return expected


def kinematics(joints_rad: Vector3) -> tuple[Vector3, Matrix3]:
    """Position (hand frame, m) and Jacobian (m/rad, row by row) of an Omni's three joints."""
    position, jacobian = _V3(), _M3()
    _library().omni_kinematics(_V3(*joints_rad), position, jacobian)
    x, y, z = position[:]
    a, b, c, d, e, f, g, h, i = jacobian[:]
    return Vector3(x, y, z), (a, b, c, d, e, f, g, h, i)


_NO_MATRIX = (0.0,) * 9
_NO_VECTOR = (0.0,) * 3


def _flat(fixture: Fixture) -> tuple[Any, ...]:
    """The numbers of a TickFixture, in order."""
    if isinstance(fixture, Sphere):
        return (0, fixture.inside, *fixture.centre, *_NO_VECTOR, *IDENTITY3, *fixture[1:5])
    if isinstance(fixture, Plane):
        return (1, 0, *fixture.point, *fixture.normal, *IDENTITY3, 0.0, *fixture[2:5])
    if isinstance(fixture, Box):
        return (
            2,
            fixture.inside,
            *fixture.centre,
            *fixture.half_sides_m,
            *fixture.rotation,
            0.0,
            *fixture[2:5],
        )
    if isinstance(fixture, Cylinder):
        return (3, fixture.inside, *fixture.point, *fixture.axis, *IDENTITY3, *fixture[2:6])
    if isinstance(fixture, Spring):
        return (4, 0, *fixture.target, *_NO_VECTOR, *IDENTITY3, 0.0, *fixture[1:4])
    if isinstance(fixture, Viscous):
        return (5, 0, *_NO_VECTOR, *_NO_VECTOR, *IDENTITY3, 0.0, 0.0, fixture[1], fixture[0])
    raise CommandError(f"{fixture!r} is no fixture")


class Tick:
    """The law of the force feedback, compiled.

    One thread steps it: libHD's through a :class:`Servo`, or the caller's own through step(). The
    other methods may be called from any thread. Raises NativeMissingError where it was not
    compiled.
    """

    def __init__(self, limits: TickLimits | None = None) -> None:
        self._library = _library()
        self._writing, self._reading = threading.Lock(), threading.Lock()
        self._command = bytearray(ctypes.sizeof(_Command))
        self._snapshot = bytearray(ctypes.sizeof(_Snapshot))
        self._sample = bytearray(ctypes.sizeof(_Sample))
        self._output = _Output()
        # The buffers' addresses: they live as long as this does.
        self._command_at = _address(self._command)
        self._snapshot_at = _address(self._snapshot)
        self._sample_at = _address(self._sample)
        self._output_at = ctypes.addressof(self._output)
        self._jacobian_of: Vector3 | None = None
        self._jacobian: Matrix3 = _NO_MATRIX
        limits = limits or TickLimits()
        self._pointer = self._library.tick_create(ctypes.byref(_c_limits(limits)))
        if not self._pointer:
            raise DriverError(f"the tick does not take {limits}")
        self.limits = limits
        """What it keeps to now."""

    def set_limits(self, limits: TickLimits) -> None:
        """Keep to `limits` from the next step on."""
        with self._writing:
            if self._library.tick_set_limits(self._open(), ctypes.byref(_c_limits(limits))):
                raise DriverError(f"the tick does not take {limits}")
            self.limits = limits

    def command(self, command: HapticCommand, now_s: float | None = None) -> bool:
        """Render `command` from the next step on; False: it was dropped as stale.

        `now_s`: the time, where the caller knows it; else the newest step's counts. Raises
        CommandError for what is not finite, no rotation, negative where that makes no sense, too
        much, or of a time to come; the command before it then stays.
        """
        count = len(command.fixtures)
        if count > MAX_FIXTURES:
            raise CommandError(f"a haptic command cannot be taken: {_WRONG[4]}")
        measured, torques, world = command.measured, command.joint_torques_n_m, command.world
        with self._writing:
            tick = self._open()
            try:
                _COMMAND.pack_into(
                    self._command,
                    0,
                    command.sequence,
                    command.stamp_s,
                    command.engaged,
                    count,
                    measured is not None,
                    torques is not None,
                    *world.linear,
                    *world.offset,
                    *world.rotation,
                    *command.force,
                    command.force_scale,
                    *(torques or _NO_VECTOR),
                    *(measured.force if measured else _NO_VECTOR),
                    measured.stamp_s if measured else 0.0,
                    *(measured.rate_n_s if measured else _NO_VECTOR),
                    *(measured.position if measured else _NO_VECTOR),
                    measured.stiffness_n_m if measured else 0.0,
                )
                at = _COMMAND.size
                for fixture in command.fixtures:
                    _FIXTURE.pack_into(self._command, at, *_flat(fixture))
                    at += _FIXTURE.size
            except (struct.error, TypeError, OverflowError) as error:
                raise CommandError(f"a haptic command cannot be taken: {error}") from None
            result: int = self._library.tick_command(
                tick, self._command_at, math.nan if now_s is None else now_s
            )
        if result == _OF_THE_FUTURE:
            raise CommandError(
                f"a haptic command cannot be taken: its stamp, {command.stamp_s:.3f} s, is of a "
                "time to come: stamps are of the monotonic clock, time.monotonic()"
            )
        if result > _DROPPED:
            raise CommandError(f"a haptic command cannot be taken: {_WRONG[result]}")
        return result == _TAKEN

    def step(self, sample: StylusSample) -> Vector3:
        """One step of the law, in the caller's time: the force to send, N, hand frame."""
        if sample.joints_rad != self._jacobian_of:
            self._jacobian_of = sample.joints_rad
            self._jacobian = kinematics(sample.joints_rad)[1]
        _SAMPLE.pack_into(
            self._sample,
            0,
            sample.now_s,
            *sample.position,
            *sample.velocity,
            *sample.rotation,
            *sample.joints_rad,
            *sample.gimbal_rad,
            *self._jacobian,
            sample.temperature,
        )
        _SAMPLE_REST.pack_into(
            self._sample,
            _SAMPLE.size,
            0.0,
            *sample.encoders,
            sample.buttons,
            sample.inkwell,
            sample.calibrated,
            0x5000 if sample.calibrated else 0x5001,
            sample.joint_torque,
            sample.unsound,
        )
        self._library.tick_step(self._open(), self._sample_at, self._output_at)
        x, y, z = self._output.force
        return Vector3(x, y, z)

    def snapshot(self) -> HapticState:
        """The newest snapshot, whole. Its maxima are since the one read before."""
        with self._reading:
            tick = self._open()
            self._library.tick_snapshot(tick, self._snapshot_at)
            dropped: int = self._library.tick_dropped(tick)
            v = _SNAPSHOT.unpack_from(self._snapshot)
        ticks, state, reason = v[1], v[2], v[3]
        pose = None
        heard = v[0] > _TICK_NEVER
        if heard:
            pose = Pose(Vector3(*v[4:7]), _quaternion(v[10:19]))
        return HapticState(
            stamp_s=v[0] if heard else NEVER_S,
            ticks=ticks,
            state=_STATES[state],
            reason=_REASONS[reason],
            pose=pose,
            velocity=Vector3(*v[7:10]),
            joints_rad=Vector3(*v[19:22]),
            gimbal_rad=Vector3(*v[22:25]),
            force_commanded=Vector3(*v[25:28]),
            force=Vector3(*v[28:31]),
            energy_j=v[34],
            delivered_j=v[35],
            passivity_damping_n_s_m=v[36],
            squeeze=v[37],
            temperature=v[38],
            command_sequence=v[39],
            command_age_s=v[40],
            force_age_s=v[41],
            gap_s=v[42],
            tick_cost_s=v[43],
            rate_hz=v[44] if ticks else 0.0,
            buttons=v[51],
            inkwell=bool(v[52]),
            calibration=_CALIBRATIONS.get(v[54], Calibration.UNKNOWN),
            presses=(v[55], v[56]),
            late_ticks=v[57],
            stale_commands=v[58],
            faults=v[59],
            peak_n=v[67],
            given_peak_j=v[68],
            rendering=bool(v[69]),
            dropped_commands=dropped,
        )

    def details(self) -> TickDetails:
        """The rest of what snapshot() read last."""
        with self._reading:
            v = _SNAPSHOT.unpack_from(self._snapshot)
        return TickDetails(
            encoders=v[45:51],
            torques_n_m=Vector3(*v[31:34]),
            buzzes=v[60],
            errors=v[61],
            force_errors=v[62],
            error=v[63],
            internal_error=v[64],
            realtime=None if v[65] < 0 else bool(v[65]),
            finished=bool(v[66]),
            bad_readings=v[70],
        )

    @property
    def state(self) -> OperatingState:
        """The operating state now."""
        return _STATES[self._library.tick_state(self._open()) & 0xFF]

    def enable(self) -> None:
        """Let force out, after a fault too. Raises CommandError when paused."""
        self._request(_ENABLE, "enable")

    def disable(self) -> None:
        """No force until enable()."""
        self._request(_DISABLE, "disable")

    def pause(self) -> None:
        """No force until resume(). Raises CommandError unless enabled or paused."""
        self._request(_PAUSE, "pause")

    def resume(self) -> None:
        """Go on after a pause. Raises CommandError unless paused."""
        self._request(_RESUME, "resume")

    def lose(self) -> None:
        """Nothing steps it any more: a latched fault, whatever the state was."""
        self._library.tick_lose(self._open())

    def allow(self, allowed: bool) -> None:
        """Whether the motors are on; they are at first. While they are not it asks for no force,
        and what comes then engages anew: so they are switched at zero force only."""
        self._library.tick_allow(self._open(), allowed)

    def _request(self, verb: int, name: str) -> None:
        if self._library.tick_request(self._open(), verb):
            raise CommandError(f"{name} is not possible in state {self.state.value}")

    def close(self) -> None:
        """Free it. Nothing may step it any more: its Servo must be closed before."""
        with self._writing, self._reading:
            pointer, self._pointer = self._pointer, None
        if pointer:
            self._library.tick_destroy(pointer)

    def _open(self) -> int:
        pointer: int | None = self._pointer
        if not pointer:
            raise DriverError("the tick was closed")
        return pointer


class Servo:
    """The callback for libHD's scheduler, which steps a tick in the library's own thread.

    `functions` are the addresses of libHD's functions by name (FUNCTIONS), `handle` the device's.
    `joint_torque`: drive it by joint torques. `clock`: address of a ``double now(void)`` in s; 0
    is the monotonic clock. `realtime`: the first tick asks for SCHED_FIFO for its thread.
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
        self._library = _library()
        table = _Functions(*(functions[name] for name in FUNCTIONS))
        self._pointer = self._library.servo_create(
            tick._open(), ctypes.byref(table), handle, joint_torque, clock or None, realtime
        )
        if not self._pointer:
            raise DriverError("no memory for the force loop")
        self.tick = tick
        self.callback: int = ctypes.cast(self._library.servo_callback, c_void_p).value or 0
        """Address of the callback, for hdScheduleAsynchronous."""
        self.user: int = self._pointer
        """What it wants as pUserData."""
        _scheduled.add(self)

    def stop(self) -> None:
        """The next tick sends no force and asks for no more."""
        if self._pointer:
            self._library.servo_stop(self._pointer)

    def close(self) -> None:
        """Free it. The callback must not be scheduled any more."""
        pointer, self._pointer = self._pointer, None
        if pointer:
            self._library.servo_destroy(pointer)
        _scheduled.discard(self)


_scheduled: set[Servo] = set()
"""Not closed: libHD may call them, and they their ticks, whether or not anybody else knows them."""


def _quaternion(r: Matrix3) -> Quaternion:
    """Of a rotation matrix; the largest component is found first, so none is lost."""
    w, x, y, z = (
        1.0 + r[0] + r[4] + r[8],
        1.0 + r[0] - r[4] - r[8],
        1.0 - r[0] + r[4] - r[8],
        1.0 - r[0] - r[4] + r[8],
    )
    largest = max(w, x, y, z)
    if w == largest:
        q = (w, r[7] - r[5], r[2] - r[6], r[3] - r[1])
    elif x == largest:
        q = (r[7] - r[5], x, r[1] + r[3], r[2] + r[6])
    elif y == largest:
        q = (r[2] - r[6], r[1] + r[3], y, r[5] + r[7])
    else:
        q = (r[3] - r[1], r[2] + r[6], r[5] + r[7], z)
    size = 2.0 * math.sqrt(largest)
    return Quaternion(q[0] / size, q[1] / size, q[2] / size, q[3] / size)


def _address(buffer: bytearray) -> int:
    return ctypes.addressof((ctypes.c_char * len(buffer)).from_buffer(buffer))


def _c_limits(limits: TickLimits) -> Any:
    values = dataclasses.asdict(limits)
    return _Limits(
        unchecked=isinstance(limits, UncheckedLimits),
        **{
            name: kind(*values[name]) if kind is _V3 else values[name]
            for name, kind in _LIMIT_NAMES
        },
    )
