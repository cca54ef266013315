"""The rosbridge server on a network within the test, with a plain WebSocket client."""

from __future__ import annotations

import json
import logging
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from itertools import pairwise

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.sync.client import connect

from cardan.bus.network import Failure
from cardan.errors import OptionError

cbor2 = pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.gateway.servers import connection, rosbridge as server, rosbridge_client, web  # noqa: E402
from cardan.gateway.servers.rosbridge import RosbridgeOptions  # noqa: E402
from cardan.protocols.rosbridge.delivery import MAX_SUBSCRIPTIONS  # noqa: E402
from cardan.protocols.rosbridge.forms import EncodedMessage  # noqa: E402
from tests.gateway.servers.bench import WAIT_S, PlainClient, plain_client, rosbridge  # noqa: E402
from tests.gateway.servers.memory_network import SERVER, TEST_NODE, MemoryNetwork  # noqa: E402
from tests.gateway.servers.nodes import MOVE, Mover, Parameters  # noqa: E402
from tests.waiting import until  # noqa: E402

pytestmark = pytest.mark.matrix

POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Twist"
STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"


@pytest.fixture
def network():
    return MemoryNetwork()


@pytest.fixture
def running(network):
    with rosbridge(network) as server:
        yield server


@pytest.fixture
def client(running):
    with plain_client(running) as each:
        yield each


# -- topics ---------------------------------------------------------------------------------------


def test_a_subscription_hears_what_is_published(network, client):
    client.send("subscribe", topic="/state/pose", type="geometry_msgs/PoseStamped")
    client.settle()
    network.publish("/state/pose", POSE, pose={"position": {"x": 1}})
    said = client.receive()
    assert (said["op"], said["topic"]) == ("publish", "/state/pose")
    assert said["msg"]["pose"]["position"] == {"x": 1.0, "y": 0.0, "z": 0.0}
    client.send("unsubscribe", topic="/state/pose")
    client.settle()
    assert network.subscriptions == []


def test_the_topic_is_called_as_the_client_calls_it(network, client):
    client.subscribe("chatter")
    network.publish("/chatter", STRING, data="x")
    assert client.receive() == {"op": "publish", "topic": "chatter", "msg": {"data": "x"}}


def test_a_topic_is_subscribed_to_once_for_all_clients(network, running):
    with plain_client(running) as one, plain_client(running) as other:
        for each in (one, other):
            each.subscribe()
        assert len(network.subscriptions) == 1
        network.publish("/chatter", STRING, data="x")
        assert one.receive() == other.receive()
        one.send("unsubscribe", topic="/chatter")
        one.settle()
        network.publish("/chatter", STRING, data="y")
        assert other.receive()["msg"] == {"data": "y"}
    until(lambda: not network.subscriptions)


def test_what_is_latched_comes_to_every_subscription(network, running):
    network.latch("/robot_description", STRING, data="<robot/>")
    with plain_client(running) as one, plain_client(running) as other:
        for each in (one, other, one):
            each.subscribe("/robot_description")
            assert each.receive()["msg"] == {"data": "<robot/>"}
        network.publish("/robot_description", STRING, data="new")
        assert one.receive()["msg"] == {"data": "new"}
        one.settle()
        assert one.heard == [], "once for each client, however often it subscribed"
    until(lambda: not network.subscriptions)


def test_what_several_nodes_have_latched_comes_whole(network, client):
    """Each arm has its own latched message on /tf_static; no message replaces another arm's."""
    network.latch("/tf_static", STRING, data="one")
    client.subscribe("/tf_static", throttle_rate=50)
    for name in ("two", "three"):
        network.publish("/tf_static", STRING, data=name)
    assert [client.receive()["msg"]["data"] for _ in range(3)] == ["one", "two", "three"]


def test_several_subscriptions_are_one_stream_in_the_best_form(network, client):
    client.send("subscribe", id="1", topic="/chatter", type=STRING)
    client.send("subscribe", id="2", topic="/chatter", type=STRING, compression="cbor")
    client.settle()
    network.publish("/chatter", STRING, data="x")
    assert cbor2.loads(client.receive())["msg"] == {"data": "x"}
    client.send("unsubscribe", id="2", topic="/chatter")
    client.settle()
    network.publish("/chatter", STRING, data="y")
    assert client.receive()["msg"] == {"data": "y"}
    client.settle()
    assert client.heard == []


def test_raw_messages_need_no_type_not_even_a_known_one(network, client):
    network.known["/strange"] = "acme_msgs/msg/Odd"
    client.send("subscribe", topic="/strange", compression="cbor-raw")
    client.send("subscribe", topic="/not/yet", compression="cbor-raw")
    client.settle()
    for topic in ("/strange", "/not/yet"):
        network.send(topic, b"\x00\x01\x00\x00odd", 5_000_000_006)
        said = cbor2.loads(client.receive())
        assert said["msg"] == {"secs": 5, "nsecs": 6, "bytes": b"\x00\x01\x00\x00odd"}


def test_a_throttled_queue_is_emptied_in_time(network, client):
    client.subscribe(throttle_rate=50, queue_length=2)
    for number in range(5):
        network.publish("/chatter", STRING, data=str(number))
    begin_s = time.monotonic()
    assert [client.receive()["msg"]["data"] for _ in range(3)] == ["0", "3", "4"]
    assert time.monotonic() - begin_s > 0.09


def test_fragments_go_both_ways(network, client):
    client.subscribe(fragment_size=30)
    network.publish("/chatter", STRING, data="y" * 50)
    parts = [client.receive()]
    while len(parts) < parts[0]["total"]:
        parts.append(client.receive())
    assert {part["op"] for part in parts} == {"fragment"}
    assert [part["num"] for part in parts] == list(range(len(parts)))
    assert json.loads("".join(part["data"] for part in parts))["msg"] == {"data": "y" * 50}
    text = json.dumps({"op": "publish", "topic": "/chatter", "msg": {"data": "z"}})
    for number, data in enumerate((text[:20], text[20:])):
        client.send("fragment", id="f", num=number, total=2, data=data)
    client.settle()
    assert network.published == [("/chatter", {"data": "z"})]


@pytest.mark.real
def test_a_client_publishes(network, client):
    client.send("advertise", id="a", topic="/cmd", type="geometry_msgs/Twist", latch=True)
    client.send("publish", topic="/cmd", msg={"linear": {"x": 1}})
    client.settle()
    assert network.publishers == [("/cmd", TWIST, True)]
    assert network.published[0][1]["linear"] == {"x": 1.0, "y": 0.0, "z": 0.0}
    client.send("unadvertise", id="a", topic="/cmd")
    client.settle()
    assert network.publishers == []


def test_what_is_not_advertised_has_the_type_of_the_topic(network, client):
    network.known["/chatter"] = STRING
    client.send("publish", topic="/chatter", msg={"data": "x"})
    client.send("set_level", level="error")
    client.send("publish", id="p", topic="/nobody", msg={"data": "x"})
    client.settle()
    assert network.published == [("/chatter", {"data": "x"})]
    assert client.receive()["msg"] == ("/nobody has no type yet: advertise it before you publish")


def test_a_header_has_the_time_now(network, client):
    client.send("advertise", topic="/target", type=POSE)
    before_s = time.time()
    client.send("publish", topic="/target", msg={"header": {"frame_id": "base"}})
    client.send("publish", topic="/target", msg={"header": {"stamp": {"secs": 5, "nsecs": 6}}})
    client.settle()
    first, second = (message["header"] for _, message in network.published)
    assert first["frame_id"] == "base"
    assert before_s - 1 <= first["stamp"]["sec"] <= time.time()
    assert second["stamp"] == {"sec": 5, "nanosec": 6}


def test_frames_that_come_together_have_times_of_their_own(network, client):
    """The times differ even in seconds: an arm refuses a message with the same time as the one
    before."""
    client.send("advertise", topic="/target", type=POSE)
    client.settle()
    frame = json.dumps({"op": "publish", "topic": "/target", "msg": {}}).encode()
    protocol = client.connection.protocol
    for _ in range(50):
        protocol.send_text(frame)
    client.connection.socket.sendall(b"".join(protocol.data_to_send()))
    client.settle()
    stamps = [message["header"]["stamp"] for _, message in network.published]
    times_s = [stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps]
    assert len(times_s) == 50
    assert all(after > before for before, after in pairwise(times_s))


# -- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"op": "publish", "topic": "/cmd", "msg": {"foo": 1}}, "foo: geometry_msgs/msg/Twist has"),
        ({"op": "publish", "topic": "/cmd", "msg": {"linear": 1}}, "linear: takes an object"),
        ({"op": "publish", "topic": "/cmd", "msg": [1]}, "takes an object"),
        ({"op": "publish", "topic": "/cmd", "msg": {"linear": {"x": True}}}, "linear.x: takes a n"),
        ({"op": "advertise", "topic": "/cmd", "type": STRING}, "/cmd is of type geometry_msgs/msg"),
        ({"op": "advertise", "topic": "/x", "type": "acme/Odd"}, "acme/msg/Odd is not a type"),
        ({"op": "advertise", "topic": "/x", "type": "a/b/c/d"}, "is not a type"),
        ({"op": "advertise", "topic": "/a__b", "type": STRING}, "is not a ROS name"),
        ({"op": "unadvertise", "topic": "/never"}, "/never is not advertised"),
        ({"op": "subscribe", "topic": "/never"}, "no node has this topic yet"),
        ({"op": "subscribe", "topic": "/cmd", "type": STRING}, "/cmd is of type"),
        ({"op": "subscribe", "topic": "/x", "type": "acme/Odd"}, "is not a type that Cardan"),
        ({"op": "unadvertise_service", "service": "/never"}, "is not offered by this client"),
        (
            {"op": "advertise_service", "service": "/taken", "type": TRIGGER},
            "already offered by another client",
        ),
        ({"op": "advertise_service", "service": "/rosapi/topics", "type": TRIGGER}, "not among"),
        ({"op": "service_response", "id": "x", "service": "/s", "values": {}}, "no request with"),
        ({"op": "cancel_action_goal", "id": "x", "action": "/a"}, "no goal 'x' is under way"),
        ({"op": "unknown"}, "unknown operation"),
    ],
)
def test_bad_input_is_refused_at_the_sender_and_counted(network, running, client, fields, reason):
    network.offer("/taken", TRIGGER, lambda request: {})
    client.send("set_level", level="error")
    client.send("advertise", topic="/cmd", type=TWIST)
    identity = fields.get("id", "i")
    client.send(**{"id": identity, **fields})
    status = client.receive()
    assert (status["op"], status["level"], status["id"]) == ("status", "error", identity)
    assert reason in status["msg"]
    assert running.server.counts["refused"] == 1
    assert network.published == []
    client.settle()


def test_without_a_level_there_is_no_status(client, running):
    client.connection.send("nonsense")
    client.send("unknown", id="u")
    client.connection.send(b"\x00")
    client.settle()
    assert client.heard == []
    assert running.server.counts["refused"] == 3


@pytest.mark.parametrize("level", [None, "error"])
def test_a_call_that_cannot_be_is_answered_whatever_the_level(client, level):
    if level:
        client.send("set_level", level=level)
    answer = client.call("/nope")
    assert answer["result"] is False
    assert answer["values"] == "Service /nope does not exist"
    answer = client.call("/nope", timeout=-1)
    assert answer["values"].startswith("timeout: takes a number")
    client.settle()
    assert len(client.heard) == (2 if level else 0)


def test_what_the_network_has_that_is_no_message_is_counted(network, running, client):
    client.subscribe()
    network.send("/chatter", b"\x00\x01\x00\x00\xff\xff\xff\xff")
    network.send("/chatter", b"")
    network.publish("/chatter", STRING, data="good")
    assert client.receive()["msg"] == {"data": "good"}
    assert running.server.counts["unreadable"] == 2


def test_the_network_may_refuse(network, client):
    network.refuses = "the bus is gone"
    client.send("set_level", level="error")
    client.send("subscribe", topic="/chatter", type=STRING)
    assert client.receive()["msg"] == "the bus is gone"
    network.refuses = ""
    client.subscribe()
    assert len(network.subscriptions) == 1


def test_too_large_a_frame_ends_the_connection(network):
    with rosbridge(network, max_frame_bytes=1000) as running, plain_client(running) as client:
        client.connection.send("x" * 1001)
        with pytest.raises(ConnectionClosed) as closed:
            client.receive()
        assert closed.value.rcvd.code == 1009


def test_subscriptions_are_bounded(client, running):
    for number in range(MAX_SUBSCRIPTIONS + 1):
        client.send("subscribe", id=str(number), topic="/chatter", type=STRING)
    client.settle()
    assert running.server.counts["refused"] == 1


# -- services -------------------------------------------------------------------------------------


def test_a_service_is_called(network, client):
    network.offer("/stop", TRIGGER, lambda request: {"success": True, "message": "stopped"})
    answer = client.call("/stop")
    assert answer["values"] == {"success": True, "message": "stopped"}
    assert answer["result"] is True
    assert client.call("stop", {})["service"] == "stop"


def test_args_are_an_object_a_list_or_absent(network, client):
    network.offer("/on", "std_srvs/srv/SetBool", lambda request: {"success": request["data"]})
    assert client.call("/on", {"data": True})["values"]["success"] is True
    assert client.call("/on", [True])["values"]["success"] is True
    assert client.call("/on")["values"]["success"] is False
    assert "takes 1 values at most" in client.call("/on", [True, 1])["values"]
    assert "data: takes true or false" in client.call("/on", [1])["values"]
    assert "no such field" in client.call("/on", {"x": 1})["values"]


def test_answers_in_other_forms(network, client):
    network.offer("/stop", TRIGGER, lambda request: {"message": "m"})
    client.send("call_service", id="c", service="/stop", compression="cbor")
    assert cbor2.loads(client.receive())["values"] == {"success": False, "message": "m"}
    client.send("call_service", id="c", service="/stop", compression="png")
    assert client.receive()["op"] == "png"
    client.send("call_service", id="c", service="/stop", fragment_size=40)
    assert client.receive()["op"] == "fragment"


def test_a_service_that_fails_says_why(network, client):
    network.offer("/stop", TRIGGER, lambda request: Failure("no answer in 5 s"))
    answer = client.call("/stop")
    assert (answer["result"], answer["values"]) == (False, "no answer in 5 s")


def test_a_reply_that_is_none_is_a_failure(network, client):
    network.serve("/odd", TRIGGER, lambda _request, answered: answered(b""), TEST_NODE)
    answer = client.call("/odd")
    assert answer["result"] is False
    assert answer["values"].startswith("/odd: its reply is malformed: no plain CDR")


def test_calls_without_answer_are_bounded(network, client):
    network.offer("/never", TRIGGER, lambda request: None)
    for number in range(rosbridge_client.MAX_CALLS):
        client.send("call_service", id=f"n{number}", service="/never")
    answer = client.call("/never")
    assert "no more are taken" in answer["values"]


def asked_by_the_network(network, client, service, **fields):
    """Call a service that the client offers: returns the calling thread, the client's request, and
    the list that gets the response."""
    client.send("advertise_service", service=service, type="std_srvs/SetBool")
    client.settle()
    answers = []
    asking = threading.Thread(target=lambda: answers.append(network.ask(service, **fields)))
    asking.start()
    return asking, client.receive(), answers


def test_a_client_offers_a_service(network, running, client):
    asking, asked, answers = asked_by_the_network(network, client, "/client_srv", data=True)
    assert (asked["op"], asked["service"]) == ("call_service", "/client_srv")
    assert asked["args"] == {"data": True}
    client.send(
        "service_response",
        id=asked["id"],
        service="/client_srv",
        values={"success": True, "message": "ok"},
        result=True,
    )
    asking.join(WAIT_S)
    assert answers == [{"success": True, "message": "ok"}]
    client.send("unadvertise_service", service="/client_srv")
    client.settle()
    assert network.servers == {}


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ({"values": "not now", "result": False}, "/mine: 'not now'"),
        ({"values": {"foo": 1}, "result": True}, "no such field"),
        (None, "/mine is offered no longer"),
    ],
)
def test_a_client_that_does_not_answer_well_makes_the_call_fail(network, client, answer, reason):
    asking, asked, answers = asked_by_the_network(network, client, "/mine")
    if answer is None:
        client.connection.close()
    else:
        client.send("service_response", id=asked["id"], service="/mine", **answer)
    asking.join(WAIT_S)
    assert reason in answers[0].reason


def test_a_request_that_a_client_never_answers_fails_in_time(network):
    with rosbridge(network, service_timeout_s=0.05) as running, plain_client(running) as client:
        client.send("advertise_service", service="/mine", type="std_srvs/SetBool")
        client.settle()
        assert network.ask("/mine") == Failure("/mine gave no answer in 0.05 s")


# -- actions --------------------------------------------------------------------------------------


def send_goal(client, **fields):
    client.send(
        "send_action_goal",
        id="g",
        action="/move",
        action_type="control_msgs/FollowJointTrajectory",
        **fields,
    )


def test_a_goal_has_feedback_and_a_result(network, client):
    mover = Mover(network)
    goal = {"trajectory": {"joint_names": ["a"]}}
    send_goal(client, args=goal, feedback=True)
    assert mover.asked_result.wait(WAIT_S)
    assert mover.goals[0]["goal"]["trajectory"]["joint_names"] == ["a"]
    uuid = mover.goals[0]["goal_id"]["uuid"]
    mover.feed_back(bytes(16))
    mover.feed_back(uuid)
    said = client.receive()
    assert (said["op"], said["id"], said["action"]) == ("action_feedback", "g", "/move")
    assert said["values"]["joint_names"] == ["a"]
    mover.end(4, error_string="fine")
    said = client.receive()
    assert (said["op"], said["status"], said["result"]) == ("action_result", 4, True)
    assert said["values"]["error_string"] == "fine"
    client.settle()
    assert network.subscriptions == []


@pytest.mark.parametrize(("kind", "index"), [(MOVE, None), (f"{MOVE}SinceKilted", 3)])
def test_feedback_of_every_distribution_is_subscribed_to(network, client, kind, index):
    topic, name = "/move/_action/feedback", f"{MOVE}_FeedbackMessage"
    client.send("subscribe", topic=topic, type=name)
    client.settle()
    further = {} if index is None else {"index": index}
    network.publish(topic, f"{kind}_FeedbackMessage", feedback={"joint_names": ["a"], **further})
    feedback = client.receive()["msg"]["feedback"]
    assert (feedback["joint_names"], feedback.get("index")) == (["a"], index)


def test_feedback_of_kilted_and_later_is_understood(network, client):
    kilted = f"{MOVE}SinceKilted_FeedbackMessage"
    mover = Mover(network, feedback=kilted)
    send_goal(client, args={"trajectory": {"joint_names": ["a"]}}, feedback=True)
    assert mover.asked_result.wait(WAIT_S)
    mover.feed_back(mover.goals[0]["goal_id"]["uuid"], index=3)
    said = client.receive()
    assert (said["op"], said["values"]["joint_names"]) == ("action_feedback", ["a"])
    assert said["values"]["index"] == 3
    mover.end(4)
    assert client.receive()["op"] == "action_result"


@pytest.mark.real
def test_a_goal_is_canceled_and_ends_as_its_server_says(network, client):
    mover = Mover(network)
    send_goal(client)
    assert mover.asked_result.wait(WAIT_S)
    client.send("cancel_action_goal", id="g", action="/move")
    client.settle()
    assert mover.canceled == [mover.goals[0]["goal_id"]["uuid"]]
    mover.end(5)
    assert client.receive()["status"] == 5


def test_a_goal_that_is_not_accepted(network, client):
    Mover(network, accepts=False)
    send_goal(client, feedback=True)
    said = client.receive()
    assert (said["op"], said["result"]) == ("action_result", False)
    assert said["values"] == "/move did not accept the goal"
    client.settle()
    assert network.subscriptions == []


def test_a_goal_for_no_action(network, client):
    send_goal(client)
    assert client.receive()["values"] == "Action /move does not exist"
    Mover(network)
    send_goal(client, args={"foo": 1})
    assert "no such field" in client.receive()["values"]


def test_a_goal_ends_with_its_client(network, running):
    mover = Mover(network)
    with plain_client(running) as client:
        send_goal(client, feedback=True)
        assert mover.asked_result.wait(WAIT_S)
    until(lambda: mover.canceled)
    until(lambda: not network.subscriptions)


# -- the end of a client --------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["closes", "is cut off"])
def test_a_client_that_leaves_loses_everything(network, running, how):
    network.offer("/never", TRIGGER, lambda request: None)
    with plain_client(running) as client:
        client.send("advertise", topic="/cmd", type=TWIST)
        client.send("subscribe", topic="/chatter", type=STRING)
        client.send("subscribe", topic="/slow", type=STRING, throttle_rate=1e6, queue_length=9)
        client.send("advertise_service", service="/mine", type=TRIGGER)
        client.send("call_service", id="n", service="/never")
        client.settle()
        for _ in range(3):
            network.publish("/slow", STRING, data="waits")
        if how == "is cut off":
            client.connection.socket.shutdown(socket.SHUT_RDWR)
        else:
            client.connection.close()
        until(lambda: running.server.clients == 0)
    assert network.publishers == []
    assert network.subscriptions == []
    assert list(network.servers) == ["/never"]


def test_the_end_of_the_server_is_the_end_of_all(network):
    with ExitStack() as stack:
        running = stack.enter_context(rosbridge(network))
        client = stack.enter_context(plain_client(running))
        client.subscribe()
        hears = threading.Thread(target=expect_end, args=(client,))
        hears.start()
        stack.push(lambda *_: hears.join(WAIT_S))
        running.loop.call_soon_threadsafe(running.ended.set)
    assert network.subscriptions == []


def expect_end(client):
    with pytest.raises(ConnectionClosed):
        client.receive()


# -- slow clients ---------------------------------------------------------------------------------


def big(number):
    return {"name": [str(number)], "position": [0.5] * 2000}


def test_a_client_that_does_not_read_harms_nobody_and_has_the_newest_at_last(network, running):
    kind = "sensor_msgs/msg/JointState"
    with plain_client(running, max_queue=1) as slow, plain_client(running) as quick:
        for each in (slow, quick):
            each.subscribe("/joints", kind)
        for number in range(1000):
            network.publish("/joints", kind, **big(number))
            assert quick.receive()["msg"]["name"] == [str(number)]
        numbers = [int(slow.receive()["msg"]["name"][0])]
        while numbers[-1] < 999:
            numbers.append(int(slow.receive()["msg"]["name"][0]))
        assert numbers == sorted(numbers)
        assert len(numbers) < 900, "samples too many for the client are left out"
        slow.settle()
        assert slow.heard == []


def test_a_client_that_reads_a_kilobyte_per_second_harms_nobody(network, running):
    kind = "sensor_msgs/msg/JointState"
    over = threading.Event()

    def crawl(connection):
        while not over.wait(0.1):
            connection.recv(100)

    with (
        plain_client(running) as quick,
        socket.create_connection(("127.0.0.1", running.port)) as slow,
    ):
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.sendall(UPGRADE + masked(op="subscribe", topic="/joints", type=kind))
        until(lambda: network.subscriptions)
        quick.subscribe("/joints", kind)
        crawling = threading.Thread(target=crawl, args=(slow,))
        crawling.start()
        (behind,) = (
            each
            for each in running.server._clients
            if each.peer.endswith(f":{slow.getsockname()[1]}")
        )
        for number in range(500):
            network.publish("/joints", kind, **big(number))
            assert quick.receive()["msg"]["name"] == [str(number)]
            waiting = behind.connection.transport.get_write_buffer_size()
            one = len(json.dumps(big(number))) + 1000
            assert waiting <= connection.FREE_BYTES + 2 * one, "one queued, one in transmission"
        assert behind.sender.outbox.superseded > 100
        over.set()
        crawling.join(WAIT_S)


UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def masked(**fields):
    """A client's text frame."""
    return Frame(Opcode.TEXT, json.dumps(fields).encode()).serialize(mask=True)


def test_a_client_that_answers_no_ping_is_gone(network, monkeypatch):
    """Such as a client whose cable was unplugged: its endless motions must end."""
    monkeypatch.setattr(web, "PING_INTERVAL_S", 0.05)
    monkeypatch.setattr(web, "PING_TIMEOUT_S", 0.1)
    with (
        rosbridge(network) as running,
        socket.create_connection(("127.0.0.1", running.port)) as mute,
    ):
        mute.sendall(UPGRADE + masked(op="subscribe", topic="/chatter", type=STRING))
        until(lambda: network.subscriptions)
        until(lambda: not network.subscriptions)
        until(lambda: running.server.clients == 0)


def test_a_message_is_encoded_once_for_all_clients(network, running, monkeypatch):
    encoded = []
    once = EncodedMessage._encoded

    def counted(self, *key):
        encoded.append(key)
        return once(self, *key)

    monkeypatch.setattr(EncodedMessage, "_encoded", counted)
    with ExitStack() as stack:
        clients = [stack.enter_context(plain_client(running)) for _ in range(10)]
        for number, each in enumerate(clients):
            form = "cbor" if number % 2 else "none"
            each.subscribe(compression=form)
        for number in range(5):
            network.publish("/chatter", STRING, data=str(number))
        for each in clients:
            heard = [each.receive() for _ in range(5)]
            heard = [cbor2.loads(one) if isinstance(one, bytes) else one for one in heard]
            assert [one["msg"]["data"] for one in heard] == list("01234")
    assert sorted(encoded) == sorted([("/chatter", form, 0) for form in ("cbor", "none")] * 5)


def test_a_client_that_does_not_read_its_answers_is_closed(network, running):
    """The client sends a request only after the server read the previous one: on a busy computer,
    no request may wait so long that the server closes for that."""
    answered = []

    def stop(_request):
        answered.append(None)
        return {"success": True, "message": "x" * 200_000}

    def ask_on(client):
        for number in range(1, 1000):
            client.send("call_service", service="/stop")
            until(lambda n=number: len(answered) >= n or running.server.clients == 0)

    network.offer("/stop", TRIGGER, stop)
    with plain_client(running, max_queue=1) as client:
        with pytest.raises(ConnectionClosed):
            ask_on(client)
        assert running.server.counts["too slow"] == 1
        until(lambda: running.server.clients == 0)
    assert running.server.counts["backlogged"] == 0


# -- rosapi ---------------------------------------------------------------------------------------


def test_rosapi_tells_the_graph(network, client):
    network.known.update({"/state/pose": POSE, "/odd": "acme/msg/Odd", "/a/_action/status": STRING})
    network.offer("/stop", TRIGGER, lambda request: {})
    network.offer("/a/_action/send_goal", f"{MOVE}_SendGoal", lambda request: {})
    client.send("subscribe", topic="/state/pose", type=POSE)

    def ask(name, /, **args):
        answer = client.call(f"/rosapi/{name}", args)
        assert answer["result"], answer["values"]
        return answer["values"]

    assert ask("topics") == {
        "topics": ["/odd", "/rosout", "/state/pose"],
        "types": ["acme/msg/Odd", "rcl_interfaces/msg/Log", POSE],
    }
    raw = ask("topics_and_raw_types")
    texts = dict(zip(raw["topics"], raw["typedefs_full_text"], strict=True))
    assert texts["/odd"] == ""
    assert texts["/state/pose"].startswith("std_msgs/Header header\ngeometry_msgs/Pose pose\n====")
    assert "MSG: geometry_msgs/Quaternion\n" in texts["/state/pose"]
    assert ask("topic_type", topic="/state/pose") == {"type": POSE}
    assert ask("topic_type", topic="/none") == {"type": ""}
    assert ask("topics_for_type", type="geometry_msgs/PoseStamped") == {"topics": ["/state/pose"]}
    assert ask("publishers", topic="/state/pose") == {"publishers": [TEST_NODE]}
    assert ask("subscribers", topic="/state/pose") == {"subscribers": [SERVER]}
    services = ask("services")["services"]
    assert "/stop" in services
    assert "/rosapi/topics" in services
    assert "/a/_action/send_goal" not in services
    assert ask("service_type", service="/stop") == {"type": TRIGGER}
    assert ask("services_for_type", type="std_srvs/Trigger") == {"services": ["/stop"]}
    assert ask("service_node", service="/stop") == {"node": TEST_NODE}
    assert ask("service_providers", service="/stop") == {"providers": [TEST_NODE]}
    assert ask("nodes") == {"nodes": [TEST_NODE, "/rosapi", SERVER]}
    assert ask("node_details", node=TEST_NODE) == {
        "subscribing": [],
        "publishing": ["/odd", "/state/pose"],
        "services": ["/stop"],
    }
    assert ask("action_servers") == {"action_servers": ["/a"]}
    assert ask("action_type", action="/a") == {"type": MOVE}
    assert "std_srvs/srv/Trigger" in ask("interfaces")["interfaces"]
    assert ask("message_details", type="std_msgs/Header")["typedefs"][0]["fieldnames"] == [
        "stamp",
        "frame_id",
    ]
    assert ask("service_request_details", type="std_srvs/SetBool")["typedefs"][0]["fieldnames"] == [
        "data"
    ]
    assert ask("service_response_details", type=TRIGGER)["typedefs"][0]["fieldnames"] == [
        "success",
        "message",
    ]
    for part in ("goal", "result", "feedback"):
        (typedef, *_) = ask(f"action_{part}_details", type=MOVE)["typedefs"]
        assert typedef["type"].lower().endswith(part)
    assert abs(ask("get_time")["time"]["sec"] - time.time()) < 5
    assert ask("get_ros_version")["version"] == 2


def test_rosapi_of_a_type_that_nobody_knows(client):
    answer = client.call("/rosapi/message_details", {"type": "acme/Odd"})
    assert not answer["result"]
    assert "acme/msg/Odd" in answer["values"]


def test_rosapi_reaches_parameters(network, client):
    node = Parameters(network, speed={"type": 3, "double_value": 0.5}, fixed={"type": 2})

    def ask(name, /, **args):
        return client.call(f"/rosapi/{name}", args)["values"]

    assert ask("get_param_names") == {"names": ["/arm:fixed", "/arm:speed"]}
    assert ask("get_param", name="/arm:speed")["value"] == "0.5"
    assert ask("set_param", name="/arm:speed", value="2")["successful"] is True
    assert (node.values["speed"]["type"], node.values["speed"]["double_value"]) == (3, 2.0)
    assert ask("set_param", name="/arm:fixed", value="1") == {
        "successful": False,
        "reason": "it is fixed",
    }
    assert ask("has_param", name="/arm:speed") == {"exists": True}
    assert ask("delete_param", name="/arm:speed")["successful"] is True
    assert ask("has_param", name="/arm:speed") == {"exists": False}
    assert ask("has_param", name="nonsense") == {"exists": False}
    gone = ask("get_param", name="/arm:speed")
    assert (gone["value"], gone["successful"]) == ("null", False)
    assert ask("get_param", name="/arm:speed", default="7")["value"] == "7"
    assert (
        ask("get_param", name="/nobody:x")["reason"] == "there is no node /nobody with parameters"
    )
    assert "is not JSON" in ask("set_param", name="/arm:speed", value="{")["reason"]
    assert "names no parameter" in ask("set_param", name="x", value="1")["reason"]


# -- access control and permissions ---------------------------------------------------------------


def test_patterns_bound_what_clients_may_use(network):
    network.known.update({"/state/pose": POSE, "/secret": STRING})
    network.offer("/stop", TRIGGER, lambda request: {})
    network.offer("/reset", TRIGGER, lambda request: {})
    Parameters(network, speed={"type": 2}, secret={"type": 2})
    with (
        rosbridge(
            network,
            topics=("/state/*",),
            services=("/stop", "/arm/*"),
            parameters=("/arm:sp*",),
        ) as running,
        plain_client(running) as client,
    ):
        assert client.call("/rosapi/topics")["values"]["topics"] == ["/rosout", "/state/pose"]
        assert "/reset" not in client.call("/rosapi/services")["values"]["services"]
        assert client.call("/rosapi/get_param_names")["values"]["names"] == ["/arm:speed"]
        assert (
            "not among"
            in client.call("/rosapi/get_param", {"name": "/arm:secret"})["values"]["reason"]
        )
        assert "not among" in client.call("/reset")["values"]
        assert "use rosapi" in client.call("/arm/get_parameters", [["secret"]])["values"]
        assert client.call("/stop")["result"]
        client.send("set_level", level="error")
        for fields in (
            {"op": "subscribe", "topic": "/secret", "type": STRING},
            {"op": "advertise", "topic": "/secret", "type": STRING},
            {"op": "publish", "topic": "/secret", "msg": {}},
            {"op": "advertise_service", "service": "/mine", "type": TRIGGER},
        ):
            client.send(**fields)
            assert "not among" in client.receive()["msg"]


def test_many_denials_do_not_fill_a_log(network, caplog):
    with rosbridge(network, token=TOKEN) as running:
        for _ in range(web.MOST_DENIALS_SHOWN + 5):
            assert refusal(running) == 401
    shown = [each for each in caplog.records if "was refused" in each.getMessage()]
    assert len(shown) == web.MOST_DENIALS_SHOWN


def test_a_fault_of_the_server_is_logged_and_ends_nothing_else(network, client, caplog):
    def faulty():
        raise RuntimeError("a fault")

    network.offer("/stop", TRIGGER, lambda request: {})
    network.nodes = faulty
    client.send("call_service", id="n", service="/rosapi/nodes")
    assert client.call("/stop")["result"]
    until(lambda: "internal error of this server" in caplog.text)


TOKEN = "0123456789abcdef-token"


@pytest.mark.parametrize(
    "path", [f"/?t={TOKEN}", f"/?token={TOKEN}&x=1", f"/{TOKEN}", f"/{TOKEN}/"]
)
def test_a_token_in_the_address_lets_in_and_is_in_no_log(network, caplog, path):
    caplog.set_level(logging.DEBUG)
    with rosbridge(network, token=TOKEN) as running, plain_client(running, path) as client:
        client.settle()
        refused = refusal(running, path.replace(TOKEN, f"{TOKEN}x"))
    assert refused == 401
    # the client library logs its messages
    said = [each for each in caplog.records if each.name != "websockets.client"]
    assert said
    assert not [each for each in said if "0123456789" in each.getMessage() + str(each.exc_info)]


def refusal(running, path="/", **options):
    """Status message about a request that is refused."""
    with (
        pytest.raises(InvalidStatus) as refused,
        connect(f"ws://127.0.0.1:{running.port}{path}", **options),
    ):
        pass
    return refused.value.response.status_code


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("https://app.example", None),
        ("http://localhost.evil.example", 403),
        ("http://[", 403),
    ],
)
def test_pages_from_elsewhere_stay_out(network, origin, status):
    with rosbridge(network, origins=("https://app.example",)) as running:
        if status:
            assert refusal(running, origin=origin) == status
        else:
            with plain_client(running, origin=origin) as client:
                client.settle()


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("robot.example:9090", 101),
        (socket.gethostname(), 101),
        ("rebound.example", 403),
        (None, 400),
    ],
)
def test_names_that_are_not_ours_are_refused(network, host, status):
    lines = [
        "GET / HTTP/1.1",
        *([] if host is None else [f"Host: {host}"]),
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
    ]
    with (
        rosbridge(network, hosts=("robot.example",)) as running,
        socket.create_connection(("127.0.0.1", running.port), WAIT_S) as connection,
    ):
        connection.sendall("".join(f"{line}\r\n" for line in (*lines, "")).encode())
        assert connection.recv(1000).split()[1] == str(status).encode()


def test_the_log_says_which_page_was_kept_out(network, caplog):
    with rosbridge(network) as running:
        assert refusal(running, origin="https://app.foxglove.dev") == 403
    assert "the page 'https://app.foxglove.dev' may not connect" in caplog.text


def test_there_are_only_so_many_clients(network):
    with rosbridge(network, max_clients=1) as running:
        with plain_client(running) as client:
            client.settle()
            assert refusal(running) == 503
        until(lambda: running.server.clients == 0)
        with plain_client(running) as client:
            client.settle()


# -- options and the command's part ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"token": "short"}, "16 characters"),
        ({"certificate": "cert.pem"}, "both certificate and key"),
        ({"key": "key.pem"}, "both certificate and key"),
        ({"max_clients": 0}, "max_clients"),
    ],
)
def test_options_that_cannot_be(options, words):
    with pytest.raises(OptionError, match=words) as refused:
        RosbridgeOptions(**options)
    assert "short" not in str(refused.value)


def test_the_token_is_not_shown():
    assert TOKEN not in repr(RosbridgeOptions(host="0.0.0.0", plaintext=True, token=TOKEN))


def test_serve_runs_until_it_is_asked_to_end():
    program = (
        "from tests.gateway.servers.memory_network import MemoryNetwork\n"
        "from cardan.common.serving import interruptible\n"
        "from cardan.gateway.servers.rosbridge import RosbridgeOptions, serve\n"
        "with interruptible() as stop:\n"
        "    ready = lambda port: print(port, flush=True)\n"
        "    serve(MemoryNetwork(), RosbridgeOptions(port=0), ready, stop)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as it:
        try:
            port = int(it.stdout.readline())
            with connect(f"ws://127.0.0.1:{port}") as connection:
                it.terminate()
                with pytest.raises(ConnectionClosed) as closed:
                    connection.recv(WAIT_S)
                assert closed.value.rcvd.code == 1001
            assert it.wait(WAIT_S) == 0
        finally:
            it.kill()


def test_messages_are_deflated_where_both_want_it(network):
    with rosbridge(network, compress=True) as running:
        with connect(f"ws://127.0.0.1:{running.port}") as connection:
            assert connection.protocol.extensions
            client = PlainClient(connection)
            client.subscribe()
            network.publish("/chatter", STRING, data="x" * 1000)
            assert client.receive()["msg"] == {"data": "x" * 1000}
        with plain_client(running) as client:
            client.subscribe()
            network.publish("/chatter", STRING, data="y")
            assert client.receive()["msg"] == {"data": "y"}


def test_the_default_is_this_machine_alone():
    assert (server.RosbridgeOptions().host, server.RosbridgeOptions().port) == ("127.0.0.1", 9090)
