"""Programs that stream at the same time: one moves the arm, the others get a reason that names
it."""

import pytest

from cardan.bus.node import LEASE_MS, gid_of_token
from cardan.gateway.arm.backlog import PROVEN_S, STREAMED_S
from cardan.gateway.arm.states import LEASE_S
from cardan.gateway.arm.vocab import Stream
from cardan.gateway.bus.arm_topics import OK, WARN
from cardan.gateway.bus.commands import ASK_TYPE
from cardan.gateway.bus.sources import BEGINS_S, MAX_SOURCES, NAMED_WITHIN_S, STREAM_RETENTION_S
from cardan.protocols.ros2.zenoh import CLIENT
from cardan.types import NEVER_S
from tests.gateway.bus.bench import Bench

DT_S, PERIOD_CYCLES = 0.004, 5
TWIST, COMMAND = "//servo_node/delta_twist_cmds", "/command/twist"
JOG = "//servo_node/delta_joint_cmds"
SPEED_M_S = 0.1
FULL_M_S = 0.4
"""Speed for the value 1 in MoveIt Servo's commands."""


@pytest.fixture
def bench():
    return Bench(names=("servo",))


class Node:
    """A program on the network that streams at 50 Hz; a `new` one has only just appeared."""

    def __init__(
        self, bench, name, zid, speed_m_s=0.0, appears=True, topic=TWIST, number="0", new=False
    ):
        self.bench, self.name, self.zid, self.topic = bench, name, zid, topic
        self.number, self.speed_m_s = number, speed_m_s
        self.token = bench.appear(name, zid=zid, number=number) if appears else None
        self.gid = gid_of_token(self.token) if appears else zid.encode().ljust(16, b"-")
        self.sent = 0
        if appears and not new:
            bench.poll(PROVEN_S)
            bench.poll(PROVEN_S)

    def send(self, waited_s=0.0, stands=False):
        """Send a message that was delayed by `waited_s`; `stands`: with the stamp of a stopped
        clock."""
        self.sent += 1
        share = {"z": self.speed_m_s / FULL_M_S}
        message = {"header": {"frame_id": "base_link"}, "twist": {"linear": share}}
        sent_ns = 1 if stands else round(1e9 * (self.bench.now_s - waited_s)) + self.sent
        how = {"gid": self.gid, "zid": self.zid, "sequence": self.sent, "source_ns": sent_ns}
        self.bench.publish(self.topic, message, **how)

    def leave(self):
        self.bench.vanish(self.token)

    def call(self, service, given=None):
        token = self.bench.appear(self.name, CLIENT, self.zid, self.number)
        return self.bench.call(service, given, gid=gid_of_token(token))

    def again(self, zid):
        """The same program after a restart."""
        return Node(self.bench, self.name, zid, self.speed_m_s)


def together(bench, seconds, *nodes):
    """Let all nodes stream; return the distance of the TCP along z, m."""
    before = bench.world.six()[2]
    for cycle in range(round(seconds / DT_S)):
        for number, node in enumerate(nodes):
            if cycle % PERIOD_CYCLES == number:
                node.send()
        bench.poll(DT_S)
        bench.world.tick()
    return bench.world.six()[2] - before


def outcomes(bench):
    return [(each["source"], each["outcome"], each["reason"]) for each in bench.heard("/result")]


def owner(bench):
    return bench.world.verbs.controller.authority.owner


def two(bench):
    return Node(bench, "/left/joystick", "b0", -SPEED_M_S), Node(bench, "/script", "c0", SPEED_M_S)


def test_of_two_nodes_the_first_moves_the_arm_and_the_second_is_informed(bench):
    first, second = two(bench)
    together(bench, 0.2, first)
    moved = together(bench, 2.0, second, first)
    assert moved == pytest.approx(-0.2, abs=0.01)
    assert owner(bench) == "ros2 /left/joystick"
    note = "its stamp is zero: it counts as sent when it arrived"
    assert outcomes(bench) == [
        ("ros2 /left/joystick", "accepted", note),
        (
            "ros2 /script",
            "refused",
            "twst: 'ros2 /left/joystick' has authority over the arm",
        ),
    ]
    assert bench.server.contested == pytest.approx(100, abs=2)


def test_the_diagnostics_warn_for_some_seconds(bench):
    first, second = two(bench)
    together(bench, 0.2, first)
    assert bench.server.part().level == OK
    together(bench, 0.2, first, second)
    assert bench.server.part().level == WARN
    assert "'ros2 /left/joystick' has authority" in bench.server.part().message
    together(bench, 6.0, first)
    assert bench.server.part().level == OK


def test_a_source_that_streams_another_verb_is_refused_too_and_reported_who_moves_the_arm(bench):
    first, second = two(bench)
    together(bench, 0.2, first)
    bench.publish(JOG, {"joint_names": ["wrist_3_joint"], "velocities": [0.5]}, gid=second.gid)
    together(bench, DT_S)
    assert outcomes(bench)[-1][:2] == ("ros2 /script", "refused")
    assert "'ros2 /left/joystick' has authority" in outcomes(bench)[-1][2]


def test_another_nodes_services_do_not_take_the_arm_from_a_stream(bench):
    first, second = two(bench)
    together(bench, 0.2, first)
    answer = second.call("/movl").answer
    assert not answer["success"]
    assert "'ros2 /left/joystick' has authority" in answer["message"]
    assert second.call("/release").answer["success"]
    assert owner(bench) == "ros2 /left/joystick"
    assert second.call("/stop").answer["success"]  # allowed without authority
    together(bench, 0.5)
    assert not bench.world.verbs.commanded.moving


def test_a_nodes_own_services_are_the_same_source(bench):
    first, second = two(bench)
    together(bench, 0.2, first)
    together(bench, 0.3)
    assert first.call("/release").answer["success"]
    assert together(bench, 0.5, second) > 0.03


def test_setting_a_parameter_keeps_nobody_else_from_the_arm(bench):
    first, second = two(bench)
    given = {"name": "gain", "value": {"type": 3, "double_value": 0.06}}
    (result,) = first.call("/set_parameters", {"parameters": [given]}).answer["results"]
    assert result["successful"], result
    assert owner(bench) == ""
    assert together(bench, 0.5, second) > 0.03
    together(bench, 0.5)
    (result,) = first.call("/set_parameters", {"parameters": [given]}).answer["results"]
    assert not result["successful"]
    assert "'ros2 /script' has authority" in result["reason"]


def test_one_that_is_started_again_under_its_name_goes_on(bench):
    first, second = two(bench)
    together(bench, 0.5, first, second)
    first.leave()
    moved = together(bench, 0.7, second)
    assert moved > -0.04  # the arm brakes
    assert owner(bench) == "ros2 /left/joystick"
    back = first.again("d0")
    assert together(bench, 1.0, back, second) < -0.08
    assert owner(bench) == "ros2 /left/joystick"


@pytest.mark.parametrize("killed", [True, False])
def test_another_one_takes_over_after_the_lease_and_not_before(bench, killed):
    first, second = two(bench)
    together(bench, 0.5, first)
    if killed:
        first.leave()
    together(bench, 0.5)
    assert together(bench, LEASE_S - 0.8, second) == pytest.approx(0.0, abs=1e-4)
    assert together(bench, 1.5, second) > 0.05
    assert owner(bench) == "ros2 /script"
    assert outcomes(bench)[-1][1] == "accepted"


def test_a_stream_that_was_refused_for_long_does_not_take_over_by_itself(bench):
    first, second = two(bench)
    together(bench, 0.2, first)
    together(bench, 2 * BEGINS_S, first, second)
    first.leave()
    assert together(bench, LEASE_S + 2.0, second) == pytest.approx(0.0, abs=0.02)
    assert "send zero, first" in outcomes(bench)[-1][2]
    together(bench, STREAM_RETENTION_S + 0.1)
    assert together(bench, 1.0, second) > 0.05


def test_a_gap_of_its_own_does_not_end_a_stream_for_good(bench):
    (first,) = two(bench)[:1]
    together(bench, 1.5 * BEGINS_S, first)
    together(bench, 0.45)  # longer than streamTimeout, shorter than the wait of another stream
    assert bench.world.verbs.streams.kind is Stream.NONE
    assert together(bench, 1.0, first) < -0.05


def test_two_nodes_of_the_same_name_are_two_sources(bench):
    first, second = (
        Node(bench, "/joystick", zid, speed)
        for zid, speed in (("b0", -SPEED_M_S), ("c0", SPEED_M_S))
    )
    together(bench, 0.2, first)
    assert together(bench, 2.0, first, second) == pytest.approx(-0.2, abs=0.01)
    source, outcome, reason = outcomes(bench)[-1]
    assert source.startswith("ros2 /joystick#")
    assert (outcome, reason) == ("refused", "twst: 'ros2 /joystick' has authority over the arm")
    first.leave()
    # It has streamed against the first node all the time, so it does not get the arm after it.
    assert together(bench, 1.5, second) == pytest.approx(0.0, abs=0.02)


def test_nobody_takes_a_stream_by_another_ones_gid(bench):
    first = Node(bench, "/joystick", "b0", -SPEED_M_S)
    liar = Node(bench, "/liar", "c0", SPEED_M_S)
    liar.gid = first.gid
    liar.sent = 10**9  # Its sequence numbers must not make the other's messages late.
    together(bench, 0.2, first)
    assert together(bench, 2.0, liar, first) == pytest.approx(-0.2, abs=0.01)
    assert outcomes(bench)[-1][:2] == ("ros2 /liar", "refused")


def test_nobody_takes_a_stream_by_gids_of_nobody(bench):
    first = Node(bench, "/joystick", "b0", -SPEED_M_S)
    together(bench, 0.2, first)
    before = bench.world.six()[2]
    for number in range(4 * MAX_SOURCES):
        Node(bench, "", f"{number:x}", SPEED_M_S, appears=False).send()
        bench.poll(DT_S)
        bench.world.tick()
        together(bench, DT_S, first)
    assert bench.world.six()[2] - before < -0.15
    assert owner(bench) == "ros2 /joystick"


def test_two_publishers_of_one_node_do_not_both_move_the_arm(bench):
    first = Node(bench, "/panel", "b0", -SPEED_M_S)
    second = Node(bench, "/panel", "b0", SPEED_M_S)
    together(bench, 0.2, first)
    assert together(bench, 2.0, first, second) == pytest.approx(-0.2, abs=0.01)
    assert "another publisher of 'ros2 /panel' streams" in outcomes(bench)[-1][2]


def test_a_node_may_change_between_its_streams_where_the_one_rests(bench):
    # Like MoveIt's gamepad example, which has one publisher for each type.
    node = Node(bench, "/joy_to_servo_node", "b0", -SPEED_M_S)
    together(bench, 0.3, node)
    node.speed_m_s = 0.0
    together(bench, 0.5, node)
    jog = gid_of_token(bench.appear(node.name, zid="b0"))
    for _ in range(100):
        bench.publish(
            JOG, {"joint_names": ["wrist_3_joint"], "velocities": [0.5]}, gid=jog, zid="b0"
        )
        bench.poll(DT_S)
        bench.world.tick()
    assert bench.world.verbs.streams.kind is Stream.JOINT
    assert bench.world.verbs.commanded.moving


def test_a_command_that_is_given_again_is_the_same_source(bench):
    first = Node(bench, "/_ros2cli_4711", "b0", -SPEED_M_S)
    together(bench, 0.5, first)
    assert owner(bench) == "ros2 /_ros2cli"
    first.leave()
    together(bench, 0.6)
    again = Node(bench, "/_ros2cli_4712", "c0", -SPEED_M_S)
    assert together(bench, 0.5, again) < -0.03
    # At the same time, these are two sources.
    other = Node(bench, "/_ros2cli_4713", "d0", SPEED_M_S)
    assert together(bench, 1.0, again, other) == pytest.approx(-0.1, abs=0.01)


def test_publishers_without_a_node_are_distinguished_and_one_comes_back(bench):
    first, second = (
        Node(bench, "", zid, speed, appears=False)
        for zid, speed in (("b0", -SPEED_M_S), ("c0", SPEED_M_S))
    )
    together(bench, 0.2, first)
    assert together(bench, 1.0, first, second) == pytest.approx(-0.1, abs=0.01)
    assert owner(bench) == "ros2"
    assert outcomes(bench)[-1][0].startswith("ros2 #")
    together(bench, 0.6)
    again = Node(bench, "", "d0", -SPEED_M_S, appears=False)
    assert together(bench, NAMED_WITHIN_S + 0.5, again) < -0.03


def test_a_long_name_is_no_reason_to_refuse(bench):
    node = Node(bench, f"/{'n' * 200}", "b0", -SPEED_M_S)
    assert together(bench, 0.5, node) < -0.03
    assert owner(bench).endswith("…")


def test_the_name_that_a_program_chooses_is_its_own_while_it_is_there(bench):
    def ask(node, source):
        packet = f'{{"id":7,"source":"{source}","verb":"acquire"}}'
        return node.call("/ask", {"request": packet}).answer["reply"]

    assert bench.node.types["/arm/ask"] == ASK_TYPE
    first, second = two(bench)
    assert '"error"' not in ask(first, "pendant")
    assert "another program is the source 'pendant'" in ask(second, "pendant")
    assert "choose another one" in ask(second, "ros2 /left/joystick")
    assert "choose another one" in ask(second, "ros2")


def late(bench, name, zid, speed_m_s):
    """A node, and its liveliness token, which has not arrived."""
    node = Node(bench, name, zid, speed_m_s, new=True)
    token, _ = bench.node.tokens.waiting.pop()
    return node, token


def test_a_node_whose_token_comes_after_its_first_message_is_named_first(bench):
    node, token = late(bench, "/joystick", "b0", -SPEED_M_S)
    assert together(bench, NAMED_WITHIN_S / 2, node) == 0.0
    assert owner(bench) == ""
    bench.node.tokens.waiting.append((token, True))
    assert together(bench, PROVEN_S + 1.0, node) < -0.08
    assert owner(bench) == "ros2 /joystick"
    assert {source for source, *_ in outcomes(bench)} == {"ros2 /joystick"}
    node.leave()
    together(bench, 0.2)
    # A restarted node continues within the lease.
    assert together(bench, 1.0, node.again("d0")) < -0.08
    assert owner(bench) == "ros2 /joystick"


def test_others_do_not_end_the_wait_for_a_token_nor_wait_themselves(bench):
    node, token = late(bench, "/late", "b0", -SPEED_M_S)
    other = Node(bench, "/other", "c0", SPEED_M_S)
    assert together(bench, NAMED_WITHIN_S / 2, node, other) > 0.0
    assert {source for source, *_ in outcomes(bench)} == {"ros2 /other"}
    bench.node.tokens.waiting.append((token, True))
    together(bench, 0.1, node, other)
    assert outcomes(bench)[-1][:2] == ("ros2 /late", "refused")


def test_a_stop_waits_for_no_token_and_what_waits_does_not_begin_after_it(bench):
    node, token = late(bench, "/late", "b0", -SPEED_M_S)
    node.send()
    bench.poll(DT_S)
    assert bench.requests == []
    bench.command("/command/stop", gid=b"s" * 16, zid="e0", after_s=DT_S)
    assert [each.verb for each in bench.requests] == ["twist", "stop"]
    bench.node.tokens.waiting.append((token, True))
    bench.poll(DT_S)
    assert len(bench.requests) == 2


def test_a_program_without_tokens_is_not_in_its_own_way(bench):
    node = Node(bench, "", "b0", -SPEED_M_S, appears=False)
    assert together(bench, 1.0, node) < -0.05
    assert owner(bench) == "ros2"
    client = b"c" * 16
    bench.server.unnamed.until_s((client, ""), NEVER_S)
    node.speed_m_s = 0.0
    together(bench, 0.3, node)
    given = [{"name": "gain", "value": {"type": 3, "double_value": 0.06}}]
    answer = bench.call("/set_parameters", {"parameters": given}, gid=client).answer
    assert answer["results"][0]["successful"], answer
    together(bench, 0.7)
    assert bench.call("/release", gid=client).answer["success"]
    assert owner(bench) == ""


def test_of_a_stream_that_waits_for_its_token_the_newest_message_counts(bench):
    node, _ = late(bench, "/late", "b0", -SPEED_M_S)
    for _ in range(8):
        node.send()
        bench.poll(NAMED_WITHIN_S / 10)
    assert bench.requests == []
    bench.poll(NAMED_WITHIN_S)
    assert [each.verb for each in bench.requests] == ["twist"]


def test_the_name_of_a_program_that_was_killed_is_free_when_its_token_goes(bench):
    def ask(node):
        packet = '{"id":7,"source":"pendant","verb":"acquire"}'
        return node.call("/ask", {"request": packet}).answer["reply"]

    first = Node(bench, "/pendant_1", "b0")
    client = bench.appear(first.name, CLIENT, "b0")
    packet = {"request": '{"id":7,"source":"pendant","verb":"acquire"}'}
    assert '"error"' not in bench.call("/ask", packet, gid=gid_of_token(client)).answer["reply"]
    again = Node(bench, "/pendant_2", "c0")
    refusal = ask(again)
    assert "another program is the source 'pendant'" in refusal
    assert f"free after {LEASE_MS / 1000:g} s" in refusal
    bench.vanish(client)
    first.leave()
    bench.poll(DT_S)
    assert '"error"' not in ask(again)


@pytest.mark.parametrize("number", [1, 50])
@pytest.mark.parametrize("by_the_server", [False, True], ids=["unstamped", "stamped by a server"])
def test_what_its_sender_may_have_kept_until_it_was_connected_moves_nothing(
    bench, number, by_the_server
):
    bench.poll()
    node = Node(bench, "/rosbridge_client_1", "b0", new=True)

    def send(z, ahead_s=0.0):
        node.sent += 1
        message = {"header": {"frame_id": "base_link"}, "twist": {"linear": {"z": z}}}
        source_ns = round((1000.0 + bench.now_s + ahead_s) * 1e9)
        if by_the_server:
            sec, nanosec = divmod(source_ns - 1000, 10**9)
            message["header"]["stamp"] = {"sec": sec, "nanosec": nanosec}
        how = {"gid": node.gid, "zid": node.zid, "sequence": node.sent, "source_ns": source_ns}
        bench.publish(TWIST, message, **how)

    def go_on(seconds):
        before = bench.world.six()[2]
        for _ in range(round(seconds / DT_S)):
            bench.poll(DT_S)
            bench.world.tick()
        return bench.world.six()[2] - before

    for each in range(number):
        send(-0.25, 1e-4 * each)
        go_on(DT_S * (each % 2))
    assert go_on(1.0) == 0.0
    reported = outcomes(bench)
    assert [outcome for _, outcome, _ in reported] == ["refused"] * len(reported) != []
    assert "may have waited until it was" in reported[0][2]
    # Commands without delay then move the arm.
    assert sum(send(-0.25) or go_on(0.02) for _ in range(25)) < -0.02


def test_what_stops_a_stream_of_a_new_connection_is_heard_at_once(bench):
    node = Node(bench, "/rosbridge_client_1", "b0", new=True)
    node.send()
    bench.poll(DT_S)
    assert [each.verb for each in bench.requests] == ["twist"], "a twist of zero"


def test_a_token_that_comes_while_its_node_streams_does_not_end_the_stream(bench):
    node, token = late(bench, "/joystick", "b0", -SPEED_M_S)
    together(bench, NAMED_WITHIN_S + PROVEN_S, node)
    bench.node.tokens.waiting.append((token, True))
    together(bench, 0.1, node)
    assert "refused" not in {outcome for _, outcome, _ in outcomes(bench)}


def test_a_new_connection_is_reported_who_has_the_arm(bench):
    first = Node(bench, "/left/joystick", "b0", -SPEED_M_S)
    together(bench, 0.5, first)
    together(bench, 0.1, first, Node(bench, "/script", "c0", SPEED_M_S, new=True))
    words = "twst: 'ros2 /left/joystick' has authority over the arm"
    assert outcomes(bench)[-1] == ("ros2 /script", "refused", words)
    assert bench.server.contested == 5


def test_what_its_publisher_sent_long_ago_moves_nothing_and_what_comes_after_it_does(bench):
    """A bridge, server or network was paused in between; the message has no stamp."""
    node = Node(bench, "/joystick", "b0", -SPEED_M_S)
    together(bench, 0.5, node)
    together(bench, 1.0)
    assert not bench.world.verbs.commanded.moving
    before = len(outcomes(bench))
    node.send(waited_s=STREAMED_S + 0.01)
    bench.poll(DT_S)
    bench.world.tick()
    assert "not executed" in outcomes(bench)[before][2]
    assert together(bench, 0.3) == 0.0
    node.send(waited_s=STREAMED_S - 0.05)
    bench.poll(DT_S)
    bench.world.tick()
    assert together(bench, 0.3) < 0.0


def test_a_publisher_whose_clock_stands_still_is_heard(bench):
    """Some small computers have no clock."""
    node = Node(bench, "/joystick", "b0", -SPEED_M_S)
    for _ in range(100):
        node.send(stands=True)
        bench.poll(DT_S)
        bench.world.tick()
    assert bench.world.verbs.commanded.moving
    assert {outcome for _, outcome, _ in outcomes(bench)} == {"accepted"}
