"""Cost of pages that watch: effect on the session's latency."""

from __future__ import annotations

from contextlib import ExitStack

from bench.network.audience import Place
from bench.network.clients import Load, load, server
from cardan.demos.examples import free_ports
from cardan.gateway.bus.options import DEFAULT_NAME
from studies.cartesian.controller import session
from studies.cartesian.sessions import (
    MODEL,
    Robot,
    free_endpoint,
    keep_alive,
    network_table,
    quantile,
)

VIEWERS = 20
RATE_HZ = 30.0
AIM = 1.1
"""Limit for the session's p99 with viewers, as a multiple of its p99 without."""

TOPICS = (
    *(
        f"/{DEFAULT_NAME}/state/{name}"
        for name in ("pose", "target", "twist", "wrench", "status", "snapshot")
    ),
    "/joint_states",
)
"""Topics of one arm that a page subscribes to."""


def measure() -> Load:
    """Measure turns with and without viewers."""
    with ExitStack() as stack:
        port, endpoint = free_ports(), free_endpoint()
        stack.enter_context(session(port, MODEL + network_table(endpoint, RATE_HZ)))
        robot = Robot(port)
        stack.callback(robot.close)
        with keep_alive([robot]):
            server_port, pid = stack.enter_context(server("console", endpoint))
        place = Place(server_port, "/ws")
        return load(endpoint, robot, place, pid, VIEWERS, topics=TOPICS, rate_hz=RATE_HZ)


def table(found: Load) -> str:
    """Return the table of docs/measurements.md."""
    quiet_s, loud_s = quantile(found.quiet_s, 0.99), quantile(found.loud_s, 0.99)
    ratio = loud_s / quiet_s
    return "\n".join(
        [
            "| viewers | session's p99, none / all | times | CPU of the server | age of "
            "messages, median / p99 |",
            "|---|---|---|---|---|",
            f"| {found.clients} at {RATE_HZ:g} Hz | {1e6 * quiet_s:.0f} / {1e6 * loud_s:.0f} µs | "
            f"{ratio:.2f} | {found.cpu_share:.1%} | {1e3 * quantile(found.ages_s, 0.5):.1f} / "
            f"{1e3 * quantile(found.ages_s, 0.99):.1f} ms |",
            "",
            f"Aim: at most {AIM:g} times: {'met' if ratio <= AIM else 'missed'}.",
        ]
    )
