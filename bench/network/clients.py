"""rosbridge under load: clients that subscribe to everything, and the effect on the session."""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from bench.network.audience import Place, audience
from cardan.bus.options import BusOptions
from cardan.demos.examples import free_ports
from cardan.gateway.arm.vocab import Parameter, Stream
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.gateway.bus.remote import network_arm
from studies.cartesian.controller import session
from studies.cartesian.sessions import (
    MODEL,
    PERIOD_S,
    Robot,
    as_a_controller,
    cpu_s,
    free_endpoint,
    keep_alive,
    network_table,
    quantile,
    resident_bytes,
)

RATE_HZ = 60.0
CLIENTS = (1, 10, 50)
TURN_S, TURNS = 2.0, 6
"""Each turn with listening clients follows one in which the same clients do not listen."""

TOPICS = (
    *(f"/{DEFAULT_NAME}/state/{name}" for name in ("pose", "target", "twist", "wrench", "status")),
    *("/joint_states", "/tf", "/current_pose", "/operating_state"),
    *(f"/measured_{name}" for name in ("js", "cp", "cf")),
    *(f"/setpoint_{name}" for name in ("js", "cp", "cv")),
)
"""Topics that a session with `other_names` publishes at each instant of an engaged arm."""

SETTLE_S = 0.5
"""Settling time after clients have subscribed or left."""


class Load(NamedTuple):
    """Measurement with one number of clients."""

    clients: int
    crawling: bool
    cpu_share: float
    """CPU time of the server, as a share of one core."""
    received_share: float
    ages_s: list[float]
    quiet_s: list[float]
    """Answer times of the session without clients, ..."""
    loud_s: list[float]
    """... and with them."""
    grown_bytes: int
    """Growth of the server's memory from before its clients came until their last turn."""


@contextmanager
def server(name: str, endpoint: str) -> Iterator[tuple[int, int]]:
    """Run ``cardan net server NAME``; yield its port and process id."""
    words = ["net", "server", name, "--router", endpoint, "--port", "0", "--log-level", "warning"]
    command = [sys.executable, "-m", "cardan", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        port = int(process.stdout.readline().rsplit(":", 1)[1].strip("/\n"))
        yield port, process.pid
    finally:
        process.terminate()
        process.communicate()


def measure() -> list[Load]:
    """Measure one session and one server with different numbers of clients in turn."""
    with ExitStack() as stack:
        port, endpoint = free_ports(), free_endpoint()
        names = 'other_names = ["servo", "crtk", "fzi"]'
        tables = MODEL + network_table(endpoint, RATE_HZ, names)
        stack.enter_context(session(port, tables))
        robot = Robot(port)
        stack.callback(robot.close)
        with keep_alive([robot]):
            server_port, pid = stack.enter_context(server("rosbridge", endpoint))
        loads = [load(endpoint, robot, Place(server_port), pid, clients) for clients in CLIENTS]
        loads.append(load(endpoint, robot, Place(server_port), pid, CLIENTS[-1], crawling=True))
        return loads


def load(
    endpoint: str,
    robot: Robot,
    place: Place,
    pid: int,
    clients: int,
    *,
    crawling: bool = False,
    topics: Sequence[str] = TOPICS,
    rate_hz: float = RATE_HZ,
) -> Load:
    """Measure turns with and without these clients' subscriptions."""
    before_bytes = resident_bytes(pid)
    quiet_s: list[float] = []
    loud_s: list[float] = []
    busy_s = messages = 0.0
    ages_s: list[float] = []
    with ExitStack() as stack:
        with keep_alive([robot]):
            listening = stack.enter_context(audience(place, topics, clients, crawling))
        for _ in range(TURNS):
            quiet_s += _answers(robot)
            with keep_alive([robot]):
                with network_arm(options=BusOptions(router=endpoint)) as arm:
                    # Give the arm a target, even if it has been disengaged meanwhile.
                    arm.set_parameter(Parameter.STREAM, Stream.TWIST)
                listening.listen(True)
                time.sleep(SETTLE_S)
                listening.heard()
            began_s = cpu_s(pid)
            loud_s += _answers(robot)
            busy_s += cpu_s(pid) - began_s
            with keep_alive([robot]):
                heard = listening.heard()
                messages += heard.messages
                ages_s += heard.ages_s
                grown_bytes = resident_bytes(pid) - before_bytes
                listening.listen(False)
                time.sleep(SETTLE_S)
        with keep_alive([robot]):
            stack.close()
    seconds = TURN_S * TURNS
    expected = len(topics) * rate_hz * seconds
    return Load(
        clients,
        crawling,
        busy_s / seconds,
        messages / expected,
        ages_s,
        quiet_s,
        loud_s,
        grown_bytes,
    )


def _answers(robot: Robot) -> list[float]:
    """Return the session's answer times, s."""
    found = []
    clock = time.perf_counter
    gc.disable()
    with as_a_controller():
        slot_s = clock()
        for _ in range(round(TURN_S / PERIOD_S)):
            answer_s = robot.ask()
            if answer_s is not None:
                found.append(answer_s)
            slot_s = max(slot_s + PERIOD_S, clock())
            time.sleep(max(0.0, slot_s - clock()))
    gc.enable()
    return found


def table(loads: list[Load]) -> str:
    """Return the table of docs/measurements.md."""
    lines = [
        "| clients | messages/s | CPU of the server | for each client | received "
        "| age, median / p99 | session's p99, none / all listening | ratio "
        "| memory of the server |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for load in loads:
        quiet_s, loud_s = quantile(load.quiet_s, 0.99), quantile(load.loud_s, 0.99)
        beside = ", and one that reads 1 kB/s" if load.crawling else ""
        sent = load.clients * len(TOPICS) * RATE_HZ
        lines.append(
            f"| {load.clients}{beside} | {sent:.0f} | {load.cpu_share:.1%} | "
            f"{load.cpu_share / load.clients:.2%} | {load.received_share:.1%} | "
            f"{_ms(load.ages_s, 0.5)} / {_ms(load.ages_s, 0.99)} ms | "
            f"{quiet_s * 1e6:.0f} / {loud_s * 1e6:.0f} µs | {loud_s / quiet_s:.2f} | "
            f"{load.grown_bytes / 1e6:+.1f} MB |"
        )
    return "\n".join(lines)


def _ms(values_s: list[float], share: float) -> str:
    return f"{quantile(values_s, share) * 1e3:.1f}"
