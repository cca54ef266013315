"""Makes the table of a device at another computer, tests/results/remote-faults.md: what the arm
did when something between the two, or at the operator's, went wrong.

To write it anew: ``make fault-table``, or ``python -m tests.remote_fault_table``. All in virtual
time: `cardan devices share` and the driver's core, a network between them, and a session's control
core in front of a simulated arm.
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
from tests.fault_pilots import ACCELERATION_M_S2, SPEED_M_S, Operator
from tests.fault_table import Row, cell, in_a_copy
from tests.result_tables import REMOTE_FAULTS as RESULTS

REPORT_S = 0.008
"""A SpaceMouse's reports, while it is deflected."""

HOLD = "left"

LIVE_S, HELD_S, RUN_UP_S = 0.6, 0.25, 0.5
WATCHED_S = 1.0
"""After the fault, and after its end."""

SETTLED_S = 0.5
"""Longer than whatever the device does takes to be seen at the arm."""

AGAIN_M = 0.02
"""An arm that goes this far moves again."""

BRAKING_S = SPEED_M_S / ACCELERATION_M_S2

SERVO_S = 0.01
"""By which the arm's drives are late: it is at rest so long after what it is commanded."""

STILL_S = 0.05
"""Longer than an arm that is slower than 1 mm/s takes to be at rest."""


class Network(NamedTuple):
    """A network, each way."""

    link: Link
    max_age_s: float
    """Of the driver and of the watchdog."""
    stall_s: float = 0.0
    """Nothing arrives for so long, then all of it ..."""
    stalls_every_s: float = math.inf
    """... so often."""


NETWORKS = {
    "LAN": Network(Link(0.0003), 0.15),
    "Wi-Fi": Network(Link(0.0, 0.013, loss=0.01), 0.15, 0.08, 1.0),
    "LTE": Network(Link(0.025, 0.04, loss=0.01), 0.25, 0.5, 5.0),
    "Internet": Network(Link(0.11, 0.02, loss=0.005), 0.4),
}


class RemoteOperator(Operator):
    """A hand on a deflected device at another computer, its dead-man held."""

    bench: JointStreamBench

    def __init__(self, bench: JointStreamBench, network: Network) -> None:
        super().__init__(bench, Watchdogs(device_age_s=network.max_age_s))
        self.network = network
        self.remote = RemoteBench(network.link, now_s=bench.now_s, max_age_s=network.max_age_s)
        self.remote.direction = bench.direction
        self.deflected = self.holds = False
        self.let_go_s = -math.inf
        """Time of the device's last report that the cap, or the dead-man, was released."""
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
        """Push the cap, or let it go."""
        self.deflected = deflected

    def hold(self, holds: bool = True) -> None:
        """Press the dead-man, or release it."""
        if holds is not self.holds:
            self.holds = holds
            self.remote.press(HOLD, holds)
            if not holds:
                self.let_go_s = self.remote.now_s + STEP_S

    def act(self) -> None:
        """Re-arm, and move after it."""
        for holds, deflected in ((False, False), (True, False), (True, True)):
            self.hold(holds)
            self.deflect(deflected)
            self.bench.run(SETTLED_S)

    # -- faults ----------------------------------------------------------------------------------

    def after(self, seconds: float, act: Callable[[], None]) -> None:
        """Do that so much later."""
        self._later.append((self.remote.now_s + seconds, act))

    def stall(self, seconds: float) -> None:
        """Both ways stand still."""
        until_s = self.remote.now_s + seconds
        self.remote.down.stall(until_s)
        self.remote.up.stall(until_s)

    def cut(self, ways: Iterable[str], seconds: float) -> None:
        """`ways`, of "up" and "down", are cut for so long: "down" is to the robot."""
        for name in ways:
            way = getattr(self.remote, name)
            way.cut = True
            self.after(seconds, functools.partial(setattr, way, "cut", False))

    def sleep(self, seconds: float) -> None:
        """The lid is closed, and opened so much later."""
        self.remote.asleep = True
        self.after(seconds, lambda: setattr(self.remote, "asleep", False))

    def lose_router(self, seconds: float) -> None:
        """It is beside the session, which is told at once by its own connection."""
        self.cut(("up", "down"), seconds)
        self._lose()
        self.after(seconds, self._find)

    def kill(self, seconds: float) -> None:
        """`cardan devices share`, which is started again so much later: its computer closes the
        connection, and the router tells the session."""
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
        """The driver opens it anew, by another node."""
        self.remote.claimant += 1
        self.remote.core.on_opened(self.remote.now_s)

    def fill(self, seconds: float) -> None:
        """Pictures fill the way to the operator."""
        way = self.remote.up
        way.rate_bps = SLOW_BPS
        count = round(seconds / PICTURE_S)
        for n in range(count):
            self.after(n * PICTURE_S, lambda: way.picture(PICTURE_BYTES, self.remote.now_s))

    def change(self, **link: object) -> None:
        """Both ways pass things so."""
        for way in (self.remote.down, self.remote.up):
            way.link = way.link._replace(**link)


SLOW_BPS = 2e6
PICTURE_BYTES, PICTURE_S = 16_000, 1.0 / 30.0
"""3.8 Mbit/s: more than the link passes."""

OVERTAKEN_S = 0.06
"""Least jitter where states overtake others."""


class Fault(NamedTuple):
    """A fault and its duration."""

    act: Callable[[RemoteOperator, float], None]
    lasts_s: float = 0.0
    before: Callable[[RemoteOperator], None] = lambda pilot: None
    """Begins a fault some time before."""
    by_hand: bool = False
    """The hand ends the motion, not the fault."""


def _let_hold_go(pilot: RemoteOperator, _lasts_s: float) -> None:
    pilot.hold(False)


def _let_cap_go(pilot: RemoteOperator, _lasts_s: float) -> None:
    pilot.deflect(False)


def _twice(pilot: RemoteOperator) -> None:
    pilot.change(in_order=False, twice=1.0)


def _overtaken(pilot: RemoteOperator) -> None:
    jitter_s = max(OVERTAKEN_S, pilot.network.link.jitter_s)
    pilot.change(in_order=False, jitter_s=jitter_s)


def _cut(*ways: str) -> Callable[[RemoteOperator, float], None]:
    return lambda pilot, lasts_s: pilot.cut(ways, lasts_s)


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
    """A cell of the table, and the values to be asserted. Times are from the fault on, s."""

    fault: str
    network: str
    motion: Motion
    rest_by_s: float
    """When the arm has to be at rest; inf: the fault does not end its motion."""
    unasked_m: float
    """How far it was from where it came to rest, until re-arming."""
    again_m: float
    """How far it went after that; nan: it had never stopped."""


def rest_by_s(pilot: RemoteOperator, fault: Fault, at_s: float) -> float:
    """When the arm has to be at rest, by what really came when."""
    remote = pilot.remote
    braked_s = BRAKING_S + pilot.bench.period_s + SERVO_S
    if fault.by_hand:
        reported = (came_s for came_s, made_s, _ in remote.came if made_s >= pilot.let_go_s - 1e-9)
        return min(reported) + braked_s
    max_age_s = pilot.network.max_age_s
    # Each way takes a step of the bench's time, too.
    round_s = remote.down.link.slowest_s + remote.up.link.slowest_s + 2.0 * STEP_S
    fresh_s = -math.inf
    for came_s, made_s, asked_s in [*remote.came, (remote.now_s, -math.inf, -math.inf)]:
        if came_s > max(at_s, fresh_s + max_age_s):
            return fresh_s + max_age_s + braked_s
        if came_s - made_s <= max_age_s:
            # An answer to an old claim shows only when an answer was due at the latest.
            fresh_s = max(fresh_s, min(came_s, asked_s + CLAIM_PERIOD_S + round_s))
    return math.inf


def measured(network: str, faults: Iterable[str]) -> Iterator[Found]:
    """Yield the motion of the arm over one network after each of these faults, with one run-up
    for all."""
    with JointStreamBench() as bench:
        pilot = RemoteOperator(bench, NETWORKS[network])
        bench.answer = pilot.tick
        bench.ready().run(LIVE_S)
        pilot.hold()
        bench.run(HELD_S)
        pilot.deflect()
        bench.run(RUN_UP_S)

        def after(name: str) -> Found:
            fault = FAULTS[name]
            fault.before(pilot)
            bench.run(HELD_S)
            at_s = bench.now_s
            fault.act(pilot, fault.lasts_s)
            bench.run(WATCHED_S)
            if math.isinf((motion := bench.motion(at_s)).stop_s):
                by_s = rest_by_s(pilot, fault, at_s)
                return Found(name, network, motion, by_s - at_s, 0.0, math.nan)
            bench.run(fault.lasts_s)
            motion, by_s = bench.motion(at_s), rest_by_s(pilot, fault, at_s)
            if pilot.deflected:
                # To rest and away again without a press does not re-arm.
                for deflected in (False, True):
                    pilot.deflect(deflected)
                    bench.run(SETTLED_S)
            times, points = bench.path()
            since = points[times >= at_s + motion.stop_s + STILL_S]
            unasked_m = float(np.linalg.norm(since - since[0], axis=1).max())
            again_m = 0.0
            for _ in range(2):  # The network may stand still meanwhile.
                if again_m < AGAIN_M:
                    pilot.act()
                    again_m = float(np.linalg.norm(bench.path()[1][-1] - points[-1]))
            return Found(name, network, motion, by_s - at_s, unasked_m, again_m)

        for name in faults:
            yield in_a_copy(functools.partial(after, name))


def rows(
    networks: Iterable[str] = tuple(NETWORKS), faults: Iterable[str] = tuple(FAULTS)
) -> Iterator[Found]:
    """All of these."""
    faults = tuple(faults)
    for network in networks:
        yield from measured(network, faults)


def table(found: Iterable[Found]) -> str:
    """In Markdown: a row for each fault, a column for each network."""
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
