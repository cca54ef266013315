"""Time that a session's loop spends on publication after the robot's answer has left."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from bench.network.listening import listener
from cardan.bus.node import Publisher
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.network import SessionNetwork
from cardan.gateway.session.session import make_session
from studies.cartesian.sessions import PERIOD_S, as_a_controller, free_endpoint, quantile

AIM_S = 25e-6
"""Limit for one publication."""

SETTLE_S = 6.0
"""Wait before the first turn: a new session keeps cycles for recorders that are discovered late."""

TURN_S, TURNS = 3.0, 8
RATES_HZ = (50.0, 250.0)

ALONE, HEARD = "no subscribers", "all topics subscribed"


class _Clock:
    """Timer of the session's network methods, by name."""

    def __init__(self) -> None:
        self.kind = ""
        """Kind of the current turn; empty: samples are discarded."""
        self.rows: dict[tuple[str, str], list[float]] = {}
        self.puts = self.instants = 0
        self._began_s = 0.0

    def turn(self, kind: str) -> None:
        """Keep the samples of one turn."""
        self.kind = kind
        time.sleep(TURN_S)
        self.kind = ""

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Time the methods of all sessions of this process."""
        retained = {
            name: getattr(SessionNetwork, name)
            for name in ("due", "publish", "poll", "publish_cycle")
        }
        timed = {name: self._timed(name, retained[name]) for name in ("poll", "publish_cycle")}
        timed |= {
            "due": self._beginning(retained["due"]),
            "publish": self._ending(retained["publish"]),
        }
        for name, method in timed.items():
            setattr(SessionNetwork, name, method)
        try:
            yield
        finally:
            for name, method in retained.items():
                setattr(SessionNetwork, name, method)

    def _beginning(self, due: Callable[..., bool]) -> Callable[..., bool]:
        def timed(*arguments: Any) -> bool:
            self._began_s = time.perf_counter()
            return due(*arguments)

        return timed

    def _ending(self, publish: Callable[..., None]) -> Callable[..., None]:
        """Measure from the due time of an instant, because deciding what to publish takes time,
        too."""

        def timed(*arguments: Any) -> None:
            publish(*arguments)
            self._keep("publish", time.perf_counter() - self._began_s)

        return timed

    def _timed(self, name: str, method: Callable[..., None]) -> Callable[..., None]:
        def timed(*arguments: Any) -> None:
            began_s = time.perf_counter()
            method(*arguments)
            self._keep(name, time.perf_counter() - began_s)

        return timed

    def _keep(self, name: str, took_s: float) -> None:
        if self.kind:
            self.rows.setdefault((self.kind, name), []).append(took_s)

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count the messages of the instants; counting itself takes time."""
        put, publish = Publisher.put, SessionNetwork.publish

        def counted(*arguments: Any) -> None:
            self.puts += 1
            put(*arguments)

        def published(*arguments: Any) -> None:
            Publisher.put = counted  # type: ignore[method-assign]
            publish(*arguments)
            Publisher.put = put  # type: ignore[method-assign]
            self.instants += 1

        SessionNetwork.publish = published  # type: ignore[method-assign]
        try:
            yield
        finally:
            SessionNetwork.publish = publish  # type: ignore[method-assign]


class Cost(NamedTuple):
    """Cost for one session, s."""

    rate_hz: float
    messages: float
    """Mean number of messages per instant."""
    rows: dict[tuple[str, str], list[float]]
    scheduling: str


def measure(rate_hz: float) -> Cost:
    """Measure a session of a simulated UR5 at 250 Hz, with and without listeners in turn."""
    endpoint = free_endpoint()
    session = make_session(
        parse_config(
            {
                "robot": {"driver": "sim_arm", "robot": "ur5", "period_s": PERIOD_S},
                "arm": {"model": "ur5"},
                "network": {"router": "", "listen": [endpoint], "rate_hz": rate_hz},
            }
        )
    )
    clock = _Clock()

    def take_turns() -> None:
        time.sleep(SETTLE_S - 1.0)
        with clock.counting():
            time.sleep(1.0)
        with clock.watching():
            for turn in range(TURNS):
                if turn % 2:
                    with listener([endpoint]):
                        clock.turn(HEARD)
                else:
                    clock.turn(ALONE)
        session.stop("measured")

    thread = threading.Thread(target=take_turns)
    thread.start()
    with as_a_controller() as scheduling:
        session.run()
    thread.join()
    return Cost(rate_hz, clock.puts / clock.instants, clock.rows, scheduling)


def table(costs: list[Cost]) -> str:
    """Return the table of docs/measurements.md."""
    lines = [
        "| state published | | publications of an instant | one instant, median / p99 | one "
        f"publication, median | aim, {AIM_S * 1e6:g} µs |",
        "|---|---|---|---|---|---|",
    ]
    for cost in costs:
        for kind in (ALONE, HEARD):
            took = cost.rows[kind, "publish"]
            median, tail = statistics.median(took), quantile(took, 0.99)
            each = median / cost.messages
            lines.append(
                f"| {cost.rate_hz:g} Hz | {kind} | {cost.messages:.0f} | {median * 1e6:.0f} / "
                f"{tail * 1e6:.0f} µs | {each * 1e6:.1f} µs | "
                f"{'met' if each <= AIM_S else 'missed'}: {each / AIM_S:.2f} of it |"
            )
    lines += ["", "| in each cycle | | median / p99 |", "|---|---|---|"]
    for name, words in (
        ("poll", "check for commands"),
        ("publish_cycle", "check for recorders"),
    ):
        for kind in (ALONE, HEARD):
            took = [each for cost in costs for each in cost.rows[kind, name]]
            median, tail = statistics.median(took), quantile(took, 0.99)
            lines.append(f"| {words} | {kind} | {median * 1e6:.1f} / {tail * 1e6:.1f} µs |")
    lines += ["", f"Scheduling: {costs[0].scheduling}."]
    return "\n".join(lines)
