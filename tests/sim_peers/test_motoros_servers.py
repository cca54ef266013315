"""Servers of the simulated controller, with clients in virtual time."""

from __future__ import annotations

import itertools
import math
import struct
from collections import defaultdict

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.simple_message.codec import WireFormat
from cardan.protocols.simple_message.codes import CommType, MessageType, MotionCommand
from cardan.protocols.simple_message.framing import ByteOrder
from cardan.protocols.simple_message.messages import (
    Empty,
    JointFeedback,
    JointTrajPtFull,
    JointTrajPtFullEx,
    JointVelocity,
    Message,
    MotionCtrl,
    MotionReply,
    ReadIo,
    ReadIoReply,
    ReadRegister,
    SelectTool,
    VelocityInfoRequest,
    WriteIo,
    WriteIoReply,
    WriteRegister,
    joints10,
    reply,
    request,
    topic,
)
from cardan.sim_peers.motoros_controller import (
    CONNECTIONS,
    FAULTS,
    MotorosController,
    MotorosControllerOptions,
    MotorosServers,
)
from tests.examples import examples

START_S = 1000.0
PING = request(Empty(), MessageType.PING)
READY = request(MotionCtrl(0, 7, MotionCommand.CHECK_MOTION_READY))
START = request(MotionCtrl(0, 2, MotionCommand.START_TRAJ_MODE))
T = MessageType


class World:
    """Servers and their clients; only `run` advances time."""

    def __init__(self, **options):
        self.options = MotorosControllerOptions(**{"servo_on": True, **options})
        self.controller = MotorosController(self.options)
        self.servers = MotorosServers(self.controller, self.options)
        self.wire = WireFormat(ByteOrder.BIG if self.options.big_endian else ByteOrder.LITTLE)
        self.now_s = START_S
        self.came = defaultdict(list)
        self.closed = {}
        self.aborted = {}
        self.servers.advance(self.now_s)

    def connect(self, kind):
        number = self.servers.accepted(kind, self.now_s)
        self.poll()
        return number

    def send(self, number, *messages):
        """Send each message by its own send()."""
        for message in messages:
            self.raw(number, self.wire.encode(message))

    def raw(self, number, data):
        self.servers.data(number, data, self.now_s)
        self.poll()

    def ask(self, number, message):
        """Return the only, immediate reply."""
        self.send(number, message)
        (answer,) = self.take(number)
        return answer

    def poll(self):
        for number, data in self.servers.outgoing():
            assert number not in self.closed or self.closed[number] == self.now_s
            self.came[number].append((self.now_s, data))
        for number in self.servers.closing():
            self.closed[number] = self.now_s
        for number in self.servers.aborting():
            self.aborted[number] = self.now_s

    def run(self, seconds):
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s = min(end_s, max(self.servers.next_s, self.now_s + 1e-6))
            self.servers.advance(self.now_s)
            self.poll()

    def take(self, number):
        """Return the messages that arrived, each in a separate piece."""
        pieces, self.came[number] = self.came[number], []
        return [self.wire.decode(data) for _, data in pieces]

    def times(self, number, msg_type):
        return [
            time_s - START_S
            for time_s, data in self.came[number]
            if self.wire.decode(data).msg_type == msg_type
        ]

    def said(self, text):
        return any(text in event for _, event in self.servers.events)

    def point(self, sequence, time_s, change=(), velocity=()):
        """Return a point at the start position, moved by `change` (rad)."""
        start = self.controller.command_rad(0)
        change = (*change, *[0.0] * (len(start) - len(change)))
        position = [a + b for a, b in zip(start, change, strict=True)]
        body = JointTrajPtFull(
            0, sequence, 7, time_s, joints10(position), joints10(velocity), joints10(())
        )
        return request(body)

    def start_moving(self, motion):
        """Start trajectory mode, and queue half a second of motion."""
        self.send(motion, START)
        self.run(0.2)
        first = self.point(0, 0.0)
        second = self.point(1, 1.0, (0.05,))
        self.take(motion)
        assert self.ask(motion, first).body.result == 0
        assert self.ask(motion, second).body.result == 0
        self.run(0.05)
        assert self.controller.moving_data


@pytest.fixture
def world():
    return World()


@pytest.fixture
def motion(world):
    """Connect a client to the motion port."""
    return world.connect("motion")


@pytest.fixture
def state(world):
    return world.connect("state")


@pytest.fixture
def io(world):
    return world.connect("io")


def refusal(msg_type, subcode):
    return MotionReply(-1, -1, msg_type, 3, subcode)


# -- connections ----------------------------------------------------------------------------------


def test_a_newer_motion_client_takes_the_place_of_one_at_rest(world):
    first = world.connect("motion")
    second = world.connect("motion")
    assert list(world.closed) == [first]
    assert world.ask(second, PING).msg_type == T.PING
    world.send(first, PING)
    assert not world.take(first)
    assert world.servers.counters.replaced == 1


def test_a_newer_motion_client_is_refused_while_the_arm_moves(world):
    first = world.connect("motion")
    world.start_moving(first)
    assert world.connect("motion") is None
    assert world.ask(first, PING).msg_type == T.PING
    assert not world.closed
    assert world.said("the arm moves")
    world.run(1.5)
    assert world.connect("motion") is not None
    assert first in world.closed


@pytest.mark.parametrize("end", ["fin", "rst", "cut"])
def test_nobody_comes_while_the_velocity_mode_ramps_down(end):
    """The ramp takes longer than the 50 ms after a FIN, when the connection becomes free again."""
    world = World(acceleration_limits=(2.0,) * 6, faults={"cut": 1.5} if end == "cut" else {})
    motion = world.connect("motion")
    world.send(motion, request(MotionCtrl(0, 1, MotionCommand.START_VEL_MODE)))
    world.run(0.2)
    for sequence in range(65):
        world.send(motion, velocity(sequence, 1.0))
        world.run(0.02)
    if end == "fin":
        world.servers.eof(motion, world.now_s)
    elif end == "rst":
        world.servers.lost(motion, world.now_s, "reset")
    world.run(0.1)
    assert motion in world.closed
    assert 0.5 < world.controller.velocity_rad_s(0)[0] < 1.0
    assert world.connect("motion") is None
    assert world.connect("state") is not None
    world.run(0.5)
    assert world.connect("motion") is not None
    assert world.controller.active_mode == 1


@pytest.mark.parametrize(("end", "mode"), [("reset", 0), ("closed", 1)])
def test_a_client_that_goes_while_it_starts_the_velocity_mode(end, mode):
    """All requests of one that closes are executed: a busy server sees a FIN only then."""
    world = World(servo_on=False)
    motion = world.connect("motion")
    world.send(motion, request(MotionCtrl(0, 1, MotionCommand.START_VEL_MODE)))
    if end == "closed":
        world.servers.eof(motion, world.now_s)
    else:
        world.run(0.1)
        world.servers.lost(motion, world.now_s, end)
    world.run(3.0)
    motion = world.connect("motion")
    info = world.ask(motion, request(VelocityInfoRequest(0))).body
    assert info.active_mode == mode


def test_four_clients_get_states_and_a_fifth_takes_the_first_ones_place(world):
    four = [world.connect("state") for _ in range(CONNECTIONS["state"])]
    fifth = world.connect("state")
    assert list(world.closed) == four[:1]
    world.run(0.1)
    retained = [*four[1:], fifth]
    assert len({tuple(data for _, data in world.came[number]) for number in retained}) == 1
    assert len(world.came[fifth]) == 8
    motion = world.connect("motion")
    world.start_moving(motion)
    assert world.connect("state") is None
    io = world.connect("io")
    assert world.connect("io") is None
    assert world.ask(io, request(ReadIo(10), T.MOTO_READ_IO_BIT)).body == ReadIoReply(0, 0)


def test_a_place_is_free_50_ms_after_its_client_has_gone(world, motion):
    world.start_moving(motion)
    world.servers.eof(motion, world.now_s)
    world.run(0.03)
    assert motion not in world.closed
    assert world.connect("motion") is None
    world.run(0.03)
    assert motion in world.closed
    assert world.connect("motion") is not None


def test_a_state_client_that_goes_makes_room_at_once(world):
    four = [world.connect("state") for _ in range(4)]
    world.servers.eof(four[2], world.now_s)
    world.poll()
    assert list(world.closed) == [four[2]]
    assert world.connect("state") is not None
    assert len(world.closed) == 1


def test_connections_show_in_the_feedback_outputs(world, io):
    outputs = {"motion": 11124, "state": 11125, "io": 11126}

    def read(kind):
        return world.ask(io, request(ReadIo(outputs[kind]), T.MOTO_READ_IO_BIT)).body.value

    assert [read(kind) for kind in outputs] == [0, 0, 1]
    motion, state = world.connect("motion"), world.connect("state")
    assert [read(kind) for kind in outputs] == [1, 1, 1]
    world.servers.eof(motion, world.now_s)
    world.servers.eof(state, world.now_s)
    world.run(0.1)
    assert [read(kind) for kind in outputs] == [0, 0, 1]


# -- framing and replies --------------------------------------------------------------------------


def test_worked_bytes_in_both_orders():
    ping = "0c000000 01000000 02000000 00000000"
    pong = "0c000000 01000000 03000000 01000000"
    start = f"40000000 d1070000 02000000 00000000 00000000 02000000 b90d0300 {'00000000 ' * 10}"
    started = (
        "48000000 d2070000 03000000 01000000 00000000 02000000 b90d0300 00000000 00000000"
        f"{'00000000 ' * 10}"
    )
    for big_endian in (False, True):
        world = World(big_endian=big_endian)
        motion = world.connect("motion")
        for asked, answer in ((ping, pong), (start, started)):
            words = [bytes.fromhex(text) for text in (asked, answer)]
            if big_endian:
                words = [
                    b"".join(data[at : at + 4][::-1] for at in range(0, len(data), 4))
                    for data in words
                ]
            world.raw(motion, words[0])
            world.run(0.2)
            assert world.came.pop(motion)[0][1] == words[1]


def test_pieces_are_put_together_and_noted(world, motion):
    data = world.wire.encode(READY)
    for at in range(0, len(data), 5):
        world.raw(motion, data[at : at + 5])
    (answer,) = world.take(motion)
    assert answer.body[1:3] == (7, MotionCommand.CHECK_MOTION_READY)
    assert world.servers.counters.pieces == math.ceil(len(data) / 5) - 1
    assert world.said("came in pieces")


def test_merged_requests_are_answered_in_order_and_noted_as_pipelined(world, motion):
    asked = [request(MotionCtrl(0, n, MotionCommand.CHECK_QUEUE_CNT)) for n in range(5)]
    world.raw(motion, b"".join(map(world.wire.encode, asked)))
    assert [answer.body.sequence for answer in world.take(motion)] == [0, 1, 2, 3, 4]
    assert world.servers.counters.pipelined == 4
    assert world.said("before the reply to the one before")
    for number in range(5):
        world.ask(motion, request(MotionCtrl(0, number, MotionCommand.CHECK_QUEUE_CNT)))
    assert world.servers.counters.pipelined == 4


def test_a_waiting_server_takes_nothing_and_then_goes_on(world):
    motion, state = world.connect("motion"), world.connect("state")
    world.send(motion, START, PING, READY)
    assert world.servers.counters.pipelined == 2
    world.run(0.1)
    assert not world.came[motion]
    assert len(world.take(state)) == 8
    world.run(0.02)
    answers = world.take(motion)
    assert [answer.msg_type for answer in answers] == [2002, 1, 2002]
    assert answers[0].body.command == MotionCommand.START_TRAJ_MODE
    assert answers[2].body.result == 0


def test_a_flood_is_held_back_and_served_in_turns(world, motion):
    world.send(motion, START)
    world.raw(motion, world.wire.encode(PING) * 100)
    assert not world.servers.takes(motion)
    world.run(0.2)
    assert [answer.msg_type for answer in world.take(motion)] == [2002] + [1] * 100
    assert world.servers.takes(motion)
    assert not world.servers.takes(motion + 1)


@pytest.mark.parametrize("prefix", [11, 1021, -1, 0x40000000])
def test_a_wrong_prefix_ends_the_connection_after_what_came_before(prefix, world):
    for kind in ("motion", "io"):
        number = world.connect(kind)
        world.raw(number, world.wire.encode(PING) + struct.pack("<4i", prefix, 1, 2, 0))
        assert len(world.take(number)) == 1
        assert number in world.closed
    assert world.said(f"a prefix of {prefix}")
    assert world.servers.counters.failed == 2
    assert world.servers.accepted("motion", world.now_s) is not None


def test_a_wrong_byte_order_ends_the_connection():
    world = World(big_endian=True)
    motion = world.connect("motion")
    world.raw(motion, WireFormat(ByteOrder.LITTLE).encode(READY))
    assert motion in world.closed
    assert not world.take(motion)


@pytest.mark.parametrize(
    ("msg_type", "body", "answer"),
    [
        (1, 4, refusal(1, 3001)),
        (14, 132, MotionReply(0, 5, 14, 3, 3001)),
        (14, 4, MotionReply(0, 0, 14, 3, 3001)),
        (2001, 20, MotionReply(0, 5, 6, 3, 3001)),
        (2001, 4, MotionReply(0, 0, 0, 3, 3001)),
        (2016, 8, MotionReply(0, 5, 2016, 3, 3001)),
        (2018, 8, MotionReply(0, 0, 2018, 3, 3001)),
        (2020, 4, refusal(2020, 3001)),
        (2003, 8, refusal(2003, 3001)),
        (2040, 8, MotionReply(0, 5, 2040, 3, 3001)),
        (10, 8, refusal(10, 3003)),
        (10, 44, refusal(10, 3003)),
        (2, 0, refusal(2, 3003)),
        (2012, 4, refusal(2012, 3003)),
        (2013, 8, refusal(2013, 3003)),
        (2004, 8, refusal(2004, 3003)),
        (77, 40, refusal(77, 3003)),
        (-5, 0, refusal(-5, 3003)),
    ],
)
def test_wrong_lengths_and_types_are_refused_and_the_connection_kept(
    msg_type, body, answer, world, motion
):
    words = struct.pack(f"<{body // 4}i", *range(4, 4 + body // 4))
    frame = struct.pack("<4i", 12 + body, msg_type, CommType.SERVICE_REQUEST, 0) + words
    world.raw(motion, frame)
    found = world.take(motion)
    assert [(each.msg_type, each.reply_code, each.body) for each in found] == [(2002, 1, answer)]
    assert world.ask(motion, PING).msg_type == T.PING
    assert world.servers.counters.pipelined == 0


def test_without_velocity_mode_its_messages_are_unknown():
    world = World(velocity_mode=False)
    motion = world.connect("motion")
    for msg_type, size in itertools.product((2040, 2041, 2042), (4, 136)):
        world.raw(motion, struct.pack("<4i", 12 + size, msg_type, 2, 0) + bytes(size))
        (found,) = world.take(motion)
        assert found.body == refusal(msg_type, 3003)


@pytest.mark.parametrize("msg_type", [13, 15, 2002, 2017])
@pytest.mark.parametrize("size", [0, 28, 60, 132, 532])
def test_messages_of_the_controller_itself_end_the_connection(msg_type, size, world, motion):
    world.raw(motion, struct.pack("<4i", 12 + size, msg_type, 2, 0) + bytes(size))
    assert motion in world.closed
    assert not world.take(motion)
    assert world.connect("motion") is not None


def test_disconnect_is_not_answered(world, motion):
    world.send(motion, request(MotionCtrl(0, 0, MotionCommand.DISCONNECT)), PING)
    assert not world.take(motion)
    assert motion in world.closed


def test_a_reply_is_not_answered_and_topics_of_velocity_neither(world, motion):
    reply_like = [
        READY._replace(comm_type=CommType.SERVICE_REPLY),
        request(ReadIo(10), T.MOTO_READ_IO_BIT)._replace(comm_type=CommType.SERVICE_REPLY),
        topic(JointVelocity(0, 0, 4, 0.0, *[joints10(())] * 3)),
    ]
    world.send(motion, *reply_like)
    world.raw(motion, struct.pack("<4i", 16, 2040, CommType.TOPIC, 0) + bytes(4))
    world.raw(motion, struct.pack("<4i", 16, 14, CommType.SERVICE_REPLY, 0) + bytes(4))
    assert not world.take(motion)
    assert world.ask(motion, READY._replace(comm_type=CommType.TOPIC)).msg_type == 2002
    assert world.servers.counters.pipelined == 0


def test_a_point_may_come_with_room_for_all_groups(world, motion):
    start = joints10(world.controller.command_rad(0))
    world.send(motion, START)
    world.run(0.2)
    world.take(motion)
    one = JointTrajPtFullEx(0, (JointFeedback(0, 7, 0.0, start, *[joints10(())] * 2),))
    frame = world.wire.encode(request(one)) + bytes(3 * 132)
    world.raw(motion, struct.pack("<i", len(frame) - 4) + frame[4:])
    (answer,) = world.take(motion)
    assert answer.body[1:] == (0, 2016, 0, 0, joints10(()))


def velocity(sequence, speed_rad_s):
    return topic(
        JointVelocity(0, sequence, 4, 0.0, joints10(()), joints10([speed_rad_s]), joints10(()))
    )


def test_velocity_commands_stream_and_keep_others_out(world):
    motion, state = world.connect("motion"), world.connect("state")
    world.send(motion, request(MotionCtrl(0, 0, MotionCommand.START_VEL_MODE)))
    world.run(0.2)
    assert [each.body.result for each in world.take(motion)] == [0]
    for sequence in range(50):
        # Two in one segment: the newer one counts.
        pair = (velocity(2 * sequence, -0.3), velocity(2 * sequence + 1, 0.2))
        world.raw(motion, b"".join(map(world.wire.encode, pair)))
        world.run(0.01)
    assert not world.take(motion)
    assert world.servers.counters.pipelined == 0
    assert world.connect("motion") is None
    *_, feedback, status = world.take(state)
    assert feedback.body.vel[0] == pytest.approx(0.2, rel=0.02)
    assert status.body.in_motion == 1
    world.servers.eof(motion, world.now_s)
    world.run(0.5)
    *_, feedback, status = world.take(state)
    assert feedback.body.vel[0] == 0.0
    assert status.body.in_motion == 0
    assert world.connect("motion") is not None


# -- inputs and outputs ---------------------------------------------------------------------------


def test_the_io_port_serves_bits_groups_and_registers(world, io):
    world.servers.io.set_input(20010, True)
    assert world.ask(io, request(ReadIo(20010), T.MOTO_READ_IO_BIT)).body == ReadIoReply(1, 0)
    assert world.ask(io, request(WriteIo(1001, 9), T.MOTO_WRITE_IO_GROUP)).body == WriteIoReply(0)
    assert world.ask(io, request(ReadIo(1001), T.MOTO_READ_IO_GROUP)).body == ReadIoReply(9, 0)
    world.ask(io, request(WriteRegister(3, 77)))
    found = world.ask(io, request(ReadRegister(1_000_003)))
    assert found[:3] == (T.MOTO_READ_MREGISTER, CommType.SERVICE_REPLY, 1)
    assert found.body == (77, 0)
    found = world.ask(io, request(ReadIo(18), T.MOTO_READ_IO_BIT))
    assert found[:3] == (T.MOTO_READ_IO_BIT_REPLY, CommType.SERVICE_REPLY, 2)
    assert found.body == (0, 1001)


@pytest.mark.parametrize(
    ("frame", "subcode"),
    [
        (struct.pack("<4i", 12, 1, 2, 0), 3003),
        (struct.pack("<4i", 12, 99, 2, 0), 3003),
        (struct.pack("<4i", 12, 2003, 2, 0), 3001),
        (struct.pack("<4i", 64, 2001, 2, 0) + bytes(52), 3003),
        (struct.pack("<6i", 20, 2012, 3, 1, 5, 6), 3001),
    ],
)
def test_the_io_port_refuses_in_the_first_two_words_of_a_motion_reply(frame, subcode, world, io):
    world.raw(io, frame)
    ((_, data),) = world.came[io]
    assert len(data) == 76
    assert struct.unpack("<6i", data[:24]) == (72, 2002, 3, 1, 3, subcode)
    assert not any(data[24:])
    assert io not in world.closed


def test_old_clients_use_bits_and_groups_on_the_motion_port(world, motion):
    assert world.ask(motion, request(WriteIo(10010, 1), T.MOTO_WRITE_IO_BIT)).body == (0,)
    assert world.ask(motion, request(ReadIo(1001), T.MOTO_READ_IO_GROUP)).body == ReadIoReply(1, 0)
    assert world.ask(motion, request(SelectTool(0, 64, 3))).msg_type == 2002


# -- states ---------------------------------------------------------------------------------------


def test_an_unknown_command_repeats_whatever_the_connection_was_answered_last(world, motion):
    unknown = request(MotionCtrl(0, 5, 209999))
    counted = world.ask(motion, request(MotionCtrl(0, 1, MotionCommand.CHECK_QUEUE_CNT)))
    assert world.ask(motion, unknown) == counted
    ping = world.ask(motion, PING)
    assert world.ask(motion, unknown) == ping
    read = world.ask(motion, request(ReadIo(10010), T.MOTO_READ_IO_BIT))
    assert world.ask(motion, unknown) == read
    short = world.wire.encode(READY)[:40]
    world.raw(motion, (36).to_bytes(4, "little") + short[4:])
    (refused,) = world.take(motion)
    assert refused.body.subcode == 3001
    assert world.ask(motion, unknown) == refused
    again = world.connect("motion")
    assert world.ask(again, unknown).body == MotionReply(0, 0, 0, 0, 0)


def test_states_come_every_25_ms_in_order(world, state):
    world.run(1.0001)
    types = [each.msg_type for each in world.take(state)]
    assert types == [T.JOINT_FEEDBACK, T.ROBOT_STATUS] * 40
    world.run(1.0)
    times = world.times(state, T.ROBOT_STATUS)
    assert times == pytest.approx([1.025 + 0.025 * n for n in range(40)], abs=1e-4)
    feedback, status = world.take(state)[:2]
    start = joints10(world.options.arm.home)
    assert feedback.body.pos == pytest.approx(start, abs=1e-3)
    assert feedback.comm_type == status.comm_type == CommType.TOPIC
    assert status.body.drives_powered == 1


def test_several_groups_have_the_extended_feedback_too():
    world = World(groups=3)
    state = world.connect("state")
    world.run(0.03)
    *feedback, extended, status = world.take(state)
    assert [(each.msg_type, each.body.group) for each in feedback] == [(15, 0), (15, 1), (15, 2)]
    assert extended.msg_type == T.MOTO_JOINT_FEEDBACK_EX
    assert extended.body.groups == 3
    assert extended.body.feedback[:3] == tuple(each.body for each in feedback)
    assert extended.body.feedback[3].valid_fields == 0
    assert status.msg_type == T.ROBOT_STATUS


def test_after_a_stall_states_go_on_from_the_schedule_without_a_burst(world, state):
    world.run(0.05)
    world.take(state)
    world.now_s += 0.26
    world.servers.advance(world.now_s)
    world.poll()
    assert len(world.came[state]) == 2
    world.run(0.05)
    assert world.times(state, T.ROBOT_STATUS)[1:] == pytest.approx([0.325, 0.35], abs=1e-5)


def test_what_is_sent_to_the_state_port_changes_nothing(world, state):
    world.raw(state, b"GET / HTTP/1.1\r\n\r\n")
    world.raw(state, world.wire.encode(START))
    world.run(0.06)
    assert len(world.take(state)) == 4
    assert world.servers.counters.unread == 2
    assert world.said("which is never read")


# -- faults ---------------------------------------------------------------------------------------


def faulty(**faults):
    return World(faults={name.replace("_", "-"): value for name, value in faults.items()})


def test_replies_can_be_dropped():
    world = faulty(drop_reply=0.5)
    motion = world.connect("motion")
    world.send(motion, *[PING] * 200)
    assert 60 < len(world.take(motion)) < 140
    assert world.servers.counters.dropped_replies + world.servers.counters.replies == 200
    assert world.servers.counters.pipelined == 0


def test_replies_can_be_late():
    world = faulty(late=80.0)
    motion = world.connect("motion")
    world.send(motion, PING)
    world.run(0.0799)
    assert not world.came[motion]
    world.run(0.0002)
    assert len(world.take(motion)) == 1
    world.send(motion, READY, READY)
    assert world.servers.counters.pipelined == 1
    world.run(0.1)
    assert len(world.take(motion)) == 2


def test_replies_can_be_stale():
    world = faulty(stale_reply=1.0)
    motion = world.connect("motion")
    for sequence in range(4):
        found = world.ask(motion, READY._replace(body=READY.body._replace(sequence=sequence)))
        assert found.body.sequence == max(0, sequence - 1)


def test_a_silent_controller_leaves_its_connections_open_and_the_arm_goes_on():
    world = faulty(silent=0.5)
    motion, state = world.connect("motion"), world.connect("state")
    world.start_moving(motion)
    world.run(0.3)
    world.take(state)
    world.take(motion)
    before = world.controller.command_pulses(0)
    world.send(motion, PING)
    world.servers.eof(state, world.now_s)
    world.run(1.0)
    assert world.servers.silent
    assert not world.came[motion]
    assert not world.came[state]
    assert not world.closed
    assert not world.servers.takes(motion)
    assert world.controller.command_pulses(0) != before


def test_the_motion_connection_can_be_cut_and_all_be_reset():
    world = faulty(cut=0.2, reset=0.4)
    numbers = {kind: world.connect(kind) for kind in CONNECTIONS}
    world.run(0.3)
    assert world.closed == {numbers["motion"]: pytest.approx(START_S + 0.2, abs=1e-6)}
    numbers["motion"] = world.connect("motion")
    world.run(0.3)
    assert set(world.aborted) == set(numbers.values())
    assert world.connect("motion") is not None


def test_strict_reception_loses_split_messages():
    world = faulty(strict_recv=1.0)
    motion = world.connect("motion")
    data = world.wire.encode(READY)
    world.raw(motion, data[:30])
    assert [each.body[2:5] for each in world.take(motion)] == [(200101, 3, 3001)]
    world.raw(motion, data[30:])
    (answer,) = world.take(motion)
    assert answer.body == refusal(0, 3003)
    world.raw(motion, data[:9])
    (answer,) = world.take(motion)
    assert answer.body[3:5] == (3, 3001)
    assert world.ask(motion, READY).body.sequence == 7
    assert world.servers.counters.pieces == 2


def test_strict_reception_goes_by_type_and_not_by_prefix():
    world = faulty(strict_recv=1.0)
    motion = world.connect("motion")
    data = world.wire.encode(READY)
    world.raw(motion, struct.pack("<i", 99999) + data[4:])
    (answer,) = world.take(motion)
    assert answer.body.sequence == 7
    world.raw(motion, data + world.wire.encode(PING) + data)
    assert [each.msg_type for each in world.take(motion)] == [2002, 1, 2002]
    world.raw(motion, data + data[:20])
    assert len(world.take(motion)) == 1
    assert world.said("MotoROS's memory is hit")
    world.raw(motion, struct.pack("<4i", 12, 99, 2, 0) + data)
    assert [each.body for each in world.take(motion)] == [refusal(99, 3003)]


def test_strict_reception_of_points_for_several_groups():
    world = faulty(strict_recv=1.0)
    motion = world.connect("motion")
    point = JointFeedback(0, 7, 0.0, *[joints10(())] * 3)
    for groups in (0, 1, 4):
        frame = world.wire.encode(request(JointTrajPtFullEx(0, (point,) * groups)))
        world.raw(motion, frame)
        assert len(world.take(motion)) == 1
        world.raw(motion, frame[:-1])
        (answer,) = world.take(motion)
        assert answer.body[3:5] == (3, 3001)
    world.raw(motion, struct.pack("<5i", 16, 2016, 2, 0, 1_000_000))
    (answer,) = world.take(motion)
    assert answer.body[3:5] == (3, 3001)


def test_the_state_port_can_pause():
    world = faulty(state_pause=0.5)
    state = world.connect("state")
    world.run(11.0)
    times = world.times(state, T.ROBOT_STATUS)
    gaps = [(a, b - a) for a, b in itertools.pairwise(times) if b - a > 0.03]
    assert [begun_s for begun_s, _ in gaps] == pytest.approx([5.0, 10.0], abs=0.03)
    assert [gap_s for _, gap_s in gaps] == pytest.approx([0.525, 0.525], abs=0.026)


def test_states_can_be_preceded_by_junk():
    world = faulty(garbage=0.5)
    state = world.connect("state")
    world.run(5.0)
    pieces = [data for _, data in world.came[state]]
    good = [data for data in pieces if len(data) in (148, 44)]
    assert len(good) >= 400
    assert 40 < len(pieces) - 400 < 160


def test_messages_can_be_split_and_merged():
    world = faulty(split=1.0, merge=1.0)
    motion, state = world.connect("motion"), world.connect("state")
    world.run(0.026)
    first, second = (data for _, data in world.came[state])
    merged = first + second
    assert len(merged) == 148 + 44
    assert world.wire.decode(merged[:148]).msg_type == T.JOINT_FEEDBACK
    world.send(motion, PING)
    assert len(world.came[motion]) == 1
    world.run(0.005)
    assert len(world.came[motion]) == 2
    assert b"".join(data for _, data in world.came[motion]) == bytes.fromhex(
        "0c000000010000000300000001000000"
    )


def test_what_waits_to_be_written_goes_out_before_a_connection_is_closed():
    world = faulty(split=1.0)
    motion = world.connect("motion")
    frames = [PING, request(MotionCtrl(0, 0, MotionCommand.DISCONNECT))]
    world.raw(motion, b"".join(map(world.wire.encode, frames)))
    assert motion in world.closed
    assert b"".join(data for _, data in world.came[motion])[4:8] == struct.pack("<i", 1)


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("estop", "e_stopped", 1),
        ("alarm", "error_code", 4107),
        ("teach", "mode", 1),
        ("servo-off", "drives_powered", 0),
        ("hold", "motion_possible", 0),
        ("pfl", "motion_possible", 0),
    ],
)
def test_things_happen_in_the_cell_at_a_time(name, field, value):
    world = World(faults={name: 0.5})
    motion = world.connect("motion")
    world.send(motion, START)
    world.run(0.45)
    before = getattr(world.controller.status(), field)
    world.run(0.15)
    assert before != getattr(world.controller.status(), field) == value


def test_a_speed_limit_of_the_safety_unit_stretches_the_trajectory():
    world = faulty(fsu=0.008)
    motion = world.connect("motion")
    world.start_moving(motion)
    world.run(0.5)
    # 0.075 rad/s without a limit.
    assert world.controller.velocity_rad_s(0)[0] == pytest.approx(
        0.008 * world.options.axis_speeds[0], rel=0.05
    )
    world.run(0.5)
    assert world.controller.moving_data  # longer than the second that the trajectory takes
    world.run(1.0)
    assert not world.controller.moving_data
    assert world.controller.command_rad(0)[0] == pytest.approx(
        world.options.arm.home[0] + 0.05, abs=1e-4
    )


def test_names_of_faults_are_unique_and_all_can_be_set():
    assert len({switch.name for switch in FAULTS}) == len(FAULTS)
    world = World(faults={switch.name: switch.default for switch in FAULTS})
    for kind in CONNECTIONS:
        world.connect(kind)
    world.run(6.0)
    assert world.servers.silent


# -- arbitrary input ------------------------------------------------------------------------------

VALID = [
    PING,
    READY,
    START,
    request(MotionCtrl(0, 0, MotionCommand.STOP_MOTION)),
    request(MotionCtrl(0, 0, MotionCommand.STOP_TRAJ_MODE)),
    request(MotionCtrl(3, 1, 12345)),
    request(JointTrajPtFull(0, 1, 7, 0.5, *[joints10([0.1] * 6)] * 3)),
    request(JointVelocity(0, 4, 4, 0.5, *[joints10([0.1] * 6)] * 3)),
    request(SelectTool(0, 1, 1)),
    request(ReadIo(10), T.MOTO_READ_IO_BIT),
    request(WriteRegister(5, 6)),
    Message(T.MOTO_GET_DH_PARAMETERS, CommType.SERVICE_REQUEST, 0, Empty()),
]


@st.composite
def mutated(draw):
    data = bytearray(WireFormat().encode(draw(st.sampled_from(VALID))))
    for _ in range(draw(st.integers(0, 4))):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return bytes(data[: draw(st.integers(1, len(data)))]) if draw(st.booleans()) else bytes(data)


STEP = st.tuples(
    st.sampled_from([*CONNECTIONS]), st.one_of(st.binary(max_size=700), mutated()), st.booleans()
)


@settings(max_examples=examples(60))
@given(steps=st.lists(STEP, max_size=12), strict=st.booleans(), big_endian=st.booleans())
def test_no_bytes_raise_or_move_the_arm(steps, strict, big_endian):
    world = World(faults={"strict-recv": float(strict)}, big_endian=big_endian)
    start = world.controller.command_pulses(0)
    numbers = {}
    for kind, data, wait in steps:
        number = numbers.get(kind)
        if number is None or number in world.closed:
            number = numbers[kind] = world.connect(kind)
        world.raw(number, data)
        if wait:
            world.run(0.15)
    world.run(0.5)
    assert world.controller.command_pulses(0) == start
    counters = world.servers.counters
    assert counters.failed == len(world.closed) - sum(
        "closed: the controller ends it" in text for _, text in world.servers.events
    )
    for kind in CONNECTIONS:
        number = world.connect(kind)
        assert number is not None
        if kind == "motion":
            assert world.ask(number, PING).msg_type == T.PING


def test_faults_of_the_servers_come_and_go_while_they_run(world, motion):
    ping = request(Empty(), msg_type=T.PING)
    assert world.ask(motion, ping) == reply(Empty(), msg_type=T.PING)
    world.servers.behave({"drop-reply": 1.0})
    world.send(motion, ping)
    assert world.take(motion) == []
    world.servers.behave({"late": 50.0})
    world.send(motion, ping)
    assert world.take(motion) == []
    world.run(0.06)
    assert len(world.take(motion)) == 1
    world.servers.behave({})
    assert world.ask(motion, ping) == reply(Empty(), msg_type=T.PING)
