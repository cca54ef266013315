"""Two clients or nodes stream at the same time, on each network: one moves the arm."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack, contextmanager

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan_dds import server as dds_server
from cardan_dds.server import DdsBridgeOptions, DdsServerOptions
from tests.dds_network import OPTIONS, network as dds_node
from tests.gateway.bus.test_liveness import served as session
from tests.gateway.servers.bench import plain_client, rosbridge
from tests.waiting import until

pytestmark = pytest.mark.matrix

TOPIC, TWIST = "/servo_node/delta_twist_cmds", "geometry_msgs/msg/TwistStamped"
PERIOD_S = 0.02
SHARE = 0.25
"""Fraction of MoveIt Servo's full speed, which makes 0.1 m/s."""


def fields(share, stamp_ns=0):
    stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
    header = {"stamp": stamp, "frame_id": "base_link"}
    return {"header": header, "twist": {"linear": {"z": share}}}


def encoded(share, stamp_ns=0):
    return codec_of(TWIST).encode(completed(TWIST, fields(share, stamp_ns)))


class Streaming:
    """A client that publishes at 50 Hz until it ends."""

    def __init__(self, publish, share):
        self._publish, self._share, self._over = publish, share, threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._over.wait(PERIOD_S):
            self._publish(self._share)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_exception):
        self._over.set()
        self._thread.join()


class Zenoh:
    """Two nodes on Zenoh itself."""

    def __init__(self, here, stack):
        self.here, self.stack = here, stack

    def join(self, name):
        node = self.stack.enter_context(BusNetwork(BusOptions(router=self.here.endpoint), name))
        until(lambda: f"/{DEFAULT_NAME}" in node.nodes())
        publisher = node.advertise(TOPIC, TWIST, False)
        return lambda share: publisher.publish(encoded(share)), None

    def source(self, name, number):
        return f"ros2 /{name}"


class Rosbridge:
    """Two connections to a rosbridge server."""

    def __init__(self, here, stack):
        self.bus = stack.enter_context(BusNetwork(BusOptions(router=here.endpoint), "rosbridge"))
        until(lambda: f"/{DEFAULT_NAME}" in self.bus.nodes())
        self.server, self.stack = stack.enter_context(rosbridge(self.bus)), stack

    def join(self, name):
        client = self.stack.enter_context(plain_client(self.server))
        client.send("set_level", level="error")
        client.send("advertise", topic=TOPIC, type=TWIST)
        client.settle()

        def reported(words):
            while True:
                frame = client.receive()
                if frame["op"] == "status" and words in frame["msg"]:
                    return frame["level"] == "error"

        return lambda *what: client.send("publish", topic=TOPIC, msg=fields(*what)), reported

    def source(self, name, number):
        return f"ros2 /rosbridge_client_{number}"


class Dds:
    """Two nodes on DDS, through the bridge."""

    def __init__(self, here, stack):
        pytest.importorskip("cyclonedds", reason="cyclonedds: pip install cardan[dds]")
        stack.enter_context(bridge(here))
        self.stack = stack

    def join(self, name):
        node = self.stack.enter_context(dds_node(name))
        until(lambda: TOPIC in node.topics())
        publisher = node.advertise(TOPIC, TWIST, False)
        until(lambda: publisher.heard)
        return lambda share: publisher.publish(encoded(share)), None

    def source(self, name, number):
        return f"ros2 /{name}"


@contextmanager
def bridge(here):
    stop, ready = threading.Event(), threading.Event()
    options = DdsServerOptions(
        bus=BusOptions(router=here.endpoint),
        dds=OPTIONS,
        bridge=DdsBridgeOptions(services=("*",)),
    )
    thread = threading.Thread(
        target=dds_server.Dds.serve, args=(options, lambda _endpoint: ready.set(), stop)
    )
    thread.start()
    try:
        assert ready.wait(20.0)
        yield
    finally:
        stop.set()
        thread.join()


class Joined:
    """Resources of a client until it leaves."""

    def __init__(self, transport, name):
        self._stack = ExitStack()
        transport.stack, before = self._stack, transport.stack
        self.publish, self.reported = transport.join(name)
        transport.stack = before

    def leave(self):
        self._stack.close()

    def __enter__(self):
        return self

    def __exit__(self, *_exception):
        self.leave()


def height(here):
    pose = here.session.controller.status().pose
    return None if pose is None else pose.position.z


def owner(here):
    return here.session.controller.authority.owner


@pytest.mark.parametrize("transport", [Zenoh, Rosbridge, Dds])
def test_the_first_moves_the_arm_and_the_second_is_refused_and_informed(transport):
    with session() as here, ExitStack() as stack:
        over = transport(here, stack)
        first, _ = over.join("joystick")
        second, reported = over.join("script")
        mine = over.source("joystick", 1)
        with Streaming(first, -SHARE):
            until(lambda: owner(here) == mine)
            with Streaming(second, SHARE):
                refused = here.reported("refused", over.source("script", 2))
                before = height(here)
                until(lambda: height(here) < before - 0.1)
                assert owner(here) == mine
        assert refused["source"] == over.source("script", 2)
        assert refused["reason"] == f"twst: {mine!r} has authority over the arm"
        if reported is not None:
            assert reported("has authority over the arm")


@pytest.mark.parametrize("transport", [Rosbridge])
def test_a_client_whose_clock_is_not_known_yet_is_informed_once(transport):
    unknown = "the clock of its sender is not known yet"
    with session() as here, ExitStack() as stack:
        publish, reported = transport(here, stack).join("joystick")
        with Streaming(lambda share: publish(share, time.time_ns()), SHARE):
            assert reported(unknown)
            until(lambda: any(each["outcome"] == "accepted" for each in here.results))
        assert sum(unknown in each["reason"] for each in here.results) == 1


@pytest.mark.parametrize("transport", [Zenoh, Dds])
def test_a_node_that_was_restarted_goes_on_within_its_lease(transport):
    with session() as here, ExitStack() as stack:
        over = transport(here, stack)
        mine = over.source("joystick", 1)
        with Joined(over, "joystick") as first, Streaming(first.publish, -SHARE):
            until(lambda: owner(here) == mine)
        with Joined(over, "joystick") as again:
            before = height(here)
            with Streaming(again.publish, -SHARE):
                until(lambda: height(here) < before - 0.02)
                assert owner(here) == mine
        assert {each["source"] for each in here.results} == {mine}


@pytest.mark.parametrize("transport", [Zenoh, Rosbridge, Dds])
def test_another_one_moves_the_arm_after_the_lease_of_the_one_that_has_gone(transport):
    with session() as here, ExitStack() as stack:
        over = transport(here, stack)
        mine, others = over.source("joystick", 1), over.source("script", 2)
        with Joined(over, "joystick") as first:
            second, _ = over.join("script")
            with Streaming(first.publish, -SHARE):
                until(lambda: owner(here) == mine)
        until(lambda: here.rests)
        before = height(here)
        with Streaming(second, SHARE):
            assert here.reported("refused", others)
            until(lambda: owner(here) == others)
            until(lambda: height(here) > before + 0.02)
