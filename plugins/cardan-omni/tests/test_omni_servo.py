"""The servo callback in libHD's thread, with fake functions of libHD."""

from __future__ import annotations

import atexit
import ctypes
import functools
import os
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cardan.common.haptics import Calibration, HapticCommand, HapticState, OperatingState, Plane
from cardan.errors import DriverError
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.limits import UncheckedLimits
from cardan_omni.driver.native import kinematics
from cardan_omni.driver.servo import FUNCTIONS, Servo
from cardan_omni.driver.tick import Tick
from cardan_omni.protocol import Error, Info, State

DONE, CONTINUE = 0, 1
OK, NEEDS_UPDATE = 0x5000, 0x5001
HANDLE, OTHER = 7, 8
HAND_FROM_DEVICE = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


GET_ERROR = """
typedef struct { unsigned code; int internal; unsigned device; } Info;
static void (*source)(Info *);
void set_source(void (*given)(Info *)) { source = given; }
Info get_error(void) { Info info = {0, 0, 0}; source(&info); return info; }
"""


@functools.cache
def error_library() -> str:
    """hdGetError returns a structure, which no ctypes callback can."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "error.c").write_text(GET_ERROR)
    made = str(folder / "error.so")
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-o", made, str(folder / "error.c")], check=True, timeout=60
    )
    return made


class Library:
    """The functions of libHD that the servo uses, and a clock."""

    def __init__(self) -> None:
        self.now_s = 50.0
        self.values: dict[int, list[float]] = {
            State.CURRENT_POSITION: [0.0, 0.0, 0.0],
            State.CURRENT_VELOCITY: [0.0, 0.0, 0.0],
            State.CURRENT_TRANSFORM: list(np.eye(4).flatten()),
            State.CURRENT_JOINT_ANGLES: [0.0, 0.742, 0.5531],
            State.CURRENT_GIMBAL_ANGLES: [0.1, 0.2, 0.3],
            Info.MOTOR_TEMPERATURE: [0.1, 0.3, 0.2],
        }
        self.buttons = 0
        self.docked = False
        self.calibration = OK
        self.encoders = [1, 2, 3, 4, 5, 6]
        self.errors: list[tuple[int, ...]] = []
        """Error code, the library's internal code, and the device if it is not HANDLE."""
        self.errors_at_begin: list[tuple[int, ...]] = []
        self.errors_at_end: list[tuple[int, ...]] = []
        self.failing: set[int] = set()
        self.calls: list[str] = []
        self.sent: list[tuple[int, list[float]]] = []
        self.asked: list[int] = []
        uint, doubles = ctypes.c_uint, ctypes.POINTER(ctypes.c_double)
        kinds: dict[str, tuple[Any, ...]] = {
            "hdBeginFrame": (None, uint),
            "hdEndFrame": (None, uint),
            "hdGetBooleanv": (None, uint, ctypes.POINTER(ctypes.c_ubyte)),
            "hdGetIntegerv": (None, uint, ctypes.POINTER(ctypes.c_int)),
            "hdGetDoublev": (None, uint, doubles),
            "hdGetLongv": (None, uint, ctypes.POINTER(ctypes.c_long)),
            "hdSetDoublev": (None, uint, doubles),
            "hdCheckCalibration": (uint,),
        }
        self.retained: list[Any] = []
        self.functions = {
            name: self.address(ctypes.CFUNCTYPE(*kind), getattr(self, name))
            for name, kind in kinds.items()
        }
        side = ctypes.CDLL(error_library())
        take = ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_uint))(self.hdGetError)
        self.retained.append(take)
        side.set_source(take)
        self.functions["hdGetError"] = ctypes.cast(side.get_error, ctypes.c_void_p).value or 0
        self.clock = self.address(ctypes.CFUNCTYPE(ctypes.c_double), lambda: self.now_s)

    def address(self, kind: Any, function: Callable[..., Any]) -> int:
        callback = kind(function)
        self.retained.append(callback)
        return ctypes.cast(callback, ctypes.c_void_p).value or 0

    def hdBeginFrame(self, device: int) -> None:  # noqa: N802
        assert device in (HANDLE, OTHER)
        self.calls.append("begin")
        self.errors += self.errors_at_begin
        self.errors_at_begin = []

    def hdEndFrame(self, device: int) -> None:  # noqa: N802
        assert device in (HANDLE, OTHER)
        self.calls.append("end")
        self.errors += self.errors_at_end
        self.errors_at_end = []

    def hdGetBooleanv(self, name: int, values: Any) -> None:  # noqa: N802
        assert name == State.CURRENT_INKWELL_SWITCH
        values[0] = self.docked

    def hdGetIntegerv(self, name: int, values: Any) -> None:  # noqa: N802
        assert name == State.CURRENT_BUTTONS
        values[0] = self.buttons

    def hdGetDoublev(self, name: int, values: Any) -> None:  # noqa: N802
        self.asked.append(name)
        if name in self.failing:
            self.errors.append((Error.INVALID_OPERATION, 0))
            return
        if name not in self.values:
            self.errors.append((Error.INVALID_ENUM, 0))
            return
        for i, value in enumerate(self.values[name]):
            values[i] = value

    def hdGetLongv(self, name: int, values: Any) -> None:  # noqa: N802
        assert name == State.CURRENT_ENCODER_VALUES
        for i, value in enumerate(self.encoders):
            values[i] = value

    def hdSetDoublev(self, name: int, values: Any) -> None:  # noqa: N802
        self.calls.append("set")
        self.sent.append((name, values[0:3]))

    def hdCheckCalibration(self) -> int:  # noqa: N802
        return self.calibration

    def hdGetError(self, answer: Any) -> None:  # noqa: N802
        code, internal, *device = self.errors.pop() if self.errors else (0, 0)
        answer[0], answer[1] = code, internal & 0xFFFFFFFF
        answer[2] = device[0] if device else HANDLE


class Bench:
    def __init__(self, **options: Any) -> None:
        self.library = Library()
        wide = {"workspace_lower_m": (-1.0,) * 3, "workspace_upper_m": (1.0,) * 3}
        self.tick = Tick(UncheckedLimits(engage_ramp_s=0.0, damping_n_s_m=0.0, **wide))
        self.servo = Servo(
            self.tick,
            self.library.functions,
            HANDLE,
            clock=self.library.clock,
            realtime=False,
            **options,
        )
        callback = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)(self.servo.callback)
        self.callback: Callable[[], int] = lambda: callback(self.servo.user)
        self.sequence = 0
        self.command = HapticCommand(0, 0.0, engaged=True)

    def step(self, ticks: int = 1, **command: Any) -> int:
        answer = -1
        self.command = self.command._replace(**command)
        for _ in range(ticks):
            self.library.now_s += 1e-3
            self.sequence += 1
            self.tick.command(
                self.command._replace(sequence=self.sequence, stamp_s=self.library.now_s)
            )
            answer = self.callback()
        return answer

    def engage(self, **command: Any) -> None:
        self.tick.enable()
        assert self.step(20) == CONTINUE
        assert self.step(60, **command) == CONTINUE

    def close(self) -> None:
        self.servo.close()
        self.tick.close()

    @property
    def state(self) -> HapticState:
        return self.tick.snapshot()

    @property
    def force(self) -> Vector3:
        """Return the force last sent to libHD, in the hand frame."""
        name, values = self.library.sent[-1]
        assert name == State.CURRENT_FORCE
        return Vector3(*(HAND_FROM_DEVICE @ values))


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def test_a_tick_is_one_frame(bench: Bench) -> None:
    bench.step(3)
    assert bench.library.calls == ["begin", "set", "end"] * 3


def test_everything_is_read_into_the_hand_frame(bench: Bench) -> None:
    library = bench.library
    library.values[State.CURRENT_POSITION] = [10.0, 20.0, 30.0]
    library.buttons = 1
    bench.step(3)
    state = bench.state
    assert state.pose is not None
    assert state.pose.position == pytest.approx((-0.03, -0.01, 0.02))
    assert state.joints_rad == (0.0, 0.742, 0.5531)
    assert state.gimbal_rad == (0.1, 0.2, 0.3)
    assert state.temperature == 0.3
    assert state.presses == (1, 0)
    assert state.calibration is Calibration.OK
    assert state.stamp_s == library.now_s
    assert bench.tick.details().encoders == (1, 2, 3, 4, 5, 6)
    assert bench.tick.details().realtime is None


def test_the_conversion_is_a_proper_rotation_both_ways(bench: Bench) -> None:
    """Measured through the servo with three unit displacements and three unit forces."""
    library, columns = bench.library, []
    bench.step()
    for axis in range(3):
        library.values[State.CURRENT_POSITION] = [1000.0 * (i == axis) for i in range(3)]
        bench.step()
        pose = bench.state.pose
        assert pose is not None
        columns.append(pose.position)
    there = np.array(columns).T
    assert there == pytest.approx(HAND_FROM_DEVICE)
    assert np.linalg.det(there) == pytest.approx(1.0)
    library.values[State.CURRENT_POSITION] = [0.0, 0.0, 0.0]
    library.values[State.CURRENT_VELOCITY] = [0.0, 0.0, 0.0]
    bench.step(500)
    bench.tick.set_limits(UncheckedLimits(engage_ramp_s=0.0, damping_n_s_m=0.0))
    bench.engage()
    back = []
    for axis in range(3):
        bench.step(200, force=Vector3(*(float(i == axis) for i in range(3))))
        assert size(bench.state.force) == pytest.approx(1.0)
        back.append(library.sent[-1][1])
    assert pytest.approx(HAND_FROM_DEVICE.T) == np.array(back).T


def size(v: Vector3) -> float:
    return float(np.linalg.norm(v))


def test_a_transform_that_is_nearly_a_rotation_becomes_one(bench: Bench) -> None:
    angle = 0.7
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # about the device's y: up
    skewed = np.eye(4)
    skewed[:3, :3] = turn @ (np.eye(3) + 0.02 * np.array([[1, 2, 0], [0, -1, 1], [1, 0, 1]]))
    bench.library.values[State.CURRENT_TRANSFORM] = list(skewed.T.flatten())
    bench.step()
    pose = bench.state.pose
    assert pose is not None
    q = pose.orientation
    assert sum(x * x for x in q) == pytest.approx(1.0, abs=1e-9)
    expected = (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2))  # about the hand's z: up
    assert abs(float(np.dot(q, expected))) > 0.9995
    bench.library.values[State.CURRENT_TRANSFORM] = [0.0] * 16
    bench.step()
    again = bench.state.pose
    assert again is not None
    assert again.orientation == q, "an invalid rotation is ignored"
    assert bench.state.state is OperatingState.DISABLED


def test_a_wall_in_front_pushes_back_along_the_devices_z(bench: Bench) -> None:
    wall = Plane(Vector3(0.01, 0.0, 0.0), Vector3(-1.0, 0.0, 0.0), 100.0)
    bench.engage(fixtures=(wall,))
    for k in range(200):
        bench.library.values[State.CURRENT_POSITION] = [0.0, 0.0, -0.1 * k]
        bench.step()
    name, values = bench.library.sent[-1]
    assert name == State.CURRENT_FORCE
    assert values == pytest.approx([0.0, 0.0, 0.99], abs=1e-6)


@pytest.mark.parametrize("raw", [True, False])
def test_joint_torques_are_in_millinewton_meters(raw: bool) -> None:
    bench = Bench(joint_torque=not raw)
    try:
        if raw:
            bench.engage(joint_torques_n_m=Vector3(0.02, 0.04, -0.06))
            expected = np.array([20.0, 40.0, -60.0])
        else:
            bench.engage(force=Vector3(0.4, 0.3, -0.5))
            joints = Vector3(*bench.library.values[State.CURRENT_JOINT_ANGLES])
            jacobian = np.array(kinematics(joints)[1]).reshape(3, 3)
            expected = 1e3 * jacobian.T @ [0.4, 0.3, -0.5]
        bench.step(40)
        name, values = bench.library.sent[-1]
        assert name == State.CURRENT_JOINT_TORQUE
        assert values == pytest.approx(list(expected), abs=1e-9)
    finally:
        bench.close()


def test_stop_sends_no_force_and_ends(bench: Bench) -> None:
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    assert size(bench.force) == pytest.approx(1.0)
    bench.servo.stop()
    assert bench.step() == DONE
    assert bench.force == ZERO3
    assert bench.library.calls[-3:] == ["begin", "set", "end"]
    assert bench.state.ticks == 80
    assert bench.tick.details().finished


@pytest.mark.parametrize("at_end", [False, True])
@pytest.mark.parametrize("code", [Error.COMM_ERROR, Error.TIMER_ERROR, Error.DEVICE_FAULT])
def test_a_lost_device_is_a_fault_and_the_end(bench: Bench, code: int, at_end: bool) -> None:
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    before = bench.state
    (bench.library.errors_at_end if at_end else bench.library.errors).append((code, -28))
    assert bench.step() == DONE
    state, details = bench.state, bench.tick.details()
    assert state.state is OperatingState.FAULT
    assert "device is lost" in state.reason
    assert state.force == ZERO3
    assert (details.error, details.internal_error) == (code, -28)
    assert details.finished
    if not at_end:
        assert bench.force == ZERO3
        assert state.stamp_s == before.stamp_s, "a reading over a broken link is not fresh"
    assert bench.library.calls[-1] == "end"


@pytest.mark.parametrize("code", [Error.COMM_ERROR, Error.DEVICE_FAULT, Error.EXCEEDED_MAX_FORCE])
def test_another_devices_errors_are_not_this_ones(bench: Bench, code: int) -> None:
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    bench.library.errors_at_begin.append((code, -1, OTHER))
    bench.library.errors_at_end.append((code, -1, OTHER))
    assert bench.step(10) == CONTINUE
    assert bench.state.state is OperatingState.ENABLED
    assert size(bench.force) == pytest.approx(1.0)
    assert bench.tick.details().errors == 0


def test_an_error_of_no_device_is_everybodys(bench: Bench) -> None:
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    bench.library.errors_at_end.append((Error.COMM_ERROR, -1, 0xFFFFFFFF))
    assert bench.step() == DONE
    assert bench.state.state is OperatingState.FAULT


def test_who_finds_another_devices_error_passes_it_on(bench: Bench) -> None:
    """The library has one error stack, and a reader empties it."""
    tick = Tick()
    other = Servo(tick, bench.library.functions, OTHER, clock=bench.library.clock, realtime=False)
    call = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)(other.callback)
    assert call(other.user) == CONTINUE
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    bench.library.errors_at_end.append((Error.COMM_ERROR, -28, OTHER))
    assert bench.step(2) == CONTINUE
    assert call(other.user) == DONE
    assert tick.snapshot().state is OperatingState.FAULT
    assert tick.details().internal_error == -28
    assert bench.state.state is OperatingState.ENABLED
    other.close()
    tick.close()


@pytest.mark.parametrize(
    "name", [State.CURRENT_POSITION, State.CURRENT_TRANSFORM, State.CURRENT_JOINT_ANGLES]
)
def test_a_reading_that_fails_is_not_taken_for_one(bench: Bench, name: int) -> None:
    bench.library.values[State.CURRENT_POSITION] = [10.0, 20.0, 30.0]
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    before = bench.state
    bench.library.failing.add(name)
    assert bench.step(6) == CONTINUE
    state = bench.state
    assert (state.pose, state.stamp_s) == (before.pose, before.stamp_s)
    assert state.joints_rad == before.joints_rad
    assert state.state is OperatingState.ENABLED
    assert bench.force == ZERO3
    assert bench.tick.details().errors == bench.tick.details().bad_readings == 6
    bench.library.failing.clear()
    bench.step(200)
    assert size(bench.force) == pytest.approx(1.0)
    bench.library.failing.add(name)
    bench.step(120)
    assert "readings fail" in bench.state.reason


def test_a_transform_that_is_no_rotation_is_no_reading(bench: Bench) -> None:
    bench.step(3)
    before = bench.state
    bench.library.values[State.CURRENT_TRANSFORM] = [0.0] * 16
    bench.library.values[State.CURRENT_POSITION] = [10.0, 20.0, 30.0]
    bench.step(3)
    assert (bench.state.pose, bench.state.stamp_s) == (before.pose, before.stamp_s)
    assert bench.tick.details().bad_readings == 3


def test_errors_of_before_the_frame_are_no_failed_reading(bench: Bench) -> None:
    """Another thread has caused the error by a query of an invalid enum."""
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    bench.library.errors_at_begin.append((Error.INVALID_ENUM, 0))
    bench.step()
    assert size(bench.force) == pytest.approx(1.0)
    assert bench.state.state is OperatingState.ENABLED
    assert (bench.tick.details().errors, bench.tick.details().bad_readings) == (1, 0)


def test_a_loop_that_begins_anew_has_sent_nothing_yet(bench: Bench) -> None:
    """The last force before the loss no longer counts, and the hand has moved."""
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    bench.servo.close()
    bench.tick.lose()
    given = bench.state.delivered_j
    bench.library.now_s += 3.0
    bench.library.values[State.CURRENT_POSITION] = [0.0, 0.0, 80.0]
    bench.servo = Servo(
        bench.tick, bench.library.functions, HANDLE, clock=bench.library.clock, realtime=False
    )
    bench.step()
    state = bench.state
    assert (state.delivered_j, state.late_ticks) == (given, 0)
    assert state.velocity == ZERO3
    assert state.force == ZERO3


def test_force_errors_release_wait_and_come_back(bench: Bench) -> None:
    bench.engage(force=Vector3(0.1, 0.0, 0.0))
    bench.library.errors_at_end.append((Error.EXCEEDED_MAX_FORCE, 0))
    assert bench.step() == CONTINUE
    assert bench.step(5) == CONTINUE
    assert bench.force == ZERO3
    assert "force error" in bench.state.reason
    bench.step(480)
    assert bench.force == ZERO3
    bench.step(60)
    assert size(bench.force) == pytest.approx(0.1)
    assert bench.state.state is OperatingState.ENABLED
    assert bench.tick.details().force_errors == 1


def test_three_force_errors_within_ten_seconds_are_a_fault(bench: Bench) -> None:
    bench.engage(force=Vector3(0.1, 0.0, 0.0))
    for code in (
        Error.WARM_MOTORS,
        Error.EXCEEDED_MAX_VELOCITY,
        Error.EXCEEDED_MAX_FORCE_IMPULSE,
    ):
        assert bench.state.state is OperatingState.ENABLED
        bench.library.errors_at_end.append((code, 0))
        assert bench.step(600) == CONTINUE
    state = bench.state
    assert state.state is OperatingState.FAULT
    assert "three force errors" in state.reason
    assert bench.tick.details().error == Error.EXCEEDED_MAX_FORCE_IMPULSE
    assert bench.force == ZERO3


def test_two_force_errors_and_a_third_much_later_are_none(bench: Bench) -> None:
    bench.engage(force=Vector3(0.1, 0.0, 0.0))
    for wait in (600, 10_100, 600):
        bench.library.errors_at_end.append((Error.EXCEEDED_MAX_FORCE, 0))
        bench.step(wait)
    assert bench.state.state is OperatingState.ENABLED


def test_programming_errors_are_counted_and_no_more(bench: Bench) -> None:
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    bench.library.errors_at_end += [(Error.ILLEGAL_BEGIN, 0), (Error.FRAME_ERROR, 3)]
    assert bench.step() == CONTINUE
    assert size(bench.force) == pytest.approx(1.0)
    bench.step()
    state, details = bench.state, bench.tick.details()
    assert state.state is OperatingState.ENABLED
    assert (details.errors, details.force_errors) == (2, 0)


def test_what_a_device_does_not_have_is_asked_for_once(bench: Bench) -> None:
    del bench.library.values[Info.MOTOR_TEMPERATURE]
    del bench.library.values[State.CURRENT_GIMBAL_ANGLES]
    bench.step(100)
    assert bench.library.asked.count(Info.MOTOR_TEMPERATURE) == 1
    assert bench.library.asked.count(State.CURRENT_GIMBAL_ANGLES) == 1
    assert bench.state.temperature == 0.0
    assert bench.tick.details().errors == 0


def test_temperatures_are_read_now_and_then(bench: Bench) -> None:
    bench.library.values[Info.MOTOR_TEMPERATURE] = [0.1, 0.2, 0.3, 0.0, 0.0, 0.5]
    bench.step(160)
    assert 10 <= bench.library.asked.count(Info.MOTOR_TEMPERATURE) <= 11
    assert bench.state.temperature == 0.5


def test_lost_calibration_and_the_inkwell_take_the_force(bench: Bench) -> None:
    bench.engage(force=Vector3(0.15, 0.0, 0.0))
    for change in ({"docked": True}, {"calibration": NEEDS_UPDATE}):
        for name, value in change.items():
            setattr(bench.library, name, value)
        bench.step(9)
        assert bench.force == ZERO3
        assert bench.state.state is OperatingState.ENABLED
        bench.library.docked, bench.library.calibration = False, OK
        bench.step(40)
        assert size(bench.force) == pytest.approx(0.15)
    bench.library.calibration = NEEDS_UPDATE
    bench.step(9)
    assert bench.state.calibration is Calibration.NEEDS_UPDATE


def test_a_position_that_jumps_with_the_calibration_is_no_motion(bench: Bench) -> None:
    bench.library.calibration = NEEDS_UPDATE
    bench.engage()
    bench.step(16)
    bench.library.calibration = OK
    bench.library.values[State.CURRENT_POSITION] = [0.0, 0.0, 80.0]
    bench.step()
    assert bench.state.velocity == ZERO3
    bench.step(20)
    assert bench.state.state is OperatingState.ENABLED
    assert bench.state.delivered_j == 0.0


def test_a_fast_stylus_is_not_engaged_and_no_fault(bench: Bench) -> None:
    bench.library.values[State.CURRENT_VELOCITY] = [0.0, 1500.0, 0.0]
    bench.tick.enable()
    bench.step(50)
    assert bench.state.state is OperatingState.ENABLED
    assert bench.state.reason != ""
    bench.library.values[State.CURRENT_VELOCITY] = [0.0, 0.0, 0.0]
    bench.step(20)
    assert bench.state.reason == ""


@pytest.mark.parametrize(
    "name",
    [
        State.CURRENT_POSITION,
        State.CURRENT_VELOCITY,
        State.CURRENT_JOINT_ANGLES,
        State.CURRENT_GIMBAL_ANGLES,
        Info.MOTOR_TEMPERATURE,
    ],
)
def test_no_numbers_from_the_library_are_a_fault(bench: Bench, name: int) -> None:
    bench.engage(force=Vector3(1.0, 0.0, 0.0))
    bench.library.values[name] = [0.0, float("nan"), 0.0]
    assert bench.step(20) == CONTINUE
    assert bench.force == ZERO3
    assert bench.state.state is OperatingState.FAULT


def test_the_librarys_thread_asks_for_real_time_and_says_whether_it_has_it() -> None:
    bench = Bench()
    before = os.sched_getscheduler(0)
    servo = Servo(
        bench.tick, bench.library.functions, HANDLE, clock=bench.library.clock, realtime=True
    )
    callback = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)(servo.callback)
    policies: list[int] = []

    def run() -> None:
        callback(servo.user)
        policies.append(os.sched_getscheduler(threading.get_native_id()))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert bench.state.ticks == 1
    realtime = bench.tick.details().realtime
    assert realtime is (policies == [os.SCHED_FIFO])
    assert os.sched_getscheduler(0) == before
    servo.close()
    bench.close()


def test_a_library_without_a_function_is_refused() -> None:
    functions = dict.fromkeys(FUNCTIONS, 1)
    functions["hdGetLongv"] = 0
    with pytest.raises(DriverError, match="hdGetLongv"):
        Servo(Tick(), functions, HANDLE)
