"""The Foxglove server on the Zenoh bus: traffic from other nodes to a client, and back."""

from __future__ import annotations

import threading
import time

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan_foxglove.server import Foxglove, FoxgloveOptions, FoxgloveServerOptions
from foxglove_pair import foxglove_client
from tests.gateway.servers.bench import WAIT_S
from tests.gateway.servers.nodes import Parameters
from tests.serving import free_endpoint
from tests.waiting import until

pytestmark = pytest.mark.matrix

STRING, TRIGGER, TF = "std_msgs/msg/String", "std_srvs/srv/Trigger", "tf2_msgs/msg/TFMessage"


def encoded(name, **fields):
    return codec_of(name).encode(completed(name, fields))


class Served:
    """Run the server like ``cardan net server foxglove``, in a thread."""

    def __init__(self, endpoint):
        self.options = FoxgloveServerOptions(
            bus=BusOptions(router=endpoint, listen=()), server=FoxgloveOptions(port=0)
        )
        self.ready, self.stop = threading.Event(), threading.Event()
        self.thread = threading.Thread(target=self._serve)

    def _serve(self):
        Foxglove.serve(self.options, self._is_ready, self.stop)

    def _is_ready(self, endpoint):
        self.port = int(endpoint.rpartition(":")[2])
        self.ready.set()

    def __enter__(self):
        self.thread.start()
        assert self.ready.wait(WAIT_S)
        return self

    def __exit__(self, *_exception):
        self.stop.set()
        self.thread.join(WAIT_S)
        assert not self.thread.is_alive()


@pytest.fixture
def robot_and_server():
    """A robot's node and the server, after they have discovered each other."""
    endpoint = free_endpoint()
    with (
        BusNetwork(BusOptions(router="", listen=(endpoint,)), "arm") as robot,
        Served(endpoint) as server,
    ):
        until(lambda: "/foxglove" in robot.nodes())
        yield robot, server


@pytest.mark.real
def test_a_client_meets_a_node_on_the_bus(robot_and_server):
    robot, server = robot_and_server
    description = robot.advertise("/robot_description", STRING, True)
    description.publish(encoded(STRING, data="<robot/>"))
    moving = robot.advertise("/tf", TF, False)
    stopped = encoded(f"{TRIGGER}_Response", success=True, message="stopped")
    stop = robot.serve("/stop", TRIGGER, lambda _request, answered: answered(stopped))
    heard = []
    listening = robot.subscribe("/cmd", STRING, lambda cdr, _stamp_ns: heard.append(cdr))

    offered = []

    class Offering:
        """Services of the robot, with the interface of nodes within a test."""

        def offer(self, service, type_name, answer):
            kind = f"{type_name}_Request", f"{type_name}_Response"

            def asked(request, answered):
                answered(encoded(kind[1], **answer(codec_of(kind[0]).decode(request))))

            offered.append(robot.serve(service, type_name, asked))

    parameters = Parameters(Offering(), speed={"type": 3, "double_value": 0.5})
    with foxglove_client(server) as client:
        number = client.subscribe("/robot_description")
        assert client.message(number)["data"] == encoded(STRING, data="<robot/>")
        with foxglove_client(server) as late:
            number = late.subscribe("/robot_description")
            assert late.message(number)["data"] == encoded(STRING, data="<robot/>")
        number = client.subscribe("/tf")
        transform = {"child_frame_id": "tool0", "transform": {"translation": {"z": 0.5}}}
        sent = encoded(TF, transforms=[transform])
        # A subscription appears in the graph slightly before messages reach it.
        until(lambda: "/foxglove" in robot.topics()["/tf"].subscribers)
        over = threading.Event()

        def repeat():
            while not over.wait(0.02):
                moving.publish(sent)

        repeating = threading.Thread(target=repeat)
        repeating.start()
        said = client.message(number)
        over.set()
        repeating.join()
        assert said["data"] == sent
        assert abs(said["time"] - time.time_ns()) < WAIT_S * 1e9
        answer = client.call("/stop", encoded(f"{TRIGGER}_Request"))
        assert answer["data"] == stopped
        channel = client.advertise("/cmd", STRING)
        until(lambda: "/foxglove_client_1" in robot.topics()["/cmd"].publishers)
        client.publish(channel, encoded(STRING, data="go"))
        until(lambda: heard)
        assert heard[0] == encoded(STRING, data="go")
        client.service("/arm/set_parameters")
        client.set(name="/arm.speed", value=0.25)
        assert parameters.values["speed"]["double_value"] == 0.25
        assert client.get()[0]["value"] == 0.25
    # An endless motion requested by the client ends because its node has left the bus.
    until(lambda: "/foxglove_client_1" not in robot.nodes())
    until(lambda: "/foxglove_client_1" not in robot.topics()["/cmd"].publishers)
    for each in (stop, listening, moving, description, *offered):
        each.close()
