"""A node on Zenoh: two sessions on loopback, as two processes would be."""

import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest

zenoh = pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')

from cardan.bus.network import Failure, NetworkError  # noqa: E402
from cardan.bus.node import AT_ONCE_S, LEASE_MS, BusNode  # noqa: E402
from cardan.bus.options import BusOptions  # noqa: E402
from cardan.bus.zenoh_network import BusNetwork  # noqa: E402
from cardan.errors import ConfigurationError, DriverError  # noqa: E402
from cardan.protocols.ros2.cdr import codec_of  # noqa: E402
from cardan.protocols.ros2.interfaces import InterfaceError  # noqa: E402
from cardan.protocols.ros2.names import RosNameError  # noqa: E402
from cardan.protocols.ros2.zenoh import LATCHED_QOS, NEWEST_QOS, Attachment, Entity, data_key  # noqa: E402
from tests.serving import free_endpoint  # noqa: E402
from tests.waiting import WITHIN_S, until  # noqa: E402

pytestmark = pytest.mark.matrix

TIMEOUT_S = WITHIN_S
STRING = "std_msgs/msg/String"
TRIGGER = "std_srvs/srv/Trigger"


def text(words):
    return codec_of(STRING).encode({"data": words})


@pytest.fixture
def bus():
    """Factory for nodes on one bus: the first listens, the others connect to it."""
    endpoint = free_endpoint()
    with ExitStack() as stack:
        first = BusNode(BusOptions(router="", listen=(endpoint,)), "robot", "/left")
        stack.enter_context(first)
        others = BusOptions(router=endpoint, listen=())

        def join(kind=BusNode, name="user", **more):
            options = BusOptions(router=endpoint, listen=(), **more) if more else others
            return stack.enter_context(kind(options, name))

        yield first, join


def meet(user, name, node):
    """Wait until `user` sees the endpoint `name` of another node."""
    seen = set()
    user.watch_graph(lambda token, there: seen.add(token) if there else seen.discard(token))
    part = f"/{node.name}/{name.replace('/', '%')}/"
    until(lambda: any(part in token for token in tuple(seen)), f"{name} on the graph")


@pytest.mark.real
def test_messages_arrive_with_their_key_and_attachment(bus):
    robot, join = bus
    heard = robot.subscription("~/command", STRING, 8)
    user = join()
    meet(user, "/left/robot/command", robot)
    publisher = user.publisher("/left/robot/command", STRING)

    def sent():
        publisher.put(text("go"), 17)
        return heard.poll()

    received = until(sent, "a message")
    assert received.data == text("go")
    assert received.key == data_key(0, "/left/robot/command", STRING)
    assert received.attachment.source_ns == 17
    assert received.attachment.sequence >= 1
    assert len(received.attachment.gid) == 16


def test_leaving_a_bus_that_does_not_answer_is_reported_and_raises_nothing(
    bus, monkeypatch, caplog
):
    """zenoh raises this error 10 s after the process of a peer was stopped."""
    _, join = bus
    user = join()
    session = user._session

    class Stuck:
        def close(self):
            session.close()
            raise zenoh.ZError(
                "close operation timed out! at /zenoh/src/api/builders/close.rs:135."
            )

    monkeypatch.setattr(user, "_session", Stuck())
    user.close()
    (record,) = caplog.records
    assert record.getMessage() == "error while leaving the bus: close operation timed out!"


def test_who_meets_a_process_that_stands_still_leaves_in_time():
    """Zenoh allows 10 s for a connection that is being established, and ends no session before."""
    with socket.create_server(("127.0.0.1", 0)) as still:
        node = BusNode(BusOptions(router=f"tcp/127.0.0.1:{still.getsockname()[1]}"), "user")
        node.open()
        begun_s = time.monotonic()
        node.close()
        assert time.monotonic() - begun_s < 2e-3 * LEASE_MS


def test_what_need_not_arrive_is_said_to_zenoh_and_on_the_graph_and_nothing_else_is(bus):
    one, join = bus
    newest = one.publisher("/lost", STRING, NEWEST_QOS, express=True)
    retained = one.publisher("/kept", STRING, express=True)
    latched = one.publisher("/latched", STRING, LATCHED_QOS)
    assert newest._publisher.reliability == zenoh.Reliability.BEST_EFFORT
    assert newest._reliable.reliability == zenoh.Reliability.RELIABLE
    for each in (retained, latched):
        assert each._reliable is each._publisher
    assert retained._publisher.reliability == zenoh.Reliability.RELIABLE
    assert not Entity.parse(newest.entity.token(0)).qos.reliable

    heard = join().waiting_subscription("/lost", STRING, 10)
    until(lambda: newest.heard)
    newest.put(text("replaced"), 1)
    newest.put_reliably(text("last"), 2)
    for number, words in ((1, "replaced"), (2, "last")):
        received = heard.wait(TIMEOUT_S)
        assert (received.data, received.attachment.sequence) == (text(words), number)
    newest.close()
    retained.put_reliably(text("the same"), 3)


class Sample:
    """Zenoh's sample of a message without an attachment."""

    key_expr, attachment, timestamp = "key", None, None

    def __init__(self, number):
        self.payload = self
        self.number = number

    def to_bytes(self):
        return text(str(self.number))


@pytest.mark.real
def test_a_handler_takes_single_messages_at_once_and_a_flood_is_queued(bus, monkeypatch):
    robot, _ = bus
    depth, now_s = 4, 10.0
    monkeypatch.setattr("cardan.bus.node.time", SimpleNamespace(monotonic=lambda: now_s))
    heard = robot.waiting_subscription("~/command", STRING, depth)
    handled = []
    heard._hear(Sample("before"))
    heard.handler = lambda received: handled.append(received.data)
    now_s += AT_ONCE_S
    heard._hear(Sample("second"))
    assert handled == []  # It does not overtake the one before.
    assert [heard.poll().data for _ in range(2)] == [text("before"), text("second")]
    for number in range(1000):
        now_s += 0.1 * AT_ONCE_S
        heard._hear(Sample(number))
    assert handled == []
    queued = [heard.poll() for _ in range(depth)]
    assert [each.data for each in queued] == [text(str(996 + number)) for number in range(depth)]
    now_s += AT_ONCE_S
    heard._hear(Sample("at once"))
    assert handled == [text("at once")]
    assert heard.wait(WITHIN_S) is None  # Its reader is woken without it.
    assert len(heard._inbox) == 0


def test_a_ring_keeps_the_newest(bus):
    robot, join = bus
    heard = robot.subscription("stream", STRING, 1)
    user = join()
    meet(user, "/left/stream", robot)
    publisher = user.publisher("/left/stream", STRING)
    until(lambda: publisher.put(text("first"), 0) or heard.poll(), "a message")
    for number in range(100):
        publisher.put(text(str(number)), 0)
    polled = []

    def last():
        publisher.put(text("last"), 0)  # A full link drops messages.
        received = heard.poll()
        polled.append(received)
        return received is not None and received.data == text("last")

    until(last, "the newest message")
    assert len([each for each in polled if each is not None]) < 50


def test_a_message_of_another_type_is_heard_by_its_key(bus):
    robot, join = bus
    heard = robot.subscription("command", STRING, 8)
    user = join()
    meet(user, "/left/command", robot)
    publisher = user.publisher("/left/command", "geometry_msgs/msg/Twist")
    received = until(lambda: publisher.put(b"\0\1\0\0", 0) or heard.poll(), "a message")
    assert "geometry_msgs::msg::dds_::Twist_" in received.key


def test_what_was_latched_is_asked_to_who_comes_later(bus):
    robot, join = bus
    publisher = robot.publisher("robot_description", STRING, LATCHED_QOS)
    publisher.put(text("old"), 0)
    publisher.put(text("<robot/>"), 0)
    late = join().subscription("/left/robot_description", STRING, 4, LATCHED_QOS)
    received = until(late.poll, "the latched message")
    assert received.data == text("<robot/>")
    assert late.poll() is None


@pytest.mark.real
def test_a_call_is_answered_from_any_thread(bus):
    robot, join = bus
    service = robot.service("~/gcmp", TRIGGER)
    user = join()
    meet(user, "/left/robot/gcmp", robot)
    client = user.client("/left/robot/gcmp", TRIGGER)
    request = codec_of(f"{TRIGGER}_Request").encode({"structure_needs_at_least_one_member": 0})
    response = codec_of(f"{TRIGGER}_Response").encode({"success": True, "message": "ok"})
    asked = []

    def serve():
        found = until(service.poll, "a request")
        asked.append(found)
        found.reply(response, 3)

    thread = threading.Thread(target=serve)
    thread.start()
    assert client.call(request) == response
    thread.join()
    assert asked[0].data == request
    assert asked[0].attachment.sequence == 1


def test_a_call_that_is_refused_or_that_nobody_serves_has_no_answer(bus):
    robot, join = bus
    service = robot.service("gcmp", TRIGGER)
    user = join()
    meet(user, "/left/gcmp", robot)
    client = user.client("/left/gcmp", TRIGGER)
    thread = threading.Thread(
        target=lambda: until(service.poll, "a request").refuse("it is no request")
    )
    thread.start()
    assert client.call(b"") is None
    thread.join()
    assert user.client("/nobody", TRIGGER).call(b"", timeout_s=0.1) is None


def test_a_message_without_an_attachment_is_heard(bus):
    robot, join = bus
    heard = robot.subscription("command", STRING, 8)
    user = join()
    meet(user, "/left/command", robot)
    with zenoh.open(_config(user)) as session:
        publisher = session.declare_publisher(data_key(0, "/left/command", STRING))
        received = until(lambda: publisher.put(text("raw")) or heard.poll(), "a message")
        assert received.attachment is None
        publisher.put(text("odd"), attachment=b"\1" * 70)
        until(lambda: (r := heard.poll()) and r.data == text("odd"), "the odd message")


def _config(node):
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", f'["{node.options.router}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    return config


def test_endpoints_come_and_go_on_the_graph(bus):
    robot, join = bus
    network = join(BusNetwork, "server")
    until(lambda: "/left/robot" in network.nodes(), "the node")
    publisher = robot.publisher("pose", STRING)
    service = robot.service("gcmp", TRIGGER)
    until(lambda: network.topics().get("/left/pose"), "the topic")
    assert network.topics()["/left/pose"].publishers == ("/left/robot",)
    assert network.wait_for_service("/left/gcmp", TIMEOUT_S)
    assert network.services()["/left/gcmp"].type == TRIGGER
    publisher.close()
    service.close()
    until(lambda: "/left/pose" not in network.topics(), "the topic's end")
    until(lambda: not network.services(), "the service's end")
    robot.close()
    until(lambda: "/left/robot" not in network.nodes(), "the node's end")
    robot.close()  # Closing twice is allowed.


def test_servers_subscribe_publish_call_and_serve(bus):
    robot, join = bus
    network = join(BusNetwork, "server")
    commands = robot.subscription("command", STRING, 8)
    description = robot.publisher("robot_description", STRING, LATCHED_QOS)
    description.put(text("<robot/>"), 9)
    pose = robot.publisher("pose", STRING)
    service = robot.service("gcmp", TRIGGER)
    until(lambda: {"/left/command", "/left/pose"} <= network.topics().keys(), "the topics")
    until(lambda: network.topics().get("/left/robot_description"), "the latched topic")
    assert network.wait_for_service("/left/gcmp", TIMEOUT_S)

    heard = []
    handle = network.subscribe("/left/pose", None, lambda *reported: heard.append(reported))
    until(lambda: pose.put(text("here"), 5) or heard, "a message")
    assert heard[0] == (text("here"), 5)
    handle.close()
    handle.close()

    latched = []
    network.subscribe("/left/robot_description", STRING, lambda *reported: latched.append(reported))
    assert until(lambda: latched, "the latched message")[0] == (text("<robot/>"), 9)

    publisher = network.advertise("/left/command", STRING, False)
    until(lambda: publisher.publish(text("go")) or commands.poll(), "a command")

    answers = []
    network.call("/left/gcmp", TRIGGER, b"\0\1\0\0\0", answers.append, TIMEOUT_S)
    until(service.poll, "the request").reply(b"yes", 0)
    assert until(lambda: answers, "the answer") == [b"yes"]
    network.call("/left/gcmp", TRIGGER, b"\0\1\0\0\0", answers.append, TIMEOUT_S)
    until(service.poll, "the request").refuse("no request")
    assert until(lambda: answers[1:], "the refusal") == [Failure("/left/gcmp: no request")]
    network.call("/nobody", TRIGGER, b"", answers.append, 0.1)
    assert "no server offers it" in until(lambda: answers[2:], "the end")[0].reason


def test_who_listens_later_is_met_later():
    endpoint = free_endpoint()
    with BusNode(BusOptions(router=endpoint, listen=()), "user") as user:
        publisher = user.publisher("command", STRING)
        with BusNode(BusOptions(router="", listen=(endpoint,)), "robot") as robot:
            heard = robot.subscription("command", STRING, 8)
            until(lambda: publisher.put(text("go"), 0) or heard.poll(), "a message")


@pytest.mark.parametrize(
    ("name", "type_name", "error"),
    [("a b", STRING, RosNameError), ("a", "std_msgs/msg/Nope", InterfaceError)],
)
def test_wrong_names_and_types_are_refused(bus, name, type_name, error):
    robot, join = bus
    for make in (robot.publisher, lambda *each: robot.subscription(*each, 1)):
        with pytest.raises(error):
            make(name, type_name)
    with pytest.raises(NetworkError):
        join(BusNetwork, "server").advertise(name, type_name, False)


def test_what_cannot_be_joined_is_said(tmp_path):
    taken = free_endpoint()
    with (
        BusNode(BusOptions(router="", listen=(taken,)), "one"),
        pytest.raises(
            DriverError, match=r"joined.*another program already listens there"
        ) as refused,
    ):
        BusNode(BusOptions(router="", listen=(taken,)), "two").open()
    assert ".rs" not in str(refused.value)
    with pytest.raises(DriverError, match="not open"):
        BusNode(BusOptions(), "three").publisher("a", STRING)
    broken = tmp_path / "zenoh.json5"
    broken.write_text("{ mode: ")
    with pytest.raises(ConfigurationError, match="zenoh_config"):
        BusNode(BusOptions(zenoh_config=str(broken)), "four").open()


def test_who_answers_or_publishes_after_the_end_is_no_error(bus):
    robot, join = bus
    service, publisher = robot.service("gcmp", TRIGGER), robot.publisher("pose", STRING)
    network = join(BusNetwork, "server")
    assert network.wait_for_service("/left/gcmp", TIMEOUT_S)
    network.call("/left/gcmp", TRIGGER, b"\0\1\0\0\0", lambda _reply: None, 0.5)
    asked = until(service.poll, "the request")
    robot.close()
    asked.reply(b"late", 0)
    asked.refuse("late")
    publisher.put(text("late"), 0)


def test_an_attachment_is_what_rmw_zenoh_reads():
    data = Attachment(1, 2, bytes(16)).encode()
    assert data.hex() == "0100000000000000" + "0200000000000000" + "10" + "00" * 16


def test_what_is_seen_on_the_bus_can_be_used_at_once(monkeypatch):
    """An endpoint's liveliness token is declared after the endpoint."""
    declared = []
    for name in ("declare_publisher", "declare_subscriber", "declare_queryable", "declare_token"):
        plain = getattr(BusNode, name)

        def noted(node, *given, name=name, plain=plain, **more):
            declared.append(name)
            return plain(node, *given, **more)

        monkeypatch.setattr(BusNode, name, noted)
    with BusNode(BusOptions(router=""), "robot") as node:
        declared.clear()
        node.publisher("a", STRING)
        node.subscription("b", STRING, 1)
        node.waiting_subscription("c", STRING, 1)
        node.service("d", TRIGGER)
    what, tokens = declared[::2], declared[1::2]
    assert what == [
        "declare_publisher",
        "declare_subscriber",
        "declare_subscriber",
        "declare_queryable",
    ]
    assert tokens == ["declare_token"] * 4


def test_the_end_of_a_service_is_reported(bus):
    server, join = bus
    network = join(BusNetwork, "network")
    first, second = server.service("/ask", TRIGGER), server.service("/ask", TRIGGER)
    gone = threading.Event()
    until(lambda: network.wait_for_service("/ask", 0.1), "the service")
    held = network.watch_service("/ask", gone.set)
    until(lambda: len(network._graph.servers("/ask")) == 2, "both")
    first.close()
    until(lambda: len(network._graph.servers("/ask")) == 1, "the first one's end")
    assert not gone.is_set()
    second.close()
    assert gone.wait(TIMEOUT_S)
    held.close()


@pytest.mark.real
def test_a_node_that_is_killed_leaves_no_shared_memory():
    program = (
        "import threading\n"
        "from cardan.bus.node import BusNode\n"
        "from cardan.bus.options import BusOptions\n"
        "with BusNode(BusOptions(router=''), 'robot', '/left'):\n"
        "    print('READY', flush=True)\n"
        "    threading.Event().wait()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    with process:
        try:
            assert process.stdout.readline() == "READY\n"
            maps = Path(f"/proc/{process.pid}/maps").read_text().splitlines()
        finally:
            process.kill()
    mapped = {line.split(maxsplit=5)[5] for line in maps if "/dev/shm/" in line}
    assert [path for path in mapped if Path(path).exists()] == []
