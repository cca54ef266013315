"""The equivalents of figures 2, 7 and 8 of Baklouti et al. 2021. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from bench.thesis.plots import STYLE
from bench.yaskawa import WORDS
from bench.yaskawa.analysis import Result
from bench.yaskawa.published import STANDARD_MEAN, VELOCITY_MEAN, Delays
from bench.yaskawa.rig import PUSH_S, Recording

mpl.use("Agg")
import matplotlib.pyplot as plt

DEVICE, GOAL, MEASURED = "tab:blue", "tab:green", "tab:red"
ZOOMED_S = 2.6
STAGES = ("device to goal", "goal to measured", "total")


def draw(directory: Path, found: list[tuple[Recording, Result]]) -> None:
    """All pictures as SVG into `directory`."""
    directory.mkdir(parents=True, exist_ok=True)
    runs = {(r.mode, r.plant): (r, result) for r, result in found}
    with plt.rc_context(STYLE):
        for mode in ("standard", "velocity"):
            figure = _motion(runs[mode, "paper"][0])
            _save(figure, directory / f"{mode}.svg", f"First axis, {WORDS[mode]}")
        results = {mode: runs[mode, "paper"][1] for mode in ("standard", "stream", "velocity")}
        _save(_averages(results), directory / "averages.svg", "Average delays")


def _save(figure: Any, path: Path, title: str) -> None:
    figure.savefig(path, metadata={"Date": None, "Creator": None, "Title": title})
    plt.close(figure)


def _motion(recording: Recording) -> Any:
    """Displacement of the first axis, whole and with two phases zoomed (figures 2 and 7)."""
    figure, (whole, fifth, sixth) = plt.subplots(
        1, 3, figsize=(11.0, 3.4), layout="constrained", width_ratios=(1.7, 1.0, 1.0)
    )
    origin_s = recording.pushes[0] - 1.0
    every = slice(None, None, 4)
    times_s = recording.times_s[every] - origin_s
    # What the mouse asks for, on the scale of the goal.
    scale = np.ptp(recording.goal) / np.ptp(recording.device)
    signals = (
        (recording.goal[0] + scale * recording.device, DEVICE, "device"),
        (recording.goal, GOAL, "goal"),
        (recording.measured, MEASURED, "measured"),
    )
    for axes in (whole, fifth, sixth):
        for values, colour, label in signals:
            axes.plot(times_s, np.degrees(values[every]), colour, lw=1.2, label=label)
        axes.set(xlabel="time, s")
    for number, start_s in enumerate(recording.pushes - origin_s):
        if number % 2 == 0:
            whole.axvspan(start_s, start_s + PUSH_S, color="0.93", lw=0)
    end_s = recording.pushes[-1] - origin_s + PUSH_S
    whole.set(ylabel="joint 1, deg", xlim=(0.0, end_s), title=WORDS[recording.mode])
    figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    for axes, start_s, name in zip(
        (fifth, sixth), recording.pushes[-2:] - origin_s, ("phase 5", "phase 6"), strict=True
    ):
        axes.set(xlim=(start_s - 0.2, start_s - 0.2 + ZOOMED_S), title=name)
    return figure


def _averages(results: dict[str, Result]) -> Any:
    """Average delays of each stage (figure 8), the paper's and ours."""
    figure, axes = plt.subplots(figsize=(8.0, 3.4), layout="constrained")
    bars: list[tuple[str, Delays, str]] = [
        ("paper, standard", STANDARD_MEAN, "0.75"),
        ("ours, two-point trajectories", results["standard"].mean, "tab:red"),
        ("paper, velocity mode", VELOCITY_MEAN, "0.55"),
        ("ours, endless trajectory", results["stream"].mean, "tab:orange"),
        ("ours, velocity mode", results["velocity"].mean, "tab:blue"),
    ]
    width = 0.16
    for index, (name, delays, colour) in enumerate(bars):
        at = np.arange(3) + (index - 2) * width
        drawn = axes.bar(at, delays, width * 0.92, color=colour, label=name)
        axes.bar_label(drawn, fmt="%.3f", fontsize=7)
    axes.set(ylabel="delay, s", xticks=range(3), xticklabels=STAGES, ylim=(-0.05, 0.95))
    axes.legend(fontsize=8, loc="upper left")
    return figure
