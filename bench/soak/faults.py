"""Faults injected into the lab, and the operator who looks after its robots."""

from __future__ import annotations

import contextlib
import math
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Final

from bench.soak import motion_scripts
from bench.soak.lab import ARMS, DEVICES_OF, SILENCE_NOTICED, SPEEDS_M_S, VETERAN
from bench.soak.rules import Violation
from bench.soak.watch import SETTLES_S, Watch
from cardan.errors import CardanError

STOPS_S: Final = (0.02, 0.1, 0.3, 1.2, 2.5, 5.0)
"""Durations for which processes are stopped."""

NOTICED_S: Final = 1.0
"""Duration of a stop of a session or device from which all requests for motion must have ended."""
HEARTBEAT_NOTICED_S: Final = 1.2
"""The same for a stop of the daemon: sessions miss its heartbeat after 0.5 s."""
ROBOT_NOTICED_S: Final = 2.0
"""The same for a stop of a robot: the slowest connection times out after 1 s without a state."""

DOWN_S: Final = (0.5, 12.0)
"""Range of durations for which a device or a robot is absent."""

BETWEEN_S: Final = (0.5, 8.0)

STARTS_S: Final = 30.0
"""Timeout for a simulated robot or device to start."""

RECORDS_S: Final = 8
RECORDED_S: Final = 40.0
"""Timeout for a recorder to start, record and end."""

OPERATOR_S: Final = 10.0
"""Time after which an operator attends to a robot that does not recover by itself: a new session
re-enables a Motoman's drives, and a GoFa's RAPID program is restarted."""


class Faults:
    """Fault injection, and the operator's recovery of the robots."""

    def __init__(self, watch: Watch) -> None:
        self._watch, self._lab, self._stop = watch, watch.lab, watch.stop

    def run(self) -> None:
        """Inject random faults in sequence until the run ends."""
        rng = random.Random(f"{self._watch.seed}-faults")
        acts: tuple[tuple[Callable[[random.Random], tuple[str, str]], int], ...] = (
            (self._unplug, 6), (self._kill_device, 3), (self._stop_device, 5),
            (self._kill_robot, 3), (self._stop_robot, 5),
            (self._kill_session, 2), (self._stop_session, 6), (self._restart_session, 1),
            (self._stop_daemon, 4), (self._kill_server, 2), (self._stop_server, 3),
            (self._reload, 2), (self._bad_reload, 1), (self._switch, 5), (self._garbage, 6),
            (self._record, 1),
        )  # fmt: skip
        while not self._stop.wait(rng.uniform(*BETWEEN_S)):
            (act,) = rng.choices([each for each, _ in acts], [weight for _, weight in acts])
            name = act.__name__.strip("_")
            try:
                who, what = act(rng)
            except CardanError as error:
                who, what = "daemon", f"refused: {error}"
            self._watch.report.did("fault", name, who, what)

    def _unplug(self, rng: random.Random) -> tuple[str, str]:
        device, away_s = rng.choice(list(DEVICES_OF)), rng.uniform(*DOWN_S)
        peer = self._lab.devices[device]
        with self._watch.away(device):
            peer.play([[0.0, motion_scripts.UNPLUG[device]]])
            self._stop.wait(away_s)
            peer.play([[0.0, motion_scripts.PLUG[device]], *motion_scripts.LET_GO[device]])
            self._stop.wait(SETTLES_S)
        return device, f"for {away_s:.1f} s"

    def _kill_device(self, rng: random.Random) -> tuple[str, str]:
        device, away_s = rng.choice(list(DEVICES_OF)), rng.uniform(*DOWN_S)
        peer = self._lab.devices[device]
        with self._watch.away(device):
            peer.end(signal.SIGKILL)
            self._stop.wait(away_s)
            peer.start()
            peer.ready.wait(STARTS_S)
        return device, f"for {away_s:.1f} s"

    def _stop_for(self, pid: int | None, rng: random.Random, noticed_s: float,
                  noticed: Callable[[], None]) -> float:  # fmt: skip
        """Stop a process for a random time; call `noticed` once other processes must have detected
        the stop."""
        lasts_s = rng.choice(STOPS_S)
        if pid is None:
            return 0.0
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGSTOP)
            try:
                if lasts_s >= noticed_s:
                    noticed()
                self._stop.wait(lasts_s)
            finally:
                os.kill(pid, signal.SIGCONT)
        return lasts_s

    def _stop_device(self, rng: random.Random) -> tuple[str, str]:
        device = rng.choice(list(DEVICES_OF))

        def noticed() -> None:
            if device in SILENCE_NOTICED:
                self._watch.operator_gone(device)

        if device not in SILENCE_NOTICED:
            # The last report stays in effect, also after the operator has released the device.
            self._watch.operator_asks(device, "held device")
        lasts_s = self._stop_for(self._lab.devices[device].pid, rng, NOTICED_S, noticed)
        self._stop.wait(SETTLES_S)
        self._watch.operator_gone(device, "held device")
        # A device held at rest was not missed and continues.
        self._watch.operator_goes_on(device)
        return device, f"for {lasts_s:g} s"

    def _kill_robot(self, rng: random.Random) -> tuple[str, str]:
        arm, away_s = rng.choice(ARMS), rng.uniform(*DOWN_S)
        robot = self._lab.robots[arm]
        with self._watch.excused(arm):
            self._watch.void(arm)
            robot.end(signal.SIGKILL)
            self._stop.wait(away_s)
            self._watch.robot_anew(arm)
            robot.start()
            robot.ready.wait(STARTS_S)
        return arm, f"for {away_s:.1f} s"

    def _stop_robot(self, rng: random.Random) -> tuple[str, str]:
        arm = rng.choice(ARMS)
        with self._watch.excused(arm):
            lasts_s = self._stop_for(
                self._lab.robots[arm].pid, rng, ROBOT_NOTICED_S, lambda: self._watch.void(arm)
            )
            self._watch.robot_anew(arm)
        return arm, f"for {lasts_s:g} s"

    def _mortal(self, rng: random.Random) -> str:
        """Return a session that may be killed."""
        return rng.choice([each for each in ARMS if each != VETERAN])

    def _kill_session(self, rng: random.Random) -> tuple[str, str]:
        name = self._mortal(rng)
        pid = self._watch.pid(name)
        if pid is None:
            return name, "it does not run"
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        self._watch.void(name)
        return name, "killed"

    def _stop_session(self, rng: random.Random) -> tuple[str, str]:
        name = rng.choice(ARMS)
        lasts_s = self._stop_for(
            self._watch.pid(name), rng, NOTICED_S, lambda: self._watch.void(name)
        )
        return name, f"for {lasts_s:g} s"

    def _restart_session(self, rng: random.Random) -> tuple[str, str]:
        name = self._mortal(rng)
        self._watch.ask("restart", name)
        self._watch.void(name)
        return name, "restarted"

    def _stop_daemon(self, rng: random.Random) -> tuple[str, str]:
        with self._watch.daemon_paused():
            lasts_s = self._stop_for(
                self._lab.daemon.pid, rng, HEARTBEAT_NOTICED_S, lambda: self._watch.void(*ARMS)
            )
        return "daemon", f"for {lasts_s:g} s"

    def _kill_server(self, _rng: random.Random) -> tuple[str, str]:
        pid = self._watch.pid("rosbridge")
        if pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return "rosbridge", "it does not run" if pid is None else "killed"

    def _stop_server(self, rng: random.Random) -> tuple[str, str]:
        name = rng.choice(("rosbridge", "metrics"))
        lasts_s = self._stop_for(self._watch.pid(name), rng, math.inf, lambda: None)
        return name, f"for {lasts_s:g} s"

    def _reload(self, _rng: random.Random) -> tuple[str, str]:
        self._lab.speed = (self._lab.speed + 1) % len(SPEEDS_M_S)
        self._lab.write()
        changes = self._watch.ask("reload")
        return "daemon", f"{len(changes)} changes"

    def _bad_reload(self, _rng: random.Random) -> tuple[str, str]:
        good = self._lab.file.read_text()
        self._lab.file.write_text(good + '\n[[sessions]]\nname = "gofa"\nrobot = 7\n')
        try:
            self._watch.ask("reload")
        except CardanError:
            return "daemon", "refused"
        finally:
            self._lab.file.write_text(good)
        self._watch.found(
            Violation(time.monotonic(), "reload", "daemon", "took a file that is wrong")
        )
        return "daemon", "taken"

    def _switch(self, _rng: random.Random) -> tuple[str, str]:
        found = self._watch.ask("switch", "mouse")
        self._watch.operator_gone("mouse")
        return "mouse", f"to {found['to']}"

    def _garbage(self, rng: random.Random) -> tuple[str, str]:
        ports = self._lab.ports
        where = rng.choice(("egm", "ur5_a", "ur5_b", "motion", "rosbridge", "metrics", "bus",
                            "control"))  # fmt: skip
        data = [
            rng.randbytes(rng.choice((1, 16, 64, 500, 1400))) for _ in range(rng.randint(1, 20))
        ]
        with contextlib.suppress(OSError):
            if where in ("egm", "ur5_a", "ur5_b"):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
                    for each in data:
                        udp.sendto(each, ("127.0.0.1", ports[where]))
            elif where == "control":
                with socket.socket(socket.AF_UNIX) as control:
                    control.settimeout(2.0)
                    control.connect(self._lab.socket)
                    for each in data:
                        control.sendall(each + b"\n")
            else:
                with socket.create_connection(("127.0.0.1", ports[where]), 2.0) as tcp:
                    for each in data:
                        tcp.sendall(each)
                    self._stop.wait(rng.uniform(0.0, 1.0))
        return where, f"{len(data)} packets"

    def _record(self, _rng: random.Random) -> tuple[str, str]:
        """A recorder starts, records and ends."""
        file = self._watch.folder / "tmp" / "record.mcap"
        router = f"tcp/127.0.0.1:{self._lab.ports['bus']}"
        process = subprocess.Popen(
            [sys.executable, "-m", "cardan", "net", "record", "-o", str(file), "--router", router,
             "--seconds", str(RECORDS_S)],
            env=self._lab.environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        give_up_s = time.monotonic() + RECORDED_S
        while process.poll() is None and time.monotonic() < give_up_s and not self._stop.wait(0.2):
            pass
        if process.poll() is None:
            process.kill()
        code = process.wait()
        size = file.stat().st_size if file.exists() else 0
        for each in file.parent.glob("record.mcap*"):
            each.unlink()
        return "recorder", f"status {code}, {size / 1e6:.1f} MB"

    def operate(self) -> None:
        """Perform the actions at the robots' pendants that only a person may do, until the run
        ends."""
        since_s: dict[str, float] = {}
        while not self._stop.wait(1.0):
            now_s = time.monotonic()
            for arm in ("gofa", "gp8"):
                row = self._watch.rows.get(arm, {})
                waits = row.get("state") == "running" and row.get("phase") == "no robot"
                if not waits or self._watch.is_excused(arm):
                    since_s.pop(arm, None)
                elif now_s - since_s.setdefault(arm, now_s) > OPERATOR_S:
                    since_s.pop(arm)
                    why = str(row.get("why", ""))
                    self._watch.void(arm)
                    if arm == "gofa":
                        self._start_anew(arm)
                    else:
                        with contextlib.suppress(CardanError):
                            self._watch.ask("restart", arm)
                    self._watch.report.did("operator", f"looks after {arm}", arm, why)

    def _start_anew(self, arm: str) -> None:
        robot = self._lab.robots[arm]
        robot.end(None)
        self._watch.robot_anew(arm)
        robot.start()
        robot.ready.wait(STARTS_S)
