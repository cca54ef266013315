"""The latency study of Baklouti et al. 2021 (Yaskawa GP8, MotoROS), run on Cardan.

    python -m bench yaskawa [--plots DIR]

A simulated SpaceMouse Pro drives the first axis of a simulated GP8, three times forward and three
times backward, over the real protocols and in real time: with the standard driver's two-point
trajectories, with one endless trajectory on the same firmware, and with the velocity mode. The
controller's drives are ideal, or as slow as the paper's robot. `--plots` also draws the pictures of
docs/evaluation.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cardan.errors import ExtraMissingError
from studies.motoros.analysis import Result
from studies.motoros.published import (
    STANDARD,
    STANDARD_MEAN,
    VELOCITY,
    VELOCITY_MEAN,
    WORDS,
    Delays,
)
from studies.motoros.study import EVERY, measure

ADDED_AT_MOST_S = 0.040
"""Limit for the delay that velocity mode adds between the mouse and the controller's command."""
GOAL_RANGE_S = (0.45, 0.65)
"""Range of the standard driver's delay after the goal that agrees with the paper."""


def main() -> None:
    """Print the tables; with `--plots`, draw the pictures."""
    words = sys.argv[1:]
    directory = Path(words[words.index("--plots") + 1]) if "--plots" in words[:-1] else None
    found = measure(EVERY)
    results = {(result.mode, result.plant): result for _, result in found}
    print(compared("Table 1. Standard driver", STANDARD, results["standard", "paper"]))
    print(compared("Table 2. Velocity mode", VELOCITY, results["velocity", "paper"]))
    print(overview(list(results.values())))
    print(verdicts(results))
    if directory is not None:
        try:
            from studies import plotting
            from studies.motoros import plots
        except ExtraMissingError as error:
            print(f"\nno plots: {error}")
            return
        plotting.save(directory, plots.draw(found))
        print(f"\nplots are in {directory}")


def compared(title: str, published: tuple[Delays, ...], ours: Result) -> str:
    """Return the paper's table with our figures added."""
    lines = [
        f"\n{title}: {WORDS[ours.mode]}, paper's plant; s\n",
        f"{'':9}{'device to goal':>20}{'goal to measured':>20}{'total':>20}",
        f"{'':9}" + f"{'paper':>11}{'ours':>9}" * 3,
    ]
    rows = [*zip(published, ours.delays, strict=False), (_printed(published), ours.mean)]
    for number, (theirs, own) in enumerate(rows, 1):
        name = f"phase {number}" if number < len(rows) else "average"
        cells = "".join(f"{a:11.3f}{b:9.3f}" for a, b in zip(theirs, own, strict=True))
        lines.append(f"{name:9}{cells}")
    return "\n".join(lines)


def _printed(published: tuple[Delays, ...]) -> Delays:
    return STANDARD_MEAN if published is STANDARD else VELOCITY_MEAN


def overview(results: list[Result]) -> str:
    """Return the table of all runs, stage by stage."""
    lines = [
        "\nAverages of all phases; s\n",
        f"{'':34}{'to goal':>9}{'command':>9}{'measured':>9}{'total':>9}{'corr.':>8}"
        f"{'stops':>7}{'stopped':>9}",
    ]
    for result in results:
        name = f"{WORDS[result.mode]}, {result.plant} plant"
        to_goal, to_measured, total = result.mean
        lines.append(
            f"{name:34}{to_goal:9.3f}{result.average('goal_to_command_s'):9.3f}{to_measured:9.3f}"
            f"{total:9.3f}{result.average('correlated_total_s'):8.3f}{result.stops:7}"
            f"{result.stopped_s:9.2f}"
        )
    lines.append(
        "\nto goal: device to goal; command, measured: goal to the controller's command, and to "
        "the joint;\ntotal: device to joint, by least error; corr.: by correlation of velocities; "
        "stops: spans over 20 ms\nin which the joint stands while motion is wanted"
    )
    return "\n".join(lines)


def verdicts(results: dict[tuple[str, str], Result]) -> str:
    """Print whether the aims are met."""
    standard, velocity = results["standard", "paper"], results["velocity", "paper"]
    ideal = results["velocity", "ideal"]
    added_s = ideal.average("device_to_command_s")
    low, high = GOAL_RANGE_S
    checks = [
        (
            f"standard driver {standard.mean.goal_to_measured:.3f} s behind the goal "
            f"(paper {STANDARD_MEAN.goal_to_measured}; wanted {low} to {high})",
            low <= standard.mean.goal_to_measured <= high,
        ),
        (f"standard driver stops within motion: {standard.stops}", standard.stops > 0),
        (
            f"velocity mode, ideal drives: device to command {added_s * 1e3:.1f} ms "
            f"(wanted at most {ADDED_AT_MOST_S * 1e3:.0f} ms)",
            added_s <= ADDED_AT_MOST_S,
        ),
        (
            f"velocity mode stops within motion: {velocity.stops} and {ideal.stops}",
            velocity.stops == ideal.stops == 0,
        ),
        (
            f"velocity mode, paper's plant: {velocity.mean.total:.3f} s in all "
            f"(paper {VELOCITY_MEAN.total})",
            velocity.mean.total < VELOCITY_MEAN.total,
        ),
    ]
    gain = 1.0 - velocity.mean.total / standard.mean.total
    lines = [f"\n{'met' if good else 'MISSED':7}{words}" for words, good in checks]
    lines.append(f"\nvelocity mode against standard driver: {gain:.1%} less (paper 42.9 %)")
    return "".join(lines)
