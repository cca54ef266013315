"""Endless motions end with the client that requested them."""

import json

import pytest

from cardan.errors import MotionRefusedError
from cardan.gateway.arm.requests import PacketError, Request, encode_request
from cardan.gateway.bus.arm_server import HELD_AT_MOST, ArmServer
from cardan.gateway.bus.commands import ASK_TYPE
from cardan.gateway.bus.sources import NAMED_WITHIN_S
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.zenoh import CLIENT, PUBLISHER
from tests.gateway.bus.fakes import OWN, FakeNode, FakeUser, Stamp

TWIST = "geometry_msgs/msg/Twist"
CYCLE_S = 0.004


class Bench:
    """A server, and the requests that it passes on: requests are decoded at once, streams
    accepted."""

    def __init__(self, **options):
        self.node, self.requests, self.refusals, self.now_s = FakeNode(), [], [], 100.0
        self.server = ArmServer(self.node, self.take, **options)

    def take(self, client, packet, _now_s):
        try:
            request = client.decode(packet)
        except PacketError as error:
            self.refusals.append(error)
            client.refused(error.request, error.__cause__ or error)
            return
        if request is not None:
            self.requests.append(request)
            client.done(request, None)

    def cycle(self, seconds=CYCLE_S):
        self.now_s += seconds
        self.server.poll(self.now_s)

    def user(self, name, type_name=TWIST, kind=PUBLISHER, **who):
        return FakeUser(self.node, kind, name, type_name, **who)

    @property
    def reported(self):
        return [(m["outcome"], m["reason"]) for m in self.node.publishers["~/result"].messages]


def movv(user, **how):
    user.publish(default_message(TWIST), **how)


@pytest.mark.parametrize(
    "how", [{}, {"attached": False, "stamp": Stamp("b0")}], ids=["its token", "its session"]
)
def test_a_motion_without_end_lasts_as_long_as_its_publisher(how):
    bench = Bench()
    user = bench.user("~/command/movv")
    movv(user, **how)
    bench.cycle()
    (request,) = bench.requests
    assert request.verb == "movv"
    assert request.there()
    user.leave()
    bench.cycle()
    assert not request.there()


def test_the_token_of_a_new_publisher_counts_before_its_message():
    bench = Bench()
    bench.cycle()
    movv(bench.user("~/command/movv"))  # token and message arrive in one cycle
    bench.cycle()
    assert bench.requests[0].there()


@pytest.mark.parametrize("stamp", [None, Stamp(OWN), Stamp("c0")], ids=["none", "ours", "router's"])
def test_a_motion_without_end_of_somebody_unknown_is_refused(stamp):
    bench = Bench()
    stranger = bench.user("~/command/movv", zid="d0")
    movv(stranger, attached=False, stamp=stamp)
    bench.cycle()
    assert stamp is None or bench.reported == []  # A token may still arrive.
    bench.cycle(NAMED_WITHIN_S)
    assert bench.requests == []
    ((outcome, reason),) = bench.reported
    assert outcome == "refused"
    assert "movv: this motion has no end" in reason
    assert "endless_without_watch" in reason
    assert isinstance(bench.refusals[0].__cause__, MotionRefusedError)


def test_a_flood_of_motions_of_somebody_unknown_is_not_kept():
    bench = Bench()
    stranger = bench.user("~/command/movv", zid="d0", appears=False)
    for _ in range(1000):
        movv(stranger)
        bench.cycle()
    assert len(bench.reported) + HELD_AT_MOST >= 1000
    cycles = round(NAMED_WITHIN_S / CYCLE_S) + 1
    movv(stranger)
    for _ in range(cycles):
        bench.cycle()
    assert len(bench.refusals) == 1001
    assert bench.requests == []


def test_a_flood_does_not_make_the_ones_before_it_wait():
    bench = Bench()
    stranger = bench.user("~/command/movv", zid="d0", appears=False)
    for _ in range(round(NAMED_WITHIN_S / CYCLE_S) // 10 + 1):
        movv(stranger)
        for _ in range(10):
            bench.cycle()
    assert bench.refusals


def test_endless_without_watch_takes_it_of_anybody():
    bench = Bench(endless_without_watch=True)
    movv(bench.user("~/command/movv"), attached=False)
    bench.cycle()
    assert bench.requests[0].there is None


def test_a_motion_that_ends_by_itself_is_taken_of_anybody():
    bench = Bench()
    pose = bench.user("~/command/movl", "geometry_msgs/msg/Pose")
    pose.publish(default_message("geometry_msgs/msg/Pose"), attached=False)
    bench.cycle()
    assert [each.verb for each in bench.requests] == ["movl"]
    assert bench.requests[0].there is None


def test_a_motion_asked_of_a_service_lasts_as_long_as_the_clients_node():
    bench = Bench()
    client = bench.user("~/gcmp", "std_srvs/srv/Trigger", CLIENT)
    other = FakeUser(bench.node, PUBLISHER, "~/command/movl", "geometry_msgs/msg/Pose")
    client.ask(default_message("std_srvs/srv/Trigger_Request"))
    bench.cycle()
    (request,) = bench.requests
    client.leave()
    bench.cycle()
    assert request.there()  # the node has another endpoint
    other.leave()
    bench.cycle()
    assert not request.there()


def test_a_packet_arm_is_watched_as_every_client_is():
    bench = Bench()
    client = bench.user("~/ask", ASK_TYPE, CLIENT)
    packet = encode_request(Request(7, "remote", "movv", [0.0] * 6)).decode()
    client.ask({"request": packet})
    bench.cycle()
    (request,) = bench.requests
    assert request.there()
    client.leave()
    bench.cycle()
    assert not request.there()


def test_a_packet_arm_that_nobody_could_watch_is_informed():
    bench = Bench()
    stranger = FakeUser(FakeNode(), CLIENT, "~/ask", ASK_TYPE)
    stranger.node = bench.node
    packet = encode_request(Request(7, "remote", "movv", [0.0] * 6)).decode()
    request = stranger.ask({"request": packet})
    bench.cycle()
    bench.cycle(NAMED_WITHIN_S)
    reply = json.loads(request.answer[8:].rstrip(b"\0"))
    assert reply["reply"] == 7
    assert reply["error"]["kind"] == "MotionRefusedError"


def test_a_motion_without_end_waits_for_the_token_of_who_asked():
    bench = Bench()
    late = bench.user("~/command/movv", appears=False)
    movv(late)
    bench.cycle()
    assert bench.requests == []
    late.appear()
    bench.cycle()
    assert bench.requests[0].there()


def test_what_comes_after_it_never_overtakes_a_motion_that_waits():
    bench = Bench()
    movv(bench.user("~/command/movv", appears=False))
    bench.cycle()
    bench.user("~/command/stop", "std_msgs/msg/Empty").publish(
        default_message("std_msgs/msg/Empty")
    )
    bench.cycle()
    assert [request.verb for request in bench.requests] == ["stop"]
    assert bench.reported[0][0] == "refused"
    bench.cycle(NAMED_WITHIN_S)
    assert [request.verb for request in bench.requests] == ["stop"]
