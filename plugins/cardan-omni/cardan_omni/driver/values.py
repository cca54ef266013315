"""Inputs and outputs of a tick, packed and unpacked in the layout of tick.h."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from cardan.common.haptics import (
    IDENTITY3,
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
from cardan.errors import CommandError
from cardan.types import NEVER_S, ZERO3, Pose, Quaternion, Vector3
from cardan_omni.driver.structures import CCommand, CFixture, CSample, CSnapshot, Flat, Reader


class StylusSample(NamedTuple):
    """Inputs of the tick from the device at an instant. SI units, hand frame."""

    now_s: float
    position: Vector3 = ZERO3
    """Position of the gimbal's center."""
    velocity: Vector3 = ZERO3
    """Velocity by the library; only the velocity gate uses it."""
    rotation: Matrix3 = IDENTITY3
    joints_rad: Vector3 = ZERO3
    """Angles of turret, thigh and shin, from which joint torques are computed."""
    gimbal_rad: Vector3 = ZERO3
    temperature: float = 0.0
    buttons: int = 0
    """Button levels; bit 0 is button 1."""
    inkwell: bool = False
    calibrated: bool = True
    encoders: tuple[int, int, int, int, int, int] = (0, 0, 0, 0, 0, 0)
    joint_torque: bool = False
    """True if the device is driven by joint torques: their limit counts."""
    unsound: bool = False
    """True if reading failed: only the time is valid."""


class TickDetails(NamedTuple):
    """Values of a snapshot beyond HapticState, for a diagnosis."""

    encoders: tuple[int, int, int, int, int, int]
    """Encoder counts of the library: three of the joints, three of the gimbal."""
    torques_n_m: Vector3
    """Force as torques of the joints."""
    oscillations: int
    errors: int
    """Number of errors of the library that the tick has seen."""
    force_errors: int
    error: int
    """Newest of these errors, a code of HDAPI; 0 before the first."""
    internal_error: int
    realtime: bool | None
    """True if the library's thread has real-time scheduling; None: not requested."""
    finished: bool
    """True if the servo has requested no more ticks."""
    bad_readings: int
    """Number of ticks with an implausible sample."""


STATES = (
    OperatingState.DISABLED,
    OperatingState.ENABLED,
    OperatingState.PAUSED,
    OperatingState.FAULT,
)
"""Operating states by the tick's numbers."""
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
    "paused: the force loop stalled",
    "paused: commands or ticks are too irregular",
    "paused: it oscillated; disengage, or resume",
    "fault: a number was not finite",
    "fault: the stylus moved too fast under force",
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
    "it oscillated: force reduced",
    "limited to stay passive",
    "limited to spare the motors",
    "limited to the largest force",
    "",  # slewing: on its way to zero
)
_NO_VECTOR = (0.0,) * 3
_COMMAND = Flat(CCommand, without="fixtures").struct
_FIXTURE = Flat(CFixture).struct
_SAMPLE = Flat(CSample).struct


def _flat(fixture: Fixture) -> tuple[Any, ...]:
    """Return the numbers of a TickFixture, in order."""
    if isinstance(fixture, Sphere):
        return (0, fixture.inside, *fixture.center, *_NO_VECTOR, *IDENTITY3, *fixture[1:5])
    if isinstance(fixture, Plane):
        return (1, 0, *fixture.point, *fixture.normal, *IDENTITY3, 0.0, *fixture[2:5])
    if isinstance(fixture, Box):
        return (
            2,
            fixture.inside,
            *fixture.center,
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
    raise CommandError(f"{fixture!r} is not a fixture")


def pack_command(buffer: bytearray, command: HapticCommand) -> None:
    """Write `command` as a TickCommand, with its fixtures. Raises struct.error, TypeError or
    OverflowError for invalid numbers."""
    measured, torques, world = command.measured, command.joint_torques_n_m, command.world
    _COMMAND.pack_into(
        buffer,
        0,
        command.sequence,
        command.stamp_s,
        command.engaged,
        len(command.fixtures),
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
        _FIXTURE.pack_into(buffer, at, *_flat(fixture))
        at += _FIXTURE.size


def pack_sample(buffer: bytearray, sample: StylusSample, jacobian: Matrix3) -> None:
    """Write `sample` as a TickSample; `jacobian` in m/rad, row by row."""
    _SAMPLE.pack_into(
        buffer,
        0,
        sample.now_s,
        *sample.position,
        *sample.velocity,
        *sample.rotation,
        *sample.joints_rad,
        *sample.gimbal_rad,
        *jacobian,
        sample.temperature,
        0.0,
        *sample.encoders,
        sample.buttons,
        sample.inkwell,
        sample.calibrated,
        0x5000 if sample.calibrated else 0x5001,
        sample.joint_torque,
        sample.unsound,
    )


def quaternion_of(r: Matrix3) -> Quaternion:
    """Return the quaternion of a rotation matrix; divides by the largest component to lose no
    precision."""
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


def _heard(stamp_s: float) -> float:
    return stamp_s if stamp_s > _TICK_NEVER else NEVER_S


def _pose(stamp_s: float, position: Sequence[float], rotation: Matrix3) -> Pose | None:
    if stamp_s > _TICK_NEVER:
        return Pose(Vector3._make(position), quaternion_of(rotation))
    return None


haptic_state = Reader(
    CSnapshot,
    HapticState,
    {
        "stamp_s": (_heard, ("stamp_s",)),
        "state": (STATES.__getitem__, ("state",)),
        "reason": (_REASONS.__getitem__, ("reason",)),
        "pose": (_pose, ("stamp_s", "position", "rotation")),
        "calibration": (
            lambda code: _CALIBRATIONS.get(code, Calibration.UNKNOWN),
            ("calibration",),
        ),
        "rate_hz": (lambda rate_hz, ticks: rate_hz if ticks else 0.0, ("rate_hz", "ticks")),
    },
    beside=("dropped_commands",),
)
"""Reader of a TickSnapshot for users; dropped commands are counted elsewhere."""

tick_details = Reader(
    CSnapshot,
    TickDetails,
    {"realtime": (lambda word: None if word < 0 else bool(word), ("realtime",))},
)
"""Reader of the remaining values of a TickSnapshot."""
