"""The Cartesian interface over ROS 2 and the web (2025): latency from a topic to the robot's
datagram."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from studies.cartesian import command
from studies.cartesian.sessions import PERIOD_S, quantile
from studies.result import Drawn, Figure, Result, Table, spread_of, table_of

TRIALS, QUICK_TRIALS = 300, 20
BLOCKS = 5
"""Cells for one transport's trials: the quantiles per block show their variation."""

HOW = (
    "Real time, everything on this computer. A session of a GoFa over EGM, its robot asking every "
    f"4 ms, is commanded by twists on `{command.TOPIC}` (100 a second, most of them zero), by each "
    "transport: ROS 2's Zenoh, rosbridge as a web page speaks it, and ROS 2's DDS. A delay is from "
    "the call that publishes to the datagram that moves the robot: half a cycle of the robot, 2 ms "
    "on average, is in it. The paper gives no latencies; its application sends 50 "
    "commands a second, which alone makes a hand's motion 10 ms old on average and 20 ms at most."
)


def run(quick: bool) -> Result:
    """Run the study."""
    found = command.measure(QUICK_TRIALS if quick else TRIALS)

    def draw() -> Iterator[Drawn]:
        from studies.cartesian import plots

        return plots.draw(found)

    missing = command.left_out()
    return Result(
        HOW,
        tables(found),
        figures(found),
        draw,
        ("moments of publishing: 0; the number of the DDS domain is not seeded",),
        (f"{QUICK_TRIALS} commands by each transport instead of {TRIALS}",) if quick else (),
        (missing,) if missing else (),
    )


def tables(found: dict[str, command.Delays]) -> tuple[Table, ...]:
    """Return the table of all transports."""
    note = f"The robot asks each {1e3 * PERIOD_S:g} ms."
    return (table_of("From a topic to the robot's datagram", command.table(found), note),)


def figures(found: dict[str, command.Delays]) -> tuple[Figure, ...]:
    """Return the figures by which reports are compared."""
    made = []
    for name, each in found.items():
        for words, share in (("median", 0.5), ("p99", 0.99)):
            value = 1e3 * quantile(each.delays_s, share) if each.delays_s else None
            spread = spread_of(1e3 * quantile(part, share) for part in _blocks(each.delays_s))
            made.append(Figure(f"{name}: {words}", value, "ms", "less", spread))
        made.append(Figure(f"{name}: commands lost", float(each.lost), "", "less", 1.0))
    return tuple(made)


def _blocks(values: list[float]) -> list[list[float]]:
    edges = [len(values) * index // BLOCKS for index in range(BLOCKS + 1)]
    return [values[a:b] for a, b in itertools.pairwise(edges) if b > a]
