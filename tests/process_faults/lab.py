"""A robot, a device and the daemon that connects them, each in a separate process, and the recorded
motion of the arm."""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cardan.common.realtime import FIFO_PRIORITY
from cardan.errors import CardanError
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.recording.mcap_file import RecordReader
from cardan.robots import load_arm
from cardan.types import NEVER_S
from tests.gateway.daemon.event_files import read_events
from tests.process_faults.peers import SAMPLE
from tests.serving import free_tcp_port, free_udp_port
from tests.test_cli import ENVIRONMENT

SPEED_M_S = 0.1
"""Speed that the device requests, the same as in the table of virtual time."""
AT_SPEED = 0.85
"""Fraction of this speed that counts as reaching it."""
STEADY_S = 0.25

WINDOW_S = 0.06
"""Speeds are means over this time, which is many periods of every controller."""
REST_M_S = 0.001
REST_S = 0.3
"""An arm slower than REST_M_S for this time is at rest."""
AGAIN_M_S = 0.02
"""An arm faster than this after its rest was moved again."""
ROOM_M = 0.12
"""The device reverses when the arm is this far from where its robot began."""

READY_S = 120.0
"""Longest wait for any start, on a computer with other work."""
STROKE_S = 1.6
"""Longest time from re-arming to a steady speed; after it the operator tries again."""
SWING_S = 1.2
"""Time between reversals when the device moves the arm to and fro."""
PAUSE_S = 0.3
"""Time for which the device is at rest before and after the release of its dead-man's switch."""


class Pair(NamedTuple):
    """A device and a robot."""

    name: str
    arm: str
    """Model of the arm, which gives the place of the TCP."""
    robot: str
    """Key in `peers.ROBOTS`."""
    hand: str
    """Key in `peers.PEERS`."""
    configured: Callable[[Lab], dict[str, Any]]
    """Function that returns the tables of the session's configuration."""
    push: tuple[str, str]
    """Steps of the device that move the arm to one side and to the other, with the dead-man's
    switch."""
    rest: str
    """Steps that release all axes and buttons."""
    touch: str
    """Steps that make the driver detect the device and the robot turn its drives on, and that
    release all again."""
    dies_s: float
    """Longest time until an arm without commands is at rest: watchdog and braking of its
    controller. See docs/faults.md, a killed session."""
    brakes_s: float
    """Longest time from the session's start of braking until the arm is at rest."""


def _network(lab: Lab) -> dict[str, Any]:
    return {"router": lab.router, "name": "arm"}


PAIRS: dict[str, Pair] = {
    each.name: each
    for each in (
        Pair(
            "SpaceMouse, GoFa (EGM pose)", "gofa_crb15000_5", "gofa-pose", "spacemouse",
            lambda lab: {
                "device": {"driver": "spacemouse", "transport": "socket", "path": lab.place},
                "robot": {"driver": "abb_egm", "listen_port": lab.port, "robot": lab.pair.arm},
                "mapping": {"deadman": "left", "linear_speed_m_s": SPEED_M_S},
                "network": _network(lab),
            },
            ("press left; axes -1 0 0 0 0 0", "press left; axes 1 0 0 0 0 0"),
            "release left; neutral", "axes 0 0 0.3 0 0 0", 0.72, 0.52,
        ),
        Pair(
            "gamepad, GP8 (MotoROS)", "gp8", "gp8", "gamepad",
            lambda lab: {
                "device": {"driver": "gamepad", "transport": "socket", "path": lab.place},
                "robot": {
                    "driver": "motoros", "mode": "velocity", "robot": "gp8", "enable": "at-start",
                    "motion_port": lab.port, "state_port": lab.port + 1, "io_port": lab.port + 2,
                },
                "arm": {"model": "gp8"},
                "mapping": {
                    "deadman": "left-shoulder", "enable": "start", "linear_speed_m_s": SPEED_M_S
                },
            },
            ("press left-shoulder; sticks -1 0 0 0", "press left-shoulder; sticks 1 0 0 0"),
            "release left-shoulder; release start; neutral", "press start", 0.15, 0.2,
        ),
        Pair(
            "Wii Remote, UR5 (joint stream)", "ur5", "ur5", "wiimote",
            lambda lab: {
                "device": {
                    "driver": "wiimote", "transport": "socket", "path": lab.place, "roles": "paper"
                },
                "robot": {
                    "driver": "sim_arm", "robot": "ur5", "transport": "udp",
                    "endpoint": f"127.0.0.1:{lab.port}",
                },
                "arm": {"model": "ur5"},
                "mapping": {
                    "deadman": ["a", "b"], "linear_speed_m_s": SPEED_M_S,
                    "axes": ["x", "-z", "y", "fixed", "fixed", "fixed"],
                },
            },
            ("release b; press a", "release a; press b"), "release a; release b; level", "level",
            0.26, 0.3,
        ),
        Pair(
            "ROS 2 spacenav, UR5 (ROS 2)", "ur5", "ros2-ur5", "ros2-device",
            lambda lab: {
                "device": {"driver": "ros2_spacenav", "port": int(lab.place)},
                "robot": {"driver": "ros2", "robot": "ur5", "port": lab.port},
                "arm": {"model": "ur5"},
                "mapping": {"deadman": "button-0", "linear_speed_m_s": SPEED_M_S / 0.68},
                "limits": {"linear_speed_m_s": SPEED_M_S},
            },
            ("press button-0; axes 0 -1 0 0 0 0", "press button-0; axes 0 1 0 0 0 0"),
            "release button-0; neutral", "axes 0 0 0.3 0 0 0", 0.26, 0.4,
        ),
        Pair(
            "spacenavd, GoFa (EGM joint)", "gofa_crb15000_5", "gofa-joint", "spacemouse",
            lambda lab: {
                "device": {"driver": "spnav", "socket": str(lab.folder / "spnav.sock")},
                "robot": {
                    "driver": "abb_egm", "mode": "joint", "listen_port": lab.port,
                    "robot": lab.pair.arm,
                },
                "arm": {"model": lab.pair.arm},
                "mapping": {"deadman": "button-0", "linear_speed_m_s": SPEED_M_S},
            },
            ("press left; axes -1 0 0 0 0 0", "press left; axes 1 0 0 0 0 0"),
            "release left; neutral", "axes 0 0 0.3 0 0 0", 0.72, 0.52,
        ),
    )
}  # fmt: skip
"""The five pairs of the table."""

GOFA, GP8, UR5, ROS2, SPNAV = PAIRS


def toml(tables: Mapping[str, Any]) -> str:
    """Write inline tables in TOML."""
    pairs = ", ".join(f"{key} = {_value(value)}" for key, value in tables.items())
    return f"{{ {pairs} }}"


def _value(value: Any) -> str:
    return toml(value) if isinstance(value, Mapping) else json.dumps(value)


class Motion(NamedTuple):
    """Motion of the arm from a fault on."""

    had_m_s: float
    """Speed at the fault."""
    stop_s: float | None
    """Time until the arm was at rest; None: it kept moving."""
    distance_m: float
    """Distance from the place at the fault to the place of rest, or the last place."""
    peak_m_s: float
    again_m_s: float
    """Highest speed after the arm had come to rest, without a new action of the operator."""

    @property
    def again(self) -> bool:
        """True if the arm was moved again."""
        return self.again_m_s > AGAIN_M_S


class Trace:
    """Recorded places of a robot's TCP."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.points: list[Any] = []
        self.begins: list[int] = []
        """Index of the first sample of each of the robot's processes."""

    def begin(self) -> None:
        """Note that a new process of the robot begins."""
        self.begins.append(len(self.times))

    def add(self, time_s: float, point: Any) -> None:
        """Add a place of the TCP."""
        self.times.append(time_s)
        self.points.append(point)

    def read(self) -> None:
        """Read the new samples."""

    def speeds(self, since_s: float, until_s: float) -> list[tuple[float, float]]:
        """For each sample of a time span, its time and the mean speed over WINDOW_S before it."""
        found = []
        first = int(np.searchsorted(self.times, since_s - 2 * WINDOW_S))
        last = int(np.searchsorted(self.times, until_s, side="right"))
        begins = set(self.begins)
        back = first
        for index in range(first, last):
            if index in begins:
                back = index  # The jump to the place where a new process begins is not a motion.
            now_s = self.times[index]
            while back + 1 < index and self.times[back + 1] <= now_s - WINDOW_S:
                back += 1
            lasted_s = now_s - self.times[back]
            if now_s >= since_s and lasted_s >= 0.8 * WINDOW_S:
                way = np.linalg.norm(self.points[index] - self.points[back])
                found.append((now_s, float(way) / lasted_s))
        return found

    def speed(self) -> float:
        """Slowest speed within the last STEADY_S; 0 without recent samples."""
        self.read()
        if not self.times:
            return 0.0
        now_s = time.monotonic()
        found = self.speeds(now_s - STEADY_S, now_s)
        if not found or found[-1][0] < now_s - 0.1 or found[0][0] > now_s - 0.5 * STEADY_S:
            return 0.0
        return min(speed for _, speed in found)

    def away(self, axis: int) -> float:
        """Distance along an axis between the TCP and the place where this robot process began."""
        self.read()
        begin = self.begins[-1] if self.begins else 0
        if begin >= len(self.points):
            return 0.0
        return float(self.points[-1][axis] - self.points[begin][axis])

    def motion(self, at_s: float, until_s: float) -> Motion:
        """Return the motion between a fault and the next action of the operator."""
        self.read()
        before = self.speeds(at_s - STEADY_S, at_s)
        found = self.speeds(at_s, until_s)
        here = int(np.searchsorted(self.times, at_s, side="right")) - 1
        last = int(np.searchsorted(self.times, until_s, side="right")) - 1
        ended = [begin for begin in self.begins if here < begin <= last]
        if ended:
            # The robot's process ended: its arm stayed at the last recorded place.
            last = ended[0] - 1
            rest_s: float | None = max(at_s, self.times[last]) + WINDOW_S
        else:
            rest_s = self._rests(found, at_s, until_s)
        again = 0.0
        if rest_s is not None:
            again = max((v for t, v in found if t > rest_s + REST_S), default=0.0)
            last = min(last, int(np.searchsorted(self.times, rest_s, side="right")) - 1)
        return Motion(
            before[-1][1] if before else 0.0,
            None if rest_s is None else max(0.0, rest_s - WINDOW_S - at_s),
            float(np.linalg.norm(self.points[last] - self.points[here])),
            max((v for _, v in found), default=0.0),
            again,
        )

    @staticmethod
    def _rests(found: list[tuple[float, float]], at_s: float, until_s: float) -> float | None:
        """Time at which the arm came to rest. An arm whose process has ended rests at its last
        place."""
        since_s = None if found else at_s + WINDOW_S
        for now_s, speed in found:
            if speed >= REST_M_S:
                if since_s is not None and now_s - WINDOW_S - since_s >= REST_S:
                    return since_s
                since_s = None
            elif since_s is None:
                since_s = now_s
        if found and since_s is None and until_s - found[-1][0] > REST_S + WINDOW_S:
            since_s = found[-1][0]
        return since_s if since_s is not None and until_s - since_s >= REST_S else None


class Noted(Trace):
    """Read the samples that the robot's process writes to a file."""

    def __init__(self, arm: str, file: Path) -> None:
        super().__init__()
        self._kinematics = ArmKinematics(load_arm(arm))
        self._file = file.open("rb")
        self._rest = b""

    def close(self) -> None:
        self._file.close()

    def read(self) -> None:
        data = self._rest + self._file.read()
        whole = len(data) - len(data) % SAMPLE.size
        self._rest = data[whole:]
        for time_s, *joints in SAMPLE.iter_unpack(data[:whole]):
            if time_s != time_s:
                self.begin()
                continue
            self.add(time_s, self._kinematics.forward(np.array(joints)).translation.copy())


class Child:
    """A process of the lab, with the lines of its output."""

    def __init__(self, words: Sequence[str], log: Path, **options: Any) -> None:
        self.log = log
        self._file = log.open("ab")
        self.process = subprocess.Popen(
            [sys.executable, "-m", *words],
            env=ENVIRONMENT,
            stdin=subprocess.PIPE,
            **{"stdout": self._file, "stderr": self._file, **options},
        )
        self.begins = log.stat().st_size

    @property
    def pid(self) -> int:
        return self.process.pid

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def said(self) -> str:
        """Return the output of the running process, without that of earlier ones."""
        with self.log.open("rb") as file:
            file.seek(self.begins)
            return file.read().decode(errors="replace")

    def wait_for(self, words: str, within_s: float = READY_S) -> None:
        """Wait until the process has printed this."""
        wait(lambda: re.search(words, self.said(), re.M) or not self.alive, words, within_s)
        if not re.search(words, self.said(), re.M):
            raise RuntimeError(f"it ended before {words}: {self.said()[-2000:]}")

    def tell(self, line: str) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.write(line.encode() + b"\n")
            self.process.stdin.flush()

    def end(self, number: int = signal.SIGKILL) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(number)
        self.process.wait()
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self._file.close()


def wait(
    found: Callable[[], Any], what: str, within_s: float = READY_S, poll_s: float = 0.02
) -> Any:
    """Return the first true result of `found`."""
    end_s = time.monotonic() + within_s
    while not (answer := found()):
        if time.monotonic() > end_s:
            raise TimeoutError(f"{what}: not within {within_s:g} s")
        threading.Event().wait(poll_s)
    return answer


def children_of(pid: int) -> list[int]:
    """Processes started by this one."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            found += [int(word) for word in (task / "children").read_text().split()]
    return found


def descendants_of(pid: int) -> list[int]:
    """Processes started by this one, and by those."""
    found = []
    with contextlib.suppress(OSError):
        for child in children_of(pid):
            found += [child, *descendants_of(child)]
    return found


def words_of(pid: int) -> str:
    """The command line of a process."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return ""


class Lab:
    """A pair of device and robot, and the daemon or command that connects them."""

    def __init__(self, pair: Pair, *, run: bool = False) -> None:
        """`run`: use ``cardan run`` instead of the daemon."""
        self.pair, self.run = pair, run
        self.record = False
        """Record with ``cardan run``."""
        self.folder = Path(tempfile.mkdtemp(prefix="cardan-faults-"))
        self.port = self._free_port()
        self.place = (
            str(free_tcp_port()) if pair.hand == "ros2-device" else str(self.folder / "device")
        )
        self.router = f"tcp/127.0.0.1:{free_tcp_port()}"
        self.server_port = free_tcp_port()
        self.samples = self.folder / "samples"
        self.samples.touch()
        self.trace = Noted(pair.arm, self.samples)
        self.robot: Child | None = None
        self.hand: Child | None = None
        self.server: Child | None = None
        """``cardan devices spnav``, if the device is read through it."""
        self.daemon: Child | None = None
        self.options: dict[str, Any] = {}
        """Options of the daemon's process."""
        self.reported: list[dict[str, Any]] = []
        """Events that the daemon has reported, over all of its restarts."""
        self.log_of_events = self.folder / "events"
        self.hit_s = NEVER_S
        self.side = 0
        """Index in `push` of the current direction."""
        self._deaths = 0
        self.file_of_record: Path | None = None

    def _free_port(self) -> int:
        if self.pair.robot != "gp8":
            return free_udp_port() if self.pair.robot != "ros2-ur5" else free_tcp_port()
        while True:  # three consecutive ports
            port = free_tcp_port()
            with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
                for each in range(3):
                    sock = stack.enter_context(socket.socket())
                    sock.bind(("127.0.0.1", port + each))
                return port

    def __enter__(self) -> Lab:
        return self

    def __exit__(self, *_error: object) -> None:
        for child in (self.daemon, self.server, self.hand, self.robot):
            if child is not None:
                pids = descendants_of(child.pid) if child.alive else []
                child.end()
                for pid in pids:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
        self.trace.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    # -- processes --------------------------------------------------------------------------------

    @property
    def socket(self) -> str:
        return str(self.folder / "cardan.sock")

    def start_robot(self) -> None:
        words = ("tests.process_faults.peers", "robot", self.pair.robot)
        self.robot = Child((*words, str(self.samples), str(self.port)), self.folder / "robot.log")

    def start_hand(self, held: str = "") -> None:
        """Plug the device in; `held`: steps that are done before the driver can open it."""
        words = ("tests.process_faults.peers", "hand", self.pair.hand, self.place, held)
        self.hand = Child(words, self.folder / "hand.log")

    def start_server(self) -> None:
        file = self.folder / "mouse.toml"
        device = {"driver": "spacemouse", "transport": "socket", "path": self.place}
        robot = {"driver": "sim_arm"}
        file.write_text(f"device = {toml(device)}\nrobot = {toml(robot)}\n")
        words = (
            "cardan",
            "devices",
            "spnav",
            "--socket",
            str(self.folder / "spnav.sock"),
            str(file),
        )
        self.server = Child(words, self.folder / "server.log")
        # like the electronics of a real device, which no other load delays
        with contextlib.suppress(OSError):
            os.sched_setscheduler(self.server.pid, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))

    def write(self, **daemon: Any) -> Path:
        """Write the file of the daemon, or of the session if it runs alone."""
        tables = self.pair.configured(self)
        file = self.folder / "lab.toml"
        if self.run:
            file.write_text("".join(f"{name} = {toml(of)}\n" for name, of in tables.items()))
            return file
        options = {"socket": self.socket, "event_log": str(self.log_of_events), **daemon}
        lines = [f"daemon = {toml(options)}", "[[sessions]]", 'name = "arm"']
        lines += [f"{name} = {toml(of)}" for name, of in tables.items()]
        if "network" in tables:
            server = {"port": self.server_port, "router": self.router}
            lines += [
                "[servers.rosbridge]",
                *(f"{key} = {_value(of)}" for key, of in server.items()),
            ]
        file.write_text("\n".join(lines) + "\n")
        return file

    def start_daemon(self, *words: str) -> None:
        file = self.write()
        command: tuple[str, ...] = ("run", "-v") if self.run else ("daemon", "run")
        if self.record:
            self.file_of_record = self.folder / f"{time.monotonic_ns()}.mcap"
            command = (*command, "--record", str(self.file_of_record))
        options = {"preexec_fn": _no_core, **self.options}
        log = self.folder / "daemon.log"
        self.daemon = Child(("cardan", *command, str(file), *words), log, **options)
        self._deaths = 0
        if not self.run:
            self.daemon.wait_for("^READY")
            threading.Thread(target=self._follow, daemon=True).start()

    def _follow(self) -> None:
        """Collect the daemon's messages about its events."""
        with contextlib.suppress(CardanError, OSError), ControlClient(self.socket, None) as client:
            for event in client.events("events", "", True):
                self.reported.append(event)

    def revive(self) -> list[str]:
        """Start the programs that are not running; return their names."""
        found = []
        if self.daemon is not None and self.daemon.alive and self._deaths >= 2:
            self.end_daemon()  # a new daemon, because this one's pauses between restarts have grown
        for name, needed in (("robot", True), ("hand", True), ("server", self.pair.name == SPNAV)):
            child = getattr(self, name)
            if needed and (child is None or not child.alive):
                if child is not None:
                    child.end()
                getattr(self, f"start_{name}")()
                getattr(self, name).wait_for("^READY")
                found.append(name)
        if self.daemon is None or not self.daemon.alive:
            if self.daemon is not None:
                self.daemon.end()
            self.start_daemon()
            found.append("daemon")
        elif not self.run:
            has_server = "network" in self.pair.configured(self)
            for name in ("arm", "rosbridge") if has_server else ("arm",):
                if self.row(name)["state"] in ("stopped", "failed"):
                    self.ask("start", name)
                    found.append("session" if name == "arm" else "server")
        return found

    def end_daemon(self) -> None:
        """End the daemon in an orderly way."""
        daemon, self.daemon = self.daemon, None
        if daemon is not None:
            if daemon.alive:
                daemon.process.terminate()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    daemon.process.wait(READY_S)
            daemon.end()

    def died(self) -> None:
        """Count a death of the session's process."""
        self._deaths += 1

    # -- the daemon -------------------------------------------------------------------------------

    def ask(self, do: str, name: str = "", value: Any = None) -> Any:
        with ControlClient(self.socket) as client:
            return client.ask(do, name, value)

    def row(self, name: str = "arm") -> dict[str, Any]:
        return self.ask("units", name)[0]

    @property
    def session_pid(self) -> int:
        """Process id of the control loop."""
        assert self.daemon is not None
        found = [
            pid
            for pid in descendants_of(self.daemon.pid)
            if "cardan.gateway.session.session" in words_of(pid)
        ]
        return found[0]

    @property
    def server_pid(self) -> int:
        return int(wait(lambda: self.row("rosbridge")["pid"], "the server"))

    @property
    def router_pid(self) -> int:
        """Process id of the router. A router that has just been killed is restarted by its
        supervisor."""
        serve = self.daemon
        assert serve is not None

        def found() -> int | None:
            pids = descendants_of(serve.pid)
            return next((pid for pid in pids if "server router" in words_of(pid)), None)

        return int(wait(found, "the router"))

    def lost_events(self, since_s: float) -> list[dict[str, Any]]:
        """Events after `since_s` that the daemon has reported and that are not in its log."""
        # In this order, because the daemon reports more events meanwhile.
        reported = [event for event in self.reported if event["time_s"] >= since_s]
        stored = list(read_events(self.log_of_events))
        return [event for event in reported if event not in stored]

    def records(self) -> list[str]:
        """List the errors in the record of a run with a fault. It must be readable, and may lack no
        more than the time between two flushes."""
        file = self.file_of_record
        if file is None:
            return ["nothing was recorded"]
        newest_s = max((each.log_ns for each in RecordReader(file)), default=0) * 1e-9
        late_s = file.stat().st_mtime - newest_s
        return [f"the record ends {late_s:.1f} s before its file"] if late_s > 1.5 else []

    # -- the operator device ----------------------------------------------------------------------

    def do(self, steps: str) -> None:
        assert self.hand is not None
        self.hand.tell(steps)

    def hit(self) -> None:
        """Note the time of the fault."""
        self.hit_s = time.monotonic()

    def swing(self, ended: Callable[[], bool]) -> None:
        """Move the arm to and fro, with the dead-man's switch held, until `ended()`."""
        end_s = time.monotonic() + READY_S
        while not ended() and time.monotonic() < end_s:
            self.side = 1 - self.side
            self.do(self.pair.push[self.side])
            with contextlib.suppress(TimeoutError):
                wait(ended, "the end", SWING_S)

    def pause(self, seconds: float = PAUSE_S) -> None:
        threading.Event().wait(seconds)

    def engage(self, within_s: float = READY_S) -> float:
        """Release the device, re-arm and move the arm, repeatedly until the arm moves steadily;
        return the time that took, s."""
        began_s = time.monotonic()
        while True:
            self.do(self.pair.rest)
            self.pause()
            self.do(self.pair.touch)
            self.pause(0.1)
            self.do(self.pair.rest)
            self.pause()
            axis = 0 if self.pair.arm.startswith("gofa") else 1
            sign = -1.0 if axis == 0 or "ur5" in self.pair.robot else 1.0
            away = sign * self.trace.away(axis)
            self.side = 1 if away > ROOM_M else 0 if away < 0.02 else self.side
            self.do(self.pair.push[self.side])
            with contextlib.suppress(TimeoutError):
                wait(lambda: self.trace.speed() > AT_SPEED * SPEED_M_S, "motion", STROKE_S)
                return time.monotonic() - began_s
            if time.monotonic() - began_s > within_s:
                raise TimeoutError(f"{self.pair.name}: nothing moves the arm; {self.why()}")

    def why(self) -> str:
        """Return the reported reason why the arm is at rest."""
        assert self.daemon is not None
        if not self.run:
            with contextlib.suppress(CardanError, OSError):
                row = self.row()
                return ", ".join(f"{k} {row[k]!r}" for k in ("state", "phase", "reason", "why"))
        return self.daemon.said()[-1500:]


def _no_core() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
