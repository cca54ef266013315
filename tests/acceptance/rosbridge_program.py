"""A client of ``cardan net server rosbridge``, as a web page would be: it streams twists and checks
their results."""

from __future__ import annotations

import contextlib
import json
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import ClientConnection, connect

from cardan.errors import DriverError

PUBLISH_PERIOD_S = 0.02
"""Rate of the stream: 50 Hz, usual in teleoperation."""

PAUSE_S = 0.5
"""Longest pause of the stream before the arm brakes. The default of 0.1 s is too strict for a
computer that runs a whole demo and other work."""

ANSWER_WITHIN_S = 10.0
"""Longest wait for the arm's state, and for the response of a service."""

ASK_AGAIN_S = 0.2
"""Pause before a refused stream is requested again: on a busy computer the robot may have been
silent for a moment."""

YOUNG = "has been connected for"
"""Part of the reason with which messages without a stamp are refused on a connection that is
younger than 0.3 s."""

SPEED_M_S = 0.06
"""Speed of the TCP; most arms allow four times as much."""

CIRCLE_S = 6.0
"""Time of one circle at that speed: a radius of 57 mm."""

RAMP_S = 0.5
"""Time for accelerating to that speed."""

Vector = tuple[float, float, float]


class RosbridgeProgram:
    """A connection to a rosbridge server, and the arm of one session."""

    def __init__(self, url: str, node: str, say: Callable[[str], None] = lambda line: None) -> None:
        """`node`: the session's full name; `say` receives progress messages in the caller's
        thread."""
        self.node, self._url, self._say = node, url, say
        self.poses: dict[int, Vector] = {}
        """Measured positions of the TCP (m), by their stamps (ns)."""
        self.targets: dict[int, Vector] = {}
        """Commanded positions."""
        self.results: list[Mapping[str, Any]] = []
        """Messages received on ~/result."""
        self.sent = 0
        """Number of twists published."""
        self._answers: dict[str, Mapping[str, Any]] = {}
        self._changed = threading.Condition()
        self._opened = contextlib.ExitStack()
        self._socket: ClientConnection | None = None
        self._thread = threading.Thread(target=self._receive, name="rosbridge-program", daemon=True)

    def __enter__(self) -> RosbridgeProgram:
        """Connect and subscribe. Raises DriverError."""
        try:
            self._socket = self._opened.enter_context(
                connect(self._url, open_timeout=ANSWER_WITHIN_S, compression=None)
            )
        except (OSError, InvalidHandshake, TimeoutError) as error:
            raise DriverError(f"cannot connect to {self._url}: {error}") from None
        self._thread.start()
        for operation, name, kind in (
            ("subscribe", "state/pose", "geometry_msgs/PoseStamped"),
            ("subscribe", "state/target", "geometry_msgs/PoseStamped"),
            ("subscribe", "result", "cardan_msgs/CommandResult"),
            ("advertise", "command/twist", "geometry_msgs/Twist"),
        ):
            self._send(op=operation, topic=f"{self.node}/{name}", type=kind)
        return self

    def __exit__(self, *_exception: object) -> None:
        self._opened.close()
        if self._socket is not None:
            self._thread.join()

    @property
    def moved_m(self) -> float:
        """Largest distance of the TCP from its first position."""
        with self._changed:
            seen = list(self.poses.values())
        return max((math.dist(each, seen[0]) for each in seen), default=0.0)

    @property
    def behind_m(self) -> float:
        """Largest distance between the measured and the commanded TCP at the same time."""
        with self._changed:
            both = self.poses.keys() & self.targets.keys()
            return max((math.dist(self.poses[at], self.targets[at]) for at in both), default=0.0)

    def refusals(self) -> list[str]:
        """Reasons of the commands that were refused although the connection was old enough."""
        reasons = [each["reason"] for each in self.results if each["outcome"] == "refused"]
        return [each for each in reasons if YOUNG not in each]

    def wait_until_seen(self) -> None:
        """Wait for the arm's state. Raises DriverError."""
        with self._changed:
            if not self._changed.wait_for(lambda: self.poses, ANSWER_WITHIN_S):
                raise DriverError(f"{self._url}: {self.node}/state/pose was not published")

    def drive(self, seconds: float, stop: threading.Event) -> None:
        """Move the arm in circles for `seconds`, or until `stop`; then brake it.

        Raises DriverError if the session or its server is gone or does not answer.
        """
        self.wait_until_seen()
        until_s = time.monotonic() + ANSWER_WITHIN_S
        while not self.refusals():
            self._publish(0.0, 0.0)
            if stop.wait(ASK_AGAIN_S) or time.monotonic() > until_s:
                raise DriverError(f"{self.node}: a twist without a preset was not refused")
        self._say(f"client: result: a twist was refused: {self.refusals()[0]}")
        values = [
            {"name": "stream_timeout", "value": {"type": 3, "double_value": PAUSE_S}},
            {"name": "preset_streaming_cmd", "value": {"type": 4, "string_value": "twist"}},
        ]
        while reason := self._set(values):
            if stop.wait(ASK_AGAIN_S) or time.monotonic() > until_s:
                raise DriverError(f"{self.node}: no stream of twists: {reason}")
        self._say("client: parameter preset_streaming_cmd is twist")
        began_s = time.monotonic()
        while (now_s := time.monotonic() - began_s) < seconds and not stop.is_set():
            left_s = max(0.0, min(now_s, seconds - now_s))
            speed, angle = SPEED_M_S * min(1.0, left_s / RAMP_S), math.tau * now_s / CIRCLE_S
            self._publish(speed * math.cos(angle), speed * math.sin(angle))
            stop.wait(PUBLISH_PERIOD_S)
        self._say(
            f"client: {self.sent} twists streamed in {time.monotonic() - began_s:.1f} s; "
            f"TCP moved by up to {1e3 * self.moved_m:.1f} mm, at most {1e3 * self.behind_m:.1f} mm "
            "away from its command"
        )
        answer = self._call("stop", {})
        self._say(f"client: service stop: {'done' if answer['success'] else answer['message']}")

    def _set(self, values: Sequence[Mapping[str, Any]]) -> str:
        """Set parameters; return the reason of the first refusal, or ""."""
        results = self._call("set_parameters", {"parameters": values})["results"]
        return next((each["reason"] for each in results if not each["successful"]), "")

    def _publish(self, y_m_s: float, z_m_s: float) -> None:
        linear = {"x": 0.0, "y": y_m_s, "z": z_m_s}
        twist = {"linear": linear, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
        self._send(op="publish", topic=f"{self.node}/command/twist", msg=twist)
        self.sent += 1

    def _call(self, service: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
        name = f"{self.node}/{service}"
        self._send(op="call_service", id=name, service=name, args=values)
        with self._changed:
            if not self._changed.wait_for(lambda: name in self._answers, ANSWER_WITHIN_S):
                raise DriverError(f"{name} did not answer")
            answer = self._answers.pop(name)
        if not answer["result"]:
            raise DriverError(f"{name}: {answer['values']}")
        found: Mapping[str, Any] = answer["values"]
        return found

    def _send(self, **operation: Any) -> None:
        assert self._socket is not None
        try:
            self._socket.send(json.dumps(operation))
        except (ConnectionClosed, OSError) as error:
            raise DriverError(f"{self._url} was closed: {error}") from None

    def _receive(self) -> None:
        assert self._socket is not None
        with contextlib.suppress(ConnectionClosed, OSError):
            for frame in self._socket:
                self._take(json.loads(frame))

    def _take(self, operation: Mapping[str, Any]) -> None:
        kind, message = operation["op"], operation.get("msg")
        with self._changed:
            if kind == "service_response":
                self._answers[operation["id"]] = operation
            elif kind == "publish" and message is not None and "outcome" in message:
                self.results.append(message)
            elif kind == "publish" and message is not None:
                stamp, at = message["header"]["stamp"], message["pose"]["position"]
                stamp_ns = stamp["sec"] * 10**9 + stamp["nanosec"]
                measured = operation["topic"].endswith("/pose")
                seen = self.poses if measured else self.targets
                seen[stamp_ns] = (at["x"], at["y"], at["z"])
            self._changed.notify_all()
