"""The same controller on each arm, with velocity and position commands, in virtual time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cardan.common.arm_libraries import np
from studies.metrics import delay_by_least_error
from studies.result import Figure, Table, known
from studies.thesis.bench import DT_S, Array, Bench, Metronome

ARMS = ("asibot", "amor", "teo_right_arm", "ur5", "gofa_crb15000_5")
PUBLISHED = {"asibot", "amor", "teo_right_arm"}
"""Arms that the paper moved, too."""

RATE_HZ = 50.0
SPEED_M_S = 0.05
LENGTH_M = 0.03
"""Length of the motion, up from the arm's home."""
HOLD_S = 1.0
LONGEST_S = 0.5


class Moved(NamedTuple):
    """Result of moving an arm up with one kind of command."""

    arm: str
    joints: int
    commands: str
    delay_s: float
    """Delay on ideal drives, by least error."""
    reached_m: float
    """Height reached on ideal drives."""
    drop_m: float
    """Descent of the arm with its dynamics while holding after the motion."""
    refusals: int


def _program(times_s: Array) -> Array:
    way: Array = np.clip(SPEED_M_S * times_s, 0.0, LENGTH_M)
    return way


def _run(arm: str, drive: str, commands: str) -> tuple[Array, Array, int, int]:
    bench = Bench(arm, drive, counterbalanced=False)  # type: ignore[arg-type]
    driving = bench.streams("twst" if commands == "velocity" else "pose")
    start, clock = bench.placement(driving), Metronome(RATE_HZ)
    period_s = 1.0 / RATE_HZ

    def operator(now_s: float) -> None:
        due_s = clock.due(now_s)
        if due_s is None:
            return
        here, there = _program(np.array((due_s, due_s + period_s)))
        if commands == "velocity":
            driving.twist((0.0, 0.0, float(there - here) / period_s))
        else:
            goal = start.translation + np.array((0.0, 0.0, float(here)))
            driving.pose(goal, start.rotation)

    trace = bench.run(driving, LENGTH_M / SPEED_M_S + HOLD_S, operator)
    way: Array = trace.measured_m[:, 2] - trace.measured_m[0, 2]
    return trace.times_s, way, len(driving.refusals), trace.joints.shape[1]


def move(arm: str, commands: str) -> Moved:
    """Move up by 30 mm and hold for a second; `commands`: velocity or position."""
    times_s, way, refusals, joints = _run(arm, "ideal", commands)
    wanted = _program(times_s)[:, None]
    delay_s = delay_by_least_error(DT_S, wanted, way[:, None], LONGEST_S)
    _, sagged, more, _ = _run(arm, "dynamic", commands)
    held = sagged[round((LENGTH_M / SPEED_M_S + 0.3 * HOLD_S) / DT_S) :]
    drop_m = max(0.0, float(held[0] - held.min()))
    return Moved(arm, joints, commands, delay_s, float(way[-1]), drop_m, refusals + more)


def measure(arms: Sequence[str] = ARMS) -> list[Moved]:
    """Measure each arm with both kinds of commands."""
    return [move(arm, commands) for arm in arms for commands in ("velocity", "position")]


def table(found: Sequence[Moved]) -> Table:
    """Return the table, a row per arm."""
    rows = tuple(
        (
            each.arm,
            "moved" if each.arm in PUBLISHED else "–",
            str(each.joints),
            each.commands,
            f"{1e3 * each.delay_s:.0f} ms",
            f"{1e3 * each.reached_m:.2f} of {1e3 * LENGTH_M:g} mm",
            f"{1e3 * each.drop_m:.2f} mm",
            str(each.refusals),
        )
        for each in found
    )
    columns = (
        *("arm", "published", "joints", "commands", "delay, ideal drives", "reached"),
        *("comes down while it holds, with dynamics", "refused"),
    )
    note = (
        "The paper saw real arms bend to the ground under velocity commands and integrates them "
        "into positions instead; here both are references that are held by position."
    )
    return Table("The one controller on each arm", columns, rows, note)


def figures(found: Sequence[Moved]) -> list[Figure]:
    """Return the figures by which reports are compared."""
    made = []
    for each in found:
        name = f"{each.arm}, {each.commands}"
        delay_ms = known(1e3 * each.delay_s)
        made.append(Figure(f"{name}: delay", delay_ms, "ms", "less", 1e3 * DT_S))
        made.append(Figure(f"{name}: comes down", 1e3 * each.drop_m, "mm", "less", 0.1))
    return made
