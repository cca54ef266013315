"""Messages sent faster than a server can handle them are dropped, not executed late."""

import json
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from cardan.demos.pauses import Pauses
from cardan.gateway.arm.backlog import STALE_S
from tests.gateway.servers.bench import plain_client, rosbridge
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.waiting import STOOD_STILL, done_again, until

pytestmark = pytest.mark.matrix

TWIST, EMPTY = "geometry_msgs/msg/Twist", "std_msgs/msg/Empty"
STALLED_S = STALE_S + 0.3
HANDLED_S = 0.1
"""Time within which a message that was read in time is published."""


def stall(running):
    """Block a server's loop for a moment; return once it is blocked."""
    begun = threading.Event()

    def sleep():
        begun.set()
        time.sleep(STALLED_S)

    running.loop.call_soon_threadsafe(sleep)
    assert begun.wait(20.0)


def test_what_waited_while_the_server_was_busy_is_dropped_but_for_a_stop():
    network = MemoryNetwork()
    with rosbridge(network) as running, plain_client(running) as client:
        client.send("advertise", topic="/cmd", type=TWIST)
        client.send("advertise", topic="/arm/command/stop", type=EMPTY)
        client.settle()
        stall(running)
        client.send("publish", topic="/cmd", msg={"linear": {"x": 1}})
        client.send("publish", topic="/arm/command/stop", msg={})
        client.settle()
        assert [topic for topic, _ in network.published] == ["/arm/command/stop"]
        assert running.server.counts["stale"] == 1
        client.send("publish", topic="/cmd", msg={"linear": {"x": 2}})
        client.settle()
        assert network.published[-1][1]["linear"]["x"] == 2.0


def test_a_message_in_fragments_that_waited_is_dropped():
    network = MemoryNetwork()
    with rosbridge(network) as running, plain_client(running) as client:
        client.send("advertise", topic="/cmd", type=TWIST)
        client.settle()
        text = json.dumps({"op": "publish", "topic": "/cmd", "msg": {"linear": {"x": 1}}})
        stall(running)
        for number, part in enumerate((text[:20], text[20:])):
            client.send("fragment", id="1", data=part, num=number, total=2)
        client.settle()
        assert network.published == []
        assert running.server.counts["stale"] == 1


def test_calls_and_goals_that_waited_are_refused_but_for_what_ends_something():
    network, called = MemoryNetwork(), []
    trigger, stat = "std_srvs/srv/Trigger", "cardan_msgs/srv/Stat"
    for name, kind in (("movl", trigger), ("stop", trigger), ("stat", stat)):
        network.offer(f"/arm/{name}", kind, lambda _asked, name=name: called.append(name) or {})
    fibonacci = "example_interfaces/action/Fibonacci"
    with rosbridge(network) as running, plain_client(running) as client:
        client.settle()
        stall(running)
        for name in ("movl", "stop", "stat"):
            client.send("call_service", service=f"/arm/{name}", id=name)
        client.send("send_action_goal", action="/fib", action_type=fibonacci, args={}, id="goal")
        answers = {}
        while len(answers) < 4:
            reported = client.receive()
            if reported["op"] in ("service_response", "action_result"):
                answers[reported["id"]] = reported
        assert called == ["stop", "stat"]
        assert "not executed" in str(answers["movl"]["values"])
        assert "not executed" in str(answers["goal"]["values"])
        assert client.call("/arm/movl")
        assert called[-1] == "movl"


FLOOD = """
import socket, sys, time
sending = socket.socket(fileno=int(sys.argv[1]))
portion = bytes.fromhex(sys.stdin.read())
until_s = ended_s = time.monotonic() + float(sys.argv[2])
try:
    while time.monotonic() < until_s:
        sending.sendall(portion)
        ended_s = time.monotonic()
except OSError:
    pass
print(ended_s)
"""
"""A separate process, because a thread would share the interpreter with the server's."""


@contextmanager
def flood(client, seconds):
    """Publish as fast as possible, in another process; yields a function that returns the time of
    the last byte."""
    text = json.dumps({"op": "publish", "topic": "/cmd", "msg": {"linear": {"x": 0.1}}})
    portion = 200 * Frame(Opcode.TEXT, text.encode()).serialize(mask=True)
    number = client.connection.socket.fileno()
    with subprocess.Popen(
        [sys.executable, "-c", FLOOD, str(number), str(seconds)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        pass_fds=[number],
    ) as process:
        process.stdin.write(portion.hex())
        process.stdin.close()
        yield lambda: float(process.stdout.read())


def test_a_client_that_sends_more_than_can_be_handled_is_disconnected_with_the_reason():
    network = MemoryNetwork()
    with rosbridge(network) as running, plain_client(running) as client:
        client.send("advertise", topic="/cmd", type=TWIST)
        client.settle()
        with flood(client, 15.0) as ended:
            with pytest.raises(ConnectionClosed) as closed:
                client.connection.recv(timeout=20.0)
            until(lambda: running.server.clients == 0)
            began_s = time.monotonic()
            assert ended() < began_s + 10.0
        assert closed.value.rcvd is not None, "closed without a reason"
        assert "send less" in closed.value.rcvd.reason
        assert running.server.counts["backlogged"] == 1
        assert running.server.counts["stale"] > 0


@pytest.mark.parametrize("seconds", [0.5, 1.2, 2.0])
def test_nothing_is_published_late_after_a_flood_has_ended(seconds):
    def published_late():
        """Delay of the newest published message, s; and the reason if this run does not count, or
        ""."""
        network = MemoryNetwork()
        with Pauses() as pauses, rosbridge(network) as running, plain_client(running) as client:
            client.send("advertise", topic="/cmd", type=TWIST)
            client.settle()
            newest_s = [0.0]
            network.send = lambda *_given: newest_s.__setitem__(0, time.monotonic())
            with flood(client, seconds) as ended:
                ended_s = ended()
            try:
                client.settle()
            except (ConnectionClosed, OSError):  # the flooding client was disconnected
                until(lambda: running.server.clients == 0)
            assert network.published
        late_s = newest_s[0] - ended_s - STALE_S
        paused = late_s >= HANDLED_S and pauses.longest_s >= 0.5 * HANDLED_S
        return late_s, f"this computer {STOOD_STILL} {pauses.longest_s:.2f} s" if paused else ""

    late_s, _ = done_again(published_late, reason=lambda reported: reported[1])
    assert late_s < HANDLED_S
