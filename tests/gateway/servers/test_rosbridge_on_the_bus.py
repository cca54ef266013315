"""The rosbridge server on Zenoh: messages of other nodes reach a client, and vice versa."""

from __future__ import annotations

import threading

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from tests.gateway.servers.bench import WAIT_S, plain_client, rosbridge
from tests.serving import free_endpoint
from tests.waiting import until

pytestmark = pytest.mark.matrix

STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"


def encoded(name, **fields):
    return codec_of(name).encode(completed(name, fields))


def repeat(publisher, over):
    while not over.wait(0.02):
        publisher.publish(encoded(STRING, data="hello"))


@pytest.fixture
def nodes():
    """A robot's node and the server's node, after they have discovered each other."""
    endpoint = free_endpoint()
    with (
        BusNetwork(BusOptions(router="", listen=(endpoint,)), "robot") as robot,
        BusNetwork(BusOptions(router=endpoint, listen=()), "rosbridge") as server,
    ):
        until(lambda: "/robot" in server.nodes() and "/rosbridge" in robot.nodes())
        yield robot, server


@pytest.mark.real
def test_a_client_meets_a_node_on_the_bus(nodes):
    robot, server = nodes
    speaker = robot.advertise("/chatter", STRING, False)
    description = robot.advertise("/robot_description", STRING, True)
    description.publish(encoded(STRING, data="<robot/>"))
    stop = robot.serve(
        "/stop",
        TRIGGER,
        lambda _request, answered: answered(
            encoded(f"{TRIGGER}_Response", success=True, message="stopped")
        ),
    )
    heard = []
    listening = robot.subscribe("/cmd", STRING, lambda cdr, _stamp_ns: heard.append(cdr))
    until(lambda: {"/chatter", "/robot_description"} <= server.topics().keys())
    until(lambda: "/stop" in server.services())
    with rosbridge(server) as running, plain_client(running) as client:
        client.send("subscribe", topic="/robot_description", type=STRING)
        assert client.receive()["msg"] == {"data": "<robot/>"}
        client.send("subscribe", topic="/chatter")
        client.settle()
        # A subscription appears in the graph a moment before messages reach it.
        repeated = threading.Event()
        repeating = threading.Thread(target=repeat, args=(speaker, repeated))
        repeating.start()
        assert client.receive()["msg"] == {"data": "hello"}
        repeated.set()
        repeating.join()
        client.send("unsubscribe", topic="/chatter")
        client.settle()
        client.heard.clear()
        assert client.call("/stop")["values"] == {"success": True, "message": "stopped"}
        client.send("advertise", topic="/cmd", type="std_msgs/String")
        client.settle()
        until(lambda: "/rosbridge_client_1" in robot.topics()["/cmd"].publishers)
        client.send("publish", topic="/cmd", msg={"data": "go"})
        until(lambda: heard)
        assert codec_of(STRING).decode(heard[0]) == {"data": "go"}
        client.send("advertise_service", service="/mine", type="std_srvs/SetBool")
        client.settle()
        until(lambda: "/mine" in robot.services())
        answers, there = [], threading.Event()
        request = encoded("std_srvs/srv/SetBool_Request", data=True)
        robot.call(
            "/mine",
            "std_srvs/srv/SetBool",
            request,
            lambda reply: (answers.append(reply), there.set()),
            WAIT_S,
        )
        asked = client.receive()
        client.send("service_response", id=asked["id"], service="/mine", values={"message": "ok"})
        assert there.wait(WAIT_S)
        assert codec_of("std_srvs/srv/SetBool_Response").decode(answers[0])["message"] == "ok"
    until(lambda: "/mine" not in robot.services())
    until(lambda: "/rosbridge_client_1" not in robot.topics()["/cmd"].publishers)
    for each in (stop, listening, speaker, description):
        each.close()
