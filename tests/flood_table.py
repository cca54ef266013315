"""Generator of the table of floods, tests/results/floods.md: time from a client's last byte to rest
of the arm.

Real sockets; the simulated arm, its session, the server and the client are separate processes. To
update it, in less than 15 minutes: ``make flood-table``, or ``python -m tests.flood_table``.
``--only WORDS`` measures only rows with these words in their name. DDS and Foxglove rows need their
plug-ins.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.arm.parameters import ParameterRule, find_rule
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from tests import flood_clients as clients
from tests.docs_tables import markdown
from tests.flood_clients import ARM
from tests.result_tables import FLOODS as RESULTS
from tests.serving import free_endpoint
from tests.waiting import until

_RULE: ParameterRule | None = find_rule("streamTimeout")
assert _RULE is not None
REST_S = _RULE.default + 0.3
"""Time limit from the client's last byte to rest of the arm: the stream's timeout, and 0.3 s for
data that was received but not processed."""

FLOOD_S = 1.6
"""Longer than the tolerated backlog."""
STOPPED_S = 1.0
PORTION_S = 0.002
BEGUN_S, BEGUN_PERIOD_S = 1.0, 0.02
"""Duration and period of a client's normal messages before its flood; repeated if the arm does not
move by then."""
SETTLED_S = 0.5
"""Required duration of the arm's rest after the time limit."""
WATCHED_S = 6.0
"""Longest wait for that rest."""
COUNTED_S = 1.0
"""Duration of the measurement of a message's cost."""
MOST_PER_S = 1e6
"""Highest assumed rate, above that of any client, for messages whose cost is too small to be
measured."""

RATES = (0.5, 2.0, 10.0)
"""Multiples of the sustainable rate."""
ENDS = ("silence", "close", "abort", "client stopped for 1 s", "server stopped for 1 s")

WITHOUT = {("joint stream", "server stopped for 1 s")}
"""Combinations that are not measured: the server is the arm itself, which does not move while it is
stopped."""
NONE = "–"
"""Text of their cells."""

PERIOD_S = 0.008
MOVES_RAD_S = 1e-3

SESSION = """
[robot]
driver = "sim_arm"
robot = "ur5"
transport = "udp"
endpoint = "{arm}"
period_s = {period_s}

[arm]
model = "ur5"

[network]
name = "arm"
namespace = "left"
router = ""
listen = ["{bus}"]
servo_units = "speed"
"""

HAND = """
[device]
driver = "{driver}"
wait_for_device = true
{more}

[mapping]
mode = "rate"
frame = "base"
linear_speed_m_s = 0.1
angular_speed_rad_s = 0.5
"""
PHONE = 'router = "{bus}"\nheading = "each hold"'


class Server(NamedTuple):
    """Command line of a server beside a session, and its client."""

    client: type[clients.Client]
    server: tuple[str, ...] = ()
    """Arguments of ``cardan net server``; empty: the session itself is the server."""
    device: str = ""
    """Device of the session."""
    deadman: str = ""
    more: str = ""
    """Further keys of the device's table."""
    counted_per_s: float = 1000.0
    """Rate at which the cost of a message is measured: one that the server can handle."""


_ROSBRIDGE = ("rosbridge", "--port", "0")
_PAGE = ("console", "--port", "0")

SERVERS = {
    "rosbridge, JSON": Server(clients.Rosbridge, _ROSBRIDGE),
    "rosbridge, CBOR": Server(clients.RosbridgeCbor, _ROSBRIDGE),
    "rosbridge, PNG": Server(clients.RosbridgePng, _ROSBRIDGE),
    "rosbridge, fragments": Server(clients.RosbridgeFragments, _ROSBRIDGE),
    "Foxglove": Server(clients.Foxglove, ("foxglove", "--port", "0")),
    "DDS": Server(clients.Dds, ("dds", "--dds-domain", "73")),
    "Zenoh": Server(clients.Zenoh, counted_per_s=20_000.0),
    "page, JSON": Server(clients.PageJson, _PAGE),
    "page, phone frames": Server(clients.PagePhone, _PAGE, "phone", "hold", PHONE, 100.0),
    "page, jog frames": Server(clients.PageJog, _PAGE, counted_per_s=100.0),
    "page, teleop": Server(
        clients.PageTeleop, _PAGE, "xr", "hold", f'{PHONE}\npart = "viewer"', 100.0
    ),
    "daemon's socket": Server(clients.Daemon),
    "joint stream": Server(clients.JointStream, counted_per_s=20_000.0),
    "spnav": Server(clients.Spnav, (), "spnav", "", 'socket = "{folder}/spnav.sock"', 20_000.0),
}


class Row(NamedTuple):
    """Result of a flood."""

    server: str
    rate: float
    end: str
    late_s: float
    """Duration of motion after the client's last byte; 0: none."""
    moved_s: float
    """Total duration of motion."""
    ended_by_server: bool
    waited_s: float
    """Part of that during which arm, session and server were ready to run and had no processor."""


# -- processes -----------------------------------------------------------------------------------


def arm(link: Connection) -> None:
    """Run the simulated arm until the other end of its pipe closes.

    It sends its endpoint first. On each request it sends its total time in motion and the time of
    the last motion (monotonic, s).
    """
    from cardan.sim_peers.arm.udp import SimulatedArmPeer

    class Watched(SimulatedArmPeer):
        moved_s = newest_s = 0.0

        def _cycle(self, now_s: float, scheduled_s: float) -> None:
            super()._cycle(now_s, scheduled_s)
            if any(abs(each) > MOVES_RAD_S for each in self.core.plant.velocities):
                self.moved_s, self.newest_s = self.moved_s + PERIOD_S, time.monotonic()

    options = SimulatedArmOptions(
        robot="ur5", port=0, period_s=PERIOD_S, plant=PlantOptions(drive="ideal")
    )
    with Watched(options) as peer, contextlib.suppress(EOFError):
        link.send(peer.endpoint)
        while True:
            peer.step(time.monotonic() + PERIOD_S)
            if link.poll():
                link.recv()
                link.send((peer.moved_s, peer.newest_s))


Waits = dict[int, dict[int, float]]
"""Time that each thread of each process has waited for a processor, s."""


def waits(roots: Sequence[int]) -> Waits:
    """Return the waiting times of these processes and all their descendants, as counted by the
    kernel."""
    found: Waits = {}
    left = list(roots)
    while left:
        pid = left.pop()
        threads = found[pid] = {}
        with contextlib.suppress(OSError):  # process or thread has ended
            for task in Path(f"/proc/{pid}/task").iterdir():
                threads[int(task.name)] = 1e-9 * int((task / "schedstat").read_text().split()[1])
                left += map(int, (task / "children").read_text().split())
    return found


def waited_s(before: Waits, after: Waits) -> float:
    """Return the longest added delay of data that passes through all processes in sequence."""
    return sum(
        max(
            (now - before.get(pid, {}).get(each, now) for each, now in threads.items()), default=0.0
        )
        for pid, threads in after.items()
    )


def send(
    link: Connection,
    name: str,
    endpoint: str,
    way: int,
    per_s: float,
    seconds: float,
    end: str,
    roots: Sequence[int],
) -> None:
    """Run a client that floods once it is told that the arm moves.

    It sends the start time, then the time of its last byte, the waiting times of the processes
    `roots` by then, and whether the server has closed the connection. It stays until it is killed,
    except if `end` says otherwise.
    """
    client = SERVERS[name].client(endpoint, way)
    while not link.poll():
        # If the session stood still before the start, the arm moves only after a rest of the
        # device.
        client.rest()
        until_s = time.monotonic() + BEGUN_S
        while time.monotonic() < until_s:
            client.hand(1)
            time.sleep(BEGUN_PERIOD_S)
    link.recv()
    began_s = ended_s = time.monotonic()
    link.send(began_s)
    handed, cut = 0, False
    try:
        while time.monotonic() - began_s < seconds:
            due = int(per_s * (time.monotonic() - began_s)) - handed
            if due >= 1 or client.has_left:
                handed += client.hand(due)
                ended_s = time.monotonic()
            else:
                time.sleep(PORTION_S)
    except OSError:
        cut = True
    before = waits(roots)
    if end in ("close", "abort") and not cut:
        {"close": client.close, "abort": client.abort}[end]()
    link.send((ended_s, before, cut))
    if end in ("close", "abort"):
        os._exit(0)
    signal.pause()


_processes = multiprocessing.get_context("forkserver")
_processes.set_forkserver_preload([__name__])


@contextlib.contextmanager
def process(target: Callable[..., None], *given: Any) -> Iterator[tuple[Connection, int]]:
    """Run a function in a process that is killed at the end; yield its pipe and process id."""
    here, there = _processes.Pipe()
    started = _processes.Process(target=target, args=(there, *given), daemon=True)
    started.start()
    there.close()
    assert started.pid is not None
    try:
        with here:
            yield here, started.pid
    finally:
        started.kill()
        started.join()


@contextlib.contextmanager
def program(*words: object, says_ready: bool = True) -> Iterator[tuple[str, int]]:
    """Run ``cardan WORDS``, killed at the end; yield its endpoint and process id."""
    with subprocess.Popen(
        [sys.executable, "-m", "cardan", *map(str, words)],
        stdout=subprocess.PIPE if says_ready else subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as started:
        try:
            endpoint = ""
            if started.stdout is not None:
                ready, _, endpoint = started.stdout.readline().strip().partition(" ")
                assert ready == "READY", f"cardan {' '.join(map(str, words))} did not serve"
            yield endpoint, started.pid
        finally:
            started.send_signal(signal.SIGCONT)
            started.kill()


# -- measuring -----------------------------------------------------------------------------------


class Bed:
    """Server with its session and arm, flooded repeatedly."""

    def __init__(
        self, name: str, arm: Connection, endpoint: str, server: int, roots: Sequence[int]
    ) -> None:
        """`roots`: process ids of the programs that a command passes."""
        self.name, self.endpoint, self.server = name, endpoint, server
        self._arm, self._way, self._roots = arm, 1, roots

    def moved(self) -> tuple[float, float]:
        """Return the arm's total time in motion, and the time of the last motion."""
        self._arm.send(None)
        moved_s, newest_s = self._arm.recv()
        return moved_s, newest_s

    def _rests(self, from_s: float) -> tuple[float, Waits]:
        """Wait until the arm is at rest; return the time of the last motion, and the waiting times
        by then."""
        before_s, found = math.nan, waits(self._roots)
        while True:
            now_s = time.monotonic()
            newest_s = self.moved()[1]
            if newest_s != before_s:
                before_s, found = newest_s, waits(self._roots)
            rests = now_s >= max(from_s + REST_S, newest_s) + SETTLED_S
            if rests or now_s > from_s + WATCHED_S:
                return newest_s, found
            time.sleep(0.05)

    @contextlib.contextmanager
    def _client(self, per_s: float, seconds: float, end: str) -> Iterator[tuple[Connection, int]]:
        """Start a client and wait until it moves the arm; yield its pipe and process id."""
        self._way = -self._way  # keeps the arm inside its range
        before_s, _ = self.moved()
        given = self.name, self.endpoint, self._way, per_s, seconds, end, self._roots
        with process(send, *given) as (sender, pid):
            until(lambda: self.moved()[0] > before_s, f"{self.name}: a motion")
            sender.send(None)
            yield sender, pid

    def handled_per_s(self) -> float:
        """Return the number of messages per second that need all of the server's processor time."""
        per_s = SERVERS[self.name].counted_per_s
        with self._client(per_s, COUNTED_S, "silence") as (sender, _):
            sender.recv()
            cost_s = -self._worked_s()
            ended_s, *_ = sender.recv()
            cost_s += self._worked_s()
            self._rests(ended_s)
            idle_s = -self._worked_s()
            time.sleep(COUNTED_S)
            idle_s += self._worked_s()
        return 1.0 / max((cost_s - idle_s) / (per_s * COUNTED_S), 1.0 / MOST_PER_S)

    def _worked_s(self) -> float:
        """Return the server's processor time (Linux, CPUCLOCK_SCHED)."""
        return time.clock_gettime(~self.server << 3 | 2)

    def flooded(self, rate: float, end: str, per_s: float) -> Row:
        """Run a flood of `per_s` messages a second."""
        seconds = FLOOD_S + (0.2 if end.startswith("server") else 0.0)
        seconds += STOPPED_S if end.startswith("client") else 0.0
        before_s, _ = self.moved()
        with self._client(per_s, seconds, end) as (sender, pid):
            began_s = sender.recv()
            late_s = resumed_s = 0.0
            if "stopped" in end:
                at_s = began_s + (FLOOD_S if end.startswith("server") else FLOOD_S / 2)
                time.sleep(max(0.0, at_s - time.monotonic()))
                stopped = self.server if end.startswith("server") else pid
                os.kill(stopped, signal.SIGSTOP)
                stopped_s = time.monotonic()
                time.sleep(STOPPED_S)
                if stopped == pid:
                    late_s = max(0.0, self.moved()[1] - stopped_s)
                os.kill(stopped, signal.SIGCONT)
                resumed_s = time.monotonic()
            ended_s, before, cut = sender.recv()
            newest_s, after = self._rests(max(ended_s, resumed_s))
            moved_s = self.moved()[0] - before_s
        late_s = max(late_s, newest_s - ended_s, 0.0)
        return Row(self.name, rate, end, late_s, moved_s, bool(cut), waited_s(before, after))


@contextlib.contextmanager
def bed(name: str) -> Iterator[Bed]:
    """Run all programs that a server needs, until the end."""
    server = SERVERS[name]
    with contextlib.ExitStack() as stack:
        # A socket's path is limited to 107 bytes.
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="cardan-"))
        link, arm_pid = stack.enter_context(process(arm))
        peer = link.recv()
        if name == "joint stream":
            yield Bed(name, link, peer, arm_pid, (arm_pid,))
            return
        bus = free_endpoint()
        known = {"arm": peer, "bus": bus, "folder": folder, "period_s": PERIOD_S}
        text = SESSION.format(**known)
        if server.device:
            text += HAND.format(driver=server.device, more=server.more.format(**known))
            text += f'deadman = "{server.deadman}"\n'
        file = Path(folder) / "left.toml"
        file.write_text(text, encoding="utf-8")
        if name == "daemon's socket":
            daemon = Path(folder) / "daemon.toml"
            path = f"{folder}/cardan.sock"
            daemon.write_text(f'[daemon]\nsocket = "{path}"\nevent_log = "none"\n', "utf-8")
            endpoint, pid = stack.enter_context(program("daemon", "run", daemon, file))
        else:
            run = program("run", file, "--seconds", 3600, says_ready=False)
            _, pid = stack.enter_context(run)
            endpoint = f"{folder}/spnav.sock" if name == "spnav" else bus
        with BusNetwork(BusOptions(router=bus), "flood_table") as network:
            until(lambda: network.wait_for_service(f"{ARM}/ask", 5.0), "a session")
        roots = [arm_pid, pid]
        if server.server:
            endpoint, pid = stack.enter_context(
                program("net", "server", *server.server, "--router", bus)
            )
            roots.append(pid)
        yield Bed(name, link, endpoint, pid, roots)


def rows(
    names: Iterable[str] = SERVERS, rates: Iterable[float] = RATES, ends: Iterable[str] = ENDS
) -> Iterator[Row]:
    """Yield the results of all floods."""
    for name in names:
        with bed(name) as made:
            per_s = made.handled_per_s()
            print(f"{name}: {per_s:.0f} messages a second", flush=True)
            for rate in rates:
                for end in ends:
                    if (name, end) in WITHOUT:
                        continue
                    yield made.flooded(rate, end, rate * per_s)


def table(found: Iterable[Row], before: Iterable[Sequence[str]] = ()) -> str:
    """Return the table: ms, bold above the limit, with a star if the server closed the connection.

    `before`: rows that are kept if not measured again.
    """
    cells: dict[tuple[str, float], dict[str, str]] = {
        (name, float(rate)): dict(zip(ENDS, each, strict=True)) for name, rate, *each in before
    }
    for row in found:
        star = "*" if row.ended_by_server else ""
        ms = f"{1e3 * row.late_s:.0f}"
        text = f"**{ms}**{star}" if row.late_s > REST_S else f"{ms}{star}"
        cells.setdefault((row.server, row.rate), {})[row.end] = text
    columns = ("server", "times what is handled", *ENDS)
    return markdown(
        columns,
        (
            (name, f"{rate:g}", *(of.get(end, NONE) for end in ENDS))
            for name in SERVERS
            for rate in RATES
            if (of := cells.get((name, rate)))
        ),
    )


def main() -> None:
    """Measure the floods, and write the table."""
    reading = argparse.ArgumentParser(description="Measure how long arms go on after floods.")
    reading.add_argument("--only", metavar="WORDS", help="rows with these words; others stay")
    only = reading.parse_args().only
    found = []
    for row in rows([name for name in SERVERS if only is None or only in name]):
        print(row, flush=True)
        found.append(row)
    before = () if only is None else RESULTS.rows()[1:]
    RESULTS.write(table(found, before))


if __name__ == "__main__":
    # Child processes find their functions by the module's name.
    from tests import flood_table

    flood_table.main()
