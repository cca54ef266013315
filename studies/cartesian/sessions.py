"""Robots that drive sessions and measure their latency and cost."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from cardan.common.realtime import ask_for_real_time
from cardan.protocols.egm.messages import EgmMeasuredForce
from studies.cartesian.controller import START, datagram, obeyed

MODEL = """
mode = "joint"
robot = "gofa_crb15000_5"

[arm]
model = "gofa_crb15000_5"
"""

FORCE = EgmMeasuredForce((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), fc_active=True)

PERIOD_S = 0.004
"""Cycle of the robots."""

ANSWER_WITHIN_S = 0.5


def free_endpoint() -> str:
    """Return a Zenoh endpoint on this computer."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def network_table(endpoint: str, rate_hz: float = 50.0, more: str = "") -> str:
    """Return the [network] table of a session whose bus is at `endpoint`."""
    return f'\n[network]\nrouter = ""\nlisten = ["{endpoint}"]\nrate_hz = {rate_hz}\n{more}\n'


class Robot:
    """A controller whose robot obeys at once."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(ANSWER_WITHIN_S)
        self._cycle = 0
        self.place = START
        self.unanswered = 0

    def ask(self) -> float | None:
        """Send the next state; return the time until its answer came, s."""
        sent = datagram(self._cycle, self.place, FORCE)
        self._cycle += 1
        start_s = time.perf_counter()
        try:
            self._socket.send(sent)
            answer = self._socket.recv(2048)
        except (TimeoutError, ConnectionRefusedError):
            self.unanswered += 1
            return None
        took_s = time.perf_counter() - start_s
        self.place = obeyed(answer, self.place)
        return took_s

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


@contextlib.contextmanager
def keep_alive(robots: Sequence[Robot]) -> Iterator[Callable[[], None]]:
    """Keep robots running in a thread while their sessions are being prepared; yield a function
    that stops it."""
    over = threading.Event()

    def ask() -> None:
        with as_a_controller():
            while not over.wait(PERIOD_S):
                for each in tuple(robots):
                    each.ask()

    thread = threading.Thread(target=ask)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()

    try:
        yield end
    finally:
        end()


@contextlib.contextmanager
def as_a_controller() -> Iterator[str]:
    """Give this thread the scheduling of a robot controller or a session; yield its name. Programs
    started meanwhile inherit it."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield ask_for_real_time()
    finally:
        os.sched_setscheduler(0, *before)


def cpu_s(pid: int) -> float:
    """CPU time used by a process and all its threads, s."""
    with open(f"/proc/{pid}/stat", encoding="ascii") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_bytes(pid: int) -> int:
    """Resident memory of a process."""
    with open(f"/proc/{pid}/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")


def quantile(values: Sequence[float], share: float) -> float:
    """Return a quantile of unsorted values."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]
