"""Forces on the hand after a fault during a press on a wall.

A hand holds the stylus on a wall of 300 N/m with about 0.9 N; a command arrives every 4 ms, and the
fault occurs at `FAULT_S`. The tick has its default limits; time is virtual.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan.common.haptics import (
    HapticCommand,
    HapticState,
    MeasuredForce,
    OperatingState,
    Plane,
    WorldMap,
)
from cardan.errors import CommandError
from cardan.types import ZERO3, Vector3
from cardan_omni.driver import library as libhd
from cardan_omni.driver.limits import TickLimits
from cardan_omni.peer.library import library_path
from cardan_omni.peer.settings import INKWELL_M, HandMotion, OmniSettings, Waypoint
from cardan_omni.protocol.constants import State
from studies.haptics.loop import TICK_S, Array, Bench, Trace

FAULT_S = 2.0
AFTER_S = 1.0
EVERY = 4
"""Ticks between two commands."""
STIFFNESS_N_M = 300.0
UP = Vector3(0.0, 0.0, 1.0)
HELD_AT_M = Vector3(0.0, 0.0, -0.007)
LIMITS = TickLimits()
FIVEFOLD = (5.0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 5.0)
NAN = float("nan")

_GET_DOUBLEV = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.POINTER(ctypes.c_double))


class Scene:
    """The press and its commands; a fault changes the attributes."""

    def __init__(self) -> None:
        self.position_is_nan = False
        self.sending = True
        self.frozen_stamp_s: float | None = None
        self.wall_m = 0.0
        self.world = WorldMap()
        self.force = ZERO3
        self.measured: Callable[[float], MeasuredForce] | None = None
        self.stiffness_n_m = STIFFNESS_N_M
        self.older_ones = False
        self.refused = 0
        """Number of commands refused by the tick."""
        self.pressed = False
        self._sequence = 0
        motion = HandMotion(
            (
                Waypoint(0.0, Vector3(0.0, 0.005, 0.0)),
                Waypoint(1.3, Vector3(0.0, 0.005, 0.0)),
                Waypoint(1.6, Vector3(0.0, HELD_AT_M.z, 0.0)),
            )
        )
        # Called in place of hdGetDoublev; kept as long as the bench.
        self._get_doublev = _GET_DOUBLEV(self._doubles)
        self._real = libhd.load(str(library_path())).functions["hdGetDoublev"]
        self._call = _GET_DOUBLEV(self._real)
        address = ctypes.cast(self._get_doublev, ctypes.c_void_p).value
        assert address is not None
        self.bench = Bench(LIMITS, OmniSettings(motion=motion), {"hdGetDoublev": address})

    def _doubles(self, name: int, values: ctypes._Pointer[ctypes.c_double]) -> None:
        self._call(name, values)
        if self.position_is_nan and name == State.CURRENT_POSITION:
            values[0] = NAN

    def command(self, now_s: float) -> None:
        """Send a command like the gateway in its cycle."""
        if not self.sending:
            return
        self._sequence += 1
        stamp_s = now_s if self.frozen_stamp_s is None else self.frozen_stamp_s
        wall = Plane(Vector3(0.0, 0.0, self.wall_m), UP, self.stiffness_n_m)
        made = HapticCommand(
            self._sequence,
            stamp_s,
            True,
            self.world,
            (wall,),
            self.measured(now_s) if self.measured is not None else None,
            self.force,
        )
        try:
            self.bench.tick.command(made)
        except CommandError:
            self.refused += 1
        if self.older_ones:
            strange = made._replace(sequence=self._sequence - 3, force=Vector3(0.0, 3.0, 0.0))
            self.bench.tick.command(strange)

    def hold(self, **words: object) -> None:
        """Hold the stylus as before, with a change."""
        options: dict[str, object] = {"target_m": HELD_AT_M, **words}
        self.bench.sim.hand(**options)  # type: ignore[arg-type]


class Fault(NamedTuple):
    """A fault, and the time in which the force has to vanish."""

    name: str
    begin: Callable[[Scene], None]
    dead_s: float = math.inf
    """Longest time from the start of the fault until the force has to be zero."""
    device_cuts: bool = False
    """True if the device itself cuts its force at once, whatever is sent."""
    forbidden: str = ""
    """State reason that forbids force: from the first tick with it, the force has to become zero
    within the release time and stay zero."""


def _set(**values: object) -> Callable[[Scene], None]:
    def begin(scene: Scene) -> None:
        for name, value in values.items():
            setattr(scene, name, value)

    return begin


def _device(name: str, value: float = 1.0) -> Callable[[Scene], None]:
    return lambda scene: scene.bench.sim.fault(name, value)


def _freeze(scene: Scene) -> None:
    scene.frozen_stamp_s = scene.bench.now_s - EVERY * TICK_S


def _dock(scene: Scene) -> None:
    scene.bench.sim.hand(target_m=Vector3(-INKWELL_M.z, -INKWELL_M.x, INKWELL_M.y), docked=True)


def _let_go(scene: Scene) -> None:
    scene.force = Vector3(0.0, 0.0, 2.0)
    scene.bench.sim.hand(gripped=False)


def _throw(scene: Scene) -> None:
    scene.bench.sim.hand(gripped=False)
    scene.bench.sim.push(Vector3(0.0, 5.0, -1.0))


def _bounce(scene: Scene) -> None:
    scene.bench.sim.fault("button-bounce", 5.0)
    scene.hold(buttons=1)


def _measured(force: Vector3, late_s: float = 0.0) -> Callable[[Scene], None]:
    return _set(measured=lambda now_s: MeasuredForce(force, now_s - late_s))


_ROUNDING_S = 1e-6
_TICK = TICK_S * 1.5
"""Allowance for the tick that detects a fault, and for rounding."""
_RELEASED = LIMITS.release_s + _TICK
_SLOW = "the force loop is too slow for force"
_IRREGULAR = "paused: commands or ticks are too irregular"

FAULTS = (
    Fault("command source dead", _set(sending=False), LIMITS.hold_s + _RELEASED),
    Fault("stamps frozen", _freeze, LIMITS.hold_s + _RELEASED),
    Fault("comm error", _device("comm-error"), _RELEASED, True),
    Fault("unplugged", _device("unplug"), _RELEASED, True),
    Fault("warm motors", _device("warm-motors"), _RELEASED, True),
    Fault("over-force", _device("over-force"), _RELEASED, True),
    Fault("calibration lost", _device("uncalibrated"), 4 * TICK_S + _RELEASED),
    Fault("docked", _dock, forbidden="the stylus is in its inkwell"),
    Fault("let go under 2 N", _let_go),
    Fault(
        "thrown along the wall", _throw, forbidden="fault: the stylus moved too fast under force"
    ),
    Fault("ticks at 200 Hz", _device("slow-ticks", 200.0), forbidden=_SLOW),
    Fault("ticks 5 ms late", _device("late-tick", 5.0), forbidden=_IRREGULAR),
    Fault("ticks 30 ms late", _device("late-tick", 30.0), forbidden=_IRREGULAR),
    Fault("callback 3 ms overrun", _device("overrun", 3.0), forbidden=_SLOW),
    Fault("jitter 500 µs", _device("jitter", 500.0)),
    Fault("encoder stuck", _device("stuck-encoder", 2.0)),
    Fault("NaN in commands", _set(force=Vector3(NAN, 0.0, 0.0)), LIMITS.hold_s + _RELEASED),
    Fault("NaN as position", _set(position_is_nan=True), _RELEASED),
    Fault("wall jumps 20 mm", _set(wall_m=0.02)),
    Fault("scale × 5", _set(world=WorldMap(FIVEFOLD))),
    Fault("recaptured 20 mm off", _set(world=WorldMap(offset=Vector3(0.0, 0.0, -0.02)))),
    Fault("measured force steps to 50 N", _measured(Vector3(0.0, 30.0, 40.0))),
    Fault("measured force 1 s late", _measured(Vector3(0.0, 30.0, 40.0), 1.0)),
    Fault("commands out of order", _set(older_ones=True)),
    Fault("button bounces", _bounce),
)


class FaultResponse(NamedTuple):
    """Force on the hand after the fault."""

    fault: Fault
    before_n: float
    """Norm of the force when the fault began."""
    most_n: float
    """Largest norm of the sent force."""
    rise_n_ms: float
    """Fastest growth of the sent force."""
    fall_n_ms: float
    """Fastest decline of the sent force while the motors were on."""
    zero_s: float
    """Time after the fault when the rendered force was first zero; infinite: never."""
    forbidden_s: float
    """Time from the first tick with the reason `forbidden` to the first after which no force was
    sent; infinite: no such tick, or force was sent to the end."""
    again: bool
    """True if force returned after that."""
    after: HapticState
    reasons: tuple[str, ...]
    """All state reasons, in order."""
    refused: int
    trace: Trace

    @property
    def in_time(self) -> bool:
        """True if the force became zero in time."""
        if self.fault.forbidden and self.forbidden_s > LIMITS.release_s + _ROUNDING_S:
            return False
        return self.zero_s <= self.fault.dead_s


def feel(fault: Fault) -> FaultResponse:
    """Run the press with one fault."""
    scene = Scene()
    with scene.bench as bench:
        bench.tick.enable()
        bench.run(FAULT_S, scene.command, EVERY)
        fault.begin(scene)
        first = len(bench.trace.times_s)
        bench.run(AFTER_S, scene.command, EVERY)
        return _response(fault, bench.trace, first, bench.tick.snapshot(), scene.refused)


def _response(
    fault: Fault, trace: Trace, first: int, after: HapticState, refused: int
) -> FaultResponse:
    since = slice(first - 1, None)
    times_s, sent, rendered = trace.times_s[since], trace.sent_n[since], trace.rendered_n[since]
    sizes: Array = np.linalg.norm(sent, axis=1)
    per_ms = np.linalg.norm(np.diff(sent, axis=0), axis=1) / (1e3 * np.diff(times_s))
    grows = np.diff(sizes) > 0.0
    gone = np.flatnonzero(np.linalg.norm(rendered, axis=1)[1:] < 1e-9)
    zero_s = float(times_s[1 + gone[0]] - times_s[0]) if len(gone) else math.inf
    over = np.flatnonzero(sizes == 0.0)
    later = sizes[over[0] :] if len(over) else sizes[:0]
    forbids = [k for k, (_, reason) in enumerate(trace.states[first:]) if reason == fault.forbidden]
    reasons: list[str] = []
    for state, reason in trace.states[first:]:
        words = _words(state, reason)
        if words not in reasons:
            reasons.append(words)
    return FaultResponse(
        fault,
        float(sizes[0]),
        float(sizes.max()),
        float(per_ms[grows].max(initial=0.0)),
        float(per_ms[~grows].max(initial=0.0)),
        zero_s,
        _until_none_s(times_s[1 + forbids[0] :], sizes[1 + forbids[0] :]) if forbids else math.inf,
        bool((later > 1e-9).any()),
        after,
        tuple(reasons),
        refused,
        trace,
    )


def _until_none_s(times_s: Array, sizes: Array) -> float:
    """Time from the first tick to the one after which there is no force; infinite: none."""
    last = int(np.flatnonzero(sizes > 1e-9).max(initial=-1))
    return float(times_s[last + 1] - times_s[0]) if last + 1 < len(sizes) else math.inf


def _words(state: OperatingState, reason: str) -> str:
    if reason.startswith(state.value):
        return reason
    return f"{state.value}: {reason}" if reason else state.value


def table(found: list[FaultResponse]) -> str:
    """Return the Markdown table."""
    lines = [
        "| fault | largest force | rise, fall at most | zero after | then |",
        "|---|---|---|---|---|",
    ]
    for one in found:
        zero = f"{1e3 * one.zero_s:.0f} ms" if math.isfinite(one.zero_s) else "–"
        words = _words(one.after.state, one.after.reason)
        if math.isfinite(one.zero_s) and one.again:
            words += "; force came back by ramp"
        if one.refused:
            words += f"; {one.refused} commands refused"
        if one.after.dropped_commands:
            words += f"; {one.after.dropped_commands} dropped"
        lines.append(
            f"| {one.fault.name} | {one.most_n:.2f} N | {one.rise_n_ms:.3f}, {one.fall_n_ms:.2f} "
            f"N/ms | {zero} | {words} |"
        )
    return "\n".join(lines)
