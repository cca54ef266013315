"""Plots of a recorded session: TCP path, following error, latencies and forces."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from cardan.common.extras import missing_extra
from cardan.errors import CaptureError, OptionError
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.recording.arms import (
    POSE,
    RAW_ROBOT,
    SNAPSHOT,
    TARGET,
    WRENCH,
    choose_arm,
    stamped_ns,
)
from cardan.recording.mcap_file import RecordedMessage, RecordReader

ENDINGS = (".png", ".svg", ".pdf")

LONGEST_ANSWER_S = 1.0
"""Longest time from a robot's datagram to its answer; a later datagram is no answer."""


class Placed(NamedTuple):
    """A position at a time."""

    stamp_ns: int
    x: float
    y: float
    z: float


@dataclass
class Series:
    """Plotted data of one arm; all times since the epoch, ns."""

    poses: list[Placed] = field(default_factory=list)
    """Measured TCP poses, m."""
    targets: list[Placed] = field(default_factory=list)
    """Commanded TCP poses, m."""
    forces: list[Placed] = field(default_factory=list)
    """Forces, N."""
    answers: list[tuple[int, float]] = field(default_factory=list)
    """Latency from the robot's datagram to ours, s."""
    ticks: list[tuple[int, float, float]] = field(default_factory=list)
    """Median and 99th percentile that the session reported, s, over its time so far."""
    trips: list[int] = field(default_factory=list)
    """Times at which the motion source was disengaged."""
    _received_ns: int = 0
    _trips: int = 0

    @property
    def begin_ns(self) -> int:
        """Earliest time of all series."""
        first = [each[0][0] for each in (self.poses, self.targets, self.forces, self.ticks) if each]
        return min(first, default=0)

    def following_error(self) -> list[tuple[int, float]]:
        """Distance of commanded and measured TCP at their common times, m."""
        measured = {each.stamp_ns: each for each in self.poses}
        return [
            (each.stamp_ns, math.dist(each[1:], measured[each.stamp_ns][1:]))
            for each in self.targets
            if each.stamp_ns in measured
        ]


def _placed(message: Message, vector: Mapping[str, float]) -> Placed:
    return Placed(stamped_ns(message), vector["x"], vector["y"], vector["z"])


def _take_pose(series: Series, message: Message, _log_ns: int) -> None:
    series.poses.append(_placed(message, message["pose"]["position"]))


def _take_target(series: Series, message: Message, _log_ns: int) -> None:
    series.targets.append(_placed(message, message["pose"]["position"]))


def _take_wrench(series: Series, message: Message, _log_ns: int) -> None:
    series.forces.append(_placed(message, message["wrench"]["force"]))


def _take_snapshot(series: Series, message: Message, log_ns: int) -> None:
    snapshot = json.loads(message["data"])
    # Records from before 0.2.0 have all of it in one object.
    nested = "loop" in snapshot
    loop, arm = (snapshot["loop"], snapshot["arm"]) if nested else (snapshot, snapshot)
    if loop["cycles"]:
        series.ticks.append((log_ns, loop["tick_p50_s"], loop["tick_p99_s"]))
    if arm["trips"] > series._trips:
        series.trips.append(log_ns)
    series._trips = arm["trips"]


def _take_raw(series: Series, message: Message, _log_ns: int) -> None:
    at_ns = stamped_ns(message)
    if not message["direction"]:
        series._received_ns = at_ns
    elif series._received_ns:
        took_s = 1e-9 * (at_ns - series._received_ns)
        if took_s < LONGEST_ANSWER_S:
            series.answers.append((at_ns, took_s))
        series._received_ns = 0


_TAKEN: Mapping[str, Callable[[Series, Message, int], None]] = {
    POSE: _take_pose,
    TARGET: _take_target,
    WRENCH: _take_wrench,
    SNAPSHOT: _take_snapshot,
    RAW_ROBOT: _take_raw,
}


def read_series(path: Path, arm: str = "") -> tuple[str, Series, list[str]]:
    """Read the full name of an arm's node, its series, and the problems of the file.

    `arm`: a node's full name; "" selects the only one. Raises CaptureError, OptionError.
    """
    found: dict[str, Series] = {}
    reader = RecordReader(path)
    for message in reader:
        for end, take in _TAKEN.items():
            if message.topic.name.endswith(end):
                node = message.topic.name.removesuffix(end)
                _take(found.setdefault(node, Series()), take, message)
    found = {node: series for node, series in found.items() if series.begin_ns}
    node = choose_arm(found, arm, path, reader.problems)
    return node, found[node], reader.problems


def _take(
    series: Series, take: Callable[[Series, Message, int], None], message: RecordedMessage
) -> None:
    try:
        decoded = codec_of(message.topic.type_name).decode(message.data)
        if not isinstance(decoded, MalformedCdr):
            take(series, decoded, message.log_ns)
    except (ValueError, KeyError, TypeError):
        return  # Another node's topic with that suffix.


def plot(path: Path, picture: Path, arm: str = "") -> list[str]:
    """Plot an arm of a record to the file `picture`. Returns the problems of the record, in words.

    Raises CaptureError, OptionError or ExtraMissingError.
    """
    if picture.suffix.lower() not in ENDINGS:
        raise OptionError("--output", str(picture), f"a name that ends in {', '.join(ENDINGS)}")
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise missing_extra("a picture", "matplotlib", "evaluate", error) from error
    node, series, problems = read_series(path, arm)
    figure = Figure(figsize=(15.0, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{path.name}: {node}")
    panels = figure.subplots(2, 3)
    for axes, (across, up) in zip(panels[0], (("x", "y"), ("x", "z"), ("y", "z")), strict=True):
        _draw_path(axes, series, across, up)
    _draw_error(panels[1][0], series)
    _draw_latencies(panels[1][1], series)
    _draw_forces(panels[1][2], series)
    try:
        figure.savefig(picture, dpi=110)
    except OSError as error:
        raise CaptureError(f"{picture} cannot be written: {error.strerror or error}") from None
    return problems


def _draw_path(axes: Any, series: Series, across: str, up: str) -> None:
    for name, places, style in (
        ("commanded", series.targets, "C1-"),
        ("measured", series.poses, "C0-"),
    ):
        horizontal = [1e3 * getattr(each, across) for each in places]
        vertical = [1e3 * getattr(each, up) for each in places]
        if places:
            axes.plot(horizontal, vertical, style, lw=1.0, label=name)
    if series.poses:
        first = series.poses[0]
        axes.plot(1e3 * getattr(first, across), 1e3 * getattr(first, up), "ko", label="begin")
    axes.set(xlabel=f"{across} [mm]", ylabel=f"{up} [mm]", title=f"path of the TCP, {across}{up}")
    axes.axis("equal")
    _finish(axes, bool(series.poses or series.targets), "no pose was recorded")


def _draw_error(axes: Any, series: Series) -> None:
    error = series.following_error()
    axes.plot(_seconds(series, error), [1e3 * each[1] for each in error], "C3-", lw=1.0)
    for number, at_ns in enumerate(series.trips):
        label = "disengaged" if number == 0 else None
        axes.axvline(1e-9 * (at_ns - series.begin_ns), color="k", ls=":", label=label)
    axes.set(xlabel="time [s]", ylabel="distance [mm]", title="following error of the TCP")
    _finish(axes, bool(error), "nothing was commanded", legend=bool(series.trips))


def _draw_latencies(axes: Any, series: Series) -> None:
    if series.answers:
        ms = [1e3 * each[1] for each in series.answers]
        axes.plot(_seconds(series, series.answers), ms, "C0.", ms=2, label="each datagram")
    for index, name in ((1, "median so far"), (2, "99 % so far")):
        if series.ticks:
            ms = [1e3 * each[index] for each in series.ticks]
            axes.plot(_seconds(series, series.ticks), ms, f"C{index}-", label=name)
    axes.set(
        xlabel="time [s]", ylabel="latency [ms]", title="from the robot's datagram to the answer"
    )
    _finish(axes, bool(series.answers or series.ticks), "no latency was recorded")


def _draw_forces(axes: Any, series: Series) -> None:
    for name in "xyz":
        values = [getattr(each, name) for each in series.forces]
        axes.plot(_seconds(series, series.forces), values, lw=1.0, label=name)
    axes.set(xlabel="time [s]", ylabel="force [N]", title="force at the TCP")
    _finish(axes, bool(series.forces), "no force was measured")


def _seconds(series: Series, rows: list[Any]) -> list[float]:
    return [1e-9 * (row[0] - series.begin_ns) for row in rows]


def _finish(axes: Any, there: bool, missing: str, legend: bool = True) -> None:
    axes.grid(alpha=0.3)
    if not there:
        axes.text(0.5, 0.5, missing, transform=axes.transAxes, ha="center", va="center")
    elif legend:
        axes.legend(loc="best", fontsize="small")
