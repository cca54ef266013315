"""The simulated libHD as seen by a program: HDAPI's functions, frames, errors and scheduler."""

from __future__ import annotations

import ctypes
import itertools
import math
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from ctypes import c_double, c_float, c_int, c_long, c_ubyte
from pathlib import Path
from typing import Any

import pytest

from cardan_omni.peer import library_path
from cardan_omni.protocol import Calibration, Capability, Error, Info, State
from omni_virtual import (
    CHECK_STATUS,
    CONTINUE,
    DONE,
    INFINITE,
    INVALID_HANDLE,
    SIGNATURES,
    LibHD,
    needs_library,
    program,
)

pytestmark = [needs_library, pytest.mark.matrix]

INKWELL = 4
FORCE = int(State.CURRENT_FORCE)


@pytest.fixture
def hd() -> Iterator[LibHD]:
    yield from program()


# --- the interface ---------------------------------------------------------------------------


@pytest.mark.skipif(shutil.which("nm") is None, reason="there is no nm")
def test_the_library_exports_hdapi_and_its_side_channel_and_nothing_else() -> None:
    symbols = subprocess.run(
        ["nm", "-D", "--defined-only", str(library_path())],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert set(re.findall(r" T (\w+)$", symbols, re.MULTILINE)) == set(SIGNATURES)


FLOATS = (c_float, c_double)
READ: list[tuple[int, int, tuple[type, ...]]] = [
    (State.CURRENT_BUTTONS, 1, (c_int,)),
    (State.CURRENT_SAFETY_SWITCH, 1, (c_ubyte,)),
    (State.CURRENT_INKWELL_SWITCH, 1, (c_ubyte,)),
    (State.CURRENT_ENCODER_VALUES, 6, (c_long,)),
    (State.CURRENT_POSITION, 3, FLOATS),
    (State.CURRENT_VELOCITY, 3, FLOATS),
    (State.CURRENT_TRANSFORM, 16, FLOATS),
    (State.CURRENT_ANGULAR_VELOCITY, 3, FLOATS),
    (State.CURRENT_JOINT_ANGLES, 3, FLOATS),
    (State.CURRENT_GIMBAL_ANGLES, 3, FLOATS),
    (State.LAST_BUTTONS, 1, (c_int,)),
    (State.LAST_SAFETY_SWITCH, 1, (c_ubyte,)),
    (State.LAST_INKWELL_SWITCH, 1, (c_ubyte,)),
    (State.LAST_ENCODER_VALUES, 6, (c_long,)),
    (State.LAST_POSITION, 3, FLOATS),
    (State.LAST_VELOCITY, 3, FLOATS),
    (State.LAST_TRANSFORM, 16, FLOATS),
    (State.LAST_ANGULAR_VELOCITY, 3, FLOATS),
    (State.LAST_JOINT_ANGLES, 3, FLOATS),
    (State.LAST_GIMBAL_ANGLES, 3, FLOATS),
    (State.CURRENT_FORCE, 3, FLOATS),
    (State.CURRENT_TORQUE, 3, FLOATS),
    (State.CURRENT_JOINT_TORQUE, 3, FLOATS),
    (State.CURRENT_GIMBAL_TORQUE, 3, FLOATS),
    (State.CURRENT_MOTOR_DAC_VALUES, 3, (c_long,)),
    (State.LAST_FORCE, 3, FLOATS),
    (State.LAST_TORQUE, 3, FLOATS),
    (State.LAST_JOINT_TORQUE, 3, FLOATS),
    (State.LAST_GIMBAL_TORQUE, 3, FLOATS),
    (State.LAST_MOTOR_DAC_VALUES, 3, (c_long,)),
    (State.USER_STATUS_LIGHT, 1, (c_int,)),
    (Info.DEVICE_FIRMWARE_VERSION, 1, (c_double,)),
    (Info.MAX_WORKSPACE_DIMENSIONS, 6, (c_double,)),
    (Info.USABLE_WORKSPACE_DIMENSIONS, 6, (c_double,)),
    (Info.TABLETOP_OFFSET, 1, (c_float,)),
    (Info.INPUT_DOF, 1, (c_int,)),
    (Info.OUTPUT_DOF, 1, (c_int,)),
    (Info.CALIBRATION_STYLE, 1, (c_int,)),
    (Info.UPDATE_RATE, 1, (c_int,)),
    (Info.INSTANTANEOUS_UPDATE_RATE, 1, (c_int,)),
    (Info.NOMINAL_MAX_STIFFNESS, 1, (c_double,)),
    (Info.NOMINAL_MAX_FORCE, 1, (c_double,)),
    (Info.NOMINAL_MAX_CONTINUOUS_FORCE, 1, (c_double,)),
    (Info.MOTOR_TEMPERATURE, 3, (c_double,)),
    (Info.SOFTWARE_VELOCITY_LIMIT, 1, (c_double,)),
    (Info.SOFTWARE_FORCE_IMPULSE_LIMIT, 1, (c_double,)),
    (Info.FORCE_RAMPING_RATE, 1, (c_double,)),
    (Info.NOMINAL_MAX_DAMPING, 1, (c_double,)),
    (Info.NOMINAL_MAX_TORQUE_STIFFNESS, 1, (c_double,)),
    (Info.NOMINAL_MAX_TORQUE_DAMPING, 1, (c_double,)),
    (Info.NOMINAL_MAX_TORQUE_FORCE, 1, (c_double,)),
    (Info.NOMINAL_MAX_TORQUE_CONTINUOUS_FORCE, 1, (c_double,)),
]


def test_each_value_has_its_types_and_its_count(hd: LibHD) -> None:
    hd.init()
    mark = 77
    for name, count, types in READ:
        for type_ in (c_ubyte, c_int, c_float, c_double, c_long):
            room = (type_ * 20)(*[mark] * 20)
            kind = {c_ubyte: "Boolean", c_int: "Integer", c_float: "Float"}.get(type_)
            kind = kind or ("Double" if type_ is c_double else "Long")
            getattr(hd, f"hdGet{kind}v")(int(name), room)
            if type_ in types:
                assert hd.errors() == [], hex(name)
                assert list(room[count:]) == [mark] * (20 - count), hex(name)
                assert mark not in room[:count], hex(name)
            else:
                assert hd.errors() == [Error.INVALID_INPUT_TYPE], (hex(name), type_)
                assert list(room) == [mark] * 20
        assert hd.hdGetString(int(name)) is None
        assert hd.errors() == [Error.INVALID_INPUT_TYPE]


def test_what_an_omni_has_not_is_an_invalid_name(hd: LibHD) -> None:
    hd.init()
    for name in (
        State.CURRENT_PINCH_VALUE,
        State.CURRENT_JACOBIAN,
        State.JOINT_ANGLE_REFERENCES,
        0x1234,
    ):
        hd.get(int(name))
        assert hd.errors() == [Error.INVALID_ENUM]
    hd.hdGetString(0x1234)
    assert hd.errors() == [Error.INVALID_ENUM]
    hd.hdEnable(0x1234)
    assert hd.hdIsEnabled(0x1235) == 0
    assert hd.errors() == [Error.INVALID_ENUM] * 2
    hd.set(int(State.CURRENT_POSITION), 1.0, 2.0, 3.0)
    assert hd.errors() == [Error.INVALID_ENUM]
    hd.set(FORCE, 1, 2, 3, type_=c_long)
    assert hd.errors() == [Error.INVALID_INPUT_TYPE]
    hd.hdGetDoublev(int(State.CURRENT_POSITION), None)
    assert hd.errors() == [Error.INVALID_VALUE]


def test_the_device_says_what_it_is(hd: LibHD) -> None:
    hd.init('model "Touch"', "serial 4711")
    assert hd.hdGetString(int(Info.DEVICE_MODEL_TYPE)) == b"Touch"
    assert hd.hdGetString(int(Info.DEVICE_SERIAL_NUMBER)) == b"4711"
    assert hd.get1(0x2602) == 0.5  # stiffness, N/mm
    assert hd.get1(0x2603) == 3.3  # force, N
    assert hd.get1(0x2604) == 0.88  # continuous force, N
    assert hd.get(int(Info.USABLE_WORKSPACE_DIMENSIONS), 6) == [-80, -60, -35, 80, 60, 35]
    assert hd.get(int(Info.MAX_WORKSPACE_DIMENSIONS), 6) == [-210, -110, -85, 210, 205, 130]
    assert [hd.get1(int(n), c_int) for n in (Info.INPUT_DOF, Info.OUTPUT_DOF)] == [6, 3]
    assert hd.get1(int(Info.CALIBRATION_STYLE), c_int) == INKWELL
    for name in (Info.VERSION, Info.DEVICE_VENDOR, Info.DEVICE_DRIVER_VERSION):
        assert hd.hdGetString(int(name))
    assert hd.errors() == []


# --- errors ----------------------------------------------------------------------------------


def test_errors_come_newest_first_with_handle_and_internal_code(hd: LibHD) -> None:
    handle = hd.init()
    hd.hdEnable(1)
    hd.hdEndFrame(handle)
    hd.simFault(b"comm-error", 1)
    hd.hdBeginFrame(handle)
    hd.hdEndFrame(handle)
    newest = hd.hdGetError()
    assert (newest.code, newest.internal, newest.handle) == (Error.COMM_ERROR, -28, handle)
    assert hd.errors() == [Error.ILLEGAL_END, Error.INVALID_ENUM]
    assert hd.hdGetError().code == Error.SUCCESS


def test_a_flood_of_errors_keeps_the_newest(hd: LibHD) -> None:
    handle = hd.init()
    for _ in range(1000):
        hd.hdEnable(1)
    hd.hdEndFrame(handle)
    errors = hd.errors()
    assert errors[0] == Error.ILLEGAL_END
    assert 16 <= len(errors) < 1000


def test_every_error_has_its_own_words(hd: LibHD) -> None:
    texts = {bytes(hd.hdGetErrorString(int(error))) for error in Error}
    assert len(texts) == len(Error)
    assert hd.hdGetErrorString(0x7777)


# --- devices ---------------------------------------------------------------------------------


def test_a_handle_may_be_zero_and_a_second_init_fails(hd: LibHD) -> None:
    assert hd.init() == 0
    assert hd.hdInitDevice(None) == INVALID_HANDLE
    assert hd.errors() == [Error.DEVICE_ALREADY_INITIATED]
    assert hd.hdGetCurrentDevice() == 0
    hd.hdMakeCurrentDevice(5)
    hd.hdBeginFrame(5)
    hd.hdEndFrame(5)
    assert hd.errors() == [Error.BAD_HANDLE] * 3
    hd.hdDisableDevice(0)
    hd.hdDisableDevice(0)
    assert hd.errors() == [Error.BAD_HANDLE]
    assert hd.hdGetCurrentDevice() == INVALID_HANDLE
    hd.get(int(State.CURRENT_POSITION))
    assert hd.errors() == [Error.INVALID_OPERATION] * 2
    hd.handle = hd.hdInitDevice(b"Default PHANToM")
    assert hd.handle != INVALID_HANDLE
    hd.hdBeginFrame(0)  # the old one
    assert hd.errors() == [Error.BAD_HANDLE]


def test_before_any_init_the_current_device_is_the_handle_that_the_first_one_gets(
    hd: LibHD,
) -> None:
    """pyOpenHaptics queries the handle before it initializes, and takes a different handle
    afterwards for a device that another program has opened."""
    hd.configure("")
    current = hd.hdGetCurrentDevice()
    assert hd.errors() == [Error.INVALID_OPERATION]
    assert hd.init() == current == 0
    assert hd.hdGetCurrentDevice() == current
    assert hd.errors() == []


def test_only_known_names_are_devices(hd: LibHD) -> None:
    hd.configure("device left hand")
    assert hd.hdInitDevice(b"right hand") == INVALID_HANDLE
    assert hd.errors() == [Error.DEVICE_FAULT]
    for name in (None, b"Default Device", b"Default PHANToM", b"left hand"):
        handle = hd.hdInitDevice(name)
        assert handle != INVALID_HANDLE
        hd.hdDisableDevice(handle)
    assert hd.errors() == []


@pytest.mark.parametrize(
    ("fault", "error", "internal"),
    [
        ("init-fails 0x303", Error.COMM_CONFIG_ERROR, 0),
        ("init-fails 770", Error.COMM_ERROR, -28),
        ("comm-error 1", Error.COMM_ERROR, -28),
        ("unplug 1", Error.DEVICE_FAULT, 0),
        ("no-license 1", Error.INVALID_LICENSE, 0),
    ],
)
def test_initializing_fails_as_asked(hd: LibHD, fault: str, error: int, internal: int) -> None:
    hd.configure(f"fault {fault}")
    assert hd.hdInitDevice(None) == INVALID_HANDLE
    info = hd.hdGetError()
    assert (info.code, info.internal, info.handle) == (error, internal, INVALID_HANDLE)


def test_a_deployment_license_is_for_before(hd: LibHD) -> None:
    hd.configure("fault no-license 1")
    assert hd.hdDeploymentLicense(b"", b"app", b"secret") == 0
    assert hd.errors() == [Error.INVALID_LICENSE]
    assert hd.hdDeploymentLicense(b"me", b"app", b"secret") == 1
    hd.handle = hd.hdInitDevice(None)
    assert hd.handle != INVALID_HANDLE
    assert hd.hdDeploymentLicense(b"me", b"app", b"secret") == 0
    assert hd.errors() == [Error.INVALID_OPERATION]


def test_the_status_light_and_limits_take_what_they_can(hd: LibHD) -> None:
    hd.init()
    light = int(State.USER_STATUS_LIGHT)
    hd.set(light, 5, type_=c_int)
    assert hd.get1(light, c_int) == 5
    hd.set(light, 8, type_=c_int)
    hd.set(int(Info.SOFTWARE_VELOCITY_LIMIT), -1.0)
    hd.set(int(Info.FORCE_RAMPING_RATE), float("nan"))
    assert hd.errors() == [Error.INVALID_VALUE] * 3
    hd.set(int(Info.SOFTWARE_VELOCITY_LIMIT), 350.0)
    assert hd.get1(int(Info.SOFTWARE_VELOCITY_LIMIT)) == pytest.approx(350.0)
    hd.hdEnable(light)
    assert hd.hdIsEnabled(light) == 1
    assert hd.errors() == []


# --- frames ----------------------------------------------------------------------------------


def test_frames_without_a_scheduler_follow_each_other(hd: LibHD) -> None:
    handle = hd.init()
    for _ in range(3):
        hd.hdBeginFrame(handle)
        hd.hdEndFrame(handle)
    assert hd.errors() == []


def test_a_tick_has_one_frame_which_may_nest(hd: LibHD) -> None:
    handle = hd.init()
    seen = []

    def twice() -> None:
        hd.hdBeginFrame(handle)
        hd.set(FORCE, 0.1, 0.2, 0.3)
        hd.hdBeginFrame(handle)  # within: no new frame
        seen.append(hd.get(FORCE))
        hd.hdEndFrame(handle)
        hd.hdEndFrame(handle)
        hd.hdBeginFrame(handle)
        hd.hdEndFrame(handle)
        seen.append(hd.errors())

    hd.schedule(twice)
    hd.hdStartScheduler()
    hd.simStep(1)
    assert seen == [[0.1, 0.2, 0.3], [Error.ILLEGAL_END, Error.ILLEGAL_BEGIN]]
    hd.hdDisable(int(Capability.ONE_FRAME_LIMIT))
    hd.simStep(1)
    assert seen[-1] == []


def test_force_is_set_in_frames_only_and_is_zero_at_each_begin(hd: LibHD) -> None:
    handle = hd.init()
    hd.set(FORCE, 1.0, 0.0, 0.0)
    hd.set(int(State.CURRENT_MOTOR_DAC_VALUES), 1, 0, 0, type_=c_long)
    assert hd.errors() == [Error.FRAME_ERROR] * 2
    hd.hdBeginFrame(handle)
    hd.set(FORCE, 1.0, 0.0, 0.0)
    hd.set(FORCE, 0.0, 0.5, 0.0, type_=c_float)  # replaces
    hd.hdEndFrame(handle)
    assert hd.get(FORCE) == [0.0, 0.5, 0.0]
    hd.hdBeginFrame(handle)
    assert hd.get(FORCE) == [0.0, 0.0, 0.0]
    assert hd.get(int(State.LAST_FORCE)) == [0.0, 0.5, 0.0]
    hd.hdEndFrame(handle)
    assert hd.get(int(State.LAST_FORCE)) == [0.0, 0.0, 0.0]


def test_a_frame_left_open_is_closed_by_the_tick(hd: LibHD) -> None:
    handle = hd.init()
    hd.schedule(lambda: hd.hdBeginFrame(handle))
    hd.hdStartScheduler()
    hd.simStep(2)
    assert hd.errors() == [Error.FRAME_ERROR] * 2


def test_current_is_latched_and_last_is_of_the_frame_before(hd: LibHD) -> None:
    handle = hd.init(
        "waypoint 0 0 0 0 0 0 0 1 0 0 0 0 0 400 400 400",
        "waypoint 1 0.05 0 0 0 0 0 1 3 0 0 0 0 400 400 400",
    )
    seen = []
    position, last = int(State.CURRENT_POSITION), int(State.LAST_POSITION)

    def look() -> None:
        before = hd.get(position)
        hd.hdBeginFrame(handle)
        seen.append((before, hd.get(last), hd.get(position)))
        hd.hdEndFrame(handle)

    hd.schedule(look)
    hd.hdStartScheduler()
    hd.simStep(500)
    for (_, _, earlier), (before, previous, _) in itertools.pairwise(seen):
        assert before == earlier == previous
    assert seen[-1][2] != seen[-50][2]
    outside = hd.get(position)
    hd.hdStopScheduler()
    assert hd.get(position) == outside
    assert hd.errors() == []


def test_joint_torque_overrides_force_and_the_converter_overrides_both(hd: LibHD) -> None:
    handle = hd.init()
    hd.hdDisable(int(Capability.FORCE_RAMPING))
    torque = [0.0]

    def both() -> None:
        hd.set(FORCE, 0.0, 2.0, 0.0)
        hd.set(int(State.CURRENT_JOINT_TORQUE), -100.0, 0.0, 0.0)
        if torque[0]:
            hd.set(int(State.CURRENT_MOTOR_DAC_VALUES), 0, 0, 0, type_=c_long)

    hd.servo(both)
    hd.hdStartScheduler()
    hd.simStep(3)
    force = list(hd.truth().delivered_n)
    assert force == pytest.approx([100.0 / 168.35, 0.0, 0.0], abs=0.01)
    assert hd.get(int(State.LAST_JOINT_TORQUE))[0] == pytest.approx(-100.0)
    assert hd.errors() == []
    torque[0] = 1.0  # now with a Cartesian force: not together
    hd.simStep(1)
    assert list(hd.truth().delivered_n) == [0.0, 0.0, 0.0]
    assert hd.errors() == [Error.FORCE_ERROR]
    assert handle == 0


def test_the_converter_alone_drives_the_motors(hd: LibHD) -> None:
    hd.init()
    hd.hdDisable(int(Capability.FORCE_RAMPING))
    hd.servo(lambda: hd.set(int(State.CURRENT_MOTOR_DAC_VALUES), -6000, 0, 0, type_=c_long))
    hd.hdStartScheduler()
    hd.simStep(3)
    assert hd.truth().delivered_n[0] > 0.3
    assert hd.get(int(State.LAST_MOTOR_DAC_VALUES), 3, c_long) == [-6000, 0, 0]
    assert hd.get(int(State.LAST_FORCE))[0] == pytest.approx(hd.truth().delivered_n[0], abs=0.01)
    assert hd.errors() == []


# --- the scheduler ---------------------------------------------------------------------------


def test_callbacks_run_once_a_tick_by_priority_until_done(hd: LibHD) -> None:
    hd.init()
    calls: list[str] = []
    hd.schedule(lambda: calls.append("low"), 0)
    high = hd.schedule(lambda: calls.append("high"), 65535)
    once = hd.schedule(lambda: (calls.append("once"), DONE)[1], 40000)
    assert min(high, once) > 0xFFFFFFFF  # wider than an int
    hd.hdStartScheduler()
    assert calls == []
    assert hd.hdWaitForCompletion(once, CHECK_STATUS) == 1
    hd.simStep(2)
    assert calls == ["high", "once", "low", "high", "low"]
    assert hd.hdWaitForCompletion(once, CHECK_STATUS) == 0
    hd.hdUnschedule(high)
    hd.simStep(1)
    assert calls[5:] == ["low"]
    hd.hdUnschedule(high)
    hd.hdUnschedule(once)
    assert hd.errors() == [Error.INVALID_OPERATION] * 2


def test_synchronous_callbacks_run_here_before_the_start_and_in_callbacks(hd: LibHD) -> None:
    hd.init()
    calls = []
    inner = hd.keep(lambda: (calls.append("inner"), DONE)[1])
    hd.hdScheduleSynchronous(inner, None, 0)
    assert calls == ["inner"]

    def outer() -> int:
        hd.hdScheduleSynchronous(inner, None, 0)
        calls.append("outer")
        return DONE

    hd.schedule(outer)
    hd.hdStartScheduler()
    hd.simStep(1)
    assert calls == ["inner", "inner", "outer"]


def test_a_synchronous_callback_takes_the_ticks_it_needs(hd: LibHD) -> None:
    hd.init()
    hd.hdStartScheduler()
    calls = []

    def thrice() -> int:
        calls.append(hd.truth().ticks)
        return CONTINUE if len(calls) < 3 else DONE

    hd.hdScheduleSynchronous(hd.keep(thrice), None, 0)
    assert calls == [0, 1, 2]


def test_a_synchronous_frame_is_the_only_one_of_its_tick(hd: LibHD) -> None:
    handle = hd.init()
    hd.hdStartScheduler()

    def frame() -> int:
        hd.hdBeginFrame(handle)
        hd.hdEndFrame(handle)
        return DONE

    callback = hd.keep(frame)
    for _ in range(3):  # each waits for a tick of its own
        hd.hdScheduleSynchronous(callback, None, 0)
    assert hd.errors() == []
    hd.servo(lambda: None)
    hd.simStep(1)
    assert hd.errors() == []
    hd.hdScheduleSynchronous(callback, None, 0)
    assert hd.errors() == [Error.ILLEGAL_END, Error.ILLEGAL_BEGIN]


def test_waiting_for_the_end_steps_virtual_time(hd: LibHD) -> None:
    hd.init()
    left = [5]

    def count() -> int:
        left[0] -= 1
        return CONTINUE if left[0] else DONE

    handle = hd.schedule(count)
    hd.hdStartScheduler()
    assert hd.hdWaitForCompletion(handle, INFINITE) == 1
    assert left == [0]
    assert hd.truth().ticks == 5


def test_a_full_scheduler_says_so(hd: LibHD) -> None:
    hd.init()
    body = hd.keep(lambda: DONE)
    handles = [hd.hdScheduleAsynchronous(body, None, 1) for _ in range(64)]
    assert len(set(handles)) == 64
    assert hd.errors() == []
    assert hd.hdScheduleAsynchronous(body, None, 1) == 0
    assert hd.errors() == [Error.SCHEDULER_FULL]
    hd.hdStartScheduler()
    hd.simStep(1)
    assert hd.hdScheduleAsynchronous(body, None, 1) != 0


def test_only_the_rates_of_the_device_are_rates(hd: LibHD) -> None:
    hd.init()
    for rate_hz in (0, 9, 700, 999, 1001, 1332, 3000, 8001, 2**63):
        hd.hdSetSchedulerRate(rate_hz)
        assert hd.errors() == [Error.INVALID_VALUE]
    hd.hdStartScheduler()
    for rate_hz in (400, 500, 727, 889, 1000, 1143, 1333, 1600, 2000, 2667, 4000, 8000):
        hd.hdSetSchedulerRate(rate_hz)
        start_s = hd.simNow()
        assert hd.simStep(rate_hz) == rate_hz
        assert hd.simNow() - start_s == pytest.approx(1.0, rel=1e-6)
        assert hd.get1(int(Info.UPDATE_RATE), c_int) == pytest.approx(rate_hz, rel=0.02)
        assert hd.get1(int(Info.INSTANTANEOUS_UPDATE_RATE), c_int) == rate_hz
    assert hd.errors() == []
    for cycles in range(1, 400):
        hd.hdSetSchedulerRate(math.floor(8000 / cycles + 0.5))
    assert hd.errors() == []


def test_virtual_time_passes_in_steps_alone(hd: LibHD) -> None:
    hd.init()
    assert hd.simStep(5) == 0  # not started
    hd.hdStartScheduler()
    hd.hdStartScheduler()
    assert hd.errors() == [Error.INVALID_OPERATION]
    assert hd.simNow() == 0.0
    assert hd.simStep(5) == 5
    assert hd.simNow() == pytest.approx(0.005)
    assert hd.hdGetSchedulerTimeStamp() == 0.0
    hd.hdStopScheduler()
    assert hd.simStep(5) == 0


def test_the_thread_ticks_in_real_time(hd: LibHD) -> None:
    hd.init(clock="real")
    stamps: list[float] = []
    threads = set()

    def look() -> None:
        stamps.append(hd.hdGetSchedulerTimeStamp())
        threads.add(threading.get_ident())

    servo = hd.servo(look)
    hd.hdStartScheduler()
    done = threading.Event()
    hd.hdScheduleSynchronous(hd.keep(lambda: (done.set(), DONE)[1]), None, 0)
    assert done.is_set()  # blocked until it had run
    deadline_s = time.monotonic() + 10.0
    left = [100]

    def last() -> int:
        left[0] -= 1
        return CONTINUE if left[0] and time.monotonic() < deadline_s else DONE

    finite = hd.schedule(last)
    assert hd.hdWaitForCompletion(finite, INFINITE) == 1
    assert left == [0]
    assert hd.hdWaitForCompletion(servo, CHECK_STATUS) == 1
    assert abs(hd.simNow() - time.monotonic()) < 1.0
    hd.hdUnschedule(servo)
    hd.hdStopScheduler()
    ticks = hd.truth().ticks
    assert ticks >= 100
    assert hd.truth().ticks == ticks
    assert threads.isdisjoint({threading.get_ident()})
    assert all(0.0 <= stamp < 1.0 for stamp in stamps)
    assert hd.errors() == []


# --- calibration -----------------------------------------------------------------------------


def test_a_warm_start_is_calibrated(hd: LibHD) -> None:
    hd.init()
    assert hd.hdCheckCalibration() == Calibration.OK
    assert hd.hdCheckCalibrationStyle() == INKWELL


def test_a_cold_start_needs_the_inkwell_then_an_update_and_the_position_jumps(hd: LibHD) -> None:
    handle = hd.init("powered cold")
    hd.hdStartScheduler()
    position = int(State.CURRENT_POSITION)
    servo = hd.servo(lambda: None)
    hd.simStep(5)
    assert hd.hdCheckCalibration() == Calibration.NEEDS_MANUAL_INPUT
    wrong = hd.get(position)
    assert wrong == pytest.approx([0.0, -65.5, -88.1], abs=0.2)  # assumed to be docked
    hd.hdUpdateCalibration(INKWELL)
    assert hd.errors() == [Error.INVALID_OPERATION]
    hd.hand(docked=True)
    hd.simStep(1500)
    assert hd.truth().docked
    assert hd.get1(int(State.CURRENT_INKWELL_SWITCH), c_ubyte) == 1
    assert hd.hdCheckCalibration() == Calibration.NEEDS_UPDATE
    encoders = int(State.CURRENT_ENCODER_VALUES)
    before, counts = hd.get(position), hd.get(encoders, 6, c_long)[:3]
    for style in (1, 2, 3):
        hd.hdUpdateCalibration(style)
    assert hd.errors() == [Error.INVALID_ENUM, Error.INVALID_OPERATION, Error.INVALID_OPERATION]
    hd.hdUpdateCalibration(INKWELL)
    assert hd.hdCheckCalibration() == Calibration.OK
    hd.simStep(3)
    after = hd.get(position)
    assert hd.get(encoders, 6, c_long)[:3] == counts
    # The velocity filter sees the jump as a motion until it has passed.
    assert max(map(abs, hd.get(int(State.CURRENT_VELOCITY)))) > 1000.0
    hd.simStep(100)
    assert max(map(abs, hd.get(int(State.CURRENT_VELOCITY)))) < 1.0
    assert after == pytest.approx([0.0, -65.5107, -88.1142], abs=0.1)
    assert max(abs(a - b) for a, b in zip(after, before, strict=True)) > 20.0
    assert hd.errors() == []
    assert hd.hdWaitForCompletion(servo, CHECK_STATUS) == 1
    assert handle == 0


def test_without_the_scheduler_there_is_no_calibration(hd: LibHD) -> None:
    hd.init("powered cold", "waypoint 0 0 0 0 0 0 0 1 0 1 0 0 0 200 200 200")
    assert hd.hdCheckCalibration() == Calibration.NEEDS_UPDATE
    hd.hdUpdateCalibration(INKWELL)
    assert hd.errors() == [Error.INVALID_OPERATION]
    assert hd.hdCheckCalibration() == Calibration.NEEDS_UPDATE
    hd.hdStartScheduler()
    hd.hdUpdateCalibration(INKWELL)
    assert hd.errors() == []
    assert hd.hdCheckCalibration() == Calibration.OK


def test_docked_no_force_goes_out_and_leaving_ramps(hd: LibHD) -> None:
    hd.init()
    hd.push_with(0.0, 0.0, 1.0)
    hd.hand(docked=True)
    hd.hdStartScheduler()
    hd.simStep(1500)
    truth = hd.truth()
    assert truth.docked
    assert not truth.amplifier
    assert list(truth.delivered_n) == [0.0] * 3
    hd.hand()
    forces = []
    for _ in range(150):
        hd.simStep(1)
        forces.append(hd.truth().delivered_n[2])
    assert forces[2] < 0.05
    assert max(b - a for a, b in itertools.pairwise(forces)) < 0.015
    assert forces[-1] == pytest.approx(1.0, abs=0.002)


# --- limits ----------------------------------------------------------------------------------


def test_no_force_goes_out_unless_enabled_and_ramps_when_it_does(hd: LibHD) -> None:
    hd.init(force=False)
    hd.push_with(0.0, 1.0, 0.0)
    hd.hdStartScheduler()
    hd.simStep(50)
    assert hd.truth().delivered_n[1] == 0.0
    assert hd.truth().commanded_n[1] == 1.0
    hd.hdEnable(int(Capability.FORCE_OUTPUT))
    forces = []
    for _ in range(200):
        hd.simStep(1)
        forces.append(hd.truth().delivered_n[1])
    rate = hd.get1(int(Info.FORCE_RAMPING_RATE)) * 1e-3
    assert forces[:50] == pytest.approx([rate * (i + 1) for i in range(50)], abs=0.012)
    assert forces[-1] == pytest.approx(1.0, abs=0.001)
    hd.hdStopScheduler()
    assert hd.truth().delivered_n[1] == 0.0


def settled(hd: LibHD, *force_n: float) -> list[float]:
    hd.servo(lambda: hd.set(FORCE, *force_n))
    hd.hdStartScheduler()
    hd.simStep(1000)
    return list(hd.truth().delivered_n)


def test_clamping_keeps_the_direction(hd: LibHD) -> None:
    hd.init()
    hd.hdDisable(int(Info.SOFTWARE_FORCE_IMPULSE_LIMIT))
    assert settled(hd, 3.0, 4.0, 0.0) == pytest.approx([1.98, 2.64, 0.0], abs=0.001)
    assert hd.errors() == []
    assert hd.get(int(State.LAST_FORCE)) == pytest.approx([1.98, 2.64, 0.0])


def test_too_much_force_without_clamping_is_an_error_and_switches_off(hd: LibHD) -> None:
    hd.init()
    hd.hdDisable(int(Info.SOFTWARE_FORCE_IMPULSE_LIMIT))
    hd.hdDisable(int(Capability.MAX_FORCE_CLAMPING))
    force = [0.0, 5.0, 0.0]
    hd.servo(lambda: hd.set(FORCE, *force))
    hd.hdStartScheduler()
    hd.simStep(1)
    assert hd.errors() == [Error.EXCEEDED_MAX_FORCE]
    assert not hd.truth().amplifier
    force[1] = 1.0
    hd.simStep(50)
    assert not hd.truth().amplifier
    hd.simStep(60)
    truth = hd.truth()
    assert truth.amplifier
    assert 0.0 < truth.delivered_n[1] < 0.2  # ramping
    hd.simStep(100)
    assert hd.truth().delivered_n[1] == pytest.approx(1.0, abs=0.002)
    assert hd.errors() == []


def test_a_jump_of_the_force_is_an_error(hd: LibHD) -> None:
    hd.init()
    hd.set(int(Info.SOFTWARE_FORCE_IMPULSE_LIMIT), 0.5)
    force = [0.0, 0.4, 0.0]
    hd.servo(lambda: hd.set(FORCE, *force))
    hd.hdStartScheduler()
    hd.simStep(200)
    assert hd.errors() == []
    force[1] = -0.4
    hd.simStep(1)
    assert hd.errors() == [Error.EXCEEDED_MAX_FORCE_IMPULSE]
    assert list(hd.truth().delivered_n) == [0.0, 0.0, 0.0]


def after_steps(hd: LibHD, *forces_n: float) -> list[int]:
    """Return the errors of these forces, one per tick."""
    hd.init()
    left = list(forces_n)
    hd.servo(lambda: hd.set(FORCE, 0.0, 0.0, left.pop(0) if left else forces_n[-1]))
    hd.hdStartScheduler()
    hd.simStep(len(forces_n))
    return hd.errors()


def test_the_whole_force_in_one_tick_is_too_much_and_a_steady_release_is_not(hd: LibHD) -> None:
    assert after_steps(hd, 0.0, 3.2) == [Error.EXCEEDED_MAX_FORCE_IMPULSE]
    hd.close()
    assert after_steps(hd, *(2.0 - 0.4 * min(abs(i - 5), 5) for i in range(11))) == []
    hd.close()
    assert after_steps(hd, *(0.66 * min(i, 10 - i) for i in range(11))) == []


def test_a_pause_between_two_forces_is_no_time_to_rise_in(hd: LibHD) -> None:
    hd.init()
    ticks: list[int] = []

    def every_tenth() -> None:
        ticks.append(0)
        if len(ticks) % 10 == 0:
            hd.hdBeginFrame(hd.handle)
            hd.set(FORCE, 0.0, 0.0, 3.2)
            hd.hdEndFrame(hd.handle)

    hd.schedule(every_tenth)
    hd.hdStartScheduler()
    hd.simStep(10)
    assert hd.errors() == [Error.EXCEEDED_MAX_FORCE_IMPULSE]


def test_a_late_tick_may_change_the_force_by_so_much_more(hd: LibHD) -> None:
    hd.init("fault late-tick 4")
    forces = [1.5 if i >= 99 else min(0.5 * i, 3.0) for i in range(120)]
    hd.servo(lambda: hd.set(FORCE, 0.0, forces.pop(0), 0.0))
    hd.hdStartScheduler()
    hd.simStep(110)
    assert hd.errors() == []


def test_speed_switches_off_while_it_lasts(hd: LibHD) -> None:
    hd.init("grip 0", "droop 0")
    hd.push_with(0.0, 0.0, 0.1)
    hd.set(int(Info.SOFTWARE_VELOCITY_LIMIT), 200.0)
    hd.hdStartScheduler()
    hd.simStep(20)
    assert hd.truth().amplifier
    hd.simPush((c_double * 3)(1.0, 0.0, 0.0))
    hd.simStep(60)
    assert hd.errors() == [Error.EXCEEDED_MAX_VELOCITY]
    assert not hd.truth().amplifier
    hd.simPush((c_double * 3)())
    hd.simStep(600)
    assert hd.truth().amplifier


def test_not_a_number_is_no_force(hd: LibHD) -> None:
    hd.init()
    force = [0.0, 0.5, 0.0]
    hd.servo(lambda: hd.set(FORCE, *force))
    hd.hdStartScheduler()
    hd.simStep(200)
    force[0] = float("nan")
    hd.simStep(1)
    assert hd.errors() == [Error.FORCE_ERROR]
    assert list(hd.truth().delivered_n) == [0.0] * 3


def test_a_force_lasts_as_long_as_there_are_frames(hd: LibHD) -> None:
    hd.init()
    servo = hd.push_with(0.0, 1.0, 0.0)
    hd.hdStartScheduler()
    hd.simStep(200)
    assert hd.truth().delivered_n[1] == pytest.approx(1.0, abs=0.001)
    hd.hdUnschedule(servo)
    hd.simStep(1)
    assert hd.truth().delivered_n[1] == 0.0


# --- faults ----------------------------------------------------------------------------------


def running(hd: LibHD, *lines: str) -> list[list[float]]:
    """Run a servo that pushes with 0.5 N; return its readings."""
    hd.init(*lines)
    seen: list[list[float]] = []
    values = (c_double * 3)(0.0, 0.5, 0.0)

    def body() -> None:
        hd.hdSetDoublev(FORCE, values)
        seen.append(hd.get(int(State.CURRENT_POSITION)))

    hd.servo(body)
    hd.hdStartScheduler()
    hd.simStep(100)
    assert hd.errors() == []
    return seen


def test_a_comm_error_stops_data_and_force_until_it_ends(hd: LibHD) -> None:
    seen = running(
        hd,
        "waypoint 0 0 0 0 0 0 0 1 0 0 0 0 0 200 200 200",
        "waypoint 1 0.05 0 0 0 0 0 1 0 0 0 0 0 200 200 200",
    )
    assert hd.simFault(b"comm-error", 1) == 0
    hd.simStep(100)
    assert set(hd.errors()) == {Error.COMM_ERROR}
    assert seen[-1] == seen[-99]
    assert list(hd.truth().delivered_n) == [0.0] * 3
    hd.hdCheckCalibration()
    assert hd.errors() == [Error.COMM_ERROR]
    hd.simFault(b"comm-error", 0)
    hd.simStep(200)
    assert hd.errors() == []
    assert seen[-1] != seen[-100]
    assert hd.truth().amplifier


def test_an_unplugged_device_must_be_initialized_and_calibrated_anew(hd: LibHD) -> None:
    running(hd)
    hd.simFault(b"unplug", 1)
    hd.simStep(10)
    assert set(hd.errors()) == {Error.DEVICE_FAULT}
    hd.simFault(b"unplug", 0)
    hd.simStep(10)
    assert set(hd.errors()) == {Error.DEVICE_FAULT}
    hd.hdDisableDevice(hd.handle)
    hd.handle = hd.hdInitDevice(None)
    assert hd.handle not in (0, INVALID_HANDLE)
    assert hd.hdCheckCalibration() == Calibration.NEEDS_MANUAL_INPUT


def test_lost_calibration_shows_and_moves_the_position(hd: LibHD) -> None:
    seen = running(hd)
    hd.simFault(b"uncalibrated", 1)
    assert hd.hdCheckCalibration() == Calibration.NEEDS_MANUAL_INPUT
    hd.simStep(3)
    assert max(abs(a - b) for a, b in zip(seen[-1], seen[-3], strict=True)) > 0.5


def test_over_force_trips_so_often(hd: LibHD) -> None:
    running(hd)
    hd.simFault(b"over-force", 2)
    hd.simStep(1400)
    assert hd.errors() == [Error.EXCEEDED_MAX_FORCE] * 3
    hd.simFault(b"over-force", 0)
    hd.simStep(1000)
    assert hd.errors() == []
    assert hd.truth().amplifier


def test_warm_motors_give_no_force_until_they_have_cooled(hd: LibHD) -> None:
    running(hd)
    hd.simFault(b"warm-motors", 0.95)
    hd.simStep(10)
    assert hd.get(int(Info.MOTOR_TEMPERATURE)) == [0.95] * 3
    assert hd.truth().amplifier
    hd.simFault(b"warm-motors", 1)
    hd.simStep(10)
    assert hd.errors() == [Error.WARM_MOTORS]
    assert not hd.truth().amplifier
    hd.simFault(b"warm-motors", 0.9)
    hd.simStep(10)
    assert not hd.truth().amplifier
    hd.simFault(b"warm-motors", 0)
    hd.simStep(10)
    assert hd.truth().amplifier


def test_a_stuck_encoder_stands(hd: LibHD) -> None:
    running(hd)
    joints, encoders = int(State.CURRENT_JOINT_ANGLES), int(State.CURRENT_ENCODER_VALUES)
    hd.simFault(b"stuck-encoder", 1)
    before = hd.get(joints), hd.get(encoders, 6, c_long)
    hd.hand((0.03, 0.03, 0.0))
    hd.simStep(500)
    after = hd.get(joints), hd.get(encoders, 6, c_long)
    assert after[0][0] == before[0][0]
    assert after[1][0] == before[1][0]
    assert after[1][1] != before[1][1]
    hd.simFault(b"stuck-encoder", 0)
    hd.simStep(5)
    assert hd.get(joints)[0] < before[0][0] - 0.1


def test_buttons_bounce_only_when_they_are_to(hd: LibHD) -> None:
    hd.init()
    levels: list[int] = []
    hd.servo(lambda: levels.append(hd.get1(int(State.CURRENT_BUTTONS), c_int)))
    hd.hdStartScheduler()
    hd.hand(buttons=2)
    hd.simStep(50)
    edges = sum(a != b for a, b in itertools.pairwise(levels))
    assert edges == 1
    assert levels[-1] == 2
    hd.simFault(b"button-bounce", 20)
    hd.hand(buttons=1)
    hd.simStep(50)
    edges = sum(a != b for a, b in itertools.pairwise(levels))
    assert edges > 4
    assert set(levels[-25:]) == {1}


def tick_times(hd: LibHD, fault: str, value: float, ticks: int = 400) -> list[float]:
    hd.init()
    times: list[float] = []
    hd.schedule(lambda: times.append(hd.simNow()))
    hd.hdStartScheduler()
    assert hd.simFault(fault.encode(), value) == 0
    hd.simStep(ticks)
    return [b - a for a, b in itertools.pairwise(times)]


def test_late_ticks_come_late_once_in_a_hundred(hd: LibHD) -> None:
    periods = tick_times(hd, "late-tick", 5.5)
    late = [period for period in periods if period > 0.002]
    assert late == pytest.approx([0.0065] * 4)
    assert min(periods) > 0.0
    assert hd.get1(int(Info.UPDATE_RATE), c_int) == pytest.approx(len(periods) / sum(periods), 0.05)


def test_jitter_stays_in_its_bound_and_does_not_add_up(hd: LibHD) -> None:
    periods = tick_times(hd, "jitter", 300)
    assert max(periods) < 0.0013 + 1e-9
    assert min(periods) > 0.0007 - 1e-9
    assert sum(periods) == pytest.approx(len(periods) * 1e-3, abs=0.0004)


def test_slow_ticks_are_slow(hd: LibHD) -> None:
    assert tick_times(hd, "slow-ticks", 250) == pytest.approx([0.004] * 399)
    assert hd.get1(int(Info.INSTANTANEOUS_UPDATE_RATE), c_int) == 250


def test_an_overrun_shows_in_the_time_stamp_and_delays_the_next_tick(hd: LibHD) -> None:
    stamps: list[float] = []
    hd.init()
    hd.schedule(lambda: stamps.append(hd.hdGetSchedulerTimeStamp()))
    hd.hdStartScheduler()
    hd.simStep(1)
    hd.simFault(b"overrun", 2.5)
    start_s = hd.simNow()
    hd.simStep(10)
    assert stamps == pytest.approx([0.0] + [0.0025] * 10)
    assert hd.simNow() - start_s == pytest.approx(10 * 0.0025, abs=0.003)


def test_a_dead_scheduler_lets_time_pass_without_a_tick(hd: LibHD) -> None:
    seen = running(hd)
    hd.simFault(b"dead-scheduler", 1)
    ticks, now_s = len(seen), hd.simNow()
    assert hd.simStep(50) == 0
    assert len(seen) == ticks
    assert hd.simNow() == pytest.approx(now_s + 0.05)
    assert list(hd.truth().delivered_n) == [0.0] * 3  # the amplifier is not fed
    hd.simFault(b"dead-scheduler", 0)
    assert hd.simStep(5) == 5


def test_planned_faults_begin_and_end_on_time(hd: LibHD) -> None:
    hd.init("fault comm-error 1 0.05", "fault comm-error 0 0.08")
    hd.servo(lambda: None)
    hd.hdStartScheduler()
    hd.simStep(49)
    assert hd.errors() == []
    hd.simStep(51)
    assert 28 <= len(hd.errors()) <= 31


def test_faults_have_names_and_bounds(hd: LibHD) -> None:
    assert hd.simFault(b"sunshine", 1) == -1
    assert b"sunshine" in hd.simProblem()
    assert hd.simFault(b"stuck-encoder", 4) == -1
    assert b"from 1 to 3" in hd.simProblem()


# --- settings --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mass x", ["line 1", "mass", "'x'"]),
        ("\n# a remark\nmas 1", ["line 3", "'mas'"]),
        ("mass 1 2", ["line 1", "mass KG"]),
        ("mass 9", ["from 0.005 to 2"]),
        ("clock lunar", ["'real' or 'virtual'", "'lunar'"]),
        ("seed -1", ["seed", "'-1'"]),
        ("seed 1\nwaypoint 0 0 0", ["line 2", "waypoint T X"]),
        ("waypoint 0 0 0 0 0 0 0 0.5 0 0 0 0 0 1 1 1", ["GRIP", "0.5"]),
        (
            "waypoint 1 0 0 0 0 0 0 1 0 0 0 0 0 1 1 1\nwaypoint 0 0 0 0 0 0 0 1 0 0 0 0 0 1 1 1",
            ["line 2", "goes back"],
        ),
        ("loop 2", ["no waypoint"]),
        ("waypoint 3 0 0 0 0 0 0 1 0 0 0 0 0 1 1 1\nloop 2", ["before the last"]),
        ("fault rain 1", ["'rain'"]),
        ("fault slow-ticks 0.1", ["slow-ticks", "from 1 to 4000"]),
        ("fault slow-ticks", ["fault NAME VALUE"]),
        ('model "Premium"', ["PHANTOM Omni", "Premium"]),
        ("serial", ["serial"]),
        ("mass nan", ["mass", "nan"]),
    ],
)
def test_bad_settings_are_named_and_change_nothing(hd: LibHD, text: str, words: list[str]) -> None:
    hd.configure("serial before")
    assert hd.simConfigure(text.encode()) == -1
    problem = hd.simProblem().decode()
    assert all(word in problem for word in words), problem
    hd.handle = hd.hdInitDevice(None)
    assert hd.hdGetString(int(Info.DEVICE_SERIAL_NUMBER)) == b"before"


def test_settings_are_for_when_no_device_is_initialized_and_forget_all(hd: LibHD) -> None:
    hd.init("seed 3")
    assert hd.simConfigure(b"") == -1
    assert b"hdDisableDevice" in hd.simProblem()
    hd.schedule(lambda: None)
    hd.hdStartScheduler()
    hd.simStep(10)
    hd.simFault(b"comm-error", 1)
    hd.hdEnable(1)
    hd.hdDisableDevice(hd.handle)
    hd.configure()
    assert hd.errors() == []
    assert hd.truth().ticks == 0
    assert hd.simNow() == 0.0
    assert hd.simStep(1) == 0
    assert hd.hdInitDevice(None) == 0
    hd.handle = 0


ENVIRONMENT_PROGRAM = """
import ctypes, sys
hd = ctypes.CDLL(sys.argv[1])
hd.hdInitDevice.restype = ctypes.c_uint
hd.hdGetString.restype = ctypes.c_char_p
handle = hd.hdInitDevice(None)
if handle == 0xFFFFFFFF:
    sys.exit(3)
hd.hdStartScheduler()
hd.simStep(20)
print(hd.hdGetString(0x2504).decode())
"""


def test_a_program_takes_its_settings_from_the_environment(tmp_path: Path) -> None:
    settings, log = tmp_path / "settings", tmp_path / "truth.csv"
    command = [sys.executable, "-c", ENVIRONMENT_PROGRAM, str(library_path())]
    settings.write_text(f"clock virtual\nserial from-file\nlog {log}\n")
    environment = dict(os.environ, CARDAN_OMNI=str(settings))
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=20)
    assert (done.returncode, done.stdout, done.stderr) == (0, "from-file\n", "")
    lines = log.read_text().splitlines()
    assert len(lines) == 21  # a row per tick, although the program stopped nothing
    assert lines[0].startswith("monotonic_s,tick,x_m")
    assert all(len(line.split(",")) == len(lines[0].split(",")) for line in lines)
    settings.write_text("mass heavy\n")
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=20)
    assert done.returncode == 3
    assert "line 1: mass" in done.stderr
    settings.unlink()
    os.mkfifo(settings)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=20)
    assert done.returncode == 3
    assert "it must be a file" in done.stderr


KILLED_PROGRAM = """
import ctypes, sys, time
hd = ctypes.CDLL(sys.argv[1])
hd.hdInitDevice(None)
hd.hdStartScheduler()
time.sleep(0.6)
print(ctypes.CDLL(None).getpid(), flush=True)
time.sleep(30)
"""


def rows_of(log: Path) -> list[dict[str, float]]:
    head, *lines = log.read_text().splitlines()
    names = head.split(",")
    return [dict(zip(names, map(float, line.split(",")), strict=True)) for line in lines]


def test_the_log_of_a_killed_program_lacks_only_its_last_moments(tmp_path: Path) -> None:
    settings, log = tmp_path / "settings", tmp_path / "truth.csv"
    settings.write_text(f"log {log}\n")
    with subprocess.Popen(
        [sys.executable, "-c", KILLED_PROGRAM, str(library_path())],
        env=dict(os.environ, CARDAN_OMNI=str(settings)),
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        before_s = time.monotonic()
        process.kill()
    rows = rows_of(log)  # whole lines, all of them
    assert len(rows) > 100
    # 50 ms, and the delay of the test machine
    assert rows[-1]["monotonic_s"] > before_s - 0.3


def test_in_virtual_time_the_log_comes_as_the_ticks_do(hd: LibHD, tmp_path: Path) -> None:
    log = tmp_path / "truth.csv"
    hd.init(f"log {log}")
    assert rows_of(log) == []
    hd.hdStartScheduler()
    hd.simStep(175)
    assert len(rows_of(log)) >= 125
    hd.hdStopScheduler()
    rows = rows_of(log)
    assert [row["tick"] for row in rows] == [*range(1, 176), 175]  # and the stop
    hd.hdDisableDevice(hd.handle)
    hd.init(f"log {log}")  # anew
    assert rows_of(log) == []


def test_a_log_that_cannot_be_written_is_a_problem_at_once(hd: LibHD, tmp_path: Path) -> None:
    hd.configure("serial before")
    assert hd.simConfigure(f"log {tmp_path}/nowhere/truth.csv".encode()) == -1
    assert b"nowhere/truth.csv: No such file" in hd.simProblem()
    hd.handle = hd.hdInitDevice(None)
    assert hd.hdGetString(int(Info.DEVICE_SERIAL_NUMBER)) == b"before"


def test_two_programs_do_not_write_one_log(hd: LibHD, tmp_path: Path) -> None:
    settings, log = tmp_path / "settings", tmp_path / "truth.csv"
    settings.write_text(f"clock virtual\nlog {log}\n")
    command = [sys.executable, "-c", ENVIRONMENT_PROGRAM, str(library_path())]
    environment = dict(os.environ, CARDAN_OMNI=str(settings))
    hd.configure(f"log {log}")
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=20)
    assert done.returncode == 3
    assert "another program writes its log there" in done.stderr
    hd.configure(f"log {log}")  # The same process may reuse its own log.
    hd.close()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=20)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_disk_that_is_full_ends_the_log_and_nothing_else(hd: LibHD, capfd: Any) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    hd.init("log /dev/full")
    hd.hdStartScheduler()
    assert hd.simStep(300) == 300
    hd.close()
    assert capfd.readouterr().err.count("No space left") == 1


def test_the_log_goes_on_while_ticks_do_not(hd: LibHD, tmp_path: Path) -> None:
    log = tmp_path / "truth.csv"
    running(hd, f"log {log}")
    hd.simFault(b"dead-scheduler", 1)
    hd.simStep(80)
    hd.simFault(b"dead-scheduler", 0)
    hd.simStep(20)
    hd.hdStopScheduler()
    rows = rows_of(log)
    times = [row["monotonic_s"] for row in rows]
    assert all(0.0 <= b - a < 0.0015 for a, b in itertools.pairwise(times))
    dead = [row for row in rows if row["tick"] == 100]
    assert len(dead) >= 80
    forces = [row["delivered_y_n"] for row in dead]
    fed = [force > 0.1 for force in forces]
    assert 24 <= sum(fed) <= 27  # the watchdog of the amplifier
    assert fed == sorted(fed, reverse=True)


def test_the_log_has_the_moment_at_which_the_watchdog_drops_the_force(
    hd: LibHD, tmp_path: Path
) -> None:
    log = tmp_path / "truth.csv"
    running(hd, f"log {log}", "fault slow-ticks 20 0.05")
    hd.hdStopScheduler()
    rows = [row for row in rows_of(log) if row["monotonic_s"] > 0.06]
    drops = [row["monotonic_s"] % 0.05 for row in rows if row["delivered_y_n"] == 0.0]
    forces = {row["delivered_y_n"] > 0.1 for row in rows}
    assert len(drops) > 20
    assert forces == {True, False}
    late = [
        b["monotonic_s"] - a["monotonic_s"]
        for a, b in itertools.pairwise(rows)
        if a["delivered_y_n"]
    ]
    assert late[:20] == pytest.approx([0.025] * 20, abs=1e-3)


def test_the_undocumented_functions_do_no_harm(hd: LibHD) -> None:
    hd.init()
    matrix = (c_double * 16)()
    hd.hdScaleGimbalAngles(1.0, 1.0, 1.0, ctypes.byref(matrix))
    assert list(matrix) == pytest.approx(hd.get(int(State.CURRENT_TRANSFORM), 16), abs=2e-5)
    hd.hdUpdateCalibrationMessage(INKWELL)
    assert hd.errors() == []
    hd.hdUpdateCalibrationMessage(17)
    assert hd.errors() == [Error.INVALID_ENUM]
