"""Permissions of viewers and operators at each server."""

from __future__ import annotations

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.gateway.servers.read_only import READING_SERVICES
from cardan.protocols.ros2.interfaces import service_type
from tests.gateway.servers.bench import plain_client, rosbridge
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.gateway.servers.nodes import MOVE, Mover, Parameters

pytestmark = pytest.mark.matrix

STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"
VIEWER, OPERATOR, ADMIN = "viewers-0123456789", "operators-0123456789", "admins-0123456789"
ROLES = {"viewer": VIEWER, "operator": OPERATOR, "admin": ADMIN}
COMMANDING = [each for each in ROLES if each != "viewer"]


@pytest.fixture
def token_file(tmp_path):
    path = tmp_path / "tokens"
    path.write_text("".join(f"{word} {token}\n" for word, token in ROLES.items()))
    path.chmod(0o600)
    return str(path)


@pytest.fixture
def network():
    network = MemoryNetwork()
    network.known["/chatter"] = STRING
    network.done = []
    network.offer("/stop", TRIGGER, lambda request: network.done.append(request) or {})
    network.parameters = Parameters(network, speed={"type": 3, "double_value": 0.5})
    network.mover = Mover(network)
    return network


def speed(network):
    return network.parameters.values["speed"]["double_value"]


# -- rosbridge ------------------------------------------------------------------------------------


@pytest.fixture
def bridge(network, token_file):
    with rosbridge(network, token_file=token_file) as running:
        yield lambda role: plain_client(running, f"/?t={ROLES[role]}")


def test_a_viewer_of_rosbridge_reads(network, bridge):
    with bridge("viewer") as client:
        client.send("subscribe", topic="/chatter", type=STRING)
        client.settle()
        network.publish("/chatter", STRING, data="hello")
        assert client.receive()["msg"] == {"data": "hello"}
        asked = client.call("/rosapi/get_param", {"name": "/arm:speed"})
        assert asked["values"]["value"] == "0.5"
        assert client.call("/arm/list_parameters")["result"]


@pytest.mark.real("asked3-call /stop")
@pytest.mark.parametrize(
    ("asked", "may_not"),
    [
        ({"op": "advertise", "topic": "/chatter", "type": STRING}, "publish on /chatter"),
        ({"op": "publish", "topic": "/chatter", "msg": {"data": "x"}}, "publish on /chatter"),
        ({"op": "advertise_service", "service": "/mine", "type": TRIGGER}, "offer /mine"),
        ({"op": "call_service", "service": "/stop"}, "call /stop"),
        (
            {"op": "call_service", "service": "/arm/set_parameters", "args": {}},
            "call /arm/set_parameters",
        ),
        (
            {"op": "send_action_goal", "action": "/move", "action_type": MOVE, "args": {}},
            "call /move/_action/send_goal",
        ),
    ],
)
def test_a_viewer_of_rosbridge_commands_nothing(network, bridge, asked, may_not):
    with bridge("viewer") as client:
        client.send("set_level", level="error")
        client.send(id="1", **asked)
        said = str(client.receive())
        assert f"a viewer may not {may_not}" in said
        assert "the token of an operator" in said
    assert (network.published, network.done, network.mover.goals) == ([], [], [])
    assert speed(network) == 0.5


def test_a_viewer_stops_an_arm_and_nothing_else(network, bridge):
    """Stopping needs no authority. Another node's Trigger service may command, whatever its
    name."""
    stopped = []
    for service in ("/arm/stop", "/arm/enable"):
        network.offer(
            service, TRIGGER, lambda request: stopped.append(request) or {"success": True}
        )
    network.offer("/arm/stat", "cardan_msgs/srv/Stat", lambda _request: {})
    with bridge("viewer") as client:
        assert client.call("/arm/stop")["values"]["success"]
        for service in ("/arm/enable", "/stop"):
            assert f"a viewer may not call {service}" in str(client.call(service))
    assert (len(stopped), network.done) == (1, [])


def test_a_viewer_of_rosbridge_sets_no_parameters(network, bridge):
    with bridge("viewer") as client:
        for service, args in (
            ("set_param", {"name": "/arm:speed", "value": "1.0"}),
            ("delete_param", {"name": "/arm:speed"}),
        ):
            values = client.call(f"/rosapi/{service}", args)["values"]
            assert not values["successful"]
            assert "a viewer may not call /arm/set_parameters" in values["reason"]
    assert speed(network) == 0.5


@pytest.mark.parametrize("role", COMMANDING)
def test_others_of_rosbridge_command(network, bridge, role):
    with bridge(role) as client:
        client.send("advertise", topic="/chatter", type=STRING)
        client.send("publish", topic="/chatter", msg={"data": "go"})
        assert client.call("/stop")["result"]
        asked = client.call("/rosapi/set_param", {"name": "/arm:speed", "value": "1.0"})
        assert asked["values"]["successful"]
    assert network.published == [("/chatter", {"data": "go"})]
    assert network.done
    assert speed(network) == 1.0


# -- services known to change nothing -------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(READING_SERVICES))
def test_services_for_viewers_are_known(name):
    assert service_type(name).name == name
