"""Pictures of docs/evaluation.md. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from cardan.common.arm_libraries import np
from studies.plotting import patches, plt
from studies.result import Drawn
from studies.thesis import arbitrary, collision, eight, faults, line
from studies.thesis.bench import DT_S, Array

COMMAND, OURS, OTHER, PUBLISHED = "0.55", "tab:blue", "tab:orange", "tab:red"


def draw(
    straight: Sequence[line.Result],
    others: tuple[line.Line, line.Line, line.Line],
    courses: Sequence[eight.Result],
    simulated_s: Array,
    hits: Sequence[collision.Result],
    free: dict[bool, list[arbitrary.Result]],
    broken: Sequence[tuple[faults.Fault, ...]],
) -> Iterator[Drawn]:
    """Draw all pictures. In each pair the ideal drive comes first."""
    yield Drawn("line", "Straight line", _line(straight, others[0]))
    yield Drawn("eight", "Eight-course", _eight(courses, simulated_s))
    yield Drawn("collision", "Collisions", _collision(hits))
    yield Drawn("arbitrary", "Arbitrary movements", _arbitrary(free))
    if broken:
        yield Drawn("faults", "A disturbed stream", _faults(broken[0]))


def _figure(columns: int, height: float = 3.4) -> Any:
    return plt.subplots(1, columns, figsize=(10.0, height), layout="constrained")


def _line(straight: Sequence[line.Result], published: line.Line) -> Any:
    figure, (left, middle, right) = _figure(3)
    ideal, dynamic = straight
    shown = (
        (ideal.relative[0], OURS, "twists, ideal"),
        (dynamic.relative[0], "tab:cyan", "twists, dynamic"),
        (ideal.absolute[0], "tab:green", "poses, ideal"),
        (published, OTHER, "published mechanism"),
    )
    every = slice(None, None, 10)
    left.plot(
        published.times_s[every], 1e3 * published.program_m[every], COMMAND, lw=3, label="program"
    )
    for one, color, label in shown:
        left.plot(one.times_s[every], 1e3 * one.output_m[every, 0], color, lw=1.2, label=label)
    left.set(xlim=(0.0, 1.2), ylim=(-5, 125), xlabel="time, s", ylabel="x, mm", title="the start")
    left.legend(loc="upper left", fontsize=8)
    sent_s = np.arange(len(ideal.relative[0].delays.per_command_s)) / line.RATE_HZ
    for one, color, label in shown:
        middle.plot(sent_s, 1e3 * one.delays.per_command_s, color, label=label)
    middle.axhline(1e3 * line.PUBLISHED_S, color=PUBLISHED, ls="--", lw=1)
    height, place = 1e3 * line.PUBLISHED_S + 9, middle.get_yaxis_transform()
    words = "published: 350 ms"
    middle.text(0.4, height, words, color=PUBLISHED, fontsize=8, transform=place)
    middle.set(
        xlabel="time of the command, s", ylabel="delay, ms", ylim=(0, 560), title="per command"
    )
    for axis, color, name in ((1, "tab:purple", "y"), (2, "tab:brown", "z")):
        for result, style in ((ideal, "-"), (dynamic, ":")):
            one = result.relative[0]
            label = f"{name}, {'ideal' if style == '-' else 'dynamic'}"
            right.plot(
                one.times_s[every], 1e3 * one.output_m[every, axis], color, ls=style, label=label
            )
    right.set(xlabel="time, s", ylabel="off the line, mm", title="the other axes (twists)")
    right.legend(fontsize=8)
    return figure


def _eight(courses: Sequence[eight.Result], simulated_s: Array) -> Any:
    figure, (left, right) = _figure(2, 4.0)
    ideal, dynamic = courses
    raw, tracked = ideal
    way = tracked.trace.measured_m[::20]
    left.scatter(1e3 * raw.sent_m[:, 1], 1e3 * raw.sent_m[:, 0], s=2, color="0.65", label="tags")
    left.plot(1e3 * way[:, 1], 1e3 * way[:, 0], OURS, lw=1.2, label="TCP (tracked poses, ideal)")
    for side in (1.0, -1.0):
        corner = (
            1e3 * (side * eight.BOX_AT_Y_M - eight.BOX_M[1]),
            1e3 * (eight.CENTER_M[0] - eight.BOX_M[0]),
        )
        size = 2e3 * eight.BOX_M[1], 2e3 * eight.BOX_M[0]
        left.add_patch(patches.Rectangle(corner, *size, color="tab:olive", alpha=0.5))
    left.set(xlabel="y, mm", ylabel="x, mm", aspect="equal", title="from above; boxes to scale")
    left.legend(loc="upper center", fontsize=8, ncols=2)
    left.set_ylim(280, 660)
    bins = np.arange(-100.0, 701.0, 12.5)
    for delays_s, color, label in (
        (tracked.delays_s, OURS, "tracked, ideal"),
        (dynamic.tracked.delays_s, "tab:cyan", "tracked, dynamic"),
        (raw.delays_s, "tab:green", "raw, ideal"),
        (simulated_s, OTHER, "published mechanism"),
    ):
        known = 1e3 * delays_s[np.isfinite(delays_s)]
        right.hist(known, bins=bins, histtype="step", color=color, lw=1.2, label=label)
    right.axvspan(370, 650, color=PUBLISHED, alpha=0.12)
    right.axvline(550, color=PUBLISHED, ls="--", lw=1)
    right.text(380, right.get_ylim()[1] * 0.4, "published:\n95 % within,\npeak at 550", fontsize=8)
    right.set(xlabel="delay, ms", ylabel="images", title="per image")
    right.legend(loc="upper right", fontsize=8)
    return figure


def _collision(hits: Sequence[collision.Result]) -> Any:
    figure, (left, middle, right) = _figure(3)
    for result, style, name in ((hits[0], "-", "ideal"), (hits[1], ":", "dynamic")):
        for stop, color, what in (
            (result.poses, OURS, "poses"),
            (result.twists, "tab:green", "twist"),
        ):
            trace, every = stop.trace, slice(None, None, 5)
            since = trace.times_s[every] - stop.back_s
            clear = 1e3 * trace.obstacle_m[every]
            left.plot(since, clear, color, ls=style, label=f"{what}, {name}")
        itself = result.itself
        middle.plot(
            itself.trace.times_s[::5] - itself.back_s,
            1e3 * itself.trace.own_m[::5],
            OURS,
            ls=style,
            label=name,
        )
        jump = result.jump
        right.plot(
            jump.trace.times_s[::2], 1e3 * jump.trace.obstacle_m[::2], OURS, ls=style, label=name
        )
    left.axhline(1e3 * collision.SAFETY_M, color="0.4", ls="--", lw=1)
    left.set(xlabel="time since it is asked back, s", ylabel="clearance, mm", title="into a wall")
    left.set_ylim(0, 105)
    middle.axhline(1e3 * collision.OWN_M, color="0.4", ls="--", lw=1)
    middle.set(xlabel="time since it is asked back, s", title="into itself", ylim=(-2, None))
    middle.axhline(0.0, color="black", lw=0.8)
    right.axhline(1e3 * collision.SAFETY_M, color="0.4", ls="--", lw=1)
    right.axhline(1e3 * hits[0].jump.published_m, color=PUBLISHED, ls="--", lw=1)
    right.text(
        0.3, 1e3 * hits[0].jump.published_m + 1, "published: through the wall", color=PUBLISHED,
        fontsize=8,
    )  # fmt: skip
    right.axhline(0.0, color="black", lw=0.8)
    right.set(xlabel="time since the pose, s", title="one pose behind a wall", xlim=(0, 1.5))
    for axes in (left, middle, right):
        axes.legend(fontsize=8)
    return figure


def _arbitrary(free: dict[bool, list[arbitrary.Result]]) -> Any:
    figure, (left, middle, right) = _figure(3)
    device = free[False][0]
    driven = [(device, OTHER, "Cartesian device")]
    if True in free:
        driven.append((free[True][0], OURS, "shaper"))
    for result, color, label in driven:
        for turning in (result.left, result.right):
            trace = turning.trace
            turned = (trace.joints[::50, 6] - trace.joints[0, 6]) / (2.0 * np.pi)
            left.plot(
                trace.times_s[::50],
                turned,
                color,
                label=label if turning is result.left else None,
            )
    left.set(xlabel="time, s", ylabel="turns of the wrist's joint", title="turns each way")
    left.legend(fontsize=8, loc="center right")
    wander = device.wander
    for index, name in enumerate("xyz"):
        wanted = 1e3 * wander.wanted_m[::25, index]
        way = 1e3 * (wander.trace.measured_m[::25, index] - wander.trace.measured_m[0, index])
        times_s = np.arange(len(wanted)) * 25 * DT_S
        middle.plot(times_s, wanted, COMMAND, lw=2.5, label="commands" if index == 0 else None)
        middle.plot(times_s, way, lw=1, label=name)
    middle.set(xlabel="time, s", ylabel="way, mm", title="free motion (Cartesian device)")
    middle.legend(fontsize=8, ncols=2)
    for result, color, label in (
        *driven,
        (free[False][1], "tab:cyan", "Cartesian device, dynamic"),
    ):
        wander = result.wander
        right.plot(wander.sent_s[::4], 1e3 * wander.delays_s[::4], color=color, lw=1, label=label)
    right.axhline(500, color=PUBLISHED, ls="--", lw=1)
    words = "published: about 500 ms, outliers to 6 s"
    place = right.get_yaxis_transform()
    right.text(0.03, 515, words, color=PUBLISHED, fontsize=8, transform=place)
    right.set(xlabel="time of the command, s", ylabel="delay, ms", ylim=(0, 600))
    right.set_title("per command")
    right.legend(fontsize=8, loc="center right")
    return figure


def _faults(broken: tuple[faults.Fault, ...]) -> Any:
    figure, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    for index, fault in enumerate(broken):
        trace = fault.trace
        way = 1e3 * (trace.measured_m[::20, 0] - trace.measured_m[0, 0])
        axes.plot(trace.times_s[::20], way - 25.0 * index, label=fault.name)
    axes.set(xlabel="time, s", ylabel="x, mm; each 25 mm below the one before")
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
