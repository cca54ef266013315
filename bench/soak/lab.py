"""The lab of the soak: a daemon, four arms and three devices, each a separate process."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, Final

ARMS: Final = ("gofa", "gp8", "ur5-a", "ur5-b")

VETERAN: Final = "ur5-b"
"""Session whose process is never killed, to reveal slow growth."""

SOURCES: Final = frozenset({"device", "verbs", "alice", "bob", "ros2", "daemon"})

DEVICES_OF: Final = {"mouse": ("gofa", "gp8"), "pad": ("ur5-a",), "remote": ("ur5-b",)}
"""Arms that each device can drive."""

SILENCE_NOTICED: Final = frozenset({"mouse", "remote"})
"""Devices that report all the time while they are deflected. A gamepad sends changes only, so that
its silence means nothing while it is stopped."""

MARK: Final = "CARDAN_SOAK"
"""The environment variable that all processes of a soak have."""

LOG_BYTES: Final = 5_000_000
"""Size limit of a process's log; the file is then renamed to .1 and restarted."""

MAX_LINE_CHARACTERS: Final = 4000

LAYOUT: Final = """
[daemon]
socket = "{folder}/cardan.sock"
event_log = "{folder}/events"

[devices.mouse]
driver = "spacemouse"
transport = "socket"
path = "{folder}/mouse.sock"

[[sessions]]
name = "gofa"
device = "mouse"
[sessions.robot]
driver = "abb_egm"
mode = "joint"
listen_port = {egm}
robot = "gofa_crb15000_5"
[sessions.arm]
model = "gofa_crb15000_5"
policy = "path"
[sessions.mapping]
deadman = "left"
linear_speed_m_s = {speed}
angular_speed_rad_s = 0.4
[sessions.limits]
workspace_x_m = [0.25, 0.75]
workspace_y_m = [-0.40, 0.40]
workspace_z_m = [0.10, 0.90]
[sessions.network]
namespace = "gofa"
router = "{router}"

[[sessions]]
name = "gp8"
device = "mouse"
[sessions.robot]
driver = "motoros"
robot = "gp8"
mode = "velocity"
enable = "at-start"
motion_port = {motion}
state_port = {state}
io_port = {io}
[sessions.arm]
model = "gp8"
policy = "path"
[sessions.mapping]
deadman = "left"
enable = "right"
linear_speed_m_s = 0.1
angular_speed_rad_s = 0.4
[sessions.network]
namespace = "gp8"
router = "{router}"

[[sessions]]
name = "ur5-a"
[sessions.device]
driver = "gamepad"
transport = "socket"
path = "{folder}/pad.sock"
[sessions.robot]
driver = "sim_arm"
robot = "ur5"
transport = "udp"
endpoint = "127.0.0.1:{ur5_a}"
[sessions.arm]
model = "ur5"
policy = "path"
[sessions.mapping]
deadman = "left-shoulder"
linear_speed_m_s = {speed}
angular_speed_rad_s = 0.4
[sessions.network]
namespace = "ur5_a"
router = "{router}"

[[sessions]]
name = "ur5-b"
[sessions.device]
driver = "wiimote"
transport = "socket"
path = "{folder}/remote"
roles = "paper"
[sessions.robot]
driver = "sim_arm"
robot = "ur5"
transport = "udp"
endpoint = "127.0.0.1:{ur5_b}"
[sessions.arm]
model = "ur5"
policy = "path"
[sessions.mapping]
frame = "tool"
deadman = ["a", "b"]
linear_speed_m_s = 0.03
angular_speed_rad_s = 0.3
[sessions.network]
namespace = "ur5_b"
router = "{router}"

[servers.rosbridge]
port = {rosbridge}
router = "{router}"

[servers.metrics]
port = {metrics}
"""

SPEEDS_M_S: Final = (0.08, 0.1)
"""Linear speed limits; a reload switches between them."""


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port of loopback that is not in use now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def free_ports(count: int) -> list[int]:
    """Return consecutive ports that are not in use now."""
    while True:
        first = random.randrange(20000, 30000)
        try:
            for port in range(first, first + count):
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return list(range(first, first + count))


class LabProcess:
    """A process of the soak. Its output goes to a file of limited size and to `line`."""

    def __init__(
        self,
        words: list[str],
        log: Path,
        environment: dict[str, str],
        line: Callable[[str], None] = lambda _line: None,
    ) -> None:
        self.words, self.log, self.environment, self.line = words, log, environment, line
        self.ready = threading.Event()
        self.process: subprocess.Popen[bytes] | None = None
        self._writing = threading.Lock()

    def start(self) -> None:
        """Start it if it is not running."""
        if self.process is not None and self.process.poll() is None:
            return
        self.ready.clear()
        self.process = process = subprocess.Popen(
            self.words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=self.environment,
            start_new_session=True,
        )
        for stream in (process.stdout, process.stderr):
            assert stream is not None
            threading.Thread(target=self._read, args=(stream,), daemon=True).start()

    def _read(self, stream: IO[bytes]) -> None:
        with stream:
            for data in stream:
                text = data.decode(errors="backslashreplace").rstrip()
                if text.startswith("READY "):
                    self.ready.set()
                if text.startswith("J "):
                    self.line(text)
                else:
                    self._keep(text[:MAX_LINE_CHARACTERS])

    def _keep(self, text: str) -> None:
        with self._writing:
            with contextlib.suppress(OSError):
                if self.log.exists() and self.log.stat().st_size > LOG_BYTES:
                    os.replace(self.log, self.log.with_suffix(".1"))
            with self.log.open("a") as file:
                file.write(f"{time.time():.3f} {text}\n")

    @property
    def pid(self) -> int | None:
        """Its process id while it is running."""
        running = self.process is not None and self.process.poll() is None
        return self.process.pid if running and self.process else None

    def send(self, number: int) -> None:
        """Send it a signal if it is running."""
        if self.pid is not None and self.process is not None:
            self.process.send_signal(number)

    def play(self, steps: list[list[Any]]) -> bool:
        """Make a device perform these steps from now on; return whether it is running."""
        script = {"at_s": time.monotonic(), "steps": steps}
        if self.pid is None or self.process is None or self.process.stdin is None:
            return False
        try:
            self.process.stdin.write(json.dumps(script).encode() + b"\n")
            self.process.stdin.flush()
        except (OSError, ValueError):
            return False
        return True

    def end(self, number: int | None = signal.SIGTERM, within_s: float = 30.0) -> bool:
        """End it by a signal or the end of its input, then by SIGKILL; return whether it ended by
        itself."""
        process = self.process
        if process is None:
            return True
        by_itself = True
        if process.poll() is None:
            if number is not None:
                process.send_signal(number)
            elif process.stdin is not None:
                with contextlib.suppress(OSError):
                    process.stdin.close()
            process.send_signal(signal.SIGCONT)
            try:
                process.wait(within_s)
            except subprocess.TimeoutExpired:
                by_itself = False
                process.kill()
        process.wait()
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()
        return by_itself


class Lab:
    """All processes of a soak, in a folder of the run."""

    def __init__(self, folder: Path, token: str, measured: Callable[[str, str], None]) -> None:
        """`measured(arm, line)` receives the robots' lines."""
        self.folder = folder
        for each in ("logs", "tmp", "run", "state", "remote"):
            (folder / each).mkdir(parents=True, exist_ok=True)
        os.chmod(folder / "run", 0o700)
        motion, state, io = free_ports(3)
        udp = socket.SOCK_DGRAM
        self.ports = {
            "egm": free_port(udp), "ur5_a": free_port(udp), "ur5_b": free_port(udp),
            "motion": motion, "state": state, "io": io,
            "rosbridge": free_port(), "metrics": free_port(), "bus": free_port(),
        }  # fmt: skip
        self.environment = {
            **os.environ,
            MARK: token,
            "TMPDIR": str(folder / "tmp"),
            "XDG_RUNTIME_DIR": str(folder / "run"),
            "XDG_STATE_HOME": str(folder / "state"),
            "PYTHONPATH": os.environ.get("PYTHONPATH", str(Path(__file__).parents[2])),
        }
        self.file = folder / "lab.toml"
        self.socket = str(folder / "cardan.sock")
        self.speed = 0
        self.write()
        p = self.ports
        robots: dict[str, tuple[str, dict[str, Any]]] = {
            "gofa": ("gofa", {"pc_port": p["egm"], "comm_timeout_s": 0.2}),
            "gp8": ("gp8", {"base_port": motion, "servo_on": True}),
            "ur5-a": ("ur5", {"port": p["ur5_a"], "period_s": 0.008}),
            "ur5-b": ("ur5", {"port": p["ur5_b"], "period_s": 0.008}),
        }
        devices: dict[str, tuple[str, dict[str, Any]]] = {
            "mouse": ("spacemouse", {"hid": f"{folder}/mouse.sock"}),
            "pad": ("gamepad", {"path": f"{folder}/pad.sock"}),
            "remote": ("wiimote", {"l2cap": f"{folder}/remote"}),
        }
        self.robots = {
            arm: self._peer(f"robot-{arm}", *each, functools.partial(measured, arm))
            for arm, each in robots.items()
        }
        self.devices = {
            name: self._peer(f"device-{name}", *each, lambda _line: None)
            for name, each in devices.items()
        }
        self.daemon = LabProcess(
            [sys.executable, "-m", "cardan", "daemon", "run", str(self.file),
             "--log-level", "warning", "--log-format", "text"],
            folder / "logs" / "daemon.log",
            self.environment,
        )  # fmt: skip

    def _peer(
        self, name: str, kind: str, options: dict[str, Any], line: Callable[[str], None]
    ) -> LabProcess:
        words = [sys.executable, "-m", "bench.soak.peers", kind, json.dumps(options)]
        return LabProcess(words, self.folder / "logs" / f"{name}.log", self.environment, line)

    def write(self) -> None:
        """Write the daemon's configuration file."""
        text = LAYOUT.format(
            folder=self.folder,
            router=f"tcp/127.0.0.1:{self.ports['bus']}",
            speed=SPEEDS_M_S[self.speed],
            **self.ports,
        )
        self.file.write_text(text)

    @property
    def peers(self) -> dict[str, LabProcess]:
        """Robots and devices by their names in the report."""
        return {
            **{f"robot {name}": each for name, each in self.robots.items()},
            **{f"device {name}": each for name, each in self.devices.items()},
        }

    def start(self) -> None:
        """Start all; return once the daemon accepts requests. Raises TimeoutError."""
        for each in self.peers.values():
            each.start()
        self.daemon.start()
        if not self.daemon.ready.wait(60.0):
            raise TimeoutError(f"the daemon does not serve: see {self.daemon.log}")

    def end(self) -> list[str]:
        """End all; return the processes that did not end by themselves."""
        stubborn = []
        if not self.daemon.end():
            stubborn.append("the daemon had to be killed")
        for name, each in self.peers.items():
            if not each.end(None):
                stubborn.append(f"{name} had to be killed")
        return stubborn
