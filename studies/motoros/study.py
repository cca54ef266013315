"""The latency study of 2021 (Yaskawa GP8, MotoROS): method, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from studies.motoros.analysis import Result as Run, analyze
from studies.motoros.published import (
    STANDARD,
    STANDARD_MEAN,
    VELOCITY,
    VELOCITY_MEAN,
    WORDS,
    Delays,
)
from studies.motoros.recording import MODES, PLANTS, Recording, record
from studies.result import Drawn, Figure, Result, Table, spread_of
from studies.side_by_side import side_by_side

PUSHES = 6
TRIES = 3
QUICK = (("standard", "paper"), ("velocity", "paper"))
"""Modes and plants of --quick: the two in the paper."""

SPREAD_S = 0.010
"""Minimum spread of a delay: the phase between the session's and the controller's cycles is
random."""

STAGES = ("device to goal", "goal to measured", "total")
PUBLISHED = {
    "standard": ("Table 1 of the paper, standard driver", STANDARD, STANDARD_MEAN),
    "velocity": ("Table 2 of the paper, velocity mode", VELOCITY, VELOCITY_MEAN),
}

HOW = (
    "Real time. A simulated SpaceMouse Pro pushes the first axis of a simulated GP8 forward and "
    "backward in turn; mouse and controller are processes of their own and speak the real "
    "protocols, the session is the one of `cardan run`. The plant called the paper's is as slow as "
    "its robot (a lag of 0.268 s, fitted), so the plant's share of each delay is put in, and what "
    "the modes add to it is measured; the ideal one has no lag. A delay is a shift of least error."
)


def measure(runs: Sequence[tuple[str, str]], pushes: int = PUSHES) -> list[tuple[Recording, Run]]:
    """Record each mode on its plant in sequence. Raises RuntimeError if the joint did not move."""
    return [recorded(mode, plant, pushes) for mode, plant in runs]


def recorded(mode: str, plant: str, pushes: int) -> tuple[Recording, Run]:
    """Record a run; repeat if a busy machine was not ready when the device pushed."""
    for left in reversed(range(TRIES)):
        try:
            recording = record(mode, plant, pushes)
            return recording, analyze(recording)
        except ValueError as error:
            if not left:
                words = f"{WORDS[mode]}, {plant} plant, tried {TRIES} times: {error}"
                raise RuntimeError(words) from None
    raise AssertionError


EVERY = tuple((mode, plant) for plant in PLANTS for mode in MODES)


def run(quick: bool) -> Result:
    """Run the study."""
    if quick:
        calls = [(mode, plant, 1) for mode, plant in QUICK]
        found = side_by_side(recorded, calls, len(calls))
    else:
        found = measure(EVERY)

    def draw() -> Iterator[Drawn]:
        from studies.motoros import plots

        return plots.draw(found)

    runs = [result for _, result in found]
    shortened = (
        f"one push forward instead of {PUSHES}, forward and backward in turn: no spread of phases",
        "both runs at the same time",
        "left out: the endless trajectory, and the plant without lag",
    )
    return Result(
        HOW,
        tables(runs),
        figures(runs),
        draw,
        shortened=shortened if quick else (),
    )


def tables(runs: list[Run]) -> tuple[Table, ...]:
    """Return the table of the paper's two modes and ours, and that of all runs."""
    beside = (
        _beside(*PUBLISHED[one.mode], one)
        for one in runs
        if one.plant == "paper" and one.mode in PUBLISHED
    )
    return (*beside, _overview(runs))


def _beside(title: str, published: tuple[Delays, ...], mean: Delays, ours: Run) -> Table:
    columns = ["delay, s"]
    for stage in STAGES:
        columns += [f"{stage}: published", "ours"]
    rows = []
    for number, theirs in enumerate(published):
        own = ours.delays[number] if number < len(ours.delays) else None
        rows.append(_row(f"phase {number + 1}", theirs, own))
    rows.append(_row("average", mean, ours.mean))
    return Table(title, tuple(columns), tuple(rows), "–: not measured.")


def _row(name: str, theirs: Delays, own: Delays | None) -> tuple[str, ...]:
    cells = [name]
    for index, value in enumerate(theirs):
        cells += [f"{value:.3f}", "–" if own is None else f"{own[index]:.3f}"]
    return tuple(cells)


def _overview(runs: list[Run]) -> Table:
    rows = []
    for one in runs:
        to_goal, to_measured, total = one.mean
        rows.append(
            (
                WORDS[one.mode],
                one.plant,
                *(
                    f"{value:.3f}"
                    for value in (
                        to_goal, one.average("goal_to_command_s"), to_measured, total,
                        one.average("correlated_total_s"),
                    )
                ),
                str(one.stops),
                f"{one.stopped_s:.2f}",
            )
        )  # fmt: skip
    columns = (
        *("what the session sends", "plant", "device to goal", "goal to command"),
        *("goal to measured", "total", "total by correlation", "stops", "stopped"),
    )
    return Table("All runs: averages of all phases, s", columns, tuple(rows), _NOTE)


_NOTE = (
    "Command: the controller's to its drives. Stops: spans over 20 ms in which the joint stands "
    "while motion is wanted. With stops the correlation of velocities is ambiguous."
)


def figures(runs: list[Run]) -> tuple[Figure, ...]:
    """Return the figures by which reports are compared."""
    made = []
    for one in runs:
        name, once = f"{WORDS[one.mode]}, {one.plant} plant", len(one.phases) == 1
        mean = PUBLISHED[one.mode][2] if one.mode in PUBLISHED and one.plant == "paper" else None
        for index, stage in enumerate(STAGES):
            spread_ms = None
            if not once:
                values = (delays[index] for delays in one.delays)
                spread_ms = 1e3 * spread_of(values, SPREAD_S)
            published = None if mean is None else 1e3 * mean[index]
            value = 1e3 * one.mean[index]
            made.append(Figure(f"{name}: {stage}", value, "ms", "less", spread_ms, published))
        per_push, spread = one.stops / len(one.phases), None if once else 1.0
        made.append(Figure(f"{name}: stops of a push", per_push, "", "less", spread))
    return tuple(made)
