"""Nodes that share a Zenoh session appear and leave independently."""

import itertools
import threading

import pytest

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.protocols.ros2.interfaces import revised
from tests.serving import free_endpoint
from tests.waiting import WITHIN_S, until

pytestmark = pytest.mark.matrix

TIMEOUT_S = WITHIN_S
TRIGGER = "std_srvs/srv/Trigger"


@pytest.fixture
def pair():
    endpoint = free_endpoint()
    listener = BusOptions(router="", listen=(endpoint,))
    with (
        BusNetwork(listener, "server") as server,
        BusNetwork(BusOptions(router=endpoint), "other") as other,
    ):
        until(lambda: "/server" in other.nodes() and "/other" in server.nodes())
        yield server, other


def test_a_part_is_a_node_of_its_own_that_takes_all_with_it(pair):
    server, other = pair
    retained = server.advertise("/chatter", "std_msgs/msg/String", latched=False)
    part = server.part("client")
    part.advertise("/chatter", "std_msgs/msg/String", latched=False)
    own = part.advertise("/wave", "std_msgs/msg/String", latched=False)
    served = part.serve("/ready", TRIGGER, lambda _request, _answer: None)
    until(lambda: "/client" in other.nodes() and "/ready" in other.services())
    assert other.topics()["/wave"].publishers == ("/client",)
    part.close()
    until(lambda: "/client" not in other.nodes() and "/ready" not in other.services())
    assert "/wave" not in other.topics()
    assert other.topics()["/chatter"].publishers == ("/server",)
    for each in (part, own, served, retained):
        each.close()


def test_a_subscription_hears_every_revision_of_its_type_once(pair):
    server, other = pair
    name = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
    old = other.advertise("/old", name, latched=False)
    new = other.advertise("/new", revised(name), latched=False)
    until(lambda: {"/old", "/new"} <= server.topics().keys())
    assert {server.topics()[each].type for each in ("/old", "/new")} == {name}
    heard = []
    hears = [
        server.subscribe(topic, kind, lambda data, _stamp: heard.append(data))
        for topic, kind in (("/old", name), ("/new", name))
    ]
    until(lambda: other.topics()["/old"].subscribers and other.topics()["/new"].subscribers)
    numbers = itertools.count()

    def both_are_heard():
        # A subscriber may be known before data is routed to it.
        number = next(numbers)
        old.publish(b"old %d" % number)
        new.publish(b"new %d" % number)
        return {each[:3] for each in heard} == {b"old", b"new"}

    until(both_are_heard)
    old.publish(b"end")
    until(lambda: b"end" in heard)
    assert len(heard) == len(set(heard))
    for each in (*hears, old, new):
        each.close()


@pytest.mark.real
def test_a_part_sees_the_whole_graph(pair):
    server, _ = pair
    part = server.part("client")
    assert "/other" in part.nodes()
    assert part.wait_for_service("/nothing", 0.0) is False
    part.close()


def test_the_graph_is_looked_through_once_until_it_changes(pair):
    server, other = pair
    part = server.part("client")
    first = other.advertise("/chatter", "std_msgs/msg/String", latched=False)
    served = other.serve("/ready", TRIGGER, lambda _request, _answer: None)
    until(lambda: "/chatter" in server.topics() and "/ready" in server.services())
    until(lambda: "/client" in other.nodes())
    until(lambda: server.topics() is server.topics() is part.topics())
    until(lambda: server.services() is server.services() is part.services())
    second = other.advertise("/wave", "std_msgs/msg/String", latched=True)
    until(lambda: "/wave" in part.topics())
    assert server.topics()["/wave"].latched
    for each in (first, second, served):
        each.close()
    until(lambda: not {"/chatter", "/wave"} & set(part.topics()))
    until(lambda: "/ready" not in part.services())
    part.close()


def test_what_is_left_open_when_the_network_is_closed_can_still_be_closed(pair):
    server, _ = pair
    part = server.part("client")
    publisher = part.advertise("/wave", "std_msgs/msg/String", latched=False)
    server.close()
    publisher.close()
    part.close()
    part.close()


def test_a_client_of_a_service_is_on_the_bus_as_one_while_its_node_is(pair):
    server, other = pair
    answered = threading.Semaphore(0)
    served = other.serve("/ready", TRIGGER, lambda _request, answer: answer(b"\0\1\0\0"))
    assert server.wait_for_service("/ready", TIMEOUT_S)
    for _ in range(3):
        server.call("/ready", TRIGGER, b"\0\1\0\0\0", lambda _reply: answered.release(), TIMEOUT_S)
    for _ in range(3):
        assert answered.acquire(timeout=TIMEOUT_S)
    with other._lock:
        clients = [each for each in other._graph.entities("SC") if each.full_node == "/server"]
    assert [each.name for each in clients] == ["/ready"]
    served.close()
