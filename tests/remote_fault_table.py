"""Generator of tests/results/remote-faults.md: reactions of the arm to faults of the network and of
the operator's computer.

To update it: ``make fault-table``, or ``python -m tests.remote_fault_table``. All in virtual time:
`cardan devices share` and the driver's core, a network between them, and a session's control core
in front of a simulated arm.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from cardan.drivers.remote.shared import CLAIM_PERIOD_S
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.bus.sharing import ShareCore
from cardan.types import DeviceState
from tests.docs_tables import markdown
from tests.drivers.remote_bench import STEP_S, Bench as RemoteBench, Link
from tests.fault_benches import JointStreamBench, Motion
from tests.fault_scenarios import ACCELERATION_M_S2, SPEED_M_S, Operator
from tests.fault_table import Row, cell, in_a_copy
from tests.result_tables import REMOTE_FAULTS as RESULTS

REPORT_S = 0.008
"""Period of a SpaceMouse's reports while it is deflected."""

HOLD = "left"

LIVE_S, HELD_S, RUN_UP_S = 0.6, 0.25, 0.5
WATCHED_S = 1.0
"""Observed time after the fault, and after its end."""

SETTLED_S = 0.5
"""Longer than any effect of the device takes to reach the arm."""

AGAIN_M = 0.02
"""Motion by this distance counts as resumed."""

BRAKING_S = SPEED_M_S / ACCELERATION_M_S2

SERVO_S = 0.01
"""Lag of the arm's drives: time from a stopped command to rest."""

STILL_S = 0.05
"""Longer than an arm below 1 mm/s takes to rest."""


class Network(NamedTuple):
    """Network with equal directions."""

    link: Link
    max_age_s: float
    """Setting of the driver and of the watchdog."""
    stall_s: float = 0.0
    """Length of a stall, after which everything queued arrives."""
    stalls_every_s: float = math.inf
    """Period of the stalls."""


NETWORKS = {
    "LAN": Network(Link(0.0003), 0.15),
    "Wi-Fi": Network(Link(0.0, 0.013, loss=0.01), 0.15, 0.08, 1.0),
    "LTE": Network(Link(0.025, 0.04, loss=0.01), 0.25, 0.5, 5.0),
    "Internet": Network(Link(0.11, 0.02, loss=0.005), 0.4),
}


class RemoteOperator(Operator):
    """Operator at another computer, with a deflected device and its dead-man pressed."""

    bench: JointStreamBench

    def __init__(self, bench: JointStreamBench, network: Network) -> None:
        super().__init__(bench, Watchdogs(device_age_s=network.max_age_s))
        self.network = network
        self.remote = RemoteBench(network.link, now_s=bench.now_s, max_age_s=network.max_age_s)
        self.remote.direction = bench.direction
        self.deflected = self.holds = False
        self.let_go_s = -math.inf
        """Time of the report in which the cap or the dead-man was released."""
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._reported_s = -math.inf
        self._stalls_s = bench.now_s + network.stalls_every_s

    def _device(self, now_s: float) -> DeviceState:
        self.remote.run(now_s - self.remote.now_s, self._step)
        return self.remote.state

    def _step(self) -> None:
        remote, now_s = self.remote, self.remote.now_s
        if now_s >= self._stalls_s:
            self._stalls_s += self.network.stalls_every_s
            self.stall(self.network.stall_s)
        due = [each for each in self._later if each[0] <= now_s]
        self._later = [each for each in self._later if each[0] > now_s]
        for _, act in due:
            act()
        if now_s >= self._reported_s + REPORT_S:
            self._reported_s = now_s
            if not self.deflected and any(remote.device.axes):
                self.let_go_s = now_s
            remote.move(1.0 if self.deflected else 0.0)

    # -- the hand --------------------------------------------------------------------------------

    def deflect(self, deflected: bool = True) -> None:
        """Push the cap, or release it."""
        self.deflected = deflected

    def hold(self, holds: bool = True) -> None:
        """Press the dead-man, or release it."""
        if holds is not self.holds:
            self.holds = holds
            self.remote.press(HOLD, holds)
            if not holds:
                self.let_go_s = self.remote.now_s + STEP_S

    def act(self) -> None:
        """Re-arm, and then move."""
        for holds, deflected in ((False, False), (True, False), (True, True)):
            self.hold(holds)
            self.deflect(deflected)
            self.bench.run(SETTLED_S)

    # -- faults ----------------------------------------------------------------------------------

    def after(self, seconds: float, act: Callable[[], None]) -> None:
        """Call `act` after that time."""
        self._later.append((self.remote.now_s + seconds, act))

    def stall(self, seconds: float) -> None:
        """Stall both directions."""
        until_s = self.remote.now_s + seconds
        self.remote.down.stall(until_s)
        self.remote.up.stall(until_s)

    def cut(self, ways: Iterable[str], seconds: float) -> None:
        """Cut `ways`, of "up" and "down", for that time; "down" is towards the robot."""
        for name in ways:
            way = getattr(self.remote, name)
            way.cut = True
            self.after(seconds, functools.partial(setattr, way, "cut", False))

    def sleep(self, seconds: float) -> None:
        """Close the lid for that time."""
        self.remote.asleep = True
        self.after(seconds, lambda: setattr(self.remote, "asleep", False))

    def lose_router(self, seconds: float) -> None:
        """End the router, which runs at the session's computer: the session notices it at once."""
        self.cut(("up", "down"), seconds)
        self._lose()
        self.after(seconds, self._find)

    def kill(self, seconds: float) -> None:
        """Kill `cardan devices share`, and restart it later: its computer closes the connection,
        and the router informs the session."""
        remote, slowest_s = self.remote, self.network.link.slowest_s
        remote.frozen = True
        self.after(slowest_s, self._lose)
        self.after(seconds, self._share_anew)
        self.after(seconds + slowest_s, self._find)

    def _share_anew(self) -> None:
        remote = self.remote
        remote.share, remote.sender = ShareCore("spacemouse", 12), remote.sender + 1
        remote.frozen = False

    def _lose(self) -> None:
        self.remote.core.on_lost("it is not shared any more", self.remote.now_s)

    def _find(self) -> None:
        """Let the driver open the restarted device, on another node."""
        self.remote.claimant += 1
        self.remote.core.on_opened(self.remote.now_s)

    def fill(self, seconds: float) -> None:
        """Saturate the direction to the operator with pictures."""
        way = self.remote.up
        way.rate_bps = SLOW_BPS
        count = round(seconds / PICTURE_S)
        for n in range(count):
            self.after(n * PICTURE_S, lambda: way.picture(PICTURE_BYTES, self.remote.now_s))

    def change(self, **link: object) -> None:
        """Replace the properties of both directions."""
        for way in (self.remote.down, self.remote.up):
            way.link = way.link._replace(**link)


SLOW_BPS = 2e6
PICTURE_BYTES, PICTURE_S = 16_000, 1.0 / 30.0
"""3.8 Mbit/s, more than the link's rate."""

OVERTAKEN_S = 0.06
"""Least jitter at which states overtake others."""


class Fault(NamedTuple):
    act: Callable[[RemoteOperator, float], None]
    lasts_s: float = 0.0
    before: Callable[[RemoteOperator], None] = lambda operator: None
    """Preparation of a fault, some time before it."""
    by_hand: bool = False
    """True if the operator, not the fault, ends the motion."""


def _let_hold_go(operator: RemoteOperator, _lasts_s: float) -> None:
    operator.hold(False)


def _let_cap_go(operator: RemoteOperator, _lasts_s: float) -> None:
    operator.deflect(False)


def _twice(operator: RemoteOperator) -> None:
    operator.change(in_order=False, twice=1.0)


def _overtaken(operator: RemoteOperator) -> None:
    jitter_s = max(OVERTAKEN_S, operator.network.link.jitter_s)
    operator.change(in_order=False, jitter_s=jitter_s)


def _cut(*ways: str) -> Callable[[RemoteOperator, float], None]:
    return lambda operator, lasts_s: operator.cut(ways, lasts_s)


DEAD_MAN, CAP = "the hand lets go of the dead-man", "the hand lets go of the cap"
TWICE, OVERTAKEN = "all states come twice, and " + CAP, "states overtake others, and " + CAP
CAMERA = "a camera fills a link of 2 Mbit/s"

FAULTS: dict[str, Fault] = {
    DEAD_MAN: Fault(_let_hold_go, by_hand=True),
    CAP: Fault(_let_cap_go, by_hand=True),
    TWICE: Fault(_let_cap_go, before=_twice, by_hand=True),
    OVERTAKEN: Fault(_let_cap_go, before=_overtaken, by_hand=True),
    "the network stands still for 0.5 s": Fault(RemoteOperator.stall, 0.5),
    "the link is cut": Fault(_cut("up", "down"), 1.5),
    "only the way to the robot is cut": Fault(_cut("down"), 1.5),
    "only the way to the operator is cut": Fault(_cut("up"), 1.5),
    CAMERA: Fault(RemoteOperator.fill, 1.5),
    "the laptop sleeps for 5 s": Fault(RemoteOperator.sleep, 5.0),
    "the operator's address changes, in 2 s": Fault(_cut("up", "down"), 2.0),
    "the router is killed, and is back in 3 s": Fault(RemoteOperator.lose_router, 3.0),
    "`cardan devices share` is killed, and is back in 3 s": Fault(RemoteOperator.kill, 3.0),
}


class Found(NamedTuple):
    """Cell of the table, with the values to be asserted. Times count from the fault, s."""

    fault: str
    network: str
    motion: Motion
    rest_by_s: float
    """Time limit until the arm rests; inf: the fault does not end its motion."""
    unasked_m: float
    """Largest distance from the rest position before re-arming."""
    again_m: float
    """Distance moved after re-arming; nan: the arm had not stopped."""


def rest_by_s(operator: RemoteOperator, fault: Fault, at_s: float) -> float:
    """Return the time limit until rest, from the real arrival times of states."""
    remote = operator.remote
    braked_s = BRAKING_S + operator.bench.period_s + SERVO_S
    if fault.by_hand:
        reported = (
            came_s for came_s, made_s, _ in remote.came if made_s >= operator.let_go_s - 1e-9
        )
        return min(reported) + braked_s
    max_age_s = operator.network.max_age_s
    # Each direction also takes a step of the bench's time.
    round_s = remote.down.link.slowest_s + remote.up.link.slowest_s + 2.0 * STEP_S
    fresh_s = -math.inf
    for came_s, made_s, asked_s in [*remote.came, (remote.now_s, -math.inf, -math.inf)]:
        if came_s > max(at_s, fresh_s + max_age_s):
            return fresh_s + max_age_s + braked_s
        if came_s - made_s <= max_age_s:
            # An answer to an old claim proves only that it was made before the latest time for an
            # answer.
            fresh_s = max(fresh_s, min(came_s, asked_s + CLAIM_PERIOD_S + round_s))
    return math.inf


def measured(network: str, faults: Iterable[str]) -> Iterator[Found]:
    """Yield the motion of the arm over one network after each of these faults, with one run-up
    for all."""
    with JointStreamBench() as bench:
        operator = RemoteOperator(bench, NETWORKS[network])
        bench.answer = operator.tick
        bench.ready().run(LIVE_S)
        operator.hold()
        bench.run(HELD_S)
        operator.deflect()
        bench.run(RUN_UP_S)

        def after(name: str) -> Found:
            fault = FAULTS[name]
            fault.before(operator)
            bench.run(HELD_S)
            at_s = bench.now_s
            fault.act(operator, fault.lasts_s)
            bench.run(WATCHED_S)
            if math.isinf((motion := bench.motion(at_s)).stop_s):
                by_s = rest_by_s(operator, fault, at_s)
                return Found(name, network, motion, by_s - at_s, 0.0, math.nan)
            bench.run(fault.lasts_s)
            motion, by_s = bench.motion(at_s), rest_by_s(operator, fault, at_s)
            if operator.deflected:
                # Rest and a new deflection without a press do not re-arm.
                for deflected in (False, True):
                    operator.deflect(deflected)
                    bench.run(SETTLED_S)
            times, points = bench.path()
            since = points[times >= at_s + motion.stop_s + STILL_S]
            unasked_m = float(np.linalg.norm(since - since[0], axis=1).max())
            again_m = 0.0
            for _ in range(2):  # the network may still be stalled
                if again_m < AGAIN_M:
                    operator.act()
                    again_m = float(np.linalg.norm(bench.path()[1][-1] - points[-1]))
            return Found(name, network, motion, by_s - at_s, unasked_m, again_m)

        for name in faults:
            yield in_a_copy(functools.partial(after, name))


def rows(
    networks: Iterable[str] = tuple(NETWORKS), faults: Iterable[str] = tuple(FAULTS)
) -> Iterator[Found]:
    """Yield the results of all networks and faults."""
    faults = tuple(faults)
    for network in networks:
        yield from measured(network, faults)


def table(found: Iterable[Found]) -> str:
    """Return the table in Markdown: a row for each fault, a column for each network."""
    cells = {
        (each.fault, each.network): cell(Row("", each.fault, each.network, each.motion, own=False))
        for each in found
    }
    return markdown(
        ("what happens", *NETWORKS),
        ((name, *(cells[name, each] for each in NETWORKS)) for name in FAULTS),
    )


def main() -> None:
    """Write the table, or print it with "-"."""
    found = list(rows())
    text = table(found)
    if "-" in sys.argv[1:]:
        print(text)
    else:
        RESULTS.write(text)


if __name__ == "__main__":
    main()
