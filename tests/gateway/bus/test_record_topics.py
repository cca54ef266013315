"""Topics that a session publishes for recorders, on a network without Zenoh."""

import json

import pytest

from cardan.drivers.sim_arm import SimArm
from cardan.gateway.arm.cycle_record import decode_cycle
from cardan.gateway.arm.loop import ArmLoop
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.bus.record_topics import AT_ONCE, HIDDEN, MAX_PACKETS, RETENTION_S, RecordTopics
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config
from cardan.protocols.joint_stream.codec import MalformedDatagram, decode_state
from tests.gateway.bus.fakes import FakeNode

TABLES = {
    "robot": {"driver": "sim_arm", "robot": "ur5", "pacing": "virtual", "period_s": 0.004},
    "arm": {"model": "ur5"},
}


class Bench:
    def __init__(self):
        config = parse_config(TABLES)
        self.robot = make_robot(config)
        assert isinstance(self.robot, SimArm)
        self.controller = make_controller(config, self.robot)
        self.node = FakeNode()
        self.record_topics = RecordTopics(self.node, TABLES, self.controller, self.robot, None)
        self.log = self.node.publishers["~/controller_log"]
        self.raw = self.node.publishers["~/raw/robot"]
        self.cycles = ArmLoop(self.robot, self.controller).cycles()
        self.now_s = 100.0

    def run(self, count, each=None):
        for _ in range(count):
            cycle = next(self.cycles)
            if each is not None:
                each(self.controller.ticks)
            self.now_s += 0.004
            self.record_topics.cycle(cycle, self.now_s)

    def numbers(self):
        return [decode_cycle(each["data"]).number for each in self.log.messages]


@pytest.fixture
def bench():
    made = Bench()
    with made.robot:
        yield made
        made.cycles.close()


def test_nothing_is_published_while_nobody_subscribes(bench):
    bench.run(200)
    assert bench.log.messages == bench.raw.messages == []
    assert bench.robot.raw_packet_callback is None


def test_a_recorder_that_is_found_late_gets_the_first_cycles(bench):
    bench.run(200)
    bench.log.heard = True
    bench.run(63 + 200)
    assert bench.numbers() == list(range(1, 464))


def test_kept_cycles_go_out_a_few_at_a_time(bench):
    bench.run(200)
    bench.log.heard = True
    before = 0
    for _ in range(100):
        bench.run(1)
        assert len(bench.log.messages) - before <= AT_ONCE
        before = len(bench.log.messages)


def test_what_is_kept_still_goes_out_when_the_session_ends(bench):
    bench.run(200)
    bench.log.heard = True
    bench.run(1)
    bench.record_topics.close()
    assert bench.numbers() == list(range(1, 202))


def test_nothing_is_kept_for_long(bench):
    bench.run(round(RETENTION_S / 0.004) + 100)
    assert bench.controller.recorder is None
    assert not bench.record_topics._log._cycles
    bench.log.heard = True
    bench.run(100)
    assert bench.numbers()[0] > 1250
    assert bench.numbers() == list(range(bench.numbers()[0], bench.controller.ticks + 1))


def test_it_ends_when_the_recorder_has_gone(bench):
    bench.log.heard = bench.raw.heard = True
    bench.run(round(RETENTION_S / 0.004) + 100)
    assert bench.robot.raw_packet_callback is not None
    bench.log.heard = bench.raw.heard = False
    bench.run(100)
    count = len(bench.log.messages)
    bench.run(100)
    assert len(bench.log.messages) == count
    assert bench.robot.raw_packet_callback is None


def test_requests_are_written_to_the_cycle_that_they_precede(bench):
    bench.log.heard = True

    def ask(ticks):
        if ticks == 50:
            bench.controller.stop("enough")
            bench.controller.inhibit("a reason", Inhibit.WHILE_SAID)
            bench.controller.inhibit("a reason", Inhibit.WHILE_SAID)

    bench.run(120, ask)
    records = [decode_cycle(each["data"]) for each in bench.log.messages]
    asked = {each.number: each.before for each in records if each.before}
    assert asked == {51: (("stop", "enough"), ("hold_off", "a reason"))}


def test_raw_bytes_are_those_that_were_exchanged(bench):
    bench.raw.heard = True
    bench.run(100)
    assert {each["direction"] for each in bench.raw.messages} == {0, 1}
    states = [decode_state(each["data"]) for each in bench.raw.messages if not each["direction"]]
    assert len(states) > 90
    assert not any(isinstance(state, MalformedDatagram) for state in states)
    sequences = [state.sequence for state in states]
    assert sequences == list(range(sequences[0], sequences[0] + len(states)))
    stamps = [
        (each["header"]["stamp"]["sec"], each["header"]["stamp"]["nanosec"])
        for each in bench.raw.messages
    ]
    assert stamps == sorted(stamps)


def test_raw_bytes_for_which_there_is_no_room_are_counted(bench):
    bench.raw.heard = True
    bench.run(10)
    for _ in range(MAX_PACKETS + 7):
        bench.robot.raw_packet_callback(b"x", False, "")
    assert bench.record_topics.dropped == 7
    bench.run(1)
    assert len([each for each in bench.raw.messages if each["data"] == b"x"]) <= AT_ONCE


def test_after_its_end_nothing_is_tapped(bench):
    bench.log.heard = bench.raw.heard = True
    bench.run(10)
    bench.record_topics.close()
    assert bench.robot.raw_packet_callback is None
    assert bench.controller.recorder is None


def test_the_configuration_is_there_without_secrets():
    node = FakeNode()
    config = parse_config(TABLES)
    robot = make_robot(config)
    tables = {**TABLES, "device": {"driver": "theirs", "api_token": "abc", "passwords": ["x"]}}
    RecordTopics(node, tables, make_controller(config, robot), robot, None)
    (message,) = node.publishers["~/configuration"].messages
    described = json.loads(message["data"])
    assert described["tables"]["arm"] == {"model": "ur5"}
    assert described["tables"]["device"]["api_token"] == HIDDEN
    assert described["tables"]["device"]["passwords"] == HIDDEN
    assert {"cardan", "python", "pin"} <= described["versions"].keys()
    assert "abc" not in message["data"]
