"""Pictures of docs/stability.md. Needs matplotlib."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from cardan.common.arm_libraries import np
from studies.haptics import theory
from studies.haptics.far import STIFFNESS_N_M, Point
from studies.haptics.faults import FAULT_S, LIMITS, FaultResponse
from studies.haptics.loop import TICK_S, Array, Trace
from studies.haptics.remote import Link
from studies.haptics.stability import (
    CHANNEL_DELAY_S,
    CHANNEL_STIFFNESS_N_M,
    GRID_DELAYS_S,
    GRID_STIFFNESSES,
    HELD,
    JITTERS_S,
    LOSSES,
    OURS,
    PERIODS_S,
    PLAIN,
    PUSHES,
    SAMPLED_STIFFNESSES,
    Compared,
    Hand,
    Verdict,
    hidden_j,
    link_words,
    remote,
)
from studies.haptics.zwidth import VISCOUS_N_S_M, Width
from studies.plotting import colors, plt
from studies.result import Drawn

OURS_COLOR, OFF_COLOR, PLAIN_COLOR = "tab:blue", "tab:orange", "tab:red"
THEORY = "black"
PAIR = (400.0, Link(0.05))
"""Stiffness and link of the traces of the held stylus."""
ROBOT_LAG_S = 0.004
FAULT_RESPONSES = (
    "command source dead",
    "NaN as position",
    "comm error",
    "ticks 5 ms late",
    "measured force steps to 50 N",
    "wall jumps 20 mm",
    "thrown along the wall",
)


def draw_pair() -> Iterator[Drawn]:
    """Draw the most telling pair of traces; runs their simulations."""
    yield Drawn("pair", "An unstable and a stable loop", _pair())


def draw(
    grids: list[list[Compared]],
    channel: list[Compared],
    sampling: list[Compared],
    widths: list[Width],
    responses: list[FaultResponse],
    far: list[Point],
) -> Iterator[Drawn]:
    """Draw all pictures."""
    yield Drawn("map", "Stability over stiffness and delay", _map(grids))
    yield Drawn("channel", "Jitter, loss and sampling", _channel(channel, sampling))
    yield from draw_pair()
    yield Drawn("energy", "Energy given to the hand", _energy())
    yield Drawn("zwidth", "Z-width", _zwidth(widths))
    yield Drawn("faults", "Faults as the hand feels them", _faults(responses))
    yield Drawn("far", "Stiffness felt over delay", _far(far))


def _map(grids: list[list[Compared]]) -> Any:
    figure, axes = plt.subplots(
        len(grids), 2, figsize=(10.0, 3.3 * len(grids)), layout="constrained", squeeze=False
    )
    delays_ms = 2e3 * np.array(GRID_DELAYS_S)
    for row, points in zip(axes, grids, strict=True):
        hand = points[0].hand
        for cell, name in zip(row, ("plain", "ours"), strict=True):
            columns = [f"{delay:g}" for delay in delays_ms]
            mesh = _cell(cell, points, name, columns, _edges(GRID_STIFFNESSES), GRID_STIFFNESSES)
            if name == "plain":
                limits = [_limit(hand, delay_s) for delay_s in GRID_DELAYS_S]
                cell.plot(range(len(delays_ms)), limits, color=THEORY, label="linear theory")
                rule = [_rule(hand, delay_s) for delay_s in GRID_DELAYS_S]
                cell.plot(range(len(delays_ms)), rule, color=THEORY, ls="--", label="rule of thumb")
                cell.legend(loc="upper right", fontsize=7, frameon=True)
            cell.set(
                yscale="log",
                ylim=(_edges(GRID_STIFFNESSES)[0], _edges(GRID_STIFFNESSES)[-1]),
                title=f"{name}, {hand.name}",
                xlabel="delay there and back, ms",
                ylabel="stiffness felt, N/m",
            )
        figure.colorbar(mesh, ax=row, label="energy given, mJ")
    return figure


def _cell(
    cell: Any,
    points: list[Compared],
    name: str,
    columns: list[str],
    edges: list[float],
    rows: tuple[float, ...],
) -> Any:
    """Draw the energy given by one of the loops, row by row; crosses mark unstable runs."""
    verdicts: list[Verdict] = [getattr(point, name) for point in points]
    given_mj = [1e3 * max(verdict.given_j, 1e-4) for verdict in verdicts]
    mesh = cell.pcolormesh(
        np.arange(len(columns) + 1) - 0.5,
        edges,
        np.array(given_mj).reshape(len(rows), len(columns)),
        norm=colors.LogNorm(0.1, 3000.0),
        cmap="YlOrRd",
        rasterized=True,
    )
    bad = [
        (index % len(columns), rows[index // len(columns)])
        for index, verdict in enumerate(verdicts)
        if not verdict.stable
    ]
    if bad:
        cell.plot(*np.array(bad).T, "x", color="black", ms=4, label="unstable")
    cell.set_xticks(range(len(columns)), columns)
    cell.grid(visible=False)
    return mesh


def _channel(channel: list[Compared], sampling: list[Compared]) -> Any:
    figure, axes = plt.subplots(2, 2, figsize=(10.0, 6.0), layout="constrained")
    losses = tuple(100.0 * loss for loss in LOSSES)
    jitters = [f"{2e3 * jitter:g}" for jitter in JITTERS_S]
    periods = [f"{1e3 * period:g}" for period in PERIODS_S]
    for column, name in enumerate(("plain", "ours")):
        top, bottom = axes[0][column], axes[1][column]
        mesh = _cell(top, channel, name, jitters, [x - 10.0 for x in (*losses, 100.0)], losses)
        top.set(
            title=f"{name}, {channel[0].hand.name}, {CHANNEL_STIFFNESS_N_M:.0f} N/m, "
            f"{2e3 * CHANNEL_DELAY_S:.0f} ms",
            xlabel="jitter there and back, up to, ms",
            ylabel="lost each way, %",
        )
        edges = [
            SAMPLED_STIFFNESSES[0] - 250.0,
            *((a + b) / 2.0 for a, b in itertools.pairwise(SAMPLED_STIFFNESSES)),
            SAMPLED_STIFFNESSES[-1] + 500.0,
        ]
        _cell(bottom, sampling, name, periods, edges, SAMPLED_STIFFNESSES)
        bottom.set(
            title=f"{name}, {sampling[0].hand.name}, no delay",
            xlabel="both ends look each, ms",
            ylabel="stiffness felt, N/m",
        )
    figure.colorbar(mesh, ax=axes, label="energy given, mJ")
    return figure


def _far(points: list[Point]) -> Any:
    figure, axes = plt.subplots(1, 2, figsize=(10.0, 3.2), layout="constrained", sharey=True)
    hands = list(dict.fromkeys(each.hand for each in points))
    for cell, hand in zip(axes, hands, strict=True):
        own = [each for each in points if each.hand == hand]
        delays_ms = [1e3 * each.delay_s for each in own]
        for name, values, color in (
            ("law of both ends", [each.rendered_n_m for each in own], OURS_COLOR),
            ("the tick alone", [each.alone_n_m for each in own], OFF_COLOR),
        ):
            cell.plot(delays_ms, values, "o-", color=color, label=name)
        unstable = [1e3 * each.delay_s for each in own if not each.plain.stable]
        cell.plot(unstable, [0.0] * len(unstable), "x", color=PLAIN_COLOR, label="plain unstable")
        cell.axhline(STIFFNESS_N_M, color=THEORY, ls="--", lw=1, label="the wall")
        cell.set(title=hand.name, xlabel="delay one way, ms", ylabel="stiffness felt, N/m")
        cell.legend(fontsize=8)
    return figure


def _edges(values: tuple[float, ...]) -> list[float]:
    ratio = (values[1] / values[0]) ** 0.5
    return [values[0] / ratio, *(value * ratio for value in values)]


def _samples(delay_s: float) -> int:
    return round((2.0 * delay_s + ROBOT_LAG_S + TICK_S) / Link().period_s)


def _held(hand: Hand) -> theory.Held:
    mass_kg = hand.settings.mass_kg + hand.mass_kg
    return theory.Held(mass_kg, hand.damping_n_s_m + VISCOUS_N_S_M, hand.stiffness_n_m)


def _limit(hand: Hand, delay_s: float) -> float:
    return theory.stable_stiffness(_held(hand), Link().period_s, _samples(delay_s))


def _rule(hand: Hand, delay_s: float) -> float:
    late_s = 2.0 * delay_s + ROBOT_LAG_S + TICK_S
    return theory.stable_stiffness_rule(_held(hand).damping_n_s_m, Link().period_s, late_s)


def _bound_mj(trace: Trace) -> Array:
    """Return the energy bound of a run of ours."""
    bound: Array = 1e3 * (OURS.energy_budget_j + np.maximum(0.0, hidden_j(trace)))
    return bound


def _pair() -> Any:
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(10.0, 3.2), layout="constrained")
    for limits, color, name in ((PLAIN, PLAIN_COLOR, "plain"), (OURS, OURS_COLOR, "ours")):
        trace = remote(limits, HELD, *PAIR)
        every = slice(None, None, 4)
        times_s = trace.times_s[every]
        left.plot(times_s, 1e3 * trace.position_m[every, 2], color, lw=1, label=name)
        middle.plot(times_s, trace.sent_n[every, 2], color, lw=1, label=name)
        right.plot(times_s, 1e3 * trace.given_j[every], color, lw=1.2, label=name)
        if limits is OURS:
            bound = _bound_mj(trace)[every]
            right.plot(times_s, bound, "0.3", ls="--", lw=1, label="the bound of ours")
    left.set(xlabel="time, s", ylabel="mm", title="height of the stylus over the wall")
    middle.set(xlabel="time, s", ylabel="N", title="force")
    right.set(xlabel="time, s", ylabel="mJ", title="energy given to the hand")
    right.set_yscale("symlog", linthresh=5.0)
    for axes in (left, middle, right):
        axes.legend(fontsize=8)
    return figure


def _energy() -> Any:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.4), layout="constrained")
    for index, push in enumerate(PUSHES):
        color = f"C{index}"
        stiffness, link = push.pushed
        for limits, axes in ((PLAIN, left), (OURS, right)):
            trace: Trace = remote(limits, push.hand, stiffness, link)
            given_mj = 1e3 * trace.given_j[::10]
            label = f"{push.name}: {push.hand.name}, {stiffness:.0f} N/m, {link_words(link)}"
            axes.plot(trace.times_s[::10], given_mj, color, lw=1, label=label)
            if limits is OURS:
                axes.plot(trace.times_s[::10], _bound_mj(trace)[::10], color, ls=":", lw=1)
    left.set(xlabel="time, s", ylabel="mJ", title="plain: energy given to the hand")
    left.set_yscale("symlog", linthresh=10.0)
    right.set(xlabel="time, s", ylabel="mJ", title="ours; dotted: its bound", ylim=(-3.0, 10.0))
    figure.legend(
        *left.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=2
    )
    return figure


def _zwidth(widths: list[Width]) -> Any:
    figure, axes = plt.subplots(figsize=(7.0, 3.8), layout="constrained")
    damping = np.array([one.damping_n_s_m for one in widths])
    for name, color, style, label in (
        ("plain_frictionless", PLAIN_COLOR, "o--", "plain, no friction"),
        ("off_frictionless", OFF_COLOR, "o--", "ours, controller off, no friction"),
        ("ours_frictionless", OURS_COLOR, "o--", "ours, no friction"),
        ("plain", PLAIN_COLOR, "o-", "plain, friction 0.26 N"),
        ("off", OFF_COLOR, "o-", "ours, controller off, friction 0.26 N"),
        ("ours", OURS_COLOR, "o-", "ours, friction 0.26 N"),
    ):
        axes.plot(damping, [getattr(one, name) for one in widths], style, color=color, label=label)
    fine = np.linspace(0.0, float(damping.max()), 200)
    passive = [theory.passive_stiffness(VISCOUS_N_S_M, b, TICK_S) for b in fine]
    axes.plot(fine, passive, color=THEORY, label="passive by theory: b > KT/2 + |B|")
    axes.plot(
        damping,
        [one.stable_by_theory for one in widths],
        color=THEORY,
        ls=":",
        label="stable by rule: (b + B) / (T/2 + 1 ms)",
    )
    axes.set(xlabel="damping of the wall, N·s/m", ylabel="stiffest wall, N/m", yscale="log")
    axes.set_ylim(20.0, 10_000.0)
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _faults(responses: list[FaultResponse]) -> Any:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.4), layout="constrained")
    by_name = {one.fault.name: one for one in responses}
    for name in FAULT_RESPONSES:
        trace = by_name[name].trace
        since_ms = 1e3 * (trace.times_s - FAULT_S)
        size = np.linalg.norm(trace.rendered_n, axis=1)
        for axes, first, last in ((left, -10.0, 60.0), (right, -100.0, 1000.0)):
            shown = (since_ms >= first) & (since_ms <= last)
            axes.plot(since_ms[shown], size[shown], lw=1.2, label=name)
    for axes in (left, right):
        axes.axhline(LIMITS.clamp_n, color="0.4", ls="--", lw=1)
        axes.set(xlabel="time since the fault, ms", ylabel="force felt, N")
    left.set_title("the first moments")
    right.set_title("what came of it")
    right.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
