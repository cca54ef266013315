"""Observations of the lab and its requests for motion, passed on to the rules."""

from __future__ import annotations

import contextlib
import math
import os
import random
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from bench.soak import motion_scripts, rules
from bench.soak.lab import ARMS, DEVICES_OF, MARK, SOURCES, Lab
from bench.soak.report import Report, Sample
from bench.soak.rules import ArmRules, RecoveryRule, SessionReport, Violation
from bench.soak.sampling import is_marked, shared_memory, use_of
from cardan.errors import CardanError
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.session.snapshot import BOUNDS_S

POLL_S: Final = 0.2
SAMPLE_S: Final = 10.0

BETWEEN_EPISODES_S: Final = (0.5, 12.0)

SETTLES_S: Final = 0.3
"""Longest delay of a script's step: a device's process checks for scripts twenty times a second,
and its processor may be busy."""


class Watch:
    """The lab, its rules, and the sources that request motion. Thread-safe."""

    def __init__(self, folder: Path, seed: int, hours: float) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.seed = folder.resolve(), seed
        token = f"{os.getpid()}-{time.time_ns()}"
        self.mark = f"{MARK}={token}"
        """Environment variable of all processes of the lab."""
        self.stop = threading.Event()
        """Set to end the run."""
        self.lock = threading.RLock()
        self.report = Report(self.folder, seed, hours)
        self.found = self.report.violation
        self.arms = {name: ArmRules(name, SOURCES, self.found) for name in ARMS}
        self.recovery = RecoveryRule(self.found)
        self.lab = Lab(self.folder, token, self._measured)
        self.rows: dict[str, dict[str, Any]] = {}
        """The daemon's newest rows, by name."""
        self.mapped: set[str] = set()
        """Files of shared memory that processes of the lab have mapped."""
        self._last: dict[str, tuple[float, list[float]]] = {}
        self._cycles: dict[str, tuple[int, int]] = {}
        self._excused: Counter[str] = Counter()
        self._away: Counter[str] = Counter()
        """Devices that are absent."""
        self._asked_until_s = dict.fromkeys(DEVICES_OF, -math.inf)
        self._histograms: dict[str, tuple[int, list[int], int]] = {}
        self._cpu: dict[int, tuple[float, float]] = {}
        self._paused_s = -math.inf
        """Time until which the daemon may fail to answer."""

    def ask(self, do: str, name: str = "", value: Any = None) -> Any:
        """Send a request to the daemon. Raises CardanError."""
        with ControlClient(self.lab.socket, 30.0) as client:
            return client.ask(do, name, value)

    def pid(self, name: str) -> int | None:
        """Return the process id of a session or a server if it is still one: ids are reused."""
        pid: int | None = self.rows.get(name, {}).get("pid")
        return pid if pid is not None and is_marked(pid, self.mark) else None

    # -- requests for motion ---------------------------------------------------------------------

    def asks(self, arm: str, who: str) -> None:
        """Note that a source re-arms the arm and may move it from now on."""
        with self.lock:
            self.arms[arm].asks(who, time.monotonic())

    @contextlib.contextmanager
    def asking(self, arm: str, who: str) -> Iterator[None]:
        """Note that a source requests motion until the context ends."""
        try:
            self.asks(arm, who)
            yield
        finally:
            with self.lock:
                self.arms[arm].lets_go(who, time.monotonic())

    def void(self, *arms: str) -> None:
        """Note that a fault has ended all requests for these arms."""
        with self.lock:
            for arm in arms:
                self.arms[arm].void(time.monotonic())

    def operator_asks(self, device: str, who: str = "device") -> None:
        """Note that the operator of a device holds its dead-man button."""
        with self.lock:
            for arm in DEVICES_OF[device]:
                self.arms[arm].asks(who, time.monotonic())

    def operator_gone(self, device: str, who: str = "device") -> None:
        """Note that the operator of a device has released its dead-man button."""
        with self.lock:
            for arm in DEVICES_OF[device]:
                self.arms[arm].lets_go(who, time.monotonic())

    def operator_goes_on(self, device: str) -> None:
        """Note that a device was stopped and its operator may continue the motion."""
        with self.lock:
            if time.monotonic() < self._asked_until_s[device]:
                self.operator_asks(device)

    # -- excuses by faults
    # ---------------------------------------------------------------------------

    @contextlib.contextmanager
    def away(self, device: str) -> Iterator[None]:
        """Note that a device is absent until the context ends."""
        with self.lock:
            self._away[device] += 1
            self.operator_gone(device)
        try:
            yield
        finally:
            with self.lock:
                self._away[device] -= 1

    @contextlib.contextmanager
    def excused(self, *names: str) -> Iterator[None]:
        """Excuse problems of these sessions and servers until the context ends."""
        with self.lock:
            self._excused.update(names)
        try:
            yield
        finally:
            with self.lock:
                self._excused.subtract(names)

    def is_excused(self, name: str) -> bool:
        """Return True if its problems are excused now."""
        return bool(self._excused[name])

    @contextlib.contextmanager
    def daemon_paused(self) -> Iterator[None]:
        """Note that the daemon is stopped until the context ends, and answers a little later."""
        self._paused_s = math.inf
        try:
            with self.excused(*self.rows):
                yield
        finally:
            self._paused_s = time.monotonic() + 2.0

    # -- observations
    # --------------------------------------------------------------------------------

    def robot_anew(self, arm: str) -> None:
        """Note that the arm's robot is a new process or was stopped: its motion meanwhile is not
        judged."""
        with self.lock:
            self._last.pop(arm, None)
            self.arms[arm].resumes(time.monotonic())

    def _measured(self, arm: str, line: str) -> None:
        _, time_s, *words = line.split()
        now_s, joints = float(time_s), [float(each) for each in words]
        with self.lock:
            before = self._last.get(arm)
            self._last[arm] = now_s, joints
            if before is None:
                self.arms[arm].begins(now_s)
            elif now_s > before[0]:
                way = max(abs(a - b) for a, b in zip(joints, before[1], strict=True))
                self.arms[arm].measured(now_s, way / (now_s - before[0]))

    def poll(self) -> None:
        """Poll the daemon's rows without end."""
        client: ControlClient | None = None
        while not self.stop.wait(POLL_S):
            began_s = time.monotonic()
            try:
                client = client or ControlClient(self.lab.socket, rules.ANSWER_S)
                rows = client.ask("units")
            except CardanError as error:
                if client is not None:
                    client.close()
                    client = None
                if time.monotonic() > self._paused_s and not self.stop.is_set():
                    self.found(Violation(began_s, "the daemon answers", "daemon", str(error)))
                continue
            now_s = time.monotonic()
            self.report.answered(now_s - began_s, now_s < self._paused_s)
            with self.lock:
                for row in rows:
                    self._see(row, now_s)
        if client is not None:
            client.close()

    def _see(self, row: dict[str, Any], now_s: float) -> None:
        name = row["name"]
        self.rows[name] = row
        there = True
        if row["kind"] == "session":
            pid, cycles = row["pid"] or 0, row["cycles"]
            device = next(each for each, of in DEVICES_OF.items() if name in of)
            there = not self._away[device]
            if pid and (pid, cycles) != self._cycles.get(name):
                self._cycles[name] = pid, cycles
                self.arms[name].on_report(SessionReport(now_s, pid, row["authority"], row["phase"]))
        self.recovery.seen(name, rules.problem_of(row, there), bool(self._excused[name]), now_s)

    def sample(self) -> None:
        while not self.stop.wait(SAMPLE_S):
            self.sample_once()

    def sample_once(self) -> None:
        now_s = time.monotonic()
        cycles: dict[str, tuple[float, float]] = {}
        with contextlib.suppress(CardanError), ControlClient(self.lab.socket, 30.0) as client:
            for unit in client.ask("figures")["units"]:
                if unit["kind"] == "session" and unit["snapshot"] and unit["pid"]:
                    cycles[unit["name"]] = self._tick(unit["name"], unit["pid"], unit["snapshot"])
        with self.lock:
            of = {name: row["pid"] for name, row in self.rows.items() if row["pid"]}
            restarts = {name: row["restarts"] for name, row in self.rows.items()}
        of |= {name: each.pid for name, each in self.lab.peers.items() if each.pid}
        of |= {"daemon": self.lab.daemon.pid, "the soak itself": os.getpid()}
        for name, pid in of.items():
            if pid is None or (use := use_of(pid)) is None:
                continue
            self.mapped |= shared_memory(pid) if pid != os.getpid() else set()
            before = self._cpu.get(pid)
            self._cpu[pid] = now_s, use.cpu_s
            cpu = (use.cpu_s - before[1]) / (now_s - before[0]) if before else math.nan
            p50_s, p99_s = cycles.get(name, (math.nan, math.nan))
            self.report.sample(
                Sample(now_s, name, pid, use.rss_mb, use.fds, use.threads, cpu,
                       1e3 * p50_s, 1e3 * p99_s, restarts.get(name, 0))
            )  # fmt: skip
        self.report.load(os.getloadavg()[0])

    def _tick(self, name: str, pid: int, snapshot: dict[str, Any]) -> tuple[float, float]:
        """Return p50 and p99 of the cycle since the previous sample, s."""
        within, count = snapshot["loop"]["tick_within"], snapshot["loop"]["cycles"]
        before = self._histograms.get(name)
        self._histograms[name] = pid, within, count
        if before is None or before[0] != pid or not within or len(before[1]) != len(within):
            return math.nan, math.nan
        new = count - before[2]
        p50_s, p99_s = (
            rules.quantile_s(before[1], within, new, BOUNDS_S, share) for share in (0.5, 0.99)
        )
        return p50_s, p99_s

    # -- devices ---------------------------------------------------------------------------------

    def device(self, device: str) -> None:
        """Play random motion scripts on a device without end."""
        rng = random.Random(f"{self.seed}-{device}")
        while not self.stop.wait(rng.uniform(*BETWEEN_EPISODES_S)):
            episode = motion_scripts.episode(device, rng)
            if self._away[device] or not self.lab.devices[device].play(episode.script):
                continue
            began_s = time.monotonic()
            if self.stop.wait(episode.begins_s - SETTLES_S / 2):
                return
            with self.lock:
                if not self._away[device]:
                    self.operator_asks(device)
                    self._asked_until_s[device] = began_s + episode.ends_s
            self.report.count("device", f"{device}: episode")
            if self.stop.wait(episode.ends_s - episode.begins_s + SETTLES_S):
                return
            self.operator_gone(device)
