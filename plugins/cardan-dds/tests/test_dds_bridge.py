"""The bridge between the bus and DDS: messages out, messages in, and no loops."""

from __future__ import annotations

import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install cardan[dds]")

from cardan.bus.dds_options import SERVER_NODE
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.errors import DriverError
from cardan.gateway.servers.allow_list import Allowed
from cardan.gateway.servers.pause_detector import StandStill
from cardan_dds import server as server
from cardan_dds.bridge import Bridge
from cardan_dds.server import DdsBridgeOptions, DdsServerOptions
from tests.dds_network import OPTIONS, STRING, TIMEOUT_S, TRIGGER, encoded, network
from tests.serving import free_endpoint
from tests.waiting import until

pytestmark = pytest.mark.matrix

REQUEST = encoded(f"{TRIGGER}_Request")
REPLY = encoded(f"{TRIGGER}_Response", success=True, message="stopped")
PATTERNS = DdsBridgeOptions(topics=("/arm/*", "/tf"), services=("/arm/*",))


@contextmanager
def serving(options):
    """Run the server in a thread."""
    stop, ready = threading.Event(), threading.Event()
    failed = []

    def run():
        try:
            server.Dds.serve(options, lambda _endpoint: ready.set(), stop)
        except DriverError as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert ready.wait(TIMEOUT_S)
        yield failed
    finally:
        stop.set()
        thread.join(TIMEOUT_S)
        assert not thread.is_alive()


@pytest.fixture
def sides():
    """A node on the bus and another on DDS, with the server in between."""
    endpoint = free_endpoint()
    options = DdsServerOptions(bus=BusOptions(router=endpoint), dds=OPTIONS, bridge=PATTERNS)
    with (
        BusNetwork(BusOptions(router="", listen=(endpoint,)), "robot") as robot,
        network("user") as user,
        serving(options),
    ):
        until(lambda: f"/{SERVER_NODE}" in robot.nodes() and f"/{SERVER_NODE}" in user.nodes())
        yield robot, user


def hears(subscriber, topic):
    heard = []
    handle = subscriber.subscribe(topic, STRING, lambda cdr, _ns: heard.append(cdr))
    return heard, handle


def text(words):
    return encoded(STRING, data=words)


def test_a_topic_goes_out_while_somebody_wants_it(sides):
    robot, user = sides
    state = robot.advertise("/arm/state", STRING, latched=False)
    until(lambda: "/arm/state" in user.topics())
    assert robot.topics()["/arm/state"].subscribers == ()
    heard, handle = hears(user, "/arm/state")
    until(lambda: robot.topics()["/arm/state"].subscribers == (f"/{SERVER_NODE}",))
    until(lambda: state.publish(text("here")) or heard)
    assert heard[0] == text("here")
    handle.close()
    until(lambda: robot.topics()["/arm/state"].subscribers == ())
    state.close()
    until(lambda: "/arm/state" not in user.topics())


def test_a_latched_topic_begins_with_its_last_message_of_each_publisher(sides):
    robot, user = sides
    retained = [robot.advertise("/arm/description", STRING, latched=True) for _ in range(2)]
    for number, publisher in enumerate(retained):
        publisher.publish(text(f"<robot {number}/>"))
    until(lambda: (found := user.topics().get("/arm/description")) and found.latched)
    heard, _handle = hears(user, "/arm/description")
    until(lambda: {text("<robot 0/>"), text("<robot 1/>")} <= set(heard))


def test_a_latched_message_is_kept_once_however_often_subscribers_come(sides):
    robot, user = sides
    description = robot.advertise("/arm/description", STRING, latched=True)
    description.publish(text("<robot/>"))
    state = robot.advertise("/arm/state", STRING, latched=False)
    until(lambda: {"/arm/description", "/arm/state"} <= set(user.topics()))
    for _ in range(3):
        heard, handle = hears(user, "/arm/description")
        _, other = hears(user, "/arm/state")
        until(lambda heard=heard: heard)
        until(lambda: robot.topics()["/arm/state"].subscribers)
        handle.close()
        other.close()
        # Wait until the bridge has seen both leave.
        until(lambda: not robot.topics()["/arm/state"].subscribers)
    heard, _handle = hears(user, "/arm/description")
    until(lambda: heard)
    description.publish(text("<end/>"))
    until(lambda: text("<end/>") in heard)
    assert heard == [text("<robot/>"), text("<end/>")]
    state.close()


def test_commands_come_in_in_order_each_publisher_as_a_node_of_its_participant(sides):
    robot, user = sides
    heard, _handle = hears(robot, "/arm/command")
    until(lambda: "/arm/command" in user.topics())
    commands = user.advertise("/arm/command", STRING, latched=False)
    until(lambda: robot.topics()["/arm/command"].publishers == ("/user",))
    until(lambda: commands.heard)
    until(lambda: commands.publish(text("begin")) or heard)
    for number in range(50):
        commands.publish(text(str(number)))
    until(lambda: text("49") in heard)
    rest = [each for each in heard if each != text("begin")]
    assert rest == [text(str(number)) for number in range(50)]
    commands.close()
    until(lambda: robot.topics()["/arm/command"].publishers == ())


def test_a_participant_that_leaves_takes_its_node_from_the_bus(sides):
    robot, user = sides
    _, _handle = hears(robot, "/arm/command")
    until(lambda: "/arm/command" in user.topics())
    with network("guest") as guest:
        guest.advertise("/arm/command", STRING, latched=False)
        until(lambda: "/guest" in robot.nodes())
    until(lambda: "/guest" not in robot.nodes())


PUBLISHER = """
import sys
from cardan_dds.network import DdsNetwork
from cardan.bus.dds_options import DdsOptions
with DdsNetwork(DdsOptions(dds_domain=int(sys.argv[1])), "guest") as guest:
    kept = guest.advertise("/arm/command", "std_msgs/msg/String", latched=False)
    sys.stdin.read()
"""


def test_a_participant_that_is_killed_is_missed_after_its_lease(sides):
    robot, user = sides
    _, _handle = hears(robot, "/arm/command")
    until(lambda: "/arm/command" in user.topics())
    run = [sys.executable, "-c", PUBLISHER, str(OPTIONS.dds_domain)]
    with subprocess.Popen(run, stdin=subprocess.PIPE) as guest:
        try:
            until(lambda: robot.topics()["/arm/command"].publishers == ("/guest",))
        finally:
            guest.kill()
        until(lambda: "/guest" not in robot.nodes())
    assert robot.topics()["/arm/command"].publishers == ()


def test_services_answer_and_go(sides):
    robot, user = sides
    offered = robot.serve("/arm/stop", TRIGGER, lambda _request, answer: answer(REPLY))
    assert user.wait_for_service("/arm/stop", TIMEOUT_S)
    replies = []
    user.call("/arm/stop", TRIGGER, REQUEST, replies.append, TIMEOUT_S)
    assert until(lambda: replies) == [REPLY]
    offered.close()
    until(lambda: "/arm/stop" not in user.services())


def test_services_are_not_offered_unless_asked_for():
    endpoint = free_endpoint()
    with (
        BusNetwork(BusOptions(router="", listen=(endpoint,)), "robot") as robot,
        network("user") as user,
        serving(DdsServerOptions(bus=BusOptions(router=endpoint), dds=OPTIONS)),
    ):
        offered = robot.serve("/arm/stop", TRIGGER, lambda _request, answer: answer(REPLY))
        until(lambda: f"/{SERVER_NODE}" in robot.nodes() and f"/{SERVER_NODE}" in user.nodes())
        # The bridge handles services after topics.
        for number in range(2):
            _, _handle = hears(robot, f"/arm/command_{number}")
            until(lambda number=number: f"/arm/command_{number}" in user.topics())
        assert user.services() == {}
        offered.close()


def test_nothing_goes_round_where_both_sides_publish_and_subscribe(sides):
    robot, user = sides
    given = {each: hears(each, "/tf") for each in sides}
    heard = {each: found for each, (found, _handle) in given.items()}
    publishers = {each: each.advertise("/tf", STRING, latched=False) for each in sides}
    both = {text("robot"), text("user")}

    def met():
        publishers[robot].publish(text("robot"))
        publishers[user].publish(text("user"))
        return all(both <= set(each) for each in heard.values())

    until(met)
    publishers[robot].publish(text("once"))
    publishers[user].publish(text("only"))
    for each in heard.values():
        until(lambda each=each: {text("once"), text("only")} <= set(each))
    # A looping message would have returned before the next one.
    publishers[robot].publish(text("end"))
    publishers[user].publish(text("end too"))
    for each in heard.values():
        until(lambda each=each: {text("end"), text("end too")} <= set(each))
        assert each.count(text("once")) == each.count(text("only")) == 1


def test_an_old_command_is_not_given_again(sides):
    robot, user = sides
    retained = user.advertise("/arm/command", STRING, latched=True)
    retained.publish(text("old"))
    heard, _handle = hears(robot, "/arm/command")
    until(lambda: retained.heard)
    retained.publish(text("new"))
    until(lambda: heard)
    assert set(heard) == {text("new")}


def test_what_is_not_allowed_stays_where_it_is(sides):
    robot, user = sides
    robot.advertise("/secret", STRING, latched=False)
    _, _handle = hears(robot, "/hidden")
    robot.serve("/shutdown", TRIGGER, lambda _request, answer: answer(REPLY))
    retained = robot.advertise("/arm/state", STRING, latched=False)
    until(lambda: "/arm/state" in user.topics())
    assert not {"/secret", "/hidden"} & set(user.topics())
    assert "/shutdown" not in user.services()
    retained.close()


def test_another_type_is_reported(sides, caplog):
    robot, user = sides
    _, _handle = hears(robot, "/arm/command")
    until(lambda: "/arm/command" in user.topics())
    user.advertise("/arm/command", "std_msgs/msg/Bool", latched=False)
    until(lambda: any("as std_msgs/msg/Bool" in each.message for each in caplog.records))


def test_a_second_bridge_between_the_same_networks_ends(sides):
    robot, _ = sides
    endpoint = robot.node.options.listen[0]
    with (
        BusNetwork(BusOptions(router=endpoint), SERVER_NODE, deaf=True) as bus,
        network(SERVER_NODE, deaf=True) as dds,
    ):
        bridge = Bridge(bus, dds, Allowed((), (), ()))
        until(lambda: bus.having(f"/{SERVER_NODE}") and dds.having(f"/{SERVER_NODE}"))
        if dds.having(f"/{SERVER_NODE}")[0] < dds.guid:
            with pytest.raises(DriverError, match="another `cardan net server dds`"):
                bridge.follow()
        bridge.close()
        bridge.close()


def test_what_waited_while_the_bridge_stood_still_is_not_passed_on(sides, monkeypatch):
    robot, user = sides
    heard, _listening = hears(robot, "/arm/command")
    stopped, _waiting = hears(robot, "/arm/stop")
    asked = []
    command = user.advertise("/arm/command", STRING, latched=False)
    stop = user.advertise("/arm/stop", STRING, latched=False)
    until(lambda: command.heard and stop.heard)
    command.publish(encoded(STRING, data="now"))
    until(lambda: heard)
    monkeypatch.setattr(StandStill, "standing", property(lambda _: asked.append(1) or True))
    for _ in range(50):
        command.publish(encoded(STRING, data="too late"))
    stop.publish(encoded(STRING, data="stop"))
    until(lambda: stopped and len(asked) == 50)
    monkeypatch.undo()
    command.publish(encoded(STRING, data="again"))
    until(lambda: len(heard) > 1)
    assert heard == [encoded(STRING, data="now"), encoded(STRING, data="again")]
