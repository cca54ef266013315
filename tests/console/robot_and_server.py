"""A simulated GoFa over EGM, a session that moves it, and the console server, each in a separate
process or thread; and the motion of the TCP, by the controller's true joints."""

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
"""Period of EGM, as in docs/abb-egm.md."""

SAMPLE_S = 0.004
WINDOW_S = 0.06
"""Speeds are means over this time, which is many periods of the controller."""
HISTORY_S = 30.0

STANDS_M_S = 0.001
RESTS_S = 0.25
HEARD = 60
PAUSE_S = 0.05
"""An arm is at rest if it stands still for RESTS_S while its controller receives HEARD commands, of
250 each second, without a gap of PAUSE_S. Standing still alone is no proof: the computer may have
paused, or kept the session or controller from running, and delayed commands then arrive all at
once."""

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
"""An arm this close to its final place counts as at rest: a controller's position loop closes the
last tenths of a millimeter over another half second."""


class Stop(NamedTuple):
    """Motion of an arm after an event."""

    speed_m_s: float
    """Speed at the event."""
    time_s: float
    """Time until the last motion."""
    distance_m: float
    again_m: float
    """Motion after the arm had come to rest."""


class TcpWatch(threading.Thread):
    """Records the places of a controller's TCP."""

    def __init__(self, peer: EgmControllerPeer) -> None:
        super().__init__(daemon=True)
        self._peer = peer
        self._kinematics = ArmKinematics(load_arm(MODEL))
        self._lock = threading.Lock()
        self._times: list[float] = []
        self._points: list[npt.NDArray[np.float64]] = []
        self._commands: list[int] = []
        """Number of commands that had reached the controller."""
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
        """Stop recording."""
        self._ended.set()
        self.join()

    def since(self, at_s: float) -> tuple[list[float], list[npt.NDArray[np.float64]]]:
        """Times and places from this time on."""
        with self._lock:
            first = int(np.searchsorted(self._times, at_s))
            return self._times[first:], self._points[first:]

    @property
    def here(self) -> npt.NDArray[np.float64]:
        """Newest place in the base frame, m."""
        with self._lock:
            return self._points[-1]

    def speed(self, window_s: float = WINDOW_S) -> float:
        """Mean speed over the last `window_s`, m/s."""
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
            # On a busy computer there may be no sample within that time.
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
    """Distance between the arm's first and last place of rest."""
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
    """A running robot and its session."""

    peer: EgmControllerPeer
    tcp: TcpWatch
    endpoint: str
    """Endpoint of the network."""


@contextlib.contextmanager
def robot_and_session(folder: Path, more: str = "") -> Iterator[RobotAndSession]:
    """The robot and its session, with `more` in the session's file."""
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
    """A running ``cardan net server console``."""

    address: str
    """Address of the page, with its token."""
    process: int

    @property
    def port(self) -> int:
        return int(self.address.split("/")[2].rsplit(":", 1)[1])

    def stand_still(self, seconds: float) -> None:
        """Stop the server's process for that time."""
        os.kill(self.process, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            os.kill(self.process, signal.SIGCONT)


@contextlib.contextmanager
def console_server(
    endpoint: str, words: Sequence[str] = (), environment: dict[str, str] | None = None
) -> Iterator[ServerProcess]:
    """The console server on that network."""
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
