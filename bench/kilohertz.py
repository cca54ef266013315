"""Lateness of a session with a period of 1 ms: `python -m bench kilohertz`.

    python -m bench kilohertz [--seconds=60] [--pages]

The session is a ``cardan run`` process: a simulated UR5 at 1 kHz inside it, the arm's model with at
least 35 pairs of bodies, and a simulated SpaceMouse in a separate process, which moves the arm in
circles. It runs for a minute in each case: alone, with one busy process, and with one on every
processor. After each, a C loop that only waits shows what this computer can do. `--pages` writes
the table into docs/measurements.md.

Lateness is the delay of a cycle's start after its instant on an absolute schedule; an instant is
missed if the next one is already due. The answer leaves later by the duration of the cycle.
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
"""Number of posts; with these and the floor a UR5 has 38 pairs."""
PAIRS = 35
PERIOD_S = 0.001

WARM_UP_S, SECONDS = 6.0, 60.0
"""Warm-up: the device moves after 1 s, and after 6 s all code has run once."""

LATE_P99_S = 100e-6
"""Limit for the p99 of the lateness."""

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
"""Number of busy processes, with ordinary scheduling."""


class Floor(NamedTuple):
    """Result of a C loop that only waits for its instants."""

    instants: int
    missed: int
    p50_ns: int
    """Median lateness of the loop."""
    p99_ns: int


class Row(NamedTuple):
    """Measurement of a session under one kind of load."""

    beside: str
    late_p50_s: float
    late_p99_s: float
    tick_p50_s: float
    """Median time from the start of a cycle until its answer leaves."""
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
    """Return the session's configuration; `mouse`: path of the simulated SpaceMouse."""
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
    """Number of pairs of bodies in the session's servo."""
    body: Any = make_controller(config, make_robot(config)).commanded
    return len(body.servo.collision.pairs)


@contextlib.contextmanager
def busy(count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Run `count` busy processes."""
    processes = []
    with contextlib.ExitStack() as running:
        for _ in range(count):
            process = running.enter_context(subprocess.Popen([sys.executable, "-c", BUSY]))
            running.callback(process.kill)
            processes.append(process)
        yield processes


def measure(config: SessionConfig, beside: str, seconds: float) -> Row:
    """Run the session for this time after its warm-up."""
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
    """Run the C loop for this time."""
    command = (native.built(native.TIMER), f"{1e6 * PERIOD_S:.0f}", f"{seconds}")
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return Floor(**json.loads(done.stdout))


def table(rows: list[Row], conditions: str) -> str:
    """Return the table of docs/measurements.md."""
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
    """Measure and print; with `--pages`, write the table into the page."""
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
