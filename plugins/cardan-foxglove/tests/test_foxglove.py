"""The Foxglove server on an in-process network, with our own client."""

from __future__ import annotations

import json
import logging
import socket
import struct
import sys
import threading
from contextlib import suppress

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from cardan.bus.network import Failure
from cardan.errors import ExtraMissingError
from cardan.gateway.servers.connection import FREE_BYTES
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import full_text
from cardan.protocols.ros2.messages import completed
from cardan_foxglove import client as module
from cardan_foxglove.server import FoxgloveServer
from foxglove_pair import foxglove_client, foxglove_server
from tests.gateway.servers.bench import WAIT_S
from tests.gateway.servers.memory_network import TEST_NODE, MemoryNetwork
from tests.gateway.servers.nodes import Parameters
from tests.waiting import until

pytestmark = pytest.mark.matrix

POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"
EVENT = "rcl_interfaces/msg/ParameterEvent"
TOKEN = "0123456789abcdef-token"


def encoded(name, **fields):
    return codec_of(name).encode(completed(name, fields))


@pytest.fixture
def network():
    network = MemoryNetwork()
    network.known["/chatter"] = STRING
    return network


@pytest.fixture
def running(network):
    with foxglove_server(network) as server:
        yield server


@pytest.fixture
def client(running):
    with foxglove_client(running) as each:
        yield each


def listening(network, topic):
    return [each for each in network.subscriptions if each[0] == topic]


def test_without_the_sdk_the_server_says_what_to_install(network, monkeypatch):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(ExtraMissingError, match=r"pip install .cardan\[foxglove\]"):
        FoxgloveServer(network)


# -- topics to the client -------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_both_names_of_the_protocol_are_served(running, name):
    with foxglove_client(running, subprotocol=name) as client:
        assert client.connection.subprotocol == name
        assert {"clientPublish", "services", "parameters", "parametersSubscribe"} <= set(
            client.info["capabilities"]
        )
        assert {"connectionGraph", "assets"} <= set(client.info["capabilities"])
        assert client.info["supportedEncodings"] == ["cdr", "json"]


def test_a_channel_has_the_type_and_its_full_definition(network, client):
    network.known["/state/pose"] = POSE
    channel = client.channel("/state/pose")
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", POSE)
    assert (channel["schemaEncoding"], channel["schema"]) == ("ros2msg", full_text(POSE))


def test_a_message_comes_as_it_is(network, client):
    number = client.subscribe("/chatter")
    until(lambda: listening(network, "/chatter"))
    network.publish("/chatter", STRING, stamp_ns=1_700_000_000_123_456_789, data="x")
    said = client.message(number)
    assert said["data"] == encoded(STRING, data="x")
    assert said["time"] == 1_700_000_000_123_456_789
    client.unsubscribe(number)
    until(lambda: not listening(network, "/chatter"))


def test_topics_come_and_go(network, client):
    network.known["/new"] = STRING
    first = client.channel("/new")["id"]
    network.known["/new"] = POSE
    client.until(op="unadvertise", channelIds=[first])
    assert client.channel("/new")["schemaName"] == POSE
    del network.known["/new"]
    client.until(op="unadvertise")
    assert "/new" not in client.channels


def test_what_cannot_be_shown_is_left_out(network):
    network.known.update({"/odd": "acme_msgs/msg/Odd", "/move/_action/status": STRING})
    network.known.update({"/secret": STRING, "/last": STRING})
    network.offer("/secret/stop", TRIGGER, lambda request: {})
    network.offer("/stop", TRIGGER, lambda request: {})
    network.offer("/odd/stop", "std_srvs/srv/Trigger", lambda request: {})
    name, _, asked = network.servers["/odd/stop"][0], None, network.servers["/odd/stop"][2]
    network.servers["/odd/stop"] = ("acme_msgs/srv/Odd", TEST_NODE, asked)
    assert name
    allowed = {"topics": ("/[clo]*",), "services": ("/stop", "/odd*")}
    with foxglove_server(network, **allowed) as running, foxglove_client(running) as client:
        client.channel("/last")
        client.service("/stop")
        client.settle()
        assert set(client.channels) == {"/chatter", "/last"}
        assert set(client.services) == {"/stop"}


def test_a_topic_is_subscribed_to_once_for_all_clients(network, running):
    with foxglove_client(running) as one, foxglove_client(running) as other:
        first, second = one.subscribe("/chatter"), other.subscribe("/chatter")
        subscriptions = running.server._shared_subscriptions._shared
        until(lambda: subscriptions and len(next(iter(subscriptions.values())).receivers) == 2)
        assert len(listening(network, "/chatter")) == 1
        network.publish("/chatter", STRING, data="x")
        assert one.message(first)["data"] == other.message(second)["data"]
    until(lambda: not listening(network, "/chatter"))


def test_late_clients_get_what_is_latched_each_once(network, running):
    network.latch("/robot_description", STRING, data="<robot/>")
    with foxglove_client(running) as one, foxglove_client(running) as late:
        first = one.subscribe("/robot_description")
        assert one.message(first)["data"] == encoded(STRING, data="<robot/>")
        second = late.subscribe("/robot_description")
        assert late.message(second)["data"] == encoded(STRING, data="<robot/>")
        one.settle()
        assert not [each for each in one.heard if each["op"] == "message"]
    until(lambda: not listening(network, "/robot_description"))


def test_a_topic_that_becomes_latched_begins_with_its_last_message(network, client):
    number = client.subscribe("/chatter")
    until(lambda: listening(network, "/chatter"))
    network.latched["/chatter"] = encoded(STRING, data="last")
    assert client.message(number)["data"] == encoded(STRING, data="last")


def test_the_connection_graph_has_all_nodes(network, client):
    network.offer("/stop", TRIGGER, lambda request: {})
    client.service("/stop")
    client.send("subscribeConnectionGraph")
    graph = client.until(op="connectionGraphUpdate")
    assert {"name": "/chatter", "publisherIds": [TEST_NODE]} in graph["publishedTopics"]
    assert {"name": "/stop", "providerIds": [TEST_NODE]} in graph["advertisedServices"]


def test_the_time_of_a_simulation_is_the_clients_time(network):
    network.known["/clock"] = "rosgraph_msgs/msg/Clock"
    with foxglove_server(network) as running, foxglove_client(running) as client:
        assert "time" in client.info["capabilities"]
        until(lambda: listening(network, "/clock"))
        network.publish("/clock", "rosgraph_msgs/msg/Clock", clock={"sec": 5, "nanosec": 6})
        assert client.until(op="time")["time"] == 5_000_000_006


def test_without_a_clock_messages_have_their_own_times(client):
    assert "time" not in client.info["capabilities"]


# -- topics from the client -----------------------------------------------------------------------


def test_a_client_publishes_cdr_as_it_is_and_json(network, client):
    cdr = encoded(TWIST, header={"frame_id": "base"}, twist={"linear": {"x": 0.5}})
    client.publish(client.advertise("/cmd", TWIST), cdr)
    until(lambda: network.published)
    topic, message = network.published.pop()
    assert (topic, message["twist"]["linear"]["x"]) == ("/cmd", 0.5)
    text = json.dumps({"twist": {"linear": {"x": 0.25}}}).encode()
    client.publish(client.advertise("/cmd", "geometry_msgs/TwistStamped", "json"), text)
    until(lambda: network.published)
    _, message = network.published.pop()
    assert message["twist"]["linear"]["x"] == 0.25
    assert message["header"]["stamp"]["sec"] > 1_000_000_000, (
        "a missing stamp is set to the present time"
    )


def test_an_advertisement_ends_with_the_last_of_its_topic(network, client):
    one, other = client.advertise("/cmd", STRING), client.advertise("/cmd", STRING, "json")
    until(lambda: len(network.publishers) == 1)
    client.send("unadvertise", channelIds=[one])
    client.publish(other, b'{"data": "x"}')
    until(lambda: network.published)
    client.send("unadvertise", channelIds=[other])
    until(lambda: not network.publishers)


@pytest.mark.parametrize(
    ("topic", "kind", "encoding", "words"),
    [
        ("/chatter", POSE, "cdr", f"/chatter is of type {STRING}, not {POSE}"),
        ("/x", "acme_msgs/msg/Odd", "cdr", "acme_msgs/msg/Odd"),
        ("/x", "", "cdr", ""),
        ("/x", STRING, "protobuf", "'protobuf' is not read here"),
        ("/secret", STRING, "cdr", "not among the topics"),
        ("/a b", STRING, "cdr", "/a b"),
    ],
)
def test_what_cannot_be_advertised_is_asked_to_the_client(network, topic, kind, encoding, words):
    with (
        foxglove_server(network, topics=("/x", "/chatter", "/a*")) as running,
        foxglove_client(running) as client,
        foxglove_client(running) as other,
    ):
        number = client.advertise(topic, kind, encoding)
        assert client.status(words)["level"] == 2
        client.publish(number, encoded(STRING, data="x"))
        client.status(f"nothing is advertised as channel {number}")
        other.settle()
        assert not [each for each in other.heard if each.get("id") in (topic, f"channel {number}")]
    assert not network.published


@pytest.mark.parametrize(
    ("encoding", "data", "words"),
    [
        ("cdr", b"", "begins with nothing"),
        ("cdr", b"\x00\x01\x00\x00\x05\x00", "no std_msgs/msg/String"),
        ("cdr", encoded(STRING, data="x") + b"more", "no std_msgs/msg/String"),
        ("json", b"{", "is not JSON"),
        ("json", b"\xff\xfe", "is not JSON"),
        ("json", b"[" * 100_000, "is not JSON"),
        ("json", b'{"datum": 1}', "datum"),
        ("json", b'{"data": 1}', "data"),
    ],
)
def test_messages_that_are_none_are_asked_to_the_client(network, client, encoding, data, words):
    number = client.advertise("/x", STRING, encoding)
    client.publish(number, data)
    client.status(words)
    assert not network.published


def test_a_flood_is_cut_off(network, running, monkeypatch):
    monkeypatch.setattr(module, "MAX_PUBLICATIONS_PER_S", 50)
    network.send = lambda *_given: None  # Otherwise the server would receive its own messages.
    with foxglove_client(running) as client:
        number = client.advertise("/x", STRING)
        for _ in range(1000):
            client.publish(number, encoded(STRING, data="x"))
        client.status("more than 50 messages in a second; the others are lost")
        client.settle()
        assert len(network.published) < 1000
        assert len([each for each in client.heard if each["op"] == "status"]) < 10, "reported once"


def test_what_is_no_operation_is_reported_and_ends_nothing(client):
    for frame in ("no json", "[]", json.dumps({"op": "dance"}), b"\x09", b""):
        client.connection.send(frame)
    client.send("subscribe", subscriptions=[{"id": 1, "channelId": 4_000_000_000}])
    client.send("subscribe", subscriptions="all")
    client.send("getParameters", parameterNames=7)
    client.status("Unknown channel")
    client.settle()


# -- services -------------------------------------------------------------------------------------


def test_a_service_has_the_definitions_of_both_sides(network, client):
    network.offer("/stop", TRIGGER, lambda request: {"success": True, "message": "stopped"})
    service = client.service("/stop")
    assert service["type"] == TRIGGER
    assert service["request"]["schema"] == full_text(f"{TRIGGER}_Request")
    assert service["response"]["schemaName"] == f"{TRIGGER}_Response"
    for request in (encoded(f"{TRIGGER}_Request"), b"\x00\x01\x00\x00"):
        answer = client.call("/stop", request)
        assert answer["encoding"] == "cdr"
        assert codec_of(f"{TRIGGER}_Response").decode(answer["data"])["message"] == "stopped"
    del network.servers["/stop"]
    client.until(op="unadvertiseServices")


def test_a_call_that_fails_says_why(network):
    network.offer("/stop", TRIGGER, lambda request: Failure("the arm is not there"))
    network.offer("/set", "std_srvs/srv/SetBool", lambda request: {})
    network.offer("/mute", TRIGGER, lambda request: None)
    with (
        foxglove_server(network, service_timeout_s=0.2) as running,
        foxglove_client(running) as client,
    ):
        failure = client.call("/stop", encoded(f"{TRIGGER}_Request"))
        assert "the arm is not there" in failure["message"]
        failure = client.call("/set", b"\x00\x01\x00\x00\x01\x02\x03")
        assert "no std_srvs/srv/SetBool_Request" in failure["message"]
        assert "ncoding" in client.call("/set", b"{}", b"json")["message"]


def test_a_call_that_waits_stops_nobody(network, running):
    """The SDK has one thread per core: none may wait for a node."""
    waiting = threading.Event()
    network.offer("/mute", TRIGGER, lambda request: waiting.set())
    kind = "rcl_interfaces/srv/ListParameters"
    network.offer(f"{TEST_NODE}/list_parameters", kind, lambda request: None)
    with foxglove_client(running) as one, foxglove_client(running) as other:
        service = one.service("/mute")["id"]
        for number in range(8):
            one.connection.send(b"\x02" + struct.pack("<III", service, number, 3) + b"cdr\0\1\0\0")
            one.send("getParameters", parameterNames=[], id=f"{number}")
        assert waiting.wait(WAIT_S)
        number = other.subscribe("/chatter")
        until(lambda: listening(network, "/chatter"))
        network.publish("/chatter", STRING, data="x")
        other.message(number)
        number = one.subscribe("/chatter")
        subscriptions = running.server._shared_subscriptions._shared
        until(lambda: len(next(iter(subscriptions.values())).receivers) == 2)
        network.publish("/chatter", STRING, data="y")
        assert one.message(number)["data"] == encoded(STRING, data="y")


# -- parameters -----------------------------------------------------------------------------------


@pytest.fixture
def parameters(network):
    return Parameters(
        network,
        speed={"type": 3, "double_value": 0.5},
        count={"type": 2, "integer_value": 7},
        frame={"type": 4, "string_value": "base"},
        raw={"type": 5, "byte_array_value": b"abc"},
        gains={"type": 8, "double_array_value": [1.0, 2.5]},
        names={"type": 9, "string_array_value": ["a", "b"]},
        odd={"type": 3, "double_value": float("nan")},
        fixed={"type": 1, "bool_value": True},
    )


def test_parameters_are_got_by_name_and_all_at_once(parameters, client):
    assert client.get("/arm.speed", "/arm.frame", "/arm.none") == [
        {"name": "/arm.speed", "type": "float64", "value": 0.5},
        {"name": "/arm.frame", "value": "base"},
    ]
    found = {each.pop("name"): each for each in client.get()}
    assert found["/arm.raw"] == {"type": "byte_array", "value": "YWJj"}
    assert found["/arm.gains"] == {"type": "float64_array", "value": [1.0, 2.5]}
    assert found["/arm.names"] == {"value": ["a", "b"]}
    assert found["/arm.fixed"] == {"value": True}
    assert "/arm.odd" not in found, "JSON has no such number"


def test_parameters_are_set_and_what_they_are_then_is_answered(parameters, client):
    now = client.set(name="/arm.speed", value=1)
    assert now == [{"name": "/arm.speed", "type": "float64", "value": 1.0}]
    assert parameters.values["speed"]["double_value"] == 1.0
    assert client.set(name="/arm.raw", value="eHl6", type="byte_array")[0]["value"] == "eHl6"
    assert parameters.values["raw"]["byte_array_value"] == b"xyz"
    assert client.set(name="/arm.gains", value=[3, 4], type="float64_array")
    assert parameters.values["gains"]["double_array_value"] == [3.0, 4.0]


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ({"name": "/arm.fixed", "value": False}, "/arm.fixed: it is fixed"),
        ({"name": "/arm.raw", "value": "?", "type": "byte_array"}, "not base64"),
        ({"name": "/arm.gains", "value": {"a": 1}}, "not a value of a parameter"),
        ({"name": "/nobody.x", "value": 1}, "there is no node /nobody with parameters"),
        ({"name": "speed", "value": 1}, "names no parameter"),
    ],
)
def test_a_parameter_that_cannot_be_set_so(parameters, client, parameter, words):
    before = dict(parameters.values)
    client.set(**parameter)
    client.status(words)
    assert parameters.values == before


def test_changes_keep_their_order(parameters, client):
    for number in range(50):
        given = [{"name": "/arm.count", "value": number}]
        client.send("setParameters", parameters=given, id=f"{number}")
    answers = [client.until(op="parameterValues", id=f"{number}") for number in range(50)]
    assert [each["parameters"][0]["value"] for each in answers] == list(range(50))


def test_changes_are_asked_to_those_who_subscribed(network, parameters, running):
    with foxglove_client(running) as one, foxglove_client(running) as other:
        one.send("subscribeParameterUpdates", parameterNames=["/arm.speed", "/arm.names"])
        one.settle()
        speed = {"name": "speed", "value": {"type": 3, "double_value": 2.0}}
        count = {"name": "count", "value": {"type": 2, "integer_value": 9}}
        names = {"name": "names", "value": {"type": 9, "string_array_value": ["c"]}}
        network.publish(
            "/parameter_events", EVENT, node=TEST_NODE, changed_parameters=[speed, count, names]
        )
        reported = one.until(op="parameterValues")["parameters"]
        assert {each["name"]: each["value"] for each in reported} == {
            "/arm.speed": 2.0,
            "/arm.names": ["c"],
        }
        one.send("unsubscribeParameterUpdates", parameterNames=["/arm.speed", "/arm.names"])
        one.settle()
        network.publish("/parameter_events", EVENT, node=TEST_NODE, changed_parameters=[speed])
        other.settle()
        one.settle()
        assert not [each for each in one.heard + other.heard if each["op"] == "parameterValues"]


def test_parameters_that_clients_may_not_use(network, parameters):
    with (
        foxglove_server(network, parameters=("/arm:speed",)) as running,
        foxglove_client(running) as client,
    ):
        assert [each["name"] for each in client.get()] == ["/arm.speed"]
        assert client.get("/arm.frame") == []
        client.status("not among the parameters")
        client.set(name="/arm.frame", value="tool")
        assert parameters.values["frame"]["string_value"] == "base"
        assert not [name for name in client.services if "parameters" in name]


# -- assets ---------------------------------------------------------------------------------------


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "src"
    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>acme_description</name></package>")
    (folder / "meshes" / "base link.stl").write_bytes(b"solid")
    (folder / "secrets.txt").write_text("secret")
    (tmp_path / "outside.stl").write_bytes(b"outside")
    (folder / "meshes" / "out.stl").symlink_to(tmp_path / "outside.stl")
    (folder / "meshes" / "round.stl").symlink_to(folder / "meshes" / "round.stl")
    (folder / "meshes" / "folder.stl").mkdir()
    return str(folder)


def test_meshes_of_a_package_and_nothing_else(network, package):
    with (
        foxglove_server(network, packages=(package,)) as running,
        foxglove_client(running) as client,
    ):
        for path in ("base link.stl", "base%20link.stl", "../meshes/base link.stl"):
            got = client.asset(f"package://acme_description/meshes/{path}")
            assert (got.error, got.data) == (None, b"solid")
        for uri, words in (
            ("package://acme_description/../outside.stl", "outside its package"),
            ("package://acme_description/%2e%2e/outside.stl", "outside its package"),
            ("package://acme_description//etc/passwd", "neither a mesh"),
            ("package://acme_description/meshes/out.stl", "outside its package"),
            ("package://acme_description/meshes/round.stl", ""),
            ("package://acme_description/meshes/folder.stl", "a directory"),
            ("package://acme_description/meshes/none.stl", "No such file"),
            ("package://acme_description/secrets.txt", "neither a mesh"),
            ("package://acme_description/package.xml", "neither a mesh"),
            ("package://acme_description/a%00.stl", "is not a path"),
            ("package://acme_description", "neither a mesh"),
            ("package://../outside.stl", "there is no package"),
            ("file:///etc/passwd", "only package://"),
            ("/etc/passwd", "only package://"),
            ("", "only package://"),
        ):
            refused = client.asset(uri)
            assert words in (refused.error or "nothing was refused"), uri
            assert not refused.data, uri


# -- access control -------------------------------------------------------------------------------


def refusal(running, path="/", **options):
    """Return the HTTP status of a refused request."""
    options = {"subprotocols": ["foxglove.sdk.v1"], **options}
    with (
        pytest.raises(InvalidStatus) as refused,
        connect(f"ws://127.0.0.1:{running.port}{path}", **options),
    ):
        pass
    return refused.value.response.status_code


def test_the_front_has_rosbridges_rules(network, caplog):
    caplog.set_level(logging.DEBUG)
    with foxglove_server(network, token=TOKEN, origins=("https://app.foxglove.dev",)) as running:
        assert refusal(running) == 401
        assert refusal(running, f"/?t={TOKEN}x") == 401
        assert refusal(running, f"/?t={TOKEN}", origin="https://evil.example") == 403
        assert refusal(running, f"/?t={TOKEN}", subprotocols=None) == 400
        for path in (f"/?t={TOKEN}", f"/{TOKEN}"):
            with foxglove_client(running, path, origin="https://app.foxglove.dev") as client:
                client.settle()
    said = [each for each in caplog.records if each.name != "websockets.client"]
    assert not [each for each in said if "0123456789" in each.getMessage() + str(each.exc_info)]


def hidden(running):
    """Return the SDK's server for the only client."""
    (client,) = running.server._clients
    return client


@pytest.mark.parametrize("does", ["advertises", "subscribes", "calls"])
def test_who_finds_the_way_behind_the_front_gets_nothing(network, running, does):
    called = []
    network.offer("/go", TRIGGER, lambda request: called.append(request) or {})
    with foxglove_client(running) as client:
        number = client.subscribe("/chatter")
        until(lambda: listening(network, "/chatter"))
        inner = hidden(running)
        host, port = inner._inner.remote_address[:2]
        assert host.startswith("127.")
        assert host != "127.0.0.1"
        with connect(f"ws://{host}:{port}", subprotocols=["foxglove.sdk.v1"]) as intruder:
            if does == "advertises":
                channel = {"id": 1, "topic": "/cmd", "encoding": "cdr", "schemaName": STRING}
                intruder.send(json.dumps({"op": "advertise", "channels": [channel]}))
                intruder.send(b"\x01" + struct.pack("<I", 1) + encoded(STRING, data="go"))
            elif does == "subscribes":
                asked = {"id": 1, "channelId": client.channels["/chatter"]["id"]}
                intruder.send(json.dumps({"op": "subscribe", "subscriptions": [asked]}))
            else:
                service = client.service("/go")["id"]
                intruder.send(b"\x02" + struct.pack("<III", service, 1, 3) + b"cdr\0\1\0\0")
            received = []
            with suppress(ConnectionClosed):
                while True:
                    received.append(intruder.recv(WAIT_S))
        assert not [each for each in received if each[:1] == b"\x01"]
        with pytest.raises(ConnectionClosed):
            client.message(number)
    assert running.server.counts["denied"] >= 1
    assert not called
    assert not network.published
    until(lambda: not listening(network, "/chatter"))


# -- slow clients, and clients that leave ---------------------------------------------------------


class Parts(MemoryNetwork):
    """A network that records the parts opened and closed."""

    def __init__(self):
        super().__init__()
        self.opened, self.closed = [], []

    def part(self, name):
        self.opened.append(name)
        return Part(self, name)


class Part:
    def __init__(self, whole, name):
        self._whole, self._name = whole, name

    def __getattr__(self, name):
        return getattr(self._whole, name)

    def close(self):
        self._whole.closed.append(self._name)


@pytest.mark.parametrize("how", ["says farewell", "vanishes"])
def test_a_client_that_leaves_takes_all_it_had(how):
    network = Parts()
    network.known["/chatter"] = STRING
    network.offer("/mute", TRIGGER, lambda request: None)
    with foxglove_server(network) as running:
        with foxglove_client(running) as client:
            client.publish(client.advertise("/cmd", STRING), encoded(STRING, data="x"))
            client.subscribe("/chatter")
            service = client.service("/mute")["id"]
            client.connection.send(b"\x02" + struct.pack("<III", service, 1, 3) + b"cdr\0\1\0\0")
            until(lambda: network.published and listening(network, "/chatter"))
            until(lambda: network.called)
            assert network.opened == ["foxglove_client_1"]
            inner = hidden(running)
            address = inner._inner.remote_address[:2]
            if how == "vanishes":
                reset = struct.pack("ii", 1, 0)
                client.connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
                client.connection.socket.close()
        until(lambda: network.closed == ["foxglove_client_1"])
        assert not network.publishers
        assert not listening(network, "/chatter")
        assert running.server.clients == 0
        with pytest.raises(OSError, match="refused"):
            socket.create_connection(address, WAIT_S)


def test_a_client_that_reads_slowly_harms_nobody_and_gets_the_newest(network, running):
    kind = "sensor_msgs/msg/JointState"
    network.known["/joints"] = kind
    big = [0.0] * 2000
    with foxglove_client(running) as quick, foxglove_client(running, max_queue=1) as slow:
        numbers = [each.subscribe("/joints") for each in (quick, slow)]
        subscriptions = running.server._shared_subscriptions._shared
        until(lambda: subscriptions and len(next(iter(subscriptions.values())).receivers) == 2)
        for number in range(1000):
            network.publish("/joints", kind, stamp_ns=number, position=big)
            assert quick.message(numbers[0])["time"] == number
        until(lambda: any(each._sender.outbox.superseded > 100 for each in running.server._clients))
        times = [slow.message(numbers[1])["time"]]
        while times[-1] != 999:
            times.append(slow.message(numbers[1])["time"])
        assert times == sorted(times)
        assert len(times) < 900


def test_all_that_is_latched_waits_for_a_slow_client(network, running):
    """Each publisher of /tf_static has its own last message."""
    network.latch("/tf_static", "tf2_msgs/msg/TFMessage")
    with foxglove_client(running) as client:
        number = client.subscribe("/tf_static")
        client.message(number)
        inner = hidden(running)
        assert inner._streams[number].delivery == module.ALL


def test_a_client_with_too_many_subscriptions(client):
    many = [{"id": each, "channelId": 1} for each in range(module.MAX_SUBSCRIPTIONS)]
    client.send("subscribe", subscriptions=many)
    client.send("subscribe", subscriptions=[{"id": 5000, "channelId": 1}])
    client.status("more than 1000 subscriptions")


def test_an_asset_that_is_read_slowly_closes_nobody(network, package, tmp_path):
    with open(f"{package}/meshes/big.stl", "wb") as file:
        file.write(bytes(9_000_000))
    with (
        foxglove_server(network, packages=(package,)) as running,
        foxglove_client(running) as client,
    ):
        for number in range(6):
            uri = "package://acme_description/meshes/big.stl"
            client.send("fetchAsset", uri=uri, requestId=number)
        got = [client.until(op="asset", request=number) for number in range(6)]
        assert [len(each["data"]) for each in got] == [9_000_000] * 6
        client.settle()


def test_what_is_large_leaves_room_for_pings(network, package):
    """A mesh takes long over a radio link; a ping queued behind it would time out."""
    with open(f"{package}/meshes/big.stl", "wb") as file:
        file.write(bytes(3_000_000))
    with (
        foxglove_server(network, packages=(package,)) as running,
        connect(
            f"ws://127.0.0.1:{running.port}", subprotocols=["foxglove.sdk.v1"], max_size=None
        ) as connection,
    ):
        uri = "package://acme_description/meshes/big.stl"
        connection.send(json.dumps({"op": "fetchAsset", "uri": uri, "requestId": 1}))
        whole = []
        while len(whole) < 2:
            whole = list(connection.recv_streaming(decode=False))
        assert max(map(len, whole)) <= FREE_BYTES
        assert sum(map(len, whole)) == 3_000_000 + 10
