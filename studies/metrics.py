"""Delays, errors and stops of a motion that follows a command. Both on one clock, s.

A delay is measured in three ways, because each alone can mislead: as the shift of best correlation
of the velocities (steps and reversals), as the shift of least error (ramps, which correlate badly),
and per command, as the time until the output reaches the commanded position (the delay felt by the
operator).
"""

from __future__ import annotations

from typing import NamedTuple

from cardan.common.arm_libraries import np, npt

Array = npt.NDArray[np.float64]

STOP_COMMANDED = 0.05
"""Share of the fastest commanded speed above which motion is commanded ..."""

STOP_MEASURED = 0.01
"""... and below which it has stopped ..."""

STOP_LONGER_THAN_S = 0.02
"""... for at least this time: a stop phase."""


def velocity(times_s: Array, values: Array) -> Array:
    """Central differences of `values` (time × axes)."""
    found: Array = np.gradient(values, times_s, axis=0)
    return found


def _parabola(scores: Array, best: int) -> float:
    """Offset of the extremum from `best`, in samples, by a parabola through the neighbors."""
    if not 0 < best < len(scores) - 1:
        return 0.0
    left, middle, right = scores[best - 1 : best + 2]
    curve = left - 2.0 * middle + right
    return 0.0 if curve == 0.0 else float(0.5 * (left - right) / curve)


def delay_by_correlation(dt_s: float, commanded: Array, measured: Array, longest_s: float) -> float:
    """Return the shift of `measured` with the best correlation of velocities, s; axes are
    summed."""
    most = round(longest_s / dt_s)
    one, two = np.gradient(commanded, axis=0), np.gradient(measured, axis=0)
    count = len(one) - most
    one = one[:count]
    scores = np.empty(most + 1)
    for k in range(most + 1):
        window = two[k : k + count]
        scores[k] = float((one * window).sum() / (np.linalg.norm(window) + 1e-12))
    best = int(np.argmax(scores))
    return (best + _parabola(scores, best)) * dt_s


def delay_by_least_error(dt_s: float, commanded: Array, measured: Array, longest_s: float) -> float:
    """Return the shift of `measured` with the least distance from `commanded`, s."""
    most = round(longest_s / dt_s)
    count = len(commanded) - most
    scores = np.array(
        [float(((measured[k : k + count] - commanded[:count]) ** 2).sum()) for k in range(most + 1)]
    )
    best = int(np.argmin(scores))
    return (best + _parabola(scores, best)) * dt_s


def delays_per_command(
    command_times_s: Array, commands: Array, times_s: Array, measured: Array, longest_s: float
) -> Array:
    """For each command (time × axes), return the time until the output's first nearest approach, s.

    The search ends after `longest_s`, or when the output moves away again. NaN for a command if the
    output never covers half of its initial distance from it.
    """
    found = np.full(len(commands), np.nan)
    for index, (start_s, command) in enumerate(zip(command_times_s, commands, strict=True)):
        first = int(np.searchsorted(times_s, start_s))
        last = int(np.searchsorted(times_s, start_s + longest_s))
        distance = np.linalg.norm(measured[first:last] - command, axis=1)
        if len(distance) == 0:
            continue
        near = np.flatnonzero((distance[1:-1] <= distance[:-2]) & (distance[1:-1] < distance[2:]))
        candidates = [int(k) + 1 for k in near if distance[k + 1] <= 0.5 * distance[0]]
        if distance[0] <= 1e-4:
            found[index] = 0.0
        elif candidates:
            found[index] = times_s[first + candidates[0]] - start_s
        elif distance[-1] <= 0.5 * distance[0] and distance[-1] == distance.min():
            settled = int(np.argmax(distance <= distance[-1] + 1e-4))
            found[index] = times_s[first + settled] - start_s
    return found


class StopPhases(NamedTuple):
    """Stops during commanded motion."""

    count: int  # type: ignore[assignment]
    total_s: float


def stop_phases(times_s: Array, commanded: Array, measured: Array) -> StopPhases:
    """Find spans longer than 20 ms in which motion is commanded and there is none."""
    wanted = np.linalg.norm(velocity(times_s, commanded), axis=1)
    found = np.linalg.norm(velocity(times_s, measured), axis=1)
    fastest = float(wanted.max())
    stopped = (wanted > STOP_COMMANDED * fastest) & (found < STOP_MEASURED * fastest)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], stopped.astype(int), [0]))))
    dt_s = float(times_s[1] - times_s[0])
    lengths = (edges[1::2] - edges[::2]) * dt_s
    lengths = lengths[lengths > STOP_LONGER_THAN_S]
    return StopPhases(len(lengths), float(lengths.sum()))


class Errors(NamedTuple):
    """Distance from command to output, m."""

    rms_m: float
    max_m: float
    rms_without_delay_m: float
    max_without_delay_m: float
    leakage_m: float
    """Largest motion along axes without commands."""


def errors(dt_s: float, commanded: Array, measured: Array, delay_s: float) -> Errors:
    """Position errors, raw and after removal of the delay, and cross-axis leakage."""
    raw = np.linalg.norm(commanded - measured, axis=1)
    shift = round(delay_s / dt_s)
    aligned = np.linalg.norm(commanded[: len(commanded) - shift] - measured[shift:], axis=1)
    still = np.ptp(commanded, axis=0) < 1e-9
    leak = np.abs(measured - commanded)[:, still]
    return Errors(
        float(np.sqrt((raw**2).mean())),
        float(raw.max()),
        float(np.sqrt((aligned**2).mean())),
        float(aligned.max()),
        float(leak.max()) if leak.size else 0.0,
    )
