"""Generator of the tables in tests/results/faults.md: each robot's reaction to each fault.

To update them: ``make fault-table``, or ``python -m tests.fault_table``.
"""

from __future__ import annotations

import functools
import math
import os
import pickle
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar
from weakref import WeakSet

from cardan.common import forks
from tests.fault_benches import (
    BENCHES,
    CLOCKS,
    MARGIN,
    Bench,
    EgmBench,
    EgmJointBench,
    JointStreamBench,
    Motion,
    MotorosBench,
    MotorosStreamBench,
    Ros2Bench,
    UrBench,
)
from tests.fault_scenarios import SCENARIOS, SPEED_M_S, Make, Scenario, make
from tests.result_tables import FAULTS as RESULTS

_T = TypeVar("_T")

RUN_UP_S = 0.6
"""At 1 m/s² the arm has its speed after 0.1 s."""
WATCHED_S = 1.5
CLOCK_WATCHED_S = 2.0
"""A slow clock is certain after 1 to 1.5 s."""

HIGHEST_M_S = SPEED_M_S * (1.0 + MARGIN)
HARDEST_M_S2 = 1.3
"""Requested 1 m/s² plus overshoot of the servos. For a reference that begins to brake within one
period, the drives add up to 0.1 m/s² on the joint stream, and up to 0.06 with EGM; two ramps in one
window add up to 0.2 more."""


class Fault(NamedTuple):
    """A fault, and the robots that it applies to."""

    act: Callable[[Bench, Scenario], None]
    sources: tuple[str, ...] = ("operator", "twist", "path")
    robots: tuple[type[Bench], ...] = BENCHES
    own: tuple[type[Bench], ...] = ()
    """Robots that then stop by their controller or at their driver's own limits, so that the
    deceleration is independent of the request."""
    watched_s: float = WATCHED_S


def _silence(bench: Bench, scenario: Scenario) -> None:
    scenario.silent = True


def _flood(bench: Bench, scenario: Scenario) -> None:
    bench.flooded = True


def _bad(kind: str) -> Callable[[Bench, Scenario], None]:
    def act(bench: Bench, scenario: Scenario) -> None:
        bench.bad = kind

    return act


def _stall(ms: int) -> Callable[[Bench, Scenario], None]:
    return lambda bench, scenario: bench.stall(1e-3 * ms)


def _delay(ms: int) -> Callable[[Bench, Scenario], None]:
    return lambda bench, scenario: bench.delay(1e-3 * ms)


def _clock(name: str) -> Callable[[Bench, Scenario], None]:
    return lambda bench, scenario: bench.lie(name)


_UDP = (EgmBench, EgmJointBench, JointStreamBench, Ros2Bench)
_MOTOROS = (MotorosStreamBench, MotorosBench)

_STOPPED_BY_CLOCK = (EgmBench, EgmJointBench, UrBench, JointStreamBench, Ros2Bench)
"""Robots whose driver brakes at its own limits, or ends motion, if clocks disagree."""

FAULTS: dict[str, Fault] = {
    "device or sender silent": Fault(_silence, ("operator", "twist")),
    "port flooded": Fault(_flood, robots=_UDP, own=(Ros2Bench,)),
    "states that are not numbers": Fault(_bad("nan"), own=BENCHES),
    "measured place jumps by 200 mm": Fault(_bad("jump"), own=(Ros2Bench,)),
    "second publisher of the joints": Fault(
        lambda bench, scenario: bench.peer.second(), robots=(Ros2Bench,), own=(Ros2Bench,)
    ),
    "process stalls for 20 ms": Fault(_stall(20), own=(Ros2Bench,)),
    "process stalls for 40 ms": Fault(_stall(40), own=(MotorosStreamBench, Ros2Bench)),
    "process stalls for 60 ms": Fault(_stall(60), own=(MotorosStreamBench, Ros2Bench)),
    "process stalls for 100 ms": Fault(
        _stall(100), own=(*_MOTOROS, JointStreamBench, Ros2Bench, UrBench)
    ),
    "process stalls for 500 ms": Fault(_stall(500), own=BENCHES),
    "command is 20 ms late": Fault(_delay(20), own=(MotorosStreamBench, Ros2Bench)),
    "command is 60 ms late": Fault(_delay(60), own=(MotorosStreamBench, Ros2Bench)),
    "command is 150 ms late": Fault(_delay(150), own=BENCHES),
    "controller restarts": Fault(lambda bench, scenario: bench.restart(), own=BENCHES),
    "motors off": Fault(lambda bench, scenario: bench.unpower(), own=BENCHES),
    "program stopped at the robot": Fault(lambda bench, scenario: bench.unready(), own=BENCHES),
    "commands reported as without effect": Fault(lambda bench, scenario: bench.hold(), own=BENCHES),
    "authority taken": Fault(lambda bench, scenario: scenario.lose_authority()),
    "supervisor stopped": Fault(lambda bench, scenario: scenario.stop_supervisor()),
    "process killed": Fault(lambda bench, scenario: bench.kill(), own=BENCHES),
    **{
        f"clock {name}": Fault(
            _clock(name),
            ("operator", "twist"),
            own=_STOPPED_BY_CLOCK,
            watched_s=CLOCK_WATCHED_S,
        )
        for name in CLOCKS
    },
}


class Row(NamedTuple):
    """Cell of the tables."""

    source: str
    fault: str
    robot: str
    motion: Motion
    own: bool

    @property
    def too_much(self) -> str:
        """Return, as text, the values above the request; empty if there is none."""
        found = []
        if self.motion.peak_m_s > HIGHEST_M_S:
            found.append(f"{1e3 * self.motion.peak_m_s:.0f} mm/s")
        if self.motion.peak_m_s2 > HARDEST_M_S2 and not self.own:
            found.append(f"{self.motion.peak_m_s2:.1f} m/s²")
        return " and ".join(found)


def measured(
    source: str,
    faults: Iterable[Fault],
    kind: type[Bench],
    made: Make = make,
    run_up_s: float = RUN_UP_S,
) -> Iterator[Motion]:
    """Yield the motion of a bench's arm after each of these faults, with one run-up for all."""
    with kind() as bench:
        scenario = made(source, bench)
        bench.answer = scenario.tick
        bench.ready().run(0.05)
        scenario.start()
        bench.run(run_up_s)
        at_s = bench.now_s

        def after(fault: Fault) -> Motion:
            fault.act(bench, scenario)
            bench.run(fault.watched_s)
            return bench.motion(at_s)

        for fault in faults:
            yield in_a_copy(functools.partial(after, fault))


def in_a_copy(work: Callable[[], _T]) -> _T:
    """Return the result of `work` in a forked process, which leaves this one unchanged."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        # The warning concerns other threads: the forked process has none, and waits for none.
        warnings.simplefilter("ignore", DeprecationWarning)
        # The forked process continues to use open resources.
        opened, forks._opened = forks._opened, WeakSet()
        copy = os.fork()
        forks._opened = opened
    if copy == 0:
        code = 1
        try:
            with open(writing, "wb") as writer:
                pickle.dump(work(), writer)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    os.close(writing)
    with open(reading, "rb") as found:
        data = found.read()
    _, status = os.waitpid(copy, 0)
    if status:
        raise RuntimeError("it failed in the copy, which says why on standard error")
    return pickle.loads(data)  # type: ignore[no-any-return]


def rows(made: Make = make) -> Iterator[Row]:
    """Yield the results of all valid combinations of source, fault and robot."""
    for source in SCENARIOS:
        for kind in BENCHES:
            faults = {
                name: fault
                for name, fault in FAULTS.items()
                if source in fault.sources and kind in fault.robots
            }
            motions = measured(source, faults.values(), kind, made)
            for (name, fault), motion in zip(faults.items(), motions, strict=True):
                yield Row(source, name, kind.name, motion, kind in fault.own)


def table(found: list[Row]) -> str:
    """Return the tables in Markdown: one for each source, with a row for each fault."""
    lines = []
    cells = {(row.source, row.fault, row.robot): row for row in found}
    for source in dict.fromkeys(row.source for row in found):
        lines += [f"### {source}", ""]
        lines.append(f"| | {' | '.join(kind.name for kind in BENCHES)} |")
        lines.append("|---" * (1 + len(BENCHES)) + "|")
        for name in FAULTS:
            there = [cells.get((source, name, kind.name)) for kind in BENCHES]
            if any(there):
                lines.append(f"| {name} | {' | '.join(map(cell, there))} |")
        lines.append("")
    return "\n".join(lines)


def cell(row: Row | None) -> str:
    """Return a result as the text of its cell."""
    if row is None:
        return "–"
    motion = row.motion
    stop = "continues" if math.isinf(motion.stop_s) else f"{1e3 * motion.stop_s:.0f}"
    text = (
        f"{stop}, {1e3 * motion.distance_m:.1f}, {1e3 * motion.peak_m_s:.0f}, "
        f"{motion.peak_m_s2:.1f}{'*' * row.own}"
    )
    return f"**{text}**" if row.too_much else text


def main() -> None:
    """Write the tables, or print them with "-"."""
    found = list(rows())
    text = table(found)
    if "-" in sys.argv[1:]:
        print(text)
    else:
        RESULTS.write(text)
    for row in found:
        if row.too_much:
            print(f"{row.source}, {row.fault}, {row.robot}: {row.too_much}")


if __name__ == "__main__":
    main()
