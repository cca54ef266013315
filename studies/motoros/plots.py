"""Equivalents of figures 2, 7 and 8 of Baklouti et al. 2021. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from cardan.common.arm_libraries import np
from studies.motoros.analysis import Result
from studies.motoros.published import STANDARD_MEAN, VELOCITY_MEAN, WORDS, Delays
from studies.motoros.recording import PUSH_S, Recording
from studies.plotting import plt
from studies.result import Drawn

DEVICE, GOAL, MEASURED = "tab:blue", "tab:green", "tab:red"
ZOOMED_S = 2.6
COLORS = {"standard": "tab:red", "stream": "tab:orange", "velocity": "tab:blue"}
STAGES = ("device to goal", "goal to measured", "total")


def draw(found: list[tuple[Recording, Result]]) -> Iterator[Drawn]:
    """Draw the runs on the paper's plant."""
    runs = {r.mode: (r, result) for r, result in found if r.plant == "paper"}
    for mode in ("standard", "velocity"):
        if mode in runs:
            yield Drawn(mode, f"First axis, {WORDS[mode]}", _motion(runs[mode][0]))
    results = {mode: result for mode, (_, result) in runs.items()}
    yield Drawn("averages", "Average delays", _averages(results))


def _motion(recording: Recording) -> Any:
    """Draw the displacement of the first axis, with two phases zoomed (figures 2 and 7)."""
    shown = range(len(recording.pushes))[-2:]
    ratios = (1.7, *(1.0 for _ in shown))
    size = (3.0 * sum(ratios), 3.4)
    figure, panels = plt.subplots(
        1, len(ratios), figsize=size, layout="constrained", width_ratios=ratios
    )
    whole, *zoomed = panels
    origin_s = recording.pushes[0] - 1.0
    every = slice(None, None, 4)
    times_s = recording.times_s[every] - origin_s
    # The mouse's requested motion, on the scale of the goal.
    scale = np.ptp(recording.goal) / np.ptp(recording.device)
    signals = (
        (recording.goal[0] + scale * recording.device, DEVICE, "device"),
        (recording.goal, GOAL, "goal"),
        (recording.measured, MEASURED, "measured"),
    )
    for axes in panels:
        for values, color, label in signals:
            axes.plot(times_s, np.degrees(values[every]), color, lw=1.2, label=label)
        axes.set(xlabel="time, s")
    for number, start_s in enumerate(recording.pushes - origin_s):
        if number % 2 == 0:
            whole.axvspan(start_s, start_s + PUSH_S, color="0.93", lw=0)
    end_s = recording.pushes[-1] - origin_s + PUSH_S
    whole.set(ylabel="joint 1, deg", xlim=(0.0, end_s), title=WORDS[recording.mode])
    figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    for axes, index in zip(zoomed, shown, strict=True):
        start_s = recording.pushes[index] - origin_s
        axes.set(xlim=(start_s - 0.2, start_s - 0.2 + ZOOMED_S), title=f"phase {index + 1}")
    return figure


def _averages(results: dict[str, Result]) -> Any:
    """Draw the average delays of each stage (figure 8), the paper's and ours."""
    figure, axes = plt.subplots(figsize=(8.0, 3.4), layout="constrained")
    bars: list[tuple[str, Delays, str]] = [
        ("paper, standard", STANDARD_MEAN, "0.75"),
        ("paper, velocity mode", VELOCITY_MEAN, "0.55"),
    ]
    for place, (mode, color) in enumerate(COLORS.items()):
        if mode in results:
            bars.insert(2 * place + 1, (f"ours, {WORDS[mode]}", results[mode].mean, color))
    width = 0.16
    for index, (name, delays, color) in enumerate(bars):
        at = np.arange(3) + (index - (len(bars) - 1) / 2.0) * width
        drawn = axes.bar(at, delays, width * 0.92, color=color, label=name)
        axes.bar_label(drawn, fmt="%.3f", fontsize=7)
    axes.set(ylabel="delay, s", xticks=range(3), xticklabels=STAGES, ylim=(-0.05, 0.95))
    axes.legend(fontsize=8, loc="upper left")
    return figure
