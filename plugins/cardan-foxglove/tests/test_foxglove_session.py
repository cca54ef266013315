"""A session, ``cardan net server foxglove`` and a client in separate processes."""

from __future__ import annotations

import signal
import socket
import struct
from types import SimpleNamespace

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")
pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from foxglove_pair import foxglove_client
from tests.programs import Program
from tests.serving import free_tcp_port, session_on_the_network

pytestmark = pytest.mark.matrix

ARM = "/left/arm"
STATUS = "cardan_msgs/msg/ArmStatus"
MOVE = "cardan_msgs/srv/MoveTwist"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Run the server; return its address."""
    port = str(free_tcp_port())
    with (
        session_on_the_network(tmp_path_factory.mktemp("foxglove")) as endpoint,
        Program("net", "server", "foxglove", "--router", endpoint, "--port", port) as program,
    ):
        program.wait_for(f"READY ws://127.0.0.1:{port}\n")
        yield SimpleNamespace(port=int(port))
        assert program.end(signal.SIGTERM) == 0


def decoded(kind, said):
    return codec_of(kind).decode(said["data"])


def test_the_arm_is_seen_with_all_it_publishes(server):
    with foxglove_client(server) as client:
        description = client.message(client.subscribe("/left/robot_description"))
        assert "<robot" in decoded("std_msgs/msg/String", description)["data"]
        states = decoded(
            "sensor_msgs/msg/JointState", client.message(client.subscribe("/left/joint_states"))
        )
        assert len(states["position"]) == 6
        transforms = decoded("tf2_msgs/msg/TFMessage", client.message(client.subscribe("/tf")))
        assert transforms["transforms"]


def test_parameters_of_the_arm_are_seen_set_and_refused(server):
    with foxglove_client(server) as client:
        client.service(f"{ARM}/set_parameters_atomically")
        name = f"{ARM}.trajectory_reference_speed"
        client.send("subscribeParameterUpdates", parameterNames=[name])
        before = {each["name"]: each["value"] for each in client.get()}
        assert before[name] > 0.0
        assert client.set(name=name, value=0.125)[0]["value"] == 0.125
        reported = client.until(
            lambda said: said["parameters"] == [{"name": name, "type": "float64", "value": 0.125}],
            op="parameterValues",
        )
        assert "id" not in reported
        assert client.set(name=name, value=1e9)[0]["value"] == 0.125
        client.status("allowed")


@pytest.mark.real
def test_a_motion_without_end_ends_with_the_client_that_asked_for_it(server):
    with foxglove_client(server) as watcher:
        status = watcher.subscribe(f"{ARM}/state/status")
        watcher.message(status)
        with foxglove_client(server) as client:
            client.service(f"{ARM}/movv")
            request = completed(f"{MOVE}_Request", {"xdot": {"linear": {"z": -0.01}}})
            answer = client.call(f"{ARM}/movv", codec_of(f"{MOVE}_Request").encode(request))
            assert codec_of(f"{MOVE}_Response").decode(answer["data"])["success"], answer
            watcher.until(lambda said: decoded(STATUS, said)["moving"], subscription=status)
            watcher.heard.clear()
            for _ in range(25):  # Half a second, while the client is connected.
                assert decoded(STATUS, watcher.message(status))["moving"]
            reset = struct.pack("ii", 1, 0)
            client.connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
            client.connection.socket.close()
        watcher.until(lambda said: not decoded(STATUS, said)["moving"], subscription=status)
