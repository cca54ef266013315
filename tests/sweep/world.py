"""The session of the sweep, in a separate process, and actions that make it publish on every
topic."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, get_args

from cardan.bus.node import BusNode, MatchedEndpoints
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.bus.compatibility import NamesOf
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan.protocols.ros2.zenoh import SERVICE
from tests.network_table import ACTION_PARTS, Kind, Row
from tests.serving import ARM_SESSION, session_on_the_network
from tests.sweep.plan import NAMESPACE, NODE, RESULT, RUMBLED
from tests.waiting import WITHIN_S, until

SESSION = f"""
[device]
driver = "ros2_joy"
topic = "/stick"
feedback_topic = "/stick/set_feedback"
wait_for_device = true
router = "{{endpoint}}"
listen = []
{ARM_SESSION}
other_names = {[*get_args(NamesOf)]}
device = true
"""
TIMEOUT_S = WITHIN_S
FEED_PERIOD_S = 0.03
MOVE_PERIOD_S = 0.3
JOY = "sensor_msgs/msg/Joy"
SET, ASK = "rcl_interfaces/srv/SetParameters", "cardan_msgs/srv/Ask"
RESULT_TYPE = "cardan_msgs/msg/CommandResult"
STATUS = "cardan_msgs/msg/ArmStatus"
RUMBLE = "sensor_msgs/msg/JoyFeedback"


@contextmanager
def statuses(endpoint: str) -> Iterator[Callable[[Callable[[Any], bool], str], Any]]:
    """Yield a function that waits for a status of the arm and returns it."""
    with BusNode(BusOptions(router=endpoint, listen=()), "waits") as node:
        heard = node.subscription(f"{NODE}/state/status", STATUS, 8)

        def await_status(found: Callable[[Any], bool], what: str) -> Any:
            def newest() -> Any:
                received = heard.poll()
                status = codec_of(STATUS).decode(received.data) if received is not None else None
                return status if status is not None and found(status) else None

            return until(newest, what)

        yield await_status


def rests(status: Any) -> bool:
    """True if the arm has come to rest."""
    return status["phase"] in ("holding", "disarmed")


def stamp_s(status: Any) -> float:
    """Stamp of a status, s since the epoch."""
    stamp = status["header"]["stamp"]
    return float(stamp["sec"] + 1e-9 * stamp["nanosec"])


def await_rest(endpoint: str) -> None:
    """Wait until the arm has come to rest."""
    with statuses(endpoint) as await_status:
        await_status(rests, "the rest")


class World:
    """A session with a simulated joystick, which its operator touches all the time."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        options = BusOptions(router=endpoint, listen=())
        self.network = BusNetwork(options, "watcher")
        # The driver connects to it directly, as a separate Zenoh session.
        self.node = BusNode(BusOptions(router=endpoint, listen=("tcp/127.0.0.1:0",)), "stick")
        self.moving = threading.Event()
        """While this is set, the arm moves to and fro, and a parameter changes."""
        self._over = threading.Event()
        self._servers: dict[str, MatchedEndpoints] = {}
        self._threads = [threading.Thread(target=each) for each in (self._feed, self._move)]

    def open(self) -> None:
        self.network.open()
        self.node.open()
        self._publisher = self.node.publisher("/stick", JOY)
        self._feedback = self.node.subscription("/stick/set_feedback", RUMBLE, 4)
        self._results = self.node.publisher(RESULT, RESULT_TYPE)
        for each in self._threads:
            each.start()

    def wait(self, wanted: set[Row]) -> set[Row]:
        """Return the session's rows once they equal `wanted`, or after TIMEOUT_S."""
        until_s = time.monotonic() + TIMEOUT_S
        while (found := self.rows()) != wanted and time.monotonic() < until_s:
            threading.Event().wait(0.02)
        return found

    def close(self) -> None:
        self._over.set()
        for each in self._threads:
            if each.ident is not None:
                each.join()
        self.node.close()
        self.network.close()

    def _feed(self) -> None:
        count = 0
        while not self._over.wait(FEED_PERIOD_S):
            count += 1
            now_ns = time.time_ns()
            # A key without a function counts as operator activity.
            message = {"axes": [0.0] * 8, "buttons": [*[0] * 11, int(count % 20 < 2)]}
            self._publisher.put(codec_of(JOY).encode(completed(JOY, message)), now_ns)
            while self._feedback.poll() is not None:
                reported = {"command": RUMBLED, "outcome": "done", "success": True}
                self._results.put(
                    codec_of(RESULT_TYPE).encode(completed(RESULT_TYPE, reported)), now_ns
                )

    def _move(self) -> None:
        count = 0
        while not self._over.wait(MOVE_PERIOD_S):
            if not self.moving.is_set():
                continue
            count += 1
            way = 0.01 if count % 2 else -0.01
            gain = {"type": 3, "double_value": 1.0 + 0.01 * (count % 50)}
            # Network and packets are two sources; each releases the arm for the other.
            self._ask(count, "release")
            self._call("set_parameters", SET, {"parameters": [{"name": "gain", "value": gain}]})
            self._call("release", "std_srvs/srv/Trigger", {})
            self._ask(count, "relj", value=[0, 0, way, 0, 0, 0])

    def choose(self, stream: str) -> None:
        """Select a streaming command for all senders, once the arm rests."""
        chosen = {"type": 4, "string_value": stream}
        # A busy computer makes gaps; after a silence the stream would have to be selected again.
        patient = {"type": 3, "double_value": 0.5}
        parameters = [
            {"name": "stream_timeout", "value": patient},
            {"name": "preset_streaming_cmd", "value": chosen},
        ]
        self._call("release", "std_srvs/srv/Trigger", {})
        # An earlier, killed source keeps the arm until its lease ends.
        with statuses(self.endpoint) as await_status:
            await_status(lambda status: not status["authority"], "that nobody has the arm")
        answer = self._call("set_parameters", SET, {"parameters": parameters})
        assert all(each["successful"] for each in answer["results"]), answer

    def rest(self) -> None:
        """Wait until the arm has come to rest after any motion."""
        await_rest(self.endpoint)

    def _ask(self, number: int, verb: str, **more: Any) -> None:
        packet = {"id": number, "source": "stick", "verb": verb, **more}
        self._call("ask", ASK, {"request": json.dumps(packet)})

    def _call(self, service: str, kind: str, request: dict[str, Any]) -> Any:
        """Call a service of a discovered server once; return the response, or None if there is no
        server."""
        # If no server is known, Zenoh reports at once that there is no reply.
        servers = self._servers.get(service)
        if servers is None:
            servers = self._servers[service] = self.node.presence(SERVICE, f"{NODE}/{service}")
        until(servers.others, f"a server of {service}")
        client = self.node.client(f"{NODE}/{service}", kind)
        name = f"{kind}_Request"
        reply = client.call(codec_of(name).encode(completed(name, request)), TIMEOUT_S)
        client.close()
        return None if reply is None else codec_of(f"{kind}_Response").decode(reply)

    def rows(self) -> set[Row]:
        """Return the session's rows in the graph, by the names in the table."""

        def own(name: str) -> str:
            if name.startswith(f"{NODE}/"):
                return f"~{name[len(NODE) :]}"
            return name.removeprefix(f"{NAMESPACE}/")

        found = set()
        for name, topic in self.network.topics().items():
            if ACTION_PARTS in name:
                continue
            kinds: list[Kind] = []
            if NODE in topic.publishers:
                kinds.append("published")
            if NODE in topic.subscribers:
                kinds.append("taken")
            found |= {Row(own(name), kind, topic.type) for kind in kinds}
        for name, service in self.network.services().items():
            if NODE not in service.servers:
                continue
            if ACTION_PARTS not in name:
                found.add(Row(own(name), "service", service.type))
            elif name.endswith("/send_goal"):
                kind = service.type.removesuffix("_SendGoal")
                found.add(Row(own(name.partition(ACTION_PARTS)[0]), "action", kind))
        return found


@contextmanager
def world(folder) -> Iterator[World]:
    """A running session."""
    with session_on_the_network(folder, SESSION) as endpoint:
        found = World(endpoint)
        try:
            found.open()
            yield found
        finally:
            found.close()
