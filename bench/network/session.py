"""Latency of whole sessions from robot state to answer, with and without the network, in one
run."""

from __future__ import annotations

import contextlib
import gc
import itertools
import time
from typing import NamedTuple

from bench.egm_latency import MOVE, TOUCH
from bench.network.listening import listener
from cardan.demos.examples import free_ports
from studies.cartesian.controller import session
from studies.cartesian.sessions import (
    MODEL,
    PERIOD_S,
    Robot,
    as_a_controller,
    free_endpoint,
    network_table,
    quantile,
)

AIM = 1.1
"""Limit for the p99, as a multiple of that of the session without the network."""

WARM_UP_S = 3.0
BLOCK_CYCLES, BLOCKS = 1000, 12
"""Two blocks for each order of the three sessions within a cycle."""

WITHOUT = "without the network"
RATES_HZ = (50.0, 250.0)


class Answers(NamedTuple):
    """Answers of one session."""

    blocks: list[list[float]]
    """Answer times, s."""
    unanswered: int

    def quantile(self, share: float) -> float:
        """Quantile over all blocks."""
        return quantile([each for block in self.blocks for each in block], share)


def measure() -> dict[str, Answers]:
    """Measure three sessions with moving devices in turns; all topics are subscribed to."""
    endpoints = {f"all topics at {rate:g} Hz": (free_endpoint(), rate) for rate in RATES_HZ}
    tables = {WITHOUT: MODEL}
    tables |= {name: MODEL + network_table(*each) for name, each in endpoints.items()}
    with contextlib.ExitStack() as stack:
        robots = {}
        for name, more in tables.items():
            port = free_ports()
            stack.enter_context(session(port, more, TOUCH + MOVE))
            robots[name] = Robot(port)
            stack.callback(robots[name].close)
        stack.enter_context(listener([endpoint for endpoint, _ in endpoints.values()]))
        stack.enter_context(as_a_controller())
        orders = list(itertools.permutations(robots))
        _ask(robots, orders[0], round(WARM_UP_S / PERIOD_S))
        found: dict[str, list[list[float]]] = {name: [] for name in robots}
        for number in range(BLOCKS):
            took = _ask(robots, orders[number % len(orders)], BLOCK_CYCLES)
            for name, blocks in found.items():
                blocks.append(took[name])
        return {name: Answers(found[name], robots[name].unanswered) for name in robots}


def _ask(robots: dict[str, Robot], order: tuple[str, ...], cycles: int) -> dict[str, list[float]]:
    """Run this many cycles; the slots of the sessions do not overlap, so that no state is sent
    while another session publishes."""
    took: dict[str, list[float]] = {name: [] for name in order}
    clock = time.perf_counter
    slot_s = clock()
    gc.disable()
    for _ in range(cycles):
        for name in order:
            answer_s = robots[name].ask()
            if answer_s is not None:
                took[name].append(answer_s)
            slot_s = max(slot_s + PERIOD_S / len(order), clock())
            time.sleep(max(0.0, slot_s - clock()))
    gc.enable()
    return took


def table(found: dict[str, Answers]) -> str:
    """Return the table of docs/measurements.md."""
    base = found[WITHOUT]
    lines = [
        "| session | median | p99 | times without: median | p99 | p99 of blocks of "
        f"{BLOCK_CYCLES}, least to most | unanswered |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, answers in found.items():
        median, tail = answers.quantile(0.5), answers.quantile(0.99)
        tails = sorted(quantile(block, 0.99) for block in answers.blocks)
        lines.append(
            f"| {name} | {median * 1e6:.0f} µs | {tail * 1e6:.0f} µs | "
            f"{median / base.quantile(0.5):.2f} | {tail / base.quantile(0.99):.2f} | "
            f"{tails[0] * 1e6:.0f} to {tails[-1] * 1e6:.0f} µs | {answers.unanswered} |"
        )
    lines.append("")
    for name, answers in found.items():
        if name != WITHOUT:
            ratio = answers.quantile(0.99) / base.quantile(0.99)
            verdict = "met" if ratio <= AIM else "missed"
            lines.append(f"Aim: p99 with {name} at most {AIM:g} times without: {verdict}.")
    return "\n".join(lines)
