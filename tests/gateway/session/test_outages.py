"""Messages that a rosbridge client published while the server was down move nothing afterwards:
roslibpy stores all of them and sends the oldest first."""

from __future__ import annotations

import math
import subprocess
import sys
import time

import pytest

pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
pytest.importorskip("cbor2", reason='cbor2 is not installed: "cardan[network]"')
pytest.importorskip("roslibpy", reason='roslibpy is not installed: "cardan[test]"')

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from tests.serving import free_tcp_port, session_on_the_network
from tests.waiting import until

pytestmark = pytest.mark.matrix

TIMEOUT_S = 30.0
SPEED_M_S = 0.1
RESTS_S = 0.3
MOVED_M = 1e-3
"""Least distance that counts as a motion."""

CLIENT = """
import sys, time
import roslibpy

ros = roslibpy.Ros("127.0.0.1", int(sys.argv[1]))
ros.factory.set_initial_delay(0.1)
ros.factory.set_max_delay(0.1)
ros.run(30)
topic = roslibpy.Topic(ros, sys.argv[2], sys.argv[3])
topic.advertise()

def tell(word):
    print(word, flush=True)

def publish(number, period_s, speed_m_s):
    for _ in range(number):
        stamp_s, twist = time.time(), {"linear": {"x": 0, "y": 0, "z": speed_m_s}}
        if "Stamped" in sys.argv[3]:
            stamp = {"sec": int(stamp_s), "nanosec": int(stamp_s % 1 * 1e9)}
            twist = {"header": {"stamp": stamp, "frame_id": "base_link"}, "twist": twist}
        topic.publish(roslibpy.Message(twist))
        time.sleep(period_s)

tell("connected")
for line in sys.stdin:
    word, *numbers = line.split()
    if word == "publish":
        publish(int(numbers[0]), *map(float, numbers[1:]))
    elif word == "lost":
        while ros.is_connected:
            time.sleep(0.01)
    elif word == "back":
        ros.get_time()  # Asked after all that was published, and answered after it.
    tell(word)
"""


class Client:
    """A program with roslibpy that publishes twists on one topic."""

    def __init__(self, process):
        self._process = process
        self.hear("connected")

    def hear(self, word):
        assert self._process.stdout.readline().strip() == word

    def do(self, word, *numbers):
        print(word, *numbers, file=self._process.stdin, flush=True)
        self.hear(word)


class Watcher:
    """A node that watches the arm."""

    def __init__(self, node):
        self._node = node
        self._stat = node.client("/left/arm/stat", "cardan_msgs/srv/Stat")
        self._result = node.subscription("/left/arm/result", "cardan_msgs/msg/CommandResult", 500)

    def where(self):
        """Measured position of the TCP, m."""
        kind = "cardan_msgs/srv/Stat"
        request = codec_of(f"{kind}_Request").encode(completed(f"{kind}_Request", {}))
        reply = self._stat.call(request, TIMEOUT_S)
        found = None if reply is None else codec_of(f"{kind}_Response").decode(reply)
        return found and found["success"] and tuple(found["pose"]["pose"]["position"].values())

    def results(self):
        codec = codec_of("cardan_msgs/msg/CommandResult")
        return [codec.decode(each.data) for each in iter(self._result.poll, None)]

    def settled(self):
        """Position of the arm after it has been at rest for a moment."""
        last = until(self.where, "an answer")
        for _ in range(100):
            time.sleep(RESTS_S)
            before, last = last, until(self.where, "an answer")
            if math.dist(before, last) < 1e-5:
                return last
        raise AssertionError("it does not come to rest")


@pytest.fixture(scope="module")
def watcher(tmp_path_factory):
    names = 'other_names = ["servo", "cmd_vel"]\n'
    with (
        session_on_the_network(tmp_path_factory.mktemp("session"), more=names) as endpoint,
        BusNode(BusOptions(router=endpoint, listen=()), "watcher") as node,
    ):
        found = Watcher(node)
        found.endpoint = endpoint
        until(found.where, "the arm")
        yield found


class Server:
    """A `cardan net server rosbridge` that stops and starts again at the same port."""

    def __init__(self, endpoint):
        self.port = free_tcp_port()
        arguments = ("net", "server", "rosbridge", "--router", endpoint, "--port", str(self.port))
        self._command = [sys.executable, "-m", "cardan", *arguments]
        self._process = None

    def start(self):
        self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout.readline().startswith("READY")

    def end(self):
        with self._process:
            self._process.terminate()


@pytest.fixture
def server(watcher):
    server = Server(watcher.endpoint)
    server.start()
    yield server
    server.end()


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("servo_node/delta_twist_cmds", "geometry_msgs/TwistStamped"),
        ("cmd_vel", "geometry_msgs/Twist"),
    ],
    ids=["stamped", "unstamped"],
)
def test_what_was_published_during_an_outage_moves_nothing(watcher, server, topic, kind):
    command = [sys.executable, "-c", CLIENT, str(server.port), f"/left/{topic}", kind]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            client = Client(process)
            # Before the first outage the arm has received nothing from this client.
            for number, speed_m_s in ((50, SPEED_M_S), (50, -SPEED_M_S), (1, SPEED_M_S)):
                server.end()
                client.do("lost")
                before = watcher.settled()
                client.do("publish", number, 2.0 / number, speed_m_s)
                server.start()
                client.do("back")
                assert math.dist(watcher.settled(), before) < MOVED_M, watcher.results()
                client.do("publish", 50, 0.02, speed_m_s)
                assert math.dist(watcher.settled(), before) > MOVED_M, watcher.results()
        finally:
            process.kill()
