"""Latency from topic in to robot datagram out: the same twists over each transport, in one run."""

from __future__ import annotations

import gc
import heapq
import json
import random
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib.util import find_spec
from typing import NamedTuple

from websockets.sync.client import connect

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.demos.examples import free_ports
from cardan.errors import install_command
from cardan.gateway.arm.remote_arm import RemoteArm
from cardan.gateway.arm.vocab import Parameter, Stream
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.gateway.bus.remote import network_arm
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.protocols.ros2.cdr import codec_of
from studies.cartesian.controller import session
from studies.cartesian.sessions import (
    MODEL,
    PERIOD_S,
    Robot,
    as_a_controller,
    free_endpoint,
    keep_alive,
    network_table,
    quantile,
)

TOPIC = f"/{DEFAULT_NAME}/command/twist"
TYPE = "geometry_msgs/msg/Twist"

STREAM_PERIOD_S = 0.01
"""Period of a stream of twists, most of which are zero."""

ROUND, PULSE = 30, 4
"""Length of a round in messages, and number of nonzero ones at its start. The arm rests before the
next round; the second message moves it if it overtook the first."""

TRIALS = 300
SPEED_M_S = 0.05
MOVED_RAD = 1e-9
"""Threshold of motion: a holding arm gets the same joint command in every cycle."""

GIVE_UP_S = 0.2
"""Time after which a command without effect counts as lost."""

MEET_WITHIN_S = 20.0
"""Discovery timeout: participants of DDS announce themselves about once a second."""

Put = Callable[[float], None]
"""Function that publishes a twist along x, m/s."""


@contextmanager
def _zenoh(endpoint: str) -> Iterator[Put]:
    """A node on the bus."""
    codec = codec_of(TYPE)
    with BusNode(BusOptions(router=endpoint), "bench_command") as node:
        publisher = node.publisher(TOPIC, TYPE)
        yield lambda x: publisher.put(codec.encode(_twist(x)), time.time_ns())


@contextmanager
def _rosbridge(endpoint: str) -> Iterator[Put]:
    """A client of the rosbridge server, with JSON."""
    words = ("net", "server", "rosbridge", "--router", endpoint, "--port", "0")
    with cardan_subprocess(*words) as address, connect(address, compression=None) as client:
        client.send(json.dumps({"op": "advertise", "topic": TOPIC, "type": TYPE}))
        yield lambda x: client.send(json.dumps({"op": "publish", "topic": TOPIC, "msg": _twist(x)}))


@contextmanager
def _dds(endpoint: str) -> Iterator[Put]:
    """A participant on a DDS domain used by this run alone, behind the DDS server."""
    from cardan.bus.dds_options import DdsOptions
    from cardan_dds.network import DdsNetwork

    options, codec = DdsOptions(dds_domain=random.randrange(100, 200)), codec_of(TYPE)
    words = ("net", "server", "dds", "--router", endpoint, "--dds-domain", str(options.dds_domain))
    with cardan_subprocess(*words), DdsNetwork(options, "bench_command") as network:
        publisher = network.advertise(TOPIC, TYPE, latched=False)
        give_up_s = time.monotonic() + MEET_WITHIN_S
        while not network.others(TOPIC)[1]:
            if time.monotonic() > give_up_s:
                raise RuntimeError(f"nobody on DDS subscribed to {TOPIC}")
            time.sleep(PERIOD_S)
        yield lambda x: publisher.publish(codec.encode(_twist(x)))


def _twist(x: float) -> dict[str, dict[str, float]]:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"linear": {**zero, "x": x}, "angular": zero}


TRANSPORTS: dict[str, Callable[[str], AbstractContextManager[Put]]] = {
    "Zenoh": _zenoh,
    "rosbridge": _rosbridge,
    "DDS": _dds,
}
"""Functions that join the bus at an endpoint, by the name of the transport."""


class Delays(NamedTuple):
    """Delays of one transport."""

    delays_s: list[float]
    """Times from the call that publishes to the datagram that obeys."""
    datagrams: list[int]
    """Index of that datagram among those sent after the call."""
    lost: int


class Trial:
    """A session whose arm is commanded over one transport."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.put: Put = lambda _x: None
        self.delays_s: list[float] = []
        self.datagrams: list[int] = []
        self.lost = 0
        self._sent = self._ignored = 0
        self._speed_m_s = SPEED_M_S
        self._waits_s: float | None = None
        self._since = 0

    @property
    def trials(self) -> int:
        """Number of trials."""
        return len(self.delays_s) + self.lost

    @property
    def obeys(self) -> bool:
        """True if at least one of the last two commands moved the arm."""
        return self._ignored < 2

    def begin(self) -> None:
        """Start with an arm at rest."""
        self._sent = self._ignored = 0
        self._waits_s = None

    def publish(self) -> None:
        """Publish the next message of the stream."""
        self._sent += 1
        place = self._sent % ROUND
        if not place:
            self._speed_m_s = -self._speed_m_s
            self._waits_s, self._since = time.perf_counter(), 0
        self.put(self._speed_m_s if place < PULSE and self._sent >= ROUND else 0.0)

    def ask(self) -> None:
        """Run one cycle of the robot."""
        before = self.robot.place.joints
        self.robot.ask()
        if self._waits_s is None:
            return
        late_s = time.perf_counter() - self._waits_s
        self._since += 1
        after = self.robot.place.joints
        assert before is not None
        assert after is not None
        if max(abs(b - a) for a, b in zip(before, after, strict=True)) > MOVED_RAD:
            self.delays_s.append(late_s)
            self.datagrams.append(self._since)
            self._ignored = 0
        elif late_s > GIVE_UP_S:
            self.lost += 1
            self._ignored += 1
        else:
            return
        self._waits_s = None


def left_out() -> str:
    """Return why a transport cannot be measured here; empty: all can."""
    lacking = [name for name in ("cardan_dds", "cyclonedds") if find_spec(name) is None]
    if not lacking:
        return ""
    return f"DDS, for lack of {' and '.join(lacking)}: {install_command('dds')}"


def measure(trials: int = TRIALS) -> dict[str, Delays]:
    """Run a session for each transport, all at the same time."""
    with ExitStack() as sockets, ExitStack() as stack:
        there: dict[str, Trial] = {}
        robots: list[Robot] = []
        arms: list[RemoteArm] = []
        with keep_alive(robots):
            for name, transport in TRANSPORTS.items():
                if name == "DDS" and left_out():
                    continue
                port, endpoint = free_ports(), free_endpoint()
                stack.enter_context(session(port, MODEL + network_table(endpoint)))
                robot = Robot(port)
                sockets.callback(robot.close)
                there[name] = Trial(robot)
                robots.append(robot)
                there[name].put = stack.enter_context(transport(endpoint))
                arm = network_arm(options=BusOptions(router=endpoint))
                arms.append(stack.enter_context(arm))
        while any(each.trials < trials for each in there.values()):
            with keep_alive(robots):
                for arm in arms:
                    arm.set_parameter(Parameter.STREAM, Stream.TWIST)
            with as_a_controller():
                _run(list(there.values()), trials)
        with keep_alive(robots):  # Keep all robots connected while the sessions end.
            stack.close()
        return {
            name: Delays(each.delays_s, each.datagrams, each.lost) for name, each in there.items()
        }


def _run(trials: list[Trial], count: int) -> None:
    """Send a state of each robot every 4 ms and publish at random moments between, until all
    transports have their trials, or one robot no longer obeys: a machine that stalls for 0.1 s ends
    streams."""
    clock, chance = time.perf_counter, random.Random(0)
    begin_s = clock()
    due: list[tuple[float, int, Trial, bool]] = []
    """Time, order, trial, and whether the event publishes."""
    for number, each in enumerate(trials):
        due.append((begin_s + number * PERIOD_S / len(trials), number, each, False))
        due.append((begin_s + STREAM_PERIOD_S, number + len(trials), each, True))
    heapq.heapify(due)
    gc.disable()
    for each in trials:
        each.begin()
    while any(each.trials < count for each in trials) and all(each.obeys for each in trials):
        at_s, number, each, publishes = heapq.heappop(due)
        time.sleep(max(0.0, at_s - clock()))
        if publishes:
            each.publish()
            at_s += STREAM_PERIOD_S + chance.uniform(-0.5, 0.5) * PERIOD_S
        else:
            each.ask()
            at_s = max(at_s + PERIOD_S, clock())
        heapq.heappush(due, (at_s, number, each, publishes))
    gc.enable()


def table(found: dict[str, Delays]) -> str:
    """Return the table of docs/measurements.md."""
    base = found["Zenoh"]
    lines = [
        "| transport | p50 | p99 | times Zenoh: p50 | p99 | obeyed by the next datagram, the "
        "second, a later one | lost |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, each in found.items():
        half, tail = quantile(each.delays_s, 0.5), quantile(each.delays_s, 0.99)
        count = len(each.datagrams)
        shares = [each.datagrams.count(number) / count for number in (1, 2)]
        shares.append(1.0 - sum(shares))
        lines.append(
            f"| {name} | {half * 1e3:.2f} ms | {tail * 1e3:.2f} ms | "
            f"{half / quantile(base.delays_s, 0.5):.2f} | "
            f"{tail / quantile(base.delays_s, 0.99):.2f} | "
            f"{', '.join(f'{share:.0%}' for share in shares)} | {each.lost} of "
            f"{count + each.lost} |"
        )
    return "\n".join(lines)
