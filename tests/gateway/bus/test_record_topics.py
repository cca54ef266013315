"""Topics that a session publishes for recorders, on a bus without Zenoh."""

import json

import pytest

from cardan.drivers.sim_arm import SimArm
from cardan.gateway.arm.cycle_record import decode_cycle
from cardan.gateway.arm.loop import ArmLoop
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.bus.record_topics import AT_ONCE, HIDDEN, KEPT_PACKETS, KEPT_S, RecordTopics
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config
from cardan.protocols.joint_stream.codec import MalformedDatagram, decode_state
from tests.gateway.bus.fakes import FakeNode

TABLES = {
    "robot": {"driver": "sim_arm", "robot": "ur5", "pacing": "virtual", "period_s": 0.004},
    "arm": {"model": "ur5"},
}


class Rig:
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
def rig():
    made = Rig()
    with made.robot:
        yield made
        made.cycles.close()


def test_nothing_is_published_while_nobody_subscribes(rig):
    rig.run(200)
    assert rig.log.messages == rig.raw.messages == []
    assert rig.robot.raw_packet_callback is None


def test_a_recorder_that_is_found_late_gets_the_first_cycles(rig):
    rig.run(200)
    rig.log.heard = True
    rig.run(63 + 200)
    assert rig.numbers() == list(range(1, 464))


def test_kept_cycles_go_out_a_few_at_a_time(rig):
    rig.run(200)
    rig.log.heard = True
    before = 0
    for _ in range(100):
        rig.run(1)
        assert len(rig.log.messages) - before <= AT_ONCE
        before = len(rig.log.messages)


def test_what_is_kept_still_goes_out_when_the_session_ends(rig):
    rig.run(200)
    rig.log.heard = True
    rig.run(1)
    rig.record_topics.close()
    assert rig.numbers() == list(range(1, 202))


def test_nothing_is_kept_for_long(rig):
    rig.run(round(KEPT_S / 0.004) + 100)
    assert rig.controller.recorder is None
    assert not rig.record_topics._log._cycles
    rig.log.heard = True
    rig.run(100)
    assert rig.numbers()[0] > 1250
    assert rig.numbers() == list(range(rig.numbers()[0], rig.controller.ticks + 1))


def test_it_ends_when_the_recorder_has_gone(rig):
    rig.log.heard = rig.raw.heard = True
    rig.run(round(KEPT_S / 0.004) + 100)
    assert rig.robot.raw_packet_callback is not None
    rig.log.heard = rig.raw.heard = False
    rig.run(100)
    count = len(rig.log.messages)
    rig.run(100)
    assert len(rig.log.messages) == count
    assert rig.robot.raw_packet_callback is None


def test_requests_are_written_to_the_cycle_that_they_precede(rig):
    rig.log.heard = True

    def ask(ticks):
        if ticks == 50:
            rig.controller.stop("enough")
            rig.controller.inhibit("a reason", Inhibit.WHILE_SAID)
            rig.controller.inhibit("a reason", Inhibit.WHILE_SAID)

    rig.run(120, ask)
    records = [decode_cycle(each["data"]) for each in rig.log.messages]
    asked = {each.number: each.before for each in records if each.before}
    assert asked == {51: (("stop", "enough"), ("hold_off", "a reason"))}


def test_raw_bytes_are_those_that_were_exchanged(rig):
    rig.raw.heard = True
    rig.run(100)
    assert {each["direction"] for each in rig.raw.messages} == {0, 1}
    states = [decode_state(each["data"]) for each in rig.raw.messages if not each["direction"]]
    assert len(states) > 90
    assert not any(isinstance(state, MalformedDatagram) for state in states)
    sequences = [state.sequence for state in states]
    assert sequences == list(range(sequences[0], sequences[0] + len(states)))
    stamps = [
        (each["header"]["stamp"]["sec"], each["header"]["stamp"]["nanosec"])
        for each in rig.raw.messages
    ]
    assert stamps == sorted(stamps)


def test_raw_bytes_for_which_there_is_no_room_are_counted(rig):
    rig.raw.heard = True
    rig.run(10)
    for _ in range(KEPT_PACKETS + 7):
        rig.robot.raw_packet_callback(b"x", False, "")
    assert rig.record_topics.dropped == 7
    rig.run(1)
    assert len([each for each in rig.raw.messages if each["data"] == b"x"]) <= AT_ONCE


def test_after_its_end_nothing_is_tapped(rig):
    rig.log.heard = rig.raw.heard = True
    rig.run(10)
    rig.record_topics.close()
    assert rig.robot.raw_packet_callback is None
    assert rig.controller.recorder is None


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
