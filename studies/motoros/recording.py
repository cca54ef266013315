"""A session that drives a simulated GP8's first axis from a simulated SpaceMouse, recorded.

Mouse and controller are separate processes, connected by a Unix socket and by TCP; the session is a
``cardan run``. The mouse's reports are recorded on its socket, the goal when the session passes it
to the driver, the command and the joint in each interpolation period by the controller. All times
are of this machine's monotonic clock.
"""

from __future__ import annotations

import contextlib
import csv
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from cardan.common.arm_libraries import np, npt
from cardan.demos.examples import free_ports
from cardan.drivers import registry
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import Session, make_session
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.protocols.connexion.reports import MotionReport, Translation, decode_input
from cardan.types import JointCommand

Array = npt.NDArray[np.float64]

MODES = ("standard", "stream", "velocity")
TWO_POINT = "studies.motoros.two_point:TwoPointMotoros"
PLANTS = ("paper", "ideal")
LAGS_S = {"standard": 1.2, "stream": 0.4, "velocity": 0.4}
"""Largest normal lag in each mode."""

MODEL = "spacemouse-pro"
DEFLECTION = 0.8
"""Deflection of the puck in a push."""
JOINT = "joint_1_s"
JOINT_SPEED_RAD_S = 0.4
FIRST_PUSH_S = 5.0
"""Time of the first push; enabling the drives and starting the job take 1.5 s from the session's
start."""
RAMP_S, HOLD_S, REST_S = 0.15, 1.6, 1.9
PUSH_S = 2.0 * RAMP_S + HOLD_S + REST_S
TAIL_S = 0.5
GRID_S = 0.004
LARGEST_REPORT = 64


def hand_script(pushes: int) -> str:
    """Return a script: touch, release, grip, then push forward and backward in turn."""
    lines = ["1.0 axes 0.3 0 0 0 0 0", "1.2 neutral", f"{FIRST_PUSH_S - 0.8} press ctrl"]
    for push in range(pushes):
        start_s = FIRST_PUSH_S + push * PUSH_S
        deflection = DEFLECTION if push % 2 == 0 else -DEFLECTION
        lines.append(f"{start_s:.3f} axes {deflection} 0 0 0 0 0 over {RAMP_S}")
        lines.append(f"{start_s + RAMP_S + HOLD_S:.3f} axes 0 0 0 0 0 0 over {RAMP_S}")
    return "\n".join(lines) + "\n"


class Recording(NamedTuple):
    """A run, resampled at GRID_S; joint 1 in rad."""

    mode: str
    plant: str
    times_s: Array
    device: Array
    """Motion requested by the mouse so far: its integrated deflection times the joint's speed."""
    goal: Array
    """Goal given to the driver by the session."""
    command: Array
    """Position that the controller commanded its drives."""
    measured: Array
    """Position of the joint."""
    pushes: Array
    """Start of each push as received from the mouse, s."""
    snapshot: Snapshot
    """Last snapshot of the session."""


class _Tap:
    """Records the reports of a simulated mouse as another of its clients."""

    def __init__(self, path: Path) -> None:
        self.reports: list[tuple[float, float]] = []
        """Arrival times, and deflections along x, -1..1."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.connect(str(path))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            while report := self._socket.recv(LARGEST_REPORT):
                now_s = time.monotonic()
                found = decode_input(report)
                if isinstance(found, (MotionReport, Translation)):
                    # Counts are positive towards the operator; 350 is full deflection.
                    self.reports.append((now_s, -found.y / 350.0))

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(1.0)
        self._socket.close()


@contextlib.contextmanager
def peers(
    directory: Path, script: str, *controller: str, velocity_mode: bool = True
) -> Iterator[tuple[Path, int, Path]]:
    """Run a mouse and a controller; yield the mouse's socket, the motion port and the log."""
    mouse, log = directory / "mouse.sock", directory / "controller.csv"
    hand = directory / "hand.txt"
    hand.write_text(script)
    port = free_ports(3)
    options = [*controller, "--base-port", str(port), "--log", str(log)]
    if not velocity_mode:
        options.append("--no-velocity-mode")
    with (
        cardan_subprocess("sim", "motoman-gp8", *options),
        cardan_subprocess(
            "sim", "spacemouse", "--hid", str(mouse), "--model", MODEL, "--script", str(hand)
        ),
    ):
        yield mouse, port, log


def session_tables(mouse: Path, port: int, mode: str, **robot: Any) -> dict[str, Any]:
    """Return a configuration in which the mouse's x axis drives the first joint."""
    return {
        "device": {"driver": "spacemouse", "transport": "socket", "path": str(mouse)},
        "robot": {
            "driver": "motoros",
            "motion_port": port,
            "state_port": port + 1,
            "io_port": port + 2,
            "mode": "stream" if mode == "standard" else mode,
            "enable": "at-start",
            **robot,
        },
        "arm": {"model": "gp8"},
        "mapping": {
            "deadman": "ctrl",
            "axes": ["fixed"] * 6,
            "joints": {"x": JOINT},
            "joint_speed_rad_s": JOINT_SPEED_RAD_S,
        },
        # The first joint moves the TCP on a radius of 0.7 m; the standard mode lags far behind.
        "limits": {"max_lead_m": 0.3, "max_lead_rad": 0.6, "linear_speed_m_s": 0.5},
        "watchdogs": {"following_error_m": 0.4, "following_error_rad": 0.8},
    }


def record(mode: str, plant: str, pushes: int = 6) -> Recording:
    """Run one session and resample everything at GRID_S. Raises ValueError if a busy machine did
    not run all of it."""
    goals: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory(prefix="cardan-") as name:
        directory = Path(name)
        with peers(
            directory,
            hand_script(pushes),
            "--plant",
            plant,
            velocity_mode=mode == "velocity",
        ) as (mouse, port, log):
            session = session_in(mode, session_tables(mouse, port, mode, lag_s=LAGS_S[mode]))
            watch_goals(session, goals)
            tap = _Tap(mouse)
            try:
                session.run(FIRST_PUSH_S + pushes * PUSH_S + TAIL_S)
            finally:
                tap.close()
        rows = read_log(log)
    return _on_a_grid(mode, plant, session.snapshot, tap.reports, goals, rows, pushes)


def session_in(mode: str, tables: dict[str, Any]) -> Session:
    """Return a session whose driver moves the robot by two-point trajectories in the mode
    "standard", which no driver of Cardan offers."""
    with patch.dict(registry.BUILT_IN, {"motoros": TWO_POINT} if mode == "standard" else {}):
        return make_session(parse_config(tables))


def watch_goals(session: Session, goals: list[tuple[float, float]]) -> None:
    """Record the goals of joint 1 with their times."""
    send = session.robot.send

    def noted(command: Any) -> None:
        if isinstance(command, JointCommand):
            goals.append((time.monotonic(), command.positions[0]))
        send(command)

    session.robot.send = noted  # type: ignore[method-assign]


def read_log(path: Path) -> dict[str, Array]:
    """Return the controller's log by column, without text columns."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    names, values = rows[0], rows[1:]
    found: dict[str, Array] = {}
    for column, name in enumerate(names):
        with contextlib.suppress(ValueError):
            found[name] = np.array([float(row[column] or "nan") for row in values])
    return found


def _on_a_grid(
    mode: str,
    plant: str,
    snapshot: Snapshot,
    reports: list[tuple[float, float]],
    goals: list[tuple[float, float]],
    rows: dict[str, Array],
    pushes: int,
) -> Recording:
    if not goals or not reports or not len(rows["monotonic_s"]):
        raise ValueError("the session, the mouse or the controller said nothing")
    goal_s, goal = np.array(goals).T
    device_s, deflection = np.array(reports).T
    logged_s = rows["monotonic_s"]
    begin_s, end_s = max(goal_s[0], logged_s[0]), min(goal_s[-1], logged_s[-1])
    times_s = np.arange(begin_s, end_s, GRID_S)
    # A mouse repeats itself while deflected and is silent at rest: the last report holds.
    held = deflection[np.clip(np.searchsorted(device_s, times_s, "right") - 1, 0, None)]
    held[times_s < device_s[0]] = 0.0
    away = np.abs(deflection) > 0.02
    starts = device_s[1:][away[1:] & ~away[:-1]]
    starts = starts[starts > begin_s + 1.0]
    if len(starts) < pushes:
        raise ValueError(f"{len(starts)} pushes were seen, of {pushes}")
    return Recording(
        mode,
        plant,
        times_s,
        np.cumsum(held) * GRID_S * JOINT_SPEED_RAD_S,
        np.interp(times_s, goal_s, goal),
        np.interp(times_s, logged_s, rows[f"command_{JOINT}"]),
        np.interp(times_s, logged_s, rows[f"measured_{JOINT}"]),
        starts,
        snapshot,
    )
