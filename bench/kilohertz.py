"""Lateness of a session with a period of 1 ms: `python -m bench kilohertz`.

    python -m bench kilohertz [--seconds=60] [--pages]

The session is the process of ``cardan run``: a simulated UR5 in it at 1 kHz, the arm's model with
at least 35 pairs of bodies, and a SpaceMouse (simulated, in a process of its own) which moves
the arm in circles. It runs by itself, beside a process that computes all the time, and beside one
on every processor, each for a minute; a loop in C that only waits does so after it, in each case:
that is what this computer can do. `--pages` writes the table into docs/measurements.md.

Lateness is how long after its instant, on an absolute schedule, a cycle begins; an instant is
missed when the next one is due by then. The answer leaves the later by what the cycle takes.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from bench import native, pages
from bench.arms import shapes_as_tables
from cardan.gateway.daemon.usage import processor_time_s
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.gateway.session.supervisor import SessionProcess

PAGE = Path(__file__).parents[1] / "docs/measurements.md"
PART = "kilohertz"

ARM = "ur5"
POSTS = 3
"""Beside the floor: with them a UR5 has 38 pairs."""
PAIRS = 35
PERIOD_S = 0.001

WARM_UP_S, SECONDS = 6.0, 60.0
"""The device moves after one second, and everything has been used once after six."""

LATE_P99_S = 100e-6
"""Aim."""

MOTION = """
0.3 axes 0 0 0.4 0 0 0 over 0.05
0.5 neutral over 0.05
0.9 press left
1.0 swing 0 0.4 0.4 0 0 0.2 over 1 times 3
4.1 release left
4.2 loop
"""

BUSY = "while True: pass"

BESIDE = {
    "nothing": 0,
    "a busy process": 1,
    "a busy process on every processor": os.cpu_count() or 1,
}
"""Number of processes that compute meanwhile, with ordinary scheduling."""


class Floor(NamedTuple):
    """A loop in C that only waits for its instants."""

    instants: int
    missed: int
    p50_ns: int
    """Of its lateness."""
    p99_ns: int


class Row(NamedTuple):
    """Measurement of a session beside one kind of load."""

    beside: str
    late_p50_s: float
    late_p99_s: float
    tick_p50_s: float
    """From a cycle's beginning to its answer's leaving."""
    tick_p99_s: float
    instants: int
    missed: int
    used: float
    """Share of a processor."""
    moving: float
    """Share of the time in which the arm moved."""
    scheduling: str
    floor: Floor


def configuration(mouse: str, drive: str = "dynamic") -> SessionConfig:
    """Of the session; its mouse is at `mouse`."""
    return parse_config(
        {
            "robot": {"driver": "sim_arm", "robot": ARM, "period_s": PERIOD_S, "drive": drive},
            "arm": {"model": ARM},
            "obstacles": shapes_as_tables(POSTS),
            "device": {"driver": "spacemouse", "transport": "socket", "path": mouse},
            "mapping": {"deadman": "left"},
        }
    )


def pairs(config: SessionConfig) -> int:
    """Pairs of bodies that the session's servo keeps apart."""
    body: Any = make_controller(config, make_robot(config)).commanded
    return len(body.servo.collision.pairs)


@contextlib.contextmanager
def busy(count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """So many processes that compute all the time."""
    processes = []
    with contextlib.ExitStack() as running:
        for _ in range(count):
            process = running.enter_context(subprocess.Popen([sys.executable, "-c", BUSY]))
            running.callback(process.kill)
            processes.append(process)
        yield processes


def measure(config: SessionConfig, beside: str, seconds: float) -> Row:
    """Run the session for so long after its warm-up."""
    first: list[tuple[Snapshot, float]] = []
    last: list[tuple[Snapshot, float]] = []

    def take(packet: bytes) -> Snapshot:
        snapshot = Snapshot.from_bytes(packet)
        used_s = processor_time_s(process.pid)
        if used_s is not None and snapshot.elapsed_s >= WARM_UP_S:
            last[:] = ((snapshot, used_s),)
            first.extend(last[: not first])
        return snapshot

    with busy(BESIDE[beside]):
        process = SessionProcess(config, WARM_UP_S + seconds)
        outcome = process.follow(take)
        floor = measure_floor(seconds)
    if outcome.exit_code or not first:
        raise RuntimeError(f"the session ended: {outcome.last.error or outcome.last.ending}")
    (begin, used_s), (end, used_till_s) = first[0], last[0]
    took_s = end.elapsed_s - begin.elapsed_s
    metrics = end.robot.metrics
    return Row(
        beside,
        metrics["late_p50_s"],
        metrics["late_p99_s"],
        end.loop.tick_p50_s,
        end.loop.tick_p99_s,
        round(metrics["instants"] - begin.robot.metrics["instants"]),
        round(metrics["superseded"] - begin.robot.metrics["superseded"]),
        (used_till_s - used_s) / took_s,
        (end.tracking.moving_s - begin.tracking.moving_s) / took_s,
        end.scheduling,
        floor,
    )


def measure_floor(seconds: float) -> Floor:
    """The loop in C, for so long."""
    command = (native.built(native.TIMER), f"{1e6 * PERIOD_S:.0f}", f"{seconds}")
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return Floor(**json.loads(done.stdout))


def table(rows: list[Row], conditions: str) -> str:
    """As docs/measurements.md has it."""
    lines = [
        "| load | lateness, median / p99 | answer after, median / p99 | missed "
        "| CPU of the session | moving | aim | bare loop in C: lateness | missed |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        late = f"{row.late_p50_s * 1e6:.0f} / {row.late_p99_s * 1e6:.0f}"
        met = "met" if row.late_p99_s <= LATE_P99_S and row.missed == 0 else "missed"
        lines.append(
            f"| {row.beside} | {late} µs | {row.tick_p50_s * 1e6:.0f} / {row.tick_p99_s * 1e6:.0f} "
            f"µs | {row.missed} of {row.instants} | {row.used:.1%} | {row.moving:.0%} | {met} "
            f"| {row.floor.p50_ns / 1e3:.0f} / {row.floor.p99_ns / 1e3:.0f} µs "
            f"| {row.floor.missed} of {row.floor.instants} |"
        )
    return "\n".join(lines) + "\n\n" + conditions


def main() -> None:
    """Measure and print; write where it is asked for."""
    words = sys.argv[1:]
    given = [word.partition("=")[2] for word in words if word.startswith("--seconds=")]
    seconds = float(given[-1]) if given else SECONDS
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="cardan-kilohertz-") as folder:
        mouse, script = f"{folder}/mouse", Path(folder, "hand")
        script.write_text(MOTION)
        config = configuration(mouse)
        with cardan_subprocess("sim", "spacemouse", "--hid", mouse, "--script", str(script)):
            rows = [measure(config, beside, seconds) for beside in BESIDE]
        conditions = (
            f"{pairs(config)} pairs, {seconds:g} s each, {os.cpu_count()} processors; scheduling: "
            f"{rows[0].scheduling}. Aim: p99 of the lateness at most {LATE_P99_S * 1e6:g} µs, none "
            f"missed. Load in the minute before: {load:.1f}."
        )
    body = table(rows, conditions)
    print(pages.marked(PART, body), flush=True)
    if "--pages" in words:
        pages.rewrite(PAGE, {PART: body})
        print(f"docs/{PAGE.name} has these numbers")
