"""Straight line: 0.5 m in 5 s along one axis, 20 commands a second from a program, on the UR5."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from cardan.common.arm_libraries import np
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.motion.shaping import PoseShaper, PoseShaperLimits
from cardan.types import IDENTITY, Pose, Vector3
from studies.metrics import (
    Errors,
    delay_by_correlation,
    delay_by_least_error,
    delays_per_command,
    errors,
)
from studies.thesis.bench import (
    DT_S,
    JERK_M_S3,
    STIFF,
    Array,
    Bench,
    Drive,
    Metronome,
    Row,
    published_mechanism,
    quantiles_ms,
)

SPEED_M_S = 0.1
RATE_HZ = 20.0
TAIL_S = 1.5
LONGEST_S = 1.0
SHAPER = PoseShaperLimits(
    linear_acceleration_m_s2=STIFF.streams.linear_acceleration_m_s2,
    linear_jerk_m_s3=JERK_M_S3,
)
"""Limits for the shaper alone, equal to those of the streams."""

PUBLISHED_S = 0.35
PUBLISHED_START_S = 0.5

START_DEG = (7.6, -97.3, 142.5, -135.2, -90.0, 7.6)
"""Start position from which 0.5 m along each axis of the base can be reached."""

DIRECTIONS = (Vector3(1.0, 0.0, 0.0), Vector3(0.0, -1.0, 0.0), Vector3(0.0, 0.0, 1.0))


class Delays(NamedTuple):
    """Delays of one line."""

    correlation_s: float
    least_error_s: float
    per_command_s: Array


class Line(NamedTuple):
    """Result of one line. Positions are along its axis and across, relative to its start, m."""

    name: str
    times_s: Array
    program_m: Array
    """Commanded position on the line."""
    output_m: Array
    """TCP positions, time × 3."""
    delays: Delays
    errors: Errors
    refusals: int
    sag_m: float
    """Sag of the arm below its command before the line begins."""


def program(times_s: Array, length_m: float) -> Array:
    """Return the position on the program's line, m."""
    return np.clip(SPEED_M_S * times_s, 0.0, length_m)


def delays_of(times_s: Array, line: Array, output: Array, length_m: float) -> Delays:
    """Return the three measures of the delay; `line` and `output` are time × 3."""
    sent_s = np.arange(0.0, length_m / SPEED_M_S + 1e-9, 1.0 / RATE_HZ)
    commands = np.zeros((len(sent_s), 3))
    axis = int(np.argmax(np.ptp(line, axis=0)))
    sign = np.sign(line[-1, axis])
    commands[:, axis] = sign * program(sent_s, length_m)
    return Delays(
        delay_by_correlation(DT_S, line, output, LONGEST_S),
        delay_by_least_error(DT_S, line, output, LONGEST_S),
        delays_per_command(sent_s, commands, times_s, output, LONGEST_S),
    )


def _made(
    name: str,
    times_s: Array,
    direction: Vector3,
    output: Array,
    length_m: float,
    refusals: int = 0,
    sag_m: float = 0.0,
) -> Line:
    along = program(times_s, length_m)
    line = along[:, None] * np.array(direction)
    delays = delays_of(times_s, line, output, length_m)
    delay_s = max(0.0, delays.least_error_s)
    found = errors(DT_S, line, output, delay_s)
    return Line(name, times_s, along, output, delays, found, refusals, sag_m)


def relative(drive: Drive, axis: int, length_m: float, options: ControllerOptions = STIFF) -> Line:
    """Run the line with twists: each command is the displacement of its 50 ms."""
    bench = Bench("ur5", drive, np.radians(START_DEG))
    driving = bench.streams("twst", options)
    direction, clock = DIRECTIONS[axis], Metronome(RATE_HZ)
    period_s = 1.0 / RATE_HZ

    def operator(now_s: float) -> None:
        due_s = clock.due(now_s)
        if due_s is not None:
            way = np.diff(program(np.array((due_s, due_s + period_s)), length_m))[0]
            driving.twist([float(c) * way / period_s for c in direction])

    return _record("twists", bench, driving, axis, length_m, operator)


def absolute(drive: Drive, axis: int, length_m: float, options: ControllerOptions = STIFF) -> Line:
    """Run the line with poses: each command is the line's pose at its time; damping 1.0."""
    bench = Bench("ur5", drive, np.radians(START_DEG))
    driving = bench.streams("pose", options)
    start = bench.placement(driving)
    direction, clock = DIRECTIONS[axis], Metronome(RATE_HZ)

    def operator(now_s: float) -> None:
        due_s = clock.due(now_s)
        if due_s is not None:
            way = float(program(np.array((due_s,)), length_m)[0])
            driving.pose(start.translation + way * np.array(direction), start.rotation)

    return _record("poses", bench, driving, axis, length_m, operator)


def _record(
    name: str, bench: Bench, driving: Any, axis: int, length_m: float, operator: Any
) -> Line:
    start = bench.placement(driving).translation.copy()
    trace = bench.run(driving, length_m / SPEED_M_S + TAIL_S, operator)
    output = trace.measured_m - trace.measured_m[0]
    sag_m = float(np.linalg.norm(trace.measured_m[0] - start))
    direction = DIRECTIONS[axis]
    return _made(name, trace.times_s, direction, output, length_m, len(driving.refusals), sag_m)


def _times(length_m: float) -> Array:
    return np.arange(0.0, length_m / SPEED_M_S + TAIL_S - 1e-9, DT_S)


def held(length_m: float) -> Line:
    """The commands themselves, each held until the next, as any follower receives them."""
    times_s = _times(length_m)
    held_s = np.floor(times_s * RATE_HZ + 1e-9) / RATE_HZ
    output = np.zeros((len(times_s), 3))
    output[:, 0] = program(held_s, length_m)
    return _made("commands held 50 ms", times_s, DIRECTIONS[0], output, length_m)


def shaped(length_m: float) -> Line:
    """The line through the jerk-limited shaper, damping 1.0, without an arm."""
    shaper = PoseShaper(SHAPER, damping=1.0)
    shaper.place(Pose(Vector3(0.0, 0.0, 0.0), IDENTITY))
    times_s = _times(length_m)
    held_s = np.floor(times_s * RATE_HZ + 1e-9) / RATE_HZ
    output = np.zeros((len(times_s), 3))
    for i, way in enumerate(program(held_s, length_m)):
        output[i] = shaper.pose.position if shaper.pose is not None else output[i]
        shaper.advance(Pose(Vector3(float(way), 0.0, 0.0), IDENTITY), DT_S)
    return _made("shaper alone", times_s, DIRECTIONS[0], output, length_m)


def mechanism(length_m: float) -> Line:
    """The mechanism of the published interface, simulated on the same commands."""
    times_s = _times(length_m)
    sent_s = np.arange(0.0, length_m / SPEED_M_S + 1e-9, 1.0 / RATE_HZ)
    commands = np.zeros((len(sent_s), 3))
    commands[:, 0] = program(sent_s, length_m)
    output = published_mechanism(sent_s, commands, times_s)
    return _made("published mechanism", times_s, DIRECTIONS[0], output, length_m)


PREDICTED = replace(STIFF, stream_prediction_s=0.05)


class Result(NamedTuple):
    """Results for one drive."""

    relative: tuple[Line, ...]
    """Lines along x, y and z."""
    absolute: tuple[Line, ...]
    predicted: tuple[Line, ...]
    """Absolute poses with prediction: each is extrapolated for one period."""
    relative_default: Line
    absolute_default: Line


def measure(drive: Drive, length_m: float = 0.5, axes: int = 3) -> Result:
    """Run all lines on one drive."""
    return Result(
        tuple(relative(drive, axis, length_m) for axis in range(axes)),
        tuple(absolute(drive, axis, length_m) for axis in range(axes)),
        tuple(absolute(drive, axis, length_m, PREDICTED) for axis in range(axes)),
        relative(drive, 0, length_m, ControllerOptions()),
        absolute(drive, 0, length_m, ControllerOptions()),
    )


def simulated(length_m: float = 0.5) -> tuple[Line, Line, Line]:
    """Simulate the line without an arm: the published mechanism, the held commands, the shaper."""
    return mechanism(length_m), held(length_m), shaped(length_m)


def rows(ideal: Result, dynamic: Result, others: tuple[Line, Line, Line]) -> list[Row]:
    """Return the table; `others`: lines from :func:`simulated`."""

    def ms(delay_s: float) -> str:
        return f"{delay_s * 1e3:.0f}"

    def delays(line: Line) -> str:
        return f"{ms(line.delays.correlation_s)} / {ms(line.delays.least_error_s)} ms"

    def off(line: Line) -> str:
        found = line.errors
        return f"{found.rms_m * 1e3:.2f} / {found.rms_without_delay_m * 1e3:.2f} mm"

    found = []
    for index, axis in enumerate("xyz"[: len(ideal.relative)]):
        for one, two, what in (
            (ideal.relative[index], dynamic.relative[index], "relative"),
            (ideal.absolute[index], dynamic.absolute[index], "absolute"),
            (ideal.predicted[index], dynamic.predicted[index], "absolute, predicted"),
        ):
            worst = max(one.delays.least_error_s, float(np.nanmedian(one.delays.per_command_s)))
            name = f"{axis}, {what}"
            found += [
                Row(
                    f"{name}: delay by correlation / least error",
                    "350 ms",
                    delays(one),
                    delays(two),
                    "<= 20 ms",
                    worst <= 0.02,
                ),
                Row(
                    "  per command, 5 / 50 / 95 / 100 % (ms)",
                    "mostly 350, 500 at the start",
                    quantiles_ms(one.delays.per_command_s),
                    quantiles_ms(two.delays.per_command_s),
                ),
                Row(
                    "  error, RMS raw / without delay",
                    "",
                    off(one),
                    off(two),
                    "<= 2 mm raw",
                    one.errors.rms_m <= 2e-3,
                ),
                Row(
                    "  other axes",
                    "still",
                    f"{one.errors.leakage_m * 1e3:.2f} mm",
                    f"{two.errors.leakage_m * 1e3:.2f} mm",
                    "<= 0.1 mm",
                    one.errors.leakage_m <= 1e-4,
                ),
            ]
    for one, two, what in (
        (ideal.relative_default, dynamic.relative_default, "relative"),
        (ideal.absolute_default, dynamic.absolute_default, "absolute"),
    ):
        found += [
            Row(f"x, {what}, default limits", "350 ms", delays(one), delays(two)),
            Row("  error, RMS raw / without delay", "", off(one), off(two)),
        ]
    for line in others:
        found += [
            Row(f"no arm: {line.name}", "", delays(line), ""),
            Row("  per command (ms)", "", quantiles_ms(line.delays.per_command_s), ""),
            Row("  error, RMS raw / without delay", "", off(line), ""),
        ]
    sag = max(line.sag_m for line in dynamic.relative)
    found.append(Row("sag before the line, taken off", "", "0 mm", f"{sag * 1e3:.1f} mm"))
    return found
