"""Latency from EGM datagram in to datagram out: our driver, our session, two public clients, and
echo servers in Python and C.

One process plays the controller and sends to all of them in rotating order, so that other load of
the machine affects all alike. One run sends in 4 ms slots as a controller does (every peer wakes up
with cold caches), another without pauses. The session is the real one: ``cardan run`` with a
simulated SpaceMouse that moves.
"""

from __future__ import annotations

import contextlib
import gc
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

from bench import native
from bench.figures import Aim, Figures
from bench.responders import C_ECHO, KINDS
from cardan.demos.examples import free_ports
from studies.cartesian.controller import START, datagram, obeyed, session

CYCLES = 5000
WARM_UP_TURNS = 30
"""Each turn has as many cycles as there are responders, so that echo's row is the first of the
table."""
PERIOD_S = 0.004
ANSWER_WITHIN_S = 0.5

SESSION = "cardan-session"
"""Session without the arm's model, moving."""

MOVING = "session with model"

MODEL = """
mode = "joint"
robot = "gofa_crb15000_5"

[arm]
model = "gofa_crb15000_5"

[[obstacles]]
name = "table"
plane = [[0.0, 0.0, 1.0], 0.0]
"""
TOUCH = """
0.3 axes 0 0 0.4 0 0 0 over 0.05
0.5 neutral over 0.05
"""
MOVE = """
0.9 press left
1.0 swing 0 0.4 0.4 0 0 0.2 over 1 times 3
4.1 release left
4.2 loop
"""
"""The script repeats, because a press before the robot is connected does not count."""

SESSIONS = {
    SESSION: ("", TOUCH + MOVE),
    "session, holding": ("", TOUCH),
    MOVING: (MODEL, TOUCH + MOVE),
    "session with model, holding": (MODEL, TOUCH),
}
"""Lines added to the robot's table, and the motion script of the device."""

AIMS = (
    Aim("cardan-driver", "ABBRobotEGM", 0.5, "median"),
    Aim(SESSION, None, 250e-6, "median"),
    Aim("cardan-driver", "echo", 1.0, "median", 12e-6),
    Aim(MOVING, "echo", 1.0, "median", 80e-6),
    Aim(MOVING, "echo", 1.0, "p99", 200e-6),
)


ADDED = {"cardan-driver": 12e-6, "cardan-joints": 12e-6}
"""Limit for our driver's median above that of echo, s."""


@contextlib.contextmanager
def responder(kind: str, port: int) -> Iterator[None]:
    """Run a responder's process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "bench.responders", kind, str(port)], stdout=subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        if process.stdout.readline() != b"READY\n":
            raise RuntimeError(f"{kind} did not start")
        yield
    finally:
        process.terminate()
        process.communicate()


def _kinds() -> list[str]:
    """Return the responders that can run here; print why the others cannot."""
    try:
        native.built(native.ECHO)
    except native.NotBuiltError as error:
        print(f"{C_ECHO} is left out: {error}")
        return [kind for kind in KINDS if kind != C_ECHO]
    return list(KINDS)


def measure(cycles: int = CYCLES, period_s: float = PERIOD_S) -> Figures:
    """Send to every peer `cycles` times, every `period_s`; return the latencies by name."""
    pace = f"every {period_s * 1e3:g} ms" if period_s else "without a pause"
    figures = Figures(f"EGM datagram in to datagram out, as the controller sees it, {pace}")
    kinds = _kinds()
    names = [*kinds, *SESSIONS]
    warm_up = WARM_UP_TURNS * len(names)
    datagrams = [datagram(cycle) for cycle in range(cycles + warm_up)]
    places = dict.fromkeys(SESSIONS, START)
    with contextlib.ExitStack() as stack:
        sockets = []
        # Sessions take about a second to start, and responders end after an equally long pause.
        for name in (*SESSIONS, *kinds):
            port = free_ports()
            if name in SESSIONS:
                stack.enter_context(session(port, *SESSIONS[name]))
            else:
                stack.enter_context(responder(name, port))
            sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sock.connect(("127.0.0.1", port))
            sock.settimeout(ANSWER_WITHIN_S)
            sockets.append((name, sock))
        sockets.sort(key=lambda each: names.index(each[0]))
        clock = time.perf_counter
        gc.disable()
        slot_s = begin_s = clock()
        for cycle, data in enumerate(datagrams):
            for turn in range(len(sockets)):
                name, sock = sockets[(cycle + turn) % len(sockets)]
                sent = data
                if not period_s:
                    # The session checks the controller's clock: it must not run faster than real
                    # time.
                    time_ms = round(1e3 * (clock() - begin_s))
                    sent = datagram(cycle, places.get(name, START), time_ms=time_ms)
                elif name in places:
                    sent = datagram(cycle, places[name])
                start_s = clock()
                sock.send(sent)
                try:
                    answer = sock.recv(2048)
                except (TimeoutError, ConnectionRefusedError):
                    figures.miss(name)
                    continue
                took_s = clock() - start_s
                if name in places:
                    places[name] = obeyed(answer, places[name])
                if cycle >= warm_up:
                    figures.add(name, took_s)
            slot_s = max(slot_s + period_s, clock())
            time.sleep(max(0.0, slot_s - clock()))
        gc.enable()
    return figures


def main() -> None:
    """Print the tables and whether the aims are met."""
    measure().print(AIMS, ADDED)
    measure(period_s=0.0).print()


if __name__ == "__main__":
    main()
