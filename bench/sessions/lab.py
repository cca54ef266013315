"""The measured sessions: one `cardan daemon run`, whose sessions start on demand."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from bench.sessions.crowd import ARM, MODEL, Crowd, Played
from cardan.common.tables import read_toml
from cardan.demos.examples import free_ports
from cardan.errors import DriverError
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.daemon.usage import processor_time_s
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config

STARTS_WITHIN_S = 90.0
"""Timeout for sessions to start: thirty at once need some time."""

LOOK_S = 0.2

ENDS_WITHIN_S = 20.0

SESSION = """
[[sessions]]
name = "s{number:02}"
start = false
robot = {{ driver = "abb_egm", mode = "joint", listen_port = {port}, robot = "{arm}" }}
device = {{ driver = "spacemouse", transport = "socket", model = "{model}", path = "{mouse}" }}
[sessions.arm]
model = "{arm}"
[[sessions.obstacles]]
name = "table"
plane = [[0.0, 0.0, 1.0], 0.0]
[sessions.mapping]
deadman = "left"
linear_speed_m_s = 0.1
angular_speed_rad_s = 0.3
"""


class Row(NamedTuple):
    """Measurement of a number of sessions. Loads are shares of one processor."""

    sessions: int
    each: tuple[float, ...]
    """Load of each session's process."""
    daemon: float
    crowd: float
    """Load of the process that plays robots and operators."""
    others: float
    """Load of everything else on this computer."""
    memory_mb: float
    """Mean memory of a session: PSS, which divides shared memory among its users."""
    daemon_mb: float
    """PSS of the daemon and its other subprocesses."""
    played: Played

    @property
    def mean(self) -> float:
        """Mean load of a session."""
        return sum(self.each) / len(self.each)

    @property
    def memory_in_all_mb(self) -> float:
        """Memory of all sessions and the daemon."""
        return self.sessions * self.memory_mb + self.daemon_mb


class Lab:
    """A daemon, and the process that plays its robots and operators."""

    def __init__(
        self, client: ControlClient, crowd: Crowd, daemon: int, most: int, servo: str
    ) -> None:
        """`servo`: description of the sessions' servo."""
        self._client, self.crowd, self._daemon, self.servo = client, crowd, daemon, servo
        self._names = [f"s{number:02}" for number in range(most)]

    def measure(self, count: int, warm_up_s: float, seconds: float) -> Row:
        """Run `count` sessions and measure them. Raises DriverError."""
        pids = self._run(count)
        processes = (*pids, self._daemon, self.crowd.pid)
        before: list[float] = []

        def begun() -> None:
            before.extend((time.monotonic(), _busy_s(), *map(_used_s, processes)))

        played = self.crowd.play(count, warm_up_s, seconds, begun)
        after = (time.monotonic(), _busy_s(), *map(_used_s, processes))
        took_s, busy_s, *used_s = (b - a for a, b in zip(before, after, strict=True))
        return Row(
            count,
            tuple(each / took_s for each in used_s[:count]),
            used_s[count] / took_s,
            used_s[count + 1] / took_s,
            max(0.0, busy_s - sum(used_s)) / took_s,
            sum(map(_memory_mb, pids)) / count,
            sum(map(_memory_mb, {self._daemon, *_children(self._daemon)} - set(pids))),
            played,
        )

    def scheduling(self, name: str = "s00") -> str:
        """Return the scheduling of a session's loop."""
        found: str = self._client.ask("snapshot", name)["scheduling"]
        return found

    def _run(self, count: int) -> list[int]:
        """Run the first `count` sessions, stop all others, and return the processes."""
        for number, name in enumerate(self._names):
            self._client.ask("start" if number < count else "stop", name)
        deadline_s = time.monotonic() + STARTS_WITHIN_S
        while True:
            rows = {row["name"]: row for row in self._client.ask("units")}
            wanted = [rows[name] for name in self._names[:count]]
            if all(map(_serves, wanted)) and not any(
                rows[name]["pid"] for name in self._names[count:]
            ):
                return [row["pid"] for row in wanted]
            if time.monotonic() > deadline_s:
                row = next((row for row in wanted if not _serves(row)), wanted[0])
                raise DriverError(f"{row['name']} has not begun: {row['reason'] or row['state']}")
            time.sleep(LOOK_S)


def _serves(row: dict[str, Any]) -> bool:
    return row["pid"] is not None and row["phase"] != ""


@contextlib.contextmanager
def lab(folder: Path, most: int) -> Iterator[Lab]:
    """A lab for up to `most` sessions, none of them running, with its files in `folder`."""
    # Reserved together, so that all are free at the same time.
    first = free_ports(most)
    tables = [f'[daemon]\nsocket = "{folder}/cardan.sock"\nevent_log = "none"\n']
    for number in range(most):
        mouse = Crowd.mouse(folder, number)
        tables.append(
            SESSION.format(number=number, port=first + number, arm=ARM, model=MODEL, mouse=mouse)
        )
    file = folder / "lab.toml"
    file.write_text("".join(tables))
    log = folder / "log"
    with (
        Crowd(folder, range(first, first + most)) as crowd,
        log.open("w") as said,
        subprocess.Popen(
            [sys.executable, "-m", "cardan", "daemon", "run", str(file)],
            stdout=subprocess.PIPE,
            stderr=said,
        ) as daemon,
    ):
        try:
            assert daemon.stdout is not None
            if not daemon.stdout.readline().startswith(b"READY "):
                raise DriverError(f"the daemon did not start: {log.read_text()}")
            with ControlClient(f"{folder}/cardan.sock") as client:
                yield Lab(client, crowd, daemon.pid, most, _servo(file))
        finally:
            daemon.terminate()
            try:
                daemon.wait(ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                daemon.kill()


def _servo(file: Path) -> str:
    """Describe the servo of the file's sessions and its number of pairs of bodies."""
    table = read_toml(file)["sessions"][0]
    config = parse_config({key: table[key] for key in table if key not in ("name", "start")})
    body: Any = make_controller(config, make_robot(config)).commanded
    how = "compiled" if body.status().compiled else f"in Python ({body.servo.not_compiled})"
    return f"{how}, {len(body.servo.collision.pairs)} pairs"


def _children(pid: int) -> set[int]:
    """List the child processes of this one, by Linux's proc(5)."""
    found: set[int] = set()
    for each in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # The name may contain spaces and brackets; state and parent follow it.
            parent = each.read_text("utf-8", "replace").rpartition(")")[2].split()[1]
            if int(parent) == pid:
                found.add(int(each.parent.name))
    return found


def _used_s(pid: int) -> float:
    used_s = processor_time_s(pid)
    if used_s is None:
        raise DriverError(f"process {pid} has ended while it was measured")
    return used_s


def _busy_s() -> float:
    """Busy time of all processors, by Linux's proc(5)."""
    with Path("/proc/stat").open(encoding="utf-8") as file:
        user, nice, system, _idle, _waiting, *rest = map(int, file.readline().split()[1:9])
    return (user + nice + system + sum(rest)) / 100.0


def _memory_mb(pid: int) -> float:
    """Memory of a process (PSS): shared memory is divided by the number of its users."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text("utf-8").splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) / 1024.0
    return 0.0
