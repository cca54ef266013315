"""Bilateral haptics (2026): drawing, and the paper's future work, stability at contacts."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from typing import NamedTuple

from cardan.common.arm_libraries import np
from studies.haptics import drawing, far, faults, stability, timing, zwidth
from studies.haptics.stability import HELD, LIGHTLY, PUSHES, Compared, Push
from studies.result import Drawn, Figure, Result, Table, known, table_of

DRAWING_S, QUICK_DRAWING_S = 30.0, 10.0

SMALLEST_MJ = 0.1
"""Spread of energies: smaller differences are ignored."""
WITHIN = 0.05
"""Relative spread of a stiffest wall, which is found to within 2 %."""

HOW = (
    "Stability and what faults feel like: virtual time, the simulated Omni, its libHD and the "
    "compiled tick, with a wall behind a channel that is late, uneven and lossy. Plain is the same "
    "tick without what makes a loop passive. The drawing is in real time: `cardan demo omni`, the "
    "simulated Omni and a simulated GoFa over EGM with a pen on a board. The paper shows the task "
    "and names no figures but EGM's 250 Hz; the stability of contacts is its future work."
)


class Grids(NamedTuple):
    """Measurements of a full report in addition to the pushes."""

    hands: list[list[Compared]]
    """Grid over stiffness and delay, for each way to hold the stylus."""
    channel: list[Compared]
    sampling: list[Compared]
    widths: list[zwidth.Width]
    responses: list[faults.FaultResponse]
    far: list[far.Point]


def pushes() -> list[tuple[Push, Compared, Compared]]:
    """Compare both loops, calm and pushed."""
    compare = stability.compare
    return [(p, compare(p.hand, *p.calm), compare(p.hand, *p.pushed)) for p in PUSHES]


def grids() -> Grids:
    """Measure all grids."""
    return Grids(
        [stability.grid(hand) for hand in (HELD, LIGHTLY)],
        stability.channel_grid(),
        stability.sampling_grid(),
        zwidth.measure(),
        [faults.feel(fault) for fault in faults.FAULTS],
        far.measure(),
    )


def summaries(found: Grids) -> list[str]:
    """Summarize each grid in a line."""
    lines = [stability.summary("stiffness and delay", points) for points in found.hands]
    lines.append(stability.summary("jitter and loss", found.channel))
    lines.append(stability.summary("stiffness and sampling", found.sampling))
    return lines


def run(quick: bool) -> Result:
    """Run the study."""
    pushed = pushes()
    more = None if quick else grids()
    drawn = drawing.measure(QUICK_DRAWING_S if quick else DRAWING_S)
    left_out, ticks = [], None
    if not quick:
        try:
            ticks = timing.measure_tick()
        except (OSError, subprocess.CalledProcessError) as error:
            left_out.append(f"timing of the tick, which needs a C compiler: {error}")

    def draw() -> Iterator[Drawn]:
        from studies.haptics import plots

        return plots.draw_pair() if more is None else plots.draw(*more)

    shortened = (
        f"{QUICK_DRAWING_S:g} s of drawing instead of {DRAWING_S:g} s",
        "left out: the grids over stiffness, delay, jitter, loss and sampling, the stiffest walls, "
        "faults as the hand feels them, and the timing of the tick",
    )
    return Result(
        HOW,
        tuple(_tables(pushed, drawn, more, ticks)),
        tuple(_figures(pushed, drawn, more, ticks)),
        draw,
        ("the channel's delays and losses: 1",),
        shortened if quick else (),
        tuple(left_out),
    )


def _tables(
    pushed: list[tuple[Push, Compared, Compared]],
    drawn: drawing.Drawing,
    more: Grids | None,
    ticks: timing.Timing | None,
) -> list[Table]:
    note = "Energy given to the hand at most, and its speed when it should rest; bold: not stable."
    found = [drawing_table(drawn)]
    found.append(table_of("Plain loop and ours, calm and pushed", stability.table(pushed), note))
    if more is not None:
        lines = tuple((line,) for line in summaries(more))
        found.append(Table("Over stiffness, delay, jitter, loss and sampling", ("grid",), lines))
        found.append(table_of("Stiffest walls, N/m", zwidth.table(more.widths)))
        found.append(table_of("Faults as the hand feels them", faults.table(more.responses)))
        found.append(table_of("Stiffness felt over delay", far.table(more.far)))
    if ticks is not None:
        found.append(table_of("The tick in real time", timing.evenness_table(ticks.found)))
        found.append(table_of("What the law of the tick costs", timing.law_table(ticks.alone)))
    return found


def drawing_table(drawn: drawing.Drawing) -> Table:
    """Return the table of the drawing: path and forces."""
    last = drawn.last

    def ms(seconds: float | None) -> str:
        return "–" if seconds is None else f"{1e3 * seconds:.2f} ms"

    rows = (
        ("drawn: way of the pen on the board", "shown", f"{1e3 * last.contact.path_m:.0f} mm"),
        ("force on the board, mean", "–", f"{last.contact.mean_n:.2f} N"),
        ("off its target, RMS", "–", f"{last.contact.rms_error_n:.2f} N"),
        ("force at the hand, largest", "felt", f"{last.force.peak_n:.2f} N"),
        ("age of a measured force in the tick, median", "–", ms(last.force.measured_age_p50_s)),
        ("the same, p99", "–", ms(last.force.measured_age_p99_s)),
        ("robot's cycle", "4 ms", f"{1e3 * last.elapsed_s / max(1, last.loop.cycles):.2f} ms"),
        (
            "energy given to the hand in one engagement, of what passivity allows",
            "–",
            f"{1e3 * last.force.energy_given_peak_j:.2f} of {1e3 * drawn.budget_j:g} mJ",
        ),
        ("teleoperation disengaged", "–", f"{last.arm.trips} times"),
    )
    note = f"{last.elapsed_s:.0f} s, scheduling: {last.scheduling or 'unknown'}."
    if drawn.problems:
        note += f" Problems: {'; '.join(drawn.problems)}."
    return Table("Drawing with force feedback", ("", "published", "ours"), rows, note)


def _figures(
    pushed: list[tuple[Push, Compared, Compared]],
    drawn: drawing.Drawing,
    more: Grids | None,
    ticks: timing.Timing | None,
) -> list[Figure]:
    last = drawn.last
    once = (
        ("force off its target, RMS", last.contact.rms_error_n, "N"),
        ("age of the force, median", _ms(last.force.measured_age_p50_s), "ms"),
        ("age of the force, p99", _ms(last.force.measured_age_p99_s), "ms"),
        ("energy given", 1e3 * last.force.energy_given_peak_j, "mJ"),
        ("disengaged", float(last.arm.trips), ""),
    )
    found = [Figure(f"drawing: {name}", value, unit, "less", None) for name, value, unit in once]
    for number, (push, _, point) in enumerate(pushed, 1):
        name = f"{number}, {push.name}, {push.hand.name}"
        for loop, verdict in (("plain", point.plain), ("ours", point.ours)):
            given, speed = 1e3 * verdict.given_j, 1e3 * verdict.restless_m_s
            better = "less" if loop == "ours" else ""
            found.append(
                Figure(f"push {name}: energy, {loop}", given, "mJ", better, SMALLEST_MJ)  # type: ignore[arg-type]
            )
            found.append(
                Figure(f"push {name}: speed at rest, {loop}", speed, "mm/s", better, 1.0)  # type: ignore[arg-type]
            )
    if more is not None:
        for points in (*more.hands, more.channel, more.sampling):
            one = points[0]
            name = f"grid of {len(points)} from {one.stiffness_n_m:.0f} N/m, {one.hand.name}"
            stable = sum(each.ours.stable for each in points)
            least = 1e3 * min(each.ours.margin_j for each in points)
            found.append(Figure(f"{name}: stable points of ours", float(stable), "", "more"))
            found.append(Figure(f"{name}: least margin", least, "mJ", "more", SMALLEST_MJ))
        for width in more.widths:
            name = f"stiffest wall at {width.damping_n_s_m:g} N·s/m"
            found.append(Figure(name, width.ours, "N/m", "more", WITHIN * width.ours))
        for wall in more.far:
            name = f"felt at {1e3 * wall.delay_s:.0f} ms one way, {wall.hand.name}"
            found.append(Figure(name, wall.rendered_n_m, "N/m", "more", WITHIN * far.STIFFNESS_N_M))
        late = sum(not each.in_time for each in more.responses)
        found.append(Figure("faults not over in time", float(late), "", "less"))
    if ticks is not None:
        for each in ticks.found:
            scheduling = "FIFO" if each.fifo else "ordinary"
            name = f"tick, {each.what}, {each.load}, {scheduling}: period error, p99"
            found.append(
                Figure(name, 1e6 * float(np.percentile(each.errors_s, 99)), "µs", "less", None)
            )
    return [each._replace(value=known(each.value)) for each in found]


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds
