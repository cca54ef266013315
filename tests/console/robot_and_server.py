"""A simulated GoFa over EGM, a session that moves it, and the console's server, each in a process
or thread of its own; and what the TCP does, by the controller's true joints."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.robots import load_arm
from cardan.sim_peers.egm_controller import EgmControllerOptions, EgmControllerPeer, EgmMode
from tests.serving import free_endpoint, free_udp_port

MODEL = "gofa_crb15000_5"
ARM = "/left/arm"

COMM_TIMEOUT_S = 0.2
"""EGM's, as docs/abb-egm.md sets it."""

SAMPLE_S = 0.004
WINDOW_S = 0.06
"""Speeds are means over this time, many periods of the controller."""
HISTORY_S = 30.0

STANDS_M_S = 0.001
RESTS_S = 0.25
HEARD = 60
PAUSE_S = 0.05
"""An arm that stands for RESTS_S, and while so many commands reach its controller, of 250 each
second, without such a pause, rests: one also stands while the computer does, or keeps the session
or the controller from its work, and what has waited then comes all at once."""

SESSION = """
[robot]
driver = "abb_egm"
mode = "joint"
listen_port = {port}
robot = "{model}"

[arm]
model = "{model}"

[network]
name = "arm"
namespace = "left"
router = ""
listen = ["{endpoint}"]
"""

STILL_M = 0.0005
"""Nearer to where it rests in the end the arm counts as at rest: a controller's own position loop
takes up the last tenths of a millimeter for half a second more."""


class Stop(NamedTuple):
    """Motion of an arm after an event."""

    speed_m_s: float
    """Speed at the event."""
    time_s: float
    """Until it moved for the last time."""
    distance_m: float
    again_m: float
    """Motion after the arm had come to rest."""


class TcpWatch(threading.Thread):
    """Samples where the TCP of a controller is."""

    def __init__(self, peer: EgmControllerPeer) -> None:
        super().__init__(daemon=True)
        self._peer = peer
        self._kinematics = ArmKinematics(load_arm(MODEL))
        self._lock = threading.Lock()
        self._times: list[float] = []
        self._points: list[npt.NDArray[np.float64]] = []
        self._commands: list[int] = []
        """How many had reached the controller."""
        self._ended = threading.Event()

    def run(self) -> None:
        while not self._ended.wait(SAMPLE_S):
            joints = np.array(self._peer.core.joints_rad)
            point = self._kinematics.forward(joints).translation.copy()
            commands = self._peer.core.counters.accepted
            with self._lock:
                self._times.append(time.monotonic())
                self._points.append(point)
                self._commands.append(commands)
                if self._times[0] < self._times[-1] - HISTORY_S:
                    half = len(self._times) // 2
                    del self._times[:half], self._points[:half], self._commands[:half]

    def end(self) -> None:
        """Sample no more."""
        self._ended.set()
        self.join()

    def since(self, at_s: float) -> tuple[list[float], list[npt.NDArray[np.float64]]]:
        """Times and places from then on."""
        with self._lock:
            first = int(np.searchsorted(self._times, at_s))
            return self._times[first:], self._points[first:]

    @property
    def here(self) -> npt.NDArray[np.float64]:
        """Where it is, m, along the base's axes."""
        with self._lock:
            return self._points[-1]

    def speed(self, window_s: float = WINDOW_S) -> float:
        """Mean over the last time, m/s."""
        times, points = self.since(time.monotonic() - window_s)
        if len(times) < 2 or times[-1] - times[0] < 0.5 * window_s:
            return 0.0
        return float(np.linalg.norm(points[-1] - points[0])) / (times[-1] - times[0])

    @property
    def moving(self) -> bool:
        return self.speed() > STANDS_M_S

    def stop_since(self, at_s: float) -> Stop:
        """Return the motion from `at_s` until now."""
        with self._lock:
            began = int(np.searchsorted(self._times, at_s - WINDOW_S))
            # On a busy computer nothing may have been seen for so long.
            began = max(0, min(began, int(np.searchsorted(self._times, at_s)) - 1))
            times, points = self._times[began:], self._points[began:]
            commands = self._commands[began:]
        at = int(np.searchsorted(times, at_s))
        had = float(np.linalg.norm(points[at] - points[0])) / (times[at] - times[0])
        rests = points[-1]
        away = [float(np.linalg.norm(each - rests)) for each in points[at:]]
        moved = [when for when, far in zip(times[at:], away, strict=True) if far > STILL_M]
        return Stop(
            had,
            moved[-1] - at_s if moved else 0.0,
            away[0],
            _again(times[at:], away, commands[at:]),
        )


def _again(times: list[float], away: list[float], commands: list[int]) -> float:
    """How far from its last place the arm was when it first rested."""
    first = steady = heard = 0
    for last, when in enumerate(times):
        if when - times[heard] > PAUSE_S:
            steady = last
        if commands[last] > commands[heard]:
            heard = last

        def lasted(since: int, last: int = last, when: float = when) -> bool:
            came = commands[last] - commands[since]
            return times[since] <= when - RESTS_S and came >= HEARD

        while first < last and lasted(first + 1):
            first += 1
        stood = abs(away[last] - away[first]) < STANDS_M_S * RESTS_S
        if first >= steady and lasted(first) and stood:
            return away[last]
    return away[-1]


class RobotAndSession(NamedTuple):
    """Running robot and its session."""

    peer: EgmControllerPeer
    tcp: TcpWatch
    endpoint: str
    """Of the bus."""


@contextlib.contextmanager
def robot_and_session(folder: Path, more: str = "") -> Iterator[RobotAndSession]:
    """The robot, and the session of it, with `more` in its file."""
    endpoint, port = free_endpoint(), free_udp_port()
    path = folder / "session.toml"
    path.write_text(SESSION.format(port=port, model=MODEL, endpoint=endpoint) + more)
    options = EgmControllerOptions(
        pc_port=port, mode=EgmMode("joint"), comm_timeout_s=COMM_TIMEOUT_S
    )
    command = [sys.executable, "-m", "cardan", "run", str(path), "--seconds", "3000"]
    with EgmControllerPeer(options) as peer:
        tcp = TcpWatch(peer)
        tcp.start()
        session = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            yield RobotAndSession(peer, tcp, endpoint)
        finally:
            session.terminate()
            session.wait()
            tcp.end()


class ServerProcess(NamedTuple):
    """``cardan net server console`` that serves."""

    address: str
    """Of the page, with its token."""
    process: int

    @property
    def port(self) -> int:
        return int(self.address.split("/")[2].rsplit(":", 1)[1])

    def stand_still(self, seconds: float) -> None:
        """Stop its process for that time."""
        os.kill(self.process, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            os.kill(self.process, signal.SIGCONT)


@contextlib.contextmanager
def console_server(
    endpoint: str, words: Sequence[str] = (), environment: dict[str, str] | None = None
) -> Iterator[ServerProcess]:
    """The console's server on that bus."""
    command = [sys.executable, "-m", "cardan", "net", "server", "console", "--router", endpoint]
    with subprocess.Popen(
        [*command, "--port", "0", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, **(environment or {})},
    ) as process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith("READY "):
                    yield ServerProcess(line.split()[1], process.pid)
                    return
            raise AssertionError(f"cardan net server console ended with {process.wait()}")
        finally:
            process.terminate()
