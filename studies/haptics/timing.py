"""The tick in real time: jitter, cost, and age of the sent force.

The simulated libHD runs its own thread at 1 kHz. A probe in C between the scheduler and the
callback records the call's time, cost and force, both for the compiled tick and for one in Python.
Compared variants are measured in turns within one run.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from cardan.common.arm_libraries import np
from cardan.common.haptics import Fixture, HapticCommand, MeasuredForce, Plane
from cardan.demos.demo import choose_demo, simulated_hardware
from cardan.gateway.session.supervisor import supervise
from cardan.types import Vector3
from cardan_omni import protocol as hdapi
from cardan_omni.driver import library as libhd
from cardan_omni.driver.limits import TickLimits
from cardan_omni.driver.servo import Servo
from cardan_omni.driver.tick import Tick
from cardan_omni.peer.library import SimulatedOmni
from cardan_omni.peer.settings import HandMotion, OmniSettings, Waypoint
from cardan_omni.protocol.constants import CallbackCode, Capability, State
from studies.haptics.loop import Array

PERIOD_S = 0.001
SECONDS = 2.0
TURNS = 2
CYCLE_S = 0.004
"""Cycle of the loop that supplies a measured force."""
STIFFNESS_N_M = 100.0
UP = Vector3(0.0, 0.0, 1.0)
HELD = OmniSettings(
    hand_damping_n_s_m=20.0,
    hand_stiffness_n_m=1000.0,
    motion=HandMotion((Waypoint(0.0, stiffness_n_m=Vector3(1000.0, 1000.0, 1000.0)),)),
)
FIFO_PRIORITY = 20

_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)
_TICK = np.dtype(
    [("begin_s", "f8"), ("cost_s", "f8"), ("sent_s", "f8"), ("force_n", "f8", 3)], align=True
)


class _Probe(ctypes.Structure):
    _fields_ = (
        ("inner", ctypes.c_void_p),
        ("user", ctypes.c_void_p),
        ("set_doublev", ctypes.c_void_p),
        ("end_frame", ctypes.c_void_p),
        ("ticks", ctypes.c_void_p),
        ("room", ctypes.c_int64),
        ("count", ctypes.c_int64),
        ("ordinary", ctypes.c_int64),
    )


def compile_probe(directory: Path) -> ctypes.CDLL:
    """Compile the probe. Raises CalledProcessError or FileNotFoundError without a compiler."""
    source = Path(__file__).with_name("probe.c")
    made = directory / "probe.so"
    headers = Path(hdapi.__file__).parent
    words = [os.environ.get("CC", "cc"), "-std=c11", "-D_GNU_SOURCE", "-O2", "-fPIC", "-shared"]
    subprocess.run([*words, f"-I{headers}", "-o", made, source, "-lm"], check=True)
    return ctypes.CDLL(str(made))


def _address(library: ctypes.CDLL, name: str) -> int:
    found = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    assert found is not None
    return found


class Live:
    """A simulated Omni in real time, with the compiled tick or a Python callback, and the probe."""

    def __init__(self, probe: ctypes.CDLL, *, python: bool, fifo: bool, seconds: float) -> None:
        self.sim = SimulatedOmni(HELD)
        self.tick = Tick(TickLimits(engage_ramp_s=0.1, passivity=False))
        self._probe = probe
        self._python = python
        self._fifo = fifo
        self._ticks = np.zeros(round(seconds / PERIOD_S) + 20_000, _TICK)
        self._sequence = 0

    def __enter__(self) -> Live:
        self._hd = libhd.load(str(self.sim.path))
        self._handle = self._hd.init_device("")
        self._hd.enable(self._handle, Capability.FORCE_OUTPUT, True)
        functions = dict(self._hd.functions)
        self._about = _Probe()
        self._about.set_doublev = functions["hdSetDoublev"]
        self._about.end_frame = functions["hdEndFrame"]
        self._about.ticks = self._ticks.ctypes.data
        self._about.room = len(self._ticks)
        # The simulated libHD requests real-time scheduling by itself.
        self._about.ordinary = not self._fifo
        functions["hdSetDoublev"] = _address(self._probe, "probe_set_doublev")
        functions["hdEndFrame"] = _address(self._probe, "probe_end_frame")
        self._servo = Servo(self.tick, functions, self._handle, realtime=self._fifo)
        self._python_tick = PythonTick(functions, self._handle, self._fifo)
        self._own = _CALLBACK(self._python_tick)
        if self._python:
            self._about.inner = ctypes.cast(self._own, ctypes.c_void_p).value
        else:
            self._about.inner, self._about.user = self._servo.callback, self._servo.user
        self._probe.probe_use(ctypes.byref(self._about))
        self.tick.enable()
        callback = _address(self._probe, "probe_callback")
        self._scheduled = self._hd.schedule(callback, 0, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._hd.unschedule(self._scheduled, self._handle)
        self._hd.disable_device(self._handle)
        self._servo.close()
        self.tick.close()

    @property
    def ticks(self) -> Any:
        """Ticks recorded so far."""
        return self._ticks[: self._about.count]

    @property
    def fifo(self) -> bool:
        """True if the loop's thread has real-time scheduling."""
        if self._python:
            return self._python_tick.granted
        self.tick.snapshot()
        return self.tick.details().realtime is True

    def command(
        self, fixtures: tuple[Fixture, ...] = (), measured: MeasuredForce | None = None
    ) -> None:
        """Command the tick to render this."""
        self._sequence += 1
        now_s = time.monotonic()
        self.tick.command(
            HapticCommand(self._sequence, now_s, True, fixtures=fixtures, measured=measured)
        )


class PythonTick:
    """Minimal callback in Python: read, compute a wall, send."""

    def __init__(self, functions: dict[str, int], handle: int, fifo: bool) -> None:
        def function(name: str) -> Any:
            result, arguments = libhd.SIGNATURES[name]
            return ctypes.CFUNCTYPE(result, *arguments)(functions[name])

        self._begin, self._end = function("hdBeginFrame"), function("hdEndFrame")
        self._get, self._set = function("hdGetDoublev"), function("hdSetDoublev")
        self._buttons, self._error = function("hdGetIntegerv"), function("hdGetError")
        self._handle = handle
        self._fifo = fifo
        self.granted = False
        """True if the thread has real-time scheduling."""
        self._transform = (ctypes.c_double * 16)()
        self._velocity = (ctypes.c_double * 3)()
        self._force = (ctypes.c_double * 3)()
        self._button = ctypes.c_int()

    def __call__(self, user: int | None) -> int:
        if self._fifo:
            self._fifo = False
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
                self.granted = True
        self._begin(self._handle)
        self._get(State.CURRENT_TRANSFORM, self._transform)
        self._get(State.CURRENT_VELOCITY, self._velocity)
        self._buttons(State.CURRENT_BUTTONS, ctypes.byref(self._button))
        depth_m = 0.002 - 1e-3 * self._transform[13]
        self._force[1] = max(0.0, STIFFNESS_N_M * depth_m - 5e-4 * self._velocity[1])
        self._set(State.CURRENT_FORCE, self._force)
        self._end(self._handle)
        self._error()
        return int(CallbackCode.CONTINUE)


# -- load ------------------------------------------------------------------------------------------


@contextlib.contextmanager
def busy_thread() -> Iterator[None]:
    """Load: another thread of this interpreter computes."""
    ending = threading.Event()

    def compute() -> None:
        total = 0
        while not ending.is_set():
            for number in range(1000):
                total += number * number

    thread = threading.Thread(target=compute, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


@contextlib.contextmanager
def busy_processes() -> Iterator[None]:
    """Load: as many busy processes as processors; they also end by themselves."""
    program = "import time\nend = time.monotonic() + 60\nwhile time.monotonic() < end: pass"
    count = os.cpu_count() or 1
    processes = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(count)]
    try:
        time.sleep(0.1)
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


LOADS = {
    "idle": contextlib.nullcontext,
    "a busy Python thread": busy_thread,
    "busy processes": busy_processes,
}


# -- measurements ----------------------------------------------------------------------------------


class Evenness(NamedTuple):
    """Timing of the ticks under one load."""

    what: str
    load: str
    fifo: bool
    granted: bool
    errors_s: Array
    """|time since the previous tick - 1 ms|."""
    costs_s: Array
    rate_hz: float


def evenness(probe: ctypes.CDLL, seconds: float = SECONDS, turns: int = TURNS) -> list[Evenness]:
    """Measure the compiled tick and a Python callback, each under each load, with and without
    FIFO."""
    found: dict[tuple[str, str, bool], list[tuple[bool, Any]]] = {}
    for _ in range(turns):
        for load, context in LOADS.items():
            for fifo in (False, True):
                for what in ("compiled", "Python"):
                    found.setdefault((what, load, fifo), []).append(
                        _ticks(probe, what == "Python", fifo, context, seconds)
                    )
    results = []
    for (what, load, fifo), parts in found.items():
        periods = np.concatenate([np.diff(ticks["begin_s"]) for _, ticks in parts])
        costs = np.concatenate([ticks["cost_s"] for _, ticks in parts])
        rate = 1.0 / float(periods.mean())
        granted = all(granted for granted, _ in parts)
        errors: Array = np.abs(periods - PERIOD_S)
        results.append(Evenness(what, load, fifo, granted, errors, costs, rate))
    return results


def _ticks(
    probe: ctypes.CDLL, python: bool, fifo: bool, load: Any, seconds: float
) -> tuple[bool, Any]:
    wall = Plane(Vector3(0.0, 0.0, 0.002), UP, STIFFNESS_N_M)
    with load(), Live(probe, python=python, fifo=fifo, seconds=seconds) as live:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            live.command((wall,))
            time.sleep(CYCLE_S)
        granted = live.fifo
        ticks = live.ticks[100:].copy()
    return granted, ticks


def ages(probe: ctypes.CDLL, count: int = 200, seconds: float = 10.0) -> tuple[Array, Array]:
    """Return the times from a new geometry, and from a measured force's stamp, to the end of the
    first frame whose force follows it, s."""
    chance = random.Random(1)
    from_fixture, from_measured = [], []
    with Live(probe, python=False, fifo=True, seconds=count * 0.1 + seconds) as live:
        low, high = (Plane(Vector3(0.0, 0.0, z), UP, STIFFNESS_N_M) for z in (0.0005, 0.0025))
        _keep(lambda: live.command((low,)), 0.5)
        wall = low
        for _ in range(count):
            wall = high if wall is low else low
            start_s = time.monotonic()
            live.command((wall,))
            _keep(lambda wall=wall: live.command((wall,)), 0.03 + chance.uniform(0.0, 0.004))
            from_fixture.append(_first_change(live.ticks, start_s) - start_s)
        _keep(live.command, 0.3)
        size = 0.2
        for _ in range(count):
            size = 0.4 if size == 0.2 else 0.2
            force = Vector3(0.0, 0.0, size)
            start_s = time.monotonic()

            def render(force: Vector3 = force) -> None:
                live.command(measured=MeasuredForce(force, time.monotonic()))

            render()
            _keep(render, 0.03 + chance.uniform(0.0, 0.004))
            from_measured.append(_first_change(live.ticks, start_s) - start_s)
    return np.array(from_fixture), np.array(from_measured)


def session_age(seconds: float = 20.0) -> tuple[float, float]:
    """Return the median and p99 of the age of the measured force at its last use in the tick, s, in
    a whole session of `cardan demo omni`: counted from the arrival of its EGM datagram. NaN without
    such a force."""
    with simulated_hardware(choose_demo("omni"), seconds) as (config, through):
        last = supervise(config, seconds, through=through).last
    median, p99 = last.force.measured_age_p50_s, last.force.measured_age_p99_s
    return math.nan if median is None else median, math.nan if p99 is None else p99


def _keep(again: Any, seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while (now_s := time.monotonic()) < end_s:
        time.sleep(min(CYCLE_S, end_s - now_s))
        again()


def _first_change(ticks: Any, start_s: float) -> float:
    """Return the end of the first frame whose force differs by 0.02 N from the last one before
    `start_s`."""
    first = int(np.searchsorted(ticks["begin_s"], start_s))
    before = ticks["force_n"][first - 1]
    change = np.linalg.norm(ticks["force_n"][first - 1 :] - before, axis=1)
    later = np.flatnonzero(change > 0.02)
    return float(ticks["sent_s"][first - 1 + later[0]]) if len(later) else float("nan")


def law_alone(probe: ctypes.CDLL, fixtures: int, batches: int = 400) -> Array:
    """Return the cost of back-to-back ticks with a libHD that does nothing, s; checks that the
    force is that of the walls."""
    names = {
        "hdBeginFrame": "frame",
        "hdEndFrame": "frame",
        "hdGetBooleanv": "booleanv",
        "hdGetIntegerv": "integerv",
        "hdGetDoublev": "doublev",
        "hdGetLongv": "longv",
        "hdSetDoublev": "set_doublev",
        "hdCheckCalibration": "calibration",
        "hdGetError": "error",
    }
    functions = {name: _address(probe, f"nothing_{short}") for name, short in names.items()}
    probe.nothing_now.restype = ctypes.c_double
    run = probe.probe_run
    run.restype = None
    run.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64) + (ctypes.c_void_p,) * 2
    tick = Tick(TickLimits(engage_ramp_s=0.1))
    servo = Servo(tick, functions, 0, clock=_address(probe, "nothing_now"), realtime=False)
    costs, force = np.zeros((batches, 16)), np.zeros(3)
    try:
        tick.enable()
        for batch in range(batches):
            depth_m = 0.002 if batch > batches // 10 else 0.0
            walls = tuple(Plane(Vector3(0.0, 0.0, depth_m), UP, 50.0) for _ in range(fixtures))
            tick.command(HapticCommand(batch + 1, probe.nothing_now(), True, fixtures=walls))
            run(servo.callback, servo.user, 16, costs[batch].ctypes.data, force.ctypes.data)
    finally:
        servo.close()
        tick.close()
    expected = 0.1 * fixtures
    if abs(force[1] - expected) > 0.01:
        raise AssertionError(f"the tick sent {force[1]:.3f} N instead of {expected:.3f} N")
    found: Array = costs[batches // 4 :].ravel()
    return found


# -- tables ----------------------------------------------------------------------------------------


def _three(values: Array) -> str:
    return " / ".join(f"{1e6 * x:.0f}" for x in (*np.percentile(values, (50, 99)), values.max()))


def evenness_table(found: list[Evenness]) -> str:
    """Return the Markdown table."""
    lines = [
        "| tick | load | real-time scheduling | period error, µs | rate | cost, µs |",
        "|---|---|---|---|---|---|",
    ]
    for one in found:
        fifo = "–" if not one.fifo else "FIFO" if one.granted else "refused"
        name = f"**{one.what}**" if one.what == "compiled" else one.what
        cost = " / ".join(f"{1e6 * x:.1f}" for x in np.percentile(one.costs_s, (50, 99)))
        lines.append(
            f"| {name} | {one.load} | {fifo} | {_three(one.errors_s)} | {one.rate_hz:.0f} Hz "
            f"| {cost} |"
        )
    return "\n".join(lines)


def verdicts(
    found: list[Evenness], alone: Array, fixture_s: Array, measured_s: Array, session_s: float
) -> str:
    """Return the aims, met or missed, as Markdown."""
    by_name = {(one.what, one.load, one.fifo): one for one in found}
    ours = by_name["compiled", "a busy Python thread", True]
    theirs = by_name["Python", "a busy Python thread", True]
    idle = by_name["compiled", "idle", True]
    p99 = [float(np.percentile(one.errors_s, 99)) for one in (ours, theirs)]
    rows = (
        ("period error with a busy Python thread, p99", p99[0], 100e-6),
        ("cost of a tick with the simulated libHD's calls, median",
         float(np.median(idle.costs_s)), 5e-6),
        ("cost of the law alone, 8 fixtures, p99", float(np.percentile(alone, 99)), 5e-6),
        ("age of the force, from geometry, p99", float(np.nanpercentile(fixture_s, 99)), 2e-3),
        ("age of the force, from a measured force, p99",
         float(np.nanpercentile(measured_s, 99)), CYCLE_S + 2e-3),
        ("the same in a whole session with EGM, p99", session_s, CYCLE_S + 2e-3),
    )  # fmt: skip
    lines = ["| quantity | measured | aim |", "|---|---|---|"]
    for name, value, aim in rows:
        words = "met" if value <= aim else "**missed**"
        lines.append(f"| {name} | {1e6 * value:.1f} µs | {1e6 * aim:.0f} µs: {words} |")
    lines.append(
        f"\nWith a busy Python thread the period error of a Python callback is "
        f"{p99[1] / p99[0]:.0f} times ours at p99."
    )
    return "\n".join(lines)


def load_words() -> str:
    """Describe the machine's load: the case "idle" is idle only without other programs."""
    return (
        f"Load in the minute before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors, "
        "of which this benchmark made at most 1."
    )


class Timing(NamedTuple):
    """Timing of the tick without a session."""

    found: list[Evenness]
    fixture_s: Array
    measured_s: Array
    alone: dict[int, Array]
    """Costs by the number of fixtures."""


def measure_tick() -> Timing:
    """Measure jitter, age and cost of the tick. Raises CalledProcessError or FileNotFoundError
    without a C compiler."""
    with tempfile.TemporaryDirectory() as directory:
        probe = compile_probe(Path(directory))
        found = evenness(probe)
        return Timing(found, *ages(probe), {count: law_alone(probe, count) for count in (1, 8)})


def law_table(alone: dict[int, Array]) -> str:
    """Return the tables as Markdown."""
    words = ["| law alone | median / p99 / max, µs |", "|---|---|"]
    words += [
        f"| {n} fixture{'s' if n > 1 else ''} | "
        + " / ".join(f"{1e6 * x:.2f}" for x in (*np.percentile(c, (50, 99)), c.max()))
        + " |"
        for n, c in alone.items()
    ]
    return "\n".join(words)


def measure() -> str:
    """Measure everything and return it as Markdown."""
    load = load_words()
    found, fixture_s, measured_s, alone = measure_tick()
    session_s = session_age()
    age = ["| age of the force at the device | median / p99 / max, µs |", "|---|---|"]
    age += [
        f"| from {name} | {_three(values[np.isfinite(values)])} |"
        for name, values in (("new geometry", fixture_s), ("a measured force", measured_s))
    ]
    age.append(
        "| from a measured force, used in a tick of a whole session | "
        f"{1e6 * session_s[0]:.0f} / {1e6 * session_s[1]:.0f} / – |"
    )
    parts = (
        load,
        evenness_table(found),
        law_table(alone),
        "\n".join(age),
        verdicts(found, alone[8], fixture_s, measured_s, session_s[1]),
    )
    return "\n\n".join(parts)
