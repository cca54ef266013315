"""MotoROS on loopback: reply time, age of velocities at use, CPU time of a session, and a long run.

    python -m bench motoros-link
    python -m bench motoros-soak [seconds]

The controller is a separate process (``cardan sim motoman-gp8``), the session is a ``cardan run``
with a simulated SpaceMouse in continuous motion. Ages are read in the controller, in each of its
interpolation periods.
"""

from __future__ import annotations

import socket
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.figures import Figures
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.gateway.session.snapshot import Snapshot
from cardan.protocols.simple_message import codec
from cardan.protocols.simple_message.codes import MessageType, MotionCommand
from cardan.protocols.simple_message.framing import ByteOrder, FrameReader
from cardan.protocols.simple_message.messages import Empty, MotionCtrl, VelocityInfoRequest, request
from studies.motoros.recording import FIRST_PUSH_S, Array, peers, read_log, session_tables

REQUESTS = 2000
RATES_HZ = (100, 250)
SECONDS = 10.0
SOAK_S = 120.0
SWING_S = 2.0
STALE_PERIODS = 2.0
"""Age in interpolation periods above which a command counts as late: the next one missed its
time."""


def swinging(seconds: float) -> str:
    """Motion script without rest: back and forth."""
    lines = ["1.0 axes 0.3 0 0 0 0 0", "1.2 neutral", f"{FIRST_PUSH_S - 0.8} press ctrl"]
    count = int((seconds + FIRST_PUSH_S) / SWING_S) + 2
    for number in range(count):
        start_s = FIRST_PUSH_S + number * SWING_S - 0.5
        sign = "" if number % 2 == 0 else "-"
        lines.append(f"{start_s:.2f} axes {sign}0.6 0 0 0 0 0 over 0.4")
    return "\n".join(lines) + "\n"


class Run(NamedTuple):
    """A session in velocity mode, measured from its first motion."""

    ages_s: Array
    """Age of the newest command in each interpolation period."""
    sent: int
    accepted: int
    refused: int
    left: int
    """Number of interpolation periods without velocity mode."""
    cpu_share: float
    snapshot: Snapshot


def drive(rate_hz: int, seconds: float, plant: str = "ideal") -> Run:
    """Measure a session at `rate_hz` for this time."""
    with tempfile.TemporaryDirectory(prefix="cardan-") as name:
        script = swinging(seconds)
        with peers(Path(name), script, "--plant", plant) as (mouse, port, log):
            tables: dict[str, Any] = session_tables(
                mouse, port, "velocity", command_period_s=1.0 / rate_hz
            )
            session = make_session(parse_config(tables))
            began_s, cpu_s = time.monotonic(), time.process_time()
            session.run(FIRST_PUSH_S + seconds)
            wall_s, cpu_s = time.monotonic() - began_s, time.process_time() - cpu_s
        rows = read_log(log)
    first = began_s + FIRST_PUSH_S - 0.5
    # The last periods belong to the session's own shutdown.
    moving = (rows["monotonic_s"] > first) & (rows["monotonic_s"] < began_s + wall_s - 0.5)
    ages_s = rows["command_age_s"][moving]
    found = np.isfinite(ages_s)
    return Run(
        ages_s[found],
        int(session.snapshot.robot.metrics["commands"]),
        int(rows["accepted"][-1]),
        int(rows["refused"][-1]),
        int((~found).sum()),
        cpu_s / wall_s,
        session.snapshot,
    )


def replies() -> Figures:
    """Request-to-reply times of a plain socket, by kind of request."""
    figures = Figures("simple message, request to reply on loopback")
    with (
        tempfile.TemporaryDirectory(prefix="cardan-") as name,
        peers(Path(name), "1.0 neutral\n") as (_, port, _log),
        socket.create_connection(("127.0.0.1", port)) as link,
    ):
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        wire = codec.wire()
        asked = {
            "PING": request(Empty(), MessageType.PING),
            "CHECK_QUEUE_CNT": request(MotionCtrl(0, 0, MotionCommand.CHECK_QUEUE_CNT)),
            "VELOCITY_INFO": request(VelocityInfoRequest(0)),
        }
        reader = FrameReader(ByteOrder.LITTLE)
        for _ in range(REQUESTS):
            for kind, message in asked.items():
                data = wire.encode(message)
                start_s = time.perf_counter()
                link.sendall(data)
                while reader.take() is None:
                    reader.feed(link.recv(4096))
                figures.add(kind, time.perf_counter() - start_s)
    return figures


def main() -> None:
    """Print the tables."""
    replies().print()
    print("\nvelocity mode, ideal drives: age of the newest command in each interpolation period\n")
    print(f"{'':10}{'median':>10}{'p99':>10}{'max':>10}{'late':>8}{'CPU of session':>17}")
    for rate_hz in RATES_HZ:
        run = drive(rate_hz, SECONDS)
        median, p99 = np.percentile(run.ages_s, (50, 99)) * 1e3
        late = int((run.ages_s > STALE_PERIODS / rate_hz).sum())
        print(
            f"{rate_hz:4} Hz   {median:7.2f} ms{p99:7.2f} ms{run.ages_s.max() * 1e3:7.2f} ms"
            f"{late:8}{run.cpu_share:15.1%}"
        )
        metrics, loop = run.snapshot.robot.metrics, run.snapshot.loop
        print(
            f"{'':10}driver's requests: median {metrics['request_p50_s'] * 1e3:.2f} ms, "
            f"p99 {metrics['request_p99_s'] * 1e3:.2f} ms; tick p50 "
            f"{loop.tick_p50_s * 1e6:.0f} µs, p99 {loop.tick_p99_s * 1e6:.0f} µs"
        )
    print("\nlate: periods in which the newest command was older than two of its periods")


def soak() -> None:
    """Print the result of a long run at 250 Hz; exit with 1 if anything was lost."""
    seconds = next((float(word) for word in sys.argv[1:] if word.isdecimal()), SOAK_S)
    run = drive(RATES_HZ[-1], seconds)
    lost = run.sent - run.accepted
    print(f"\nvelocity mode at {RATES_HZ[-1]} Hz for {seconds:g} s, all on this machine\n")
    print(f"velocities sent          {run.sent}")
    print(f"accepted                 {run.accepted}, refused {run.refused}, lost {lost}")
    print(f"oldest at use            {run.ages_s.max() * 1e3:.1f} ms (watchdog 100 ms)")
    print(f"periods out of the mode  {run.left}")
    print(f"operator's hand taken    {run.snapshot.arm.trips} times")
    bad = lost or run.refused or run.left or run.snapshot.arm.trips
    print("no watchdog trip, no lost command" if not bad else "FAILED")
    if bad:
        sys.exit(1)


if __name__ == "__main__":
    main()
