"""Programs that compete with the devices for the arms: through the daemon, the command line and
rosbridge."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable
from typing import Any, Final

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from bench.soak.lab import ARMS
from bench.soak.watch import Watch
from cardan.errors import CardanError
from cardan.gateway.arm.remote_arm import RemoteArm
from cardan.gateway.daemon.client import daemon_arm

BETWEEN_S: Final = (0.5, 5.0)

HOME_S: Final = 10.0
"""Longest motion back to an arm's start."""

ANSWER_S: Final = 10.0
"""Timeout for an answer of rosbridge or of the Prometheus server."""

STARTS_S: Final = 15.0
"""Timeout for a command line to move the arm."""

NOTES_S: Final = 1.0
"""Time within which motions that ended immediately are reported."""

STREAM_S: Final = 0.02


class Clients:
    """Programs that command the arms."""

    def __init__(self, watch: Watch) -> None:
        self._watch, self._stop = watch, watch.stop
        self._home: dict[str, list[float]] = {}

    def find_homes(self) -> None:
        """Record the arms' start poses. Raises CardanError."""
        for name in ARMS:
            with self._arm(name, "alice") as arm:
                self._home[name] = list(arm.stat().pose)

    def run(self) -> None:
        """Perform random actions in sequence until the run ends."""
        rng = random.Random(f"{self._watch.seed}-clients")
        acts: tuple[tuple[Callable[[str, random.Random], str], int], ...] = (
            (self._go_home, 4), (self._jog, 4), (self._contend, 3), (self._vanish, 2),
            (self._drop, 3), (self._rosbridge, 3), (self._slow_reader, 2), (self._scrape, 1),
        )  # fmt: skip
        while not self._stop.wait(rng.uniform(*BETWEEN_S)):
            (act,) = rng.choices([each for each, _ in acts], [weight for _, weight in acts])
            arm = rng.choice(ARMS)
            name = act.__name__.strip("_")
            try:
                outcome = act(arm, rng)
            except CardanError as error:
                outcome = f"refused: {error}"
            except (OSError, WebSocketException) as error:
                outcome = f"failed: {error!r}"
            self._watch.report.did("client", name, arm, outcome)

    def _arm(self, name: str, source: str) -> RemoteArm:
        return daemon_arm(name, path=self._watch.lab.socket, source=source)

    def _go_home(self, name: str, _rng: random.Random) -> str:
        """A program moves the arm back to its start."""
        with self._arm(name, "alice") as arm, self._watch.asking(name, "alice"):
            motion = arm.movj(self._home[name])
            self._watch.asks(name, "alice")
            give_up_s = time.monotonic() + HOME_S
            while not motion.over and time.monotonic() < give_up_s:
                if self._stop.wait(0.05):
                    break
            arm.stop()
            arm.release()
            return str(motion.outcome.value)

    @staticmethod
    def _twist(rng: random.Random) -> list[float]:
        twist = [0.0] * 6
        twist[rng.randrange(3)] = rng.choice((-1, 1)) * round(rng.uniform(0.01, 0.05), 3)
        return twist

    def _jog(self, name: str, rng: random.Random) -> str:
        """A program moves the arm for a time."""
        twist, lasts_s = self._twist(rng), rng.uniform(0.5, 4.0)
        with self._arm(name, "alice") as arm, self._watch.asking(name, "alice"):
            motion = arm.movv(twist)
            self._watch.asks(name, "alice")
            self._stop.wait(lasts_s)
            arm.stop()
            arm.release()
            return str(motion.outcome.value)

    def _contend(self, name: str, rng: random.Random) -> str:
        """Two programs request the same arm at once, each with an endless motion."""
        motions: dict[str, Any] = {}
        said: dict[str, str] = {}

        def ask(source: str, arm: RemoteArm) -> None:
            try:
                motions[source] = arm.movv(self._twist(rng))
            except CardanError as error:
                said[source] = str(error)

        with self._arm(name, "alice") as alice, self._arm(name, "bob") as bob:
            arms = {"alice": alice, "bob": bob}
            with self._watch.asking(name, "alice"), self._watch.asking(name, "bob"):
                threads = [threading.Thread(target=ask, args=each) for each in arms.items()]
                for thread in threads:
                    thread.start()
                for thread in threads:
                    thread.join()
                for source in motions:
                    self._watch.asks(name, source)
                # Motions that ended immediately are reported right after the answers.
                self._stop.wait(NOTES_S)
                with self._watch.lock:
                    for source, motion in motions.items():
                        if not motion.over:
                            self._watch.arms[name].accepted(source, time.monotonic())
                self._stop.wait(rng.uniform(0.2, 1.0))
                for each in arms.values():
                    with contextlib.suppress(CardanError):
                        each.stop()
                        each.release()
                with self._watch.lock:
                    for source in arms:
                        self._watch.arms[name].over(source)
        return f"{len(motions)} accepted, {len(said)} refused"

    def _vanish(self, name: str, rng: random.Random) -> str:
        """A command line that moves the arm is killed in mid-motion."""
        words = [f"{each:g}" for each in self._twist(rng)]
        with self._watch.asking(name, "verbs"):
            process = subprocess.Popen(
                [sys.executable, "-m", "cardan", "daemon", "arm", name, "movv", "--socket",
                 self._watch.lab.socket, "--", *words],
                env=self._watch.lab.environment, stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip
            give_up_s = time.monotonic() + STARTS_S
            moved = False
            while process.poll() is None and time.monotonic() < give_up_s and not moved:
                self._stop.wait(0.05)
                row = self._watch.rows.get(name, {})
                moved = row.get("authority") == "verbs" and row.get("phase") == "moving"
            self._watch.asks(name, "verbs")
            if moved:
                self._stop.wait(rng.uniform(0.0, 1.0))
            gone = process.poll() is not None
            process.kill()
            process.wait()
        return "refused" if gone else f"killed, {'moving' if moved else 'not moving'}"

    def _drop(self, name: str, rng: random.Random) -> str:
        """A program's connection breaks in mid-motion."""
        twist = self._twist(rng)
        with self._watch.asking(name, "alice"):
            arm = self._arm(name, "alice")
            arm.open()
            try:
                arm.movv(twist)
                self._watch.asks(name, "alice")
                self._stop.wait(rng.uniform(0.1, 2.0))
            finally:
                arm.close()
        return "dropped"

    def _web(self, **options: Any) -> ClientConnection:
        url = f"ws://127.0.0.1:{self._watch.lab.ports['rosbridge']}/"
        web: ClientConnection = connect(url, compression=None, open_timeout=ANSWER_S, **options)
        return web

    def _rosbridge(self, name: str, rng: random.Random) -> str:
        """A web page streams twists, and stops or vanishes."""
        node = f"/{name.replace('-', '_')}/cartesian_control_server_ros2"
        twist = self._twist(rng)
        linear = dict(zip("xyz", twist, strict=False))
        lasts_s, vanishes = rng.uniform(0.5, 4.0), rng.random() < 0.5
        with self._web() as web:
            if not self._choose_stream(web, node):
                return "refused"
            web.send(json.dumps({
                "op": "advertise", "topic": f"{node}/command/twist", "type": "geometry_msgs/Twist",
            }))  # fmt: skip
            command = json.dumps({
                "op": "publish", "topic": f"{node}/command/twist", "msg": {"linear": linear},
            })  # fmt: skip
            end_s = time.monotonic() + lasts_s
            with self._watch.asking(name, "ros2"):
                while time.monotonic() < end_s and not self._stop.wait(STREAM_S):
                    web.send(command)
                    self._watch.asks(name, "ros2")
                if vanishes:
                    web.socket.shutdown(socket.SHUT_RDWR)
                else:
                    web.send(json.dumps({"op": "call_service", "service": f"{node}/stop"}))
                    self._stop.wait(0.3)
        return "vanished" if vanishes else "stopped"

    def _choose_stream(self, web: ClientConnection, node: str) -> bool:
        value = {"type": 4, "string_value": "twist"}
        web.send(json.dumps({
            "op": "call_service", "id": "s", "service": f"{node}/set_parameters",
            "args": {"parameters": [{"name": "preset_streaming_cmd", "value": value}]},
        }))  # fmt: skip
        deadline_s = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline_s:
            frame = json.loads(web.recv(timeout=ANSWER_S))
            if frame.get("op") == "service_response":
                results = frame.get("values", {}).get("results", []) if frame["result"] else []
                return bool(results) and bool(results[0]["successful"])
        return False

    def _slow_reader(self, name: str, rng: random.Random) -> str:
        """A web page subscribes to everything of an arm and does not read."""
        node = f"/{name.replace('-', '_')}/cartesian_control_server_ros2"
        with self._web(max_queue=1) as web:
            web.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            for topic in ("state/pose", "state/twist", "joint_states"):
                web.send(json.dumps({"op": "subscribe", "topic": f"{node}/{topic}"}))
            self._stop.wait(rng.uniform(2.0, 15.0))
            web.socket.shutdown(socket.SHUT_RDWR)
        return "gone"

    def _scrape(self, _name: str, _rng: random.Random) -> str:
        """Prometheus reads the figures."""
        url = f"http://127.0.0.1:{self._watch.lab.ports['metrics']}/metrics"
        with urllib.request.urlopen(url, timeout=ANSWER_S) as answer:
            return f"{len(answer.read())} bytes"
