"""Simple message: every body encoded and decoded, with both byte orders and both sizes of reals."""

from __future__ import annotations

import enum
import struct

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.simple_message import codec, codes, messages
from cardan.protocols.simple_message.codec import WireFormat, detect_wire
from cardan.protocols.simple_message.codes import (
    MessageType,
    MotionCommand,
    MotionResult,
    NotReadySubcode,
    name_of,
)
from cardan.protocols.simple_message.framing import ByteOrder
from cardan.protocols.simple_message.messages import (
    DH_LINKS,
    MAX_GROUPS,
    ZEROS,
    Body,
    DhLink,
    DhParameters,
    Empty,
    JointFeedback,
    JointFeedbackEx,
    JointTrajPt,
    JointTrajPtFull,
    JointTrajPtFullEx,
    JointVelocity,
    JointVelocityEx,
    MalformedMessage,
    Message,
    MotionCtrl,
    MotionReply,
    Raw,
    ReadIo,
    ReadIoReply,
    ReadRegister,
    ReadRegisterReply,
    RobotStatus,
    RtGroupCommand,
    RtGroupState,
    RtJointCommand,
    RtJointState,
    VelocityInfo,
    VelocityInfoRequest,
    WriteIo,
    WriteIoReply,
    WriteRegister,
    WriteRegisterReply,
    joints10,
    reply,
    request,
    topic,
)
from tests.examples import examples

INT = st.integers(-(2**31), 2**31 - 1)
UNSIGNED = st.integers(0, 2**32 - 1)
REAL = st.floats(width=32, allow_nan=False)
JOINTS = st.tuples(*[REAL] * messages.JOINTS)
POINT = st.builds(JointFeedback, INT, INT, REAL, JOINTS, JOINTS, JOINTS)
LINK = st.builds(DhLink, REAL, REAL, REAL, REAL)
FIELDS = {"i": INT, "I": UNSIGNED, "f": REAL, "10f": JOINTS}


def _fixed(body: type) -> st.SearchStrategy:
    return st.builds(body, *(FIELDS[part] for part in codec.letters(body)))


GROUPS = st.lists(POINT, max_size=4).map(tuple)
BODIES = {
    **{
        body: _fixed(body)
        for bodies in messages.BODIES.values()
        for body in bodies
        if "" not in codec.letters(body)
    },
    JointTrajPtFullEx: st.builds(JointTrajPtFullEx, INT, GROUPS),
    JointVelocityEx: st.builds(JointVelocityEx, INT, GROUPS),
    JointFeedbackEx: st.builds(
        JointFeedbackEx, st.integers(0, 4), st.tuples(POINT, POINT, POINT, POINT)
    ),
    DhParameters: st.builds(DhParameters, st.tuples(*[st.tuples(*[LINK] * DH_LINKS)] * MAX_GROUPS)),
    RtJointState: st.builds(
        RtJointState,
        INT,
        INT,
        st.lists(st.builds(RtGroupState, INT, JOINTS, JOINTS), max_size=4).map(tuple),
    ),
    RtJointCommand: st.builds(
        RtJointCommand,
        INT,
        st.lists(st.builds(RtGroupCommand, INT, JOINTS), max_size=4).map(tuple),
    ),
    Raw: st.builds(Raw, st.binary(max_size=200)),
}
SHARED = {
    Empty: (1, 2, 2020),
    ReadIo: (2003, 2007),
    ReadIoReply: (2004, 2008),
    WriteIo: (2005, 2009),
    WriteIoReply: (2006, 2010),
    Raw: (12, 20, 21, 2040000),
}
"""Bodies that several message types share."""
TYPES = [(body, msg_type) for body in BODIES for msg_type in SHARED.get(body, (None,))]
WIRES = [codec.wire(order, reals) for order in ByteOrder for reals in (4, 8)]


def named(wire):
    return f"{wire.byte_order.name}-{wire.real_bytes}"


ON_EACH_WIRE = [
    pytest.param(
        *of_type,
        wire,
        marks=() if place == number % len(WIRES) else pytest.mark.matrix,
        id=f"{of_type[0].__name__}-{of_type[1]}-{named(wire)}",
    )
    for number, of_type in enumerate(TYPES)
    for place, wire in enumerate(WIRES)
]
"""Combinations run with every change: each type on one wire, and each wire with every fourth
type."""


def test_every_type_and_every_body_is_served():
    served = {kind for _, kind in TYPES} | set(messages._TYPES.values())
    assert served >= set(MessageType) - {16, 17}
    assert set(Body.__args__) == set(BODIES)


@pytest.mark.parametrize(("body", "msg_type", "wire"), ON_EACH_WIRE)
@settings(max_examples=examples(20))
@given(data=st.data())
def test_every_message_comes_back_as_it_was(body, msg_type, wire, data):
    message = data.draw(st.sampled_from((request, topic, reply)))(
        data.draw(BODIES[body]), msg_type=msg_type
    )
    found = wire.encode(message)
    assert int.from_bytes(found[:4], wire.byte_order.name.lower()) == len(found) - 4
    assert wire.decode(found) == message
    assert wire.decode_datagram(found + b"junk") == message


TOTALS = """
1:16 10:60 11:68 13:44 14:152 15:148 2001:68 2002:76 2003:20 2004:24 2005:24 2006:20 2007:20
2008:24 2009:24 2010:20 2011:24 2018:28 2017:548 2040:152
"""


def test_lengths_are_those_of_the_reference():
    wire = codec.wire()
    known = {int(k): int(v) for k, v in (word.split(":") for word in TOTALS.split())}
    for msg_type, total in known.items():
        frame = struct.pack("<4i", total - 4, msg_type, 1, 0) + bytes(total - 16)
        message = wire.decode(frame)
        assert isinstance(message, Message), message
        assert wire.encode(message) == frame
    for groups in range(5):
        points = (JointFeedback(0, 7, 0.0, ZEROS, ZEROS, ZEROS),) * groups
        assert len(wire.encode(request(JointTrajPtFullEx(1, points)))) == 24 + 132 * groups
    # Requests and replies of the same type.
    for body, total in (
        (ReadRegister(5), 20),
        (ReadRegisterReply(1, 0), 24),
        (WriteRegister(5, 1), 24),
        (WriteRegisterReply(0), 20),
        (VelocityInfoRequest(0), 20),
        (VelocityInfo(1, 4000, 100, 0, 1, 6, *[ZEROS] * 4), 200),
        (DhParameters(((DhLink(0.0, 0.0, 0.0, 0.0),) * 8,) * 4), 528),
    ):
        assert len(wire.encode(request(body))) == total


def _frame(words: str) -> bytes:
    return bytes.fromhex(words)


WORKED = [
    (
        "40000000 d1070000 02000000 00000000 00000000 02000000 b90d0300" + "00000000" * 10,
        request(MotionCtrl(0, 2, MotionCommand.START_TRAJ_MODE)),
    ),
    (
        "48000000 d2070000 03000000 01000000 00000000 02000000 b90d0300" + "00000000" * 12,
        reply(MotionReply(0, 2, MotionCommand.START_TRAJ_MODE, 0, 0)),
    ),
    (
        "48000000 d2070000 03000000 01000000 00000000 01000000 a50d0300 02000000 8e130000"
        + "00000000" * 10,
        reply(
            MotionReply(
                0,
                1,
                MotionCommand.CHECK_MOTION_READY,
                MotionResult.FAILURE,
                NotReadySubcode.SERVO_OFF,
            )
        ),
    ),
    (
        "28000000 0d000000 01000000 00000000 01000000 00000000 00000000 00000000 00000000"
        "02000000 01000000",
        topic(RobotStatus(1, 0, 0, 0, 0, 2, 1)),
    ),
    (
        "28000000 0d000000 01000000 00000000 00000000 01000000 0b100000 01000000 00000000"
        "02000000 00000000",
        topic(RobotStatus(0, 1, 4107, 1, 0, 2, 0)),
    ),
    ("0c000000 01000000 02000000 00000000", request(Empty(), MessageType.PING)),
    (
        "0c000000 01000000 03000000 01000000",
        reply(Empty(), msg_type=MessageType.PING),
    ),
    (
        "94000000 f8070000 01000000 00000000 00000000 05000000 05000000 0000a03f"
        + "00000000" * 10
        + "0000803e cdccccbd 00000000 00000000 00000000 0000003f 00000000 00000000 00000000"
        "00000000" + "00000000" * 10,
        topic(
            JointVelocity(
                0,
                5,
                5,
                1.25,
                ZEROS,
                joints10((0.25, struct.unpack("f", struct.pack("f", -0.1))[0], 0, 0, 0, 0.5)),
                ZEROS,
            )
        ),
    ),
    (
        "40000000 ef070000 01000000 00000000 07000000 01000000 00000000 0000803e" + "00000000" * 9,
        topic(RtJointCommand(7, (RtGroupCommand(0, joints10((0.25,))),))),
    ),
]


@pytest.mark.parametrize(("words", "message"), WORKED, ids=lambda v: str(v)[:24])
def test_worked_bytes(words, message):
    assert codec.wire().encode(message) == _frame(words)
    assert codec.wire().decode(_frame(words)) == message


def test_a_worked_point():
    point = codec.wire().decode(
        _frame(
            "94000000 0e000000 02000000 00000000 00000000 01000000 07000000 0ad7233d"
            "f4fdd43d cdcc4cbe 9a99993e 00000000 db0fc9bf 00000000 00000000 00000000 00000000"
            "00000000 cdcc4c3e" + "00000000" * 19
        )
    )
    assert isinstance(point.body, JointTrajPtFull)
    assert point.body[:3] == (0, 1, 7)
    assert point.body.time == pytest.approx(0.04)
    assert point.body.pos[:5] == pytest.approx((0.104, -0.2, 0.3, 0.0, -1.5707964))
    assert point.body.vel[0] == pytest.approx(0.2)


@given(st.binary(max_size=700))
def test_arbitrary_bytes_give_a_message_or_a_reason(data):
    for wire in WIRES:
        for found in (wire.decode(data), wire.decode_datagram(data)):
            assert isinstance(found, Message) or found.reason
    assert detect_wire(data) in (None, *WIRES)


@settings(max_examples=examples(300))
@given(st.sampled_from(sorted(MessageType)), st.binary(max_size=700))
def test_every_length_of_every_type_gives_a_message_or_a_reason(msg_type, data):
    frame = struct.pack("<4i", len(data) + 12, msg_type, 2, 0) + data
    found = codec.wire().decode(frame)
    if isinstance(found, MalformedMessage):
        assert found.msg_type == msg_type
        assert found.reason
    else:
        assert len(codec.wire().encode(found)) <= len(frame)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "0 B"),
        (struct.pack("<4i", 13, 1, 2, 0), "prefix 13, but 12 B follow"),
        (struct.pack("<4i4x", 16, 1, 2, 0), "PING with a body of 4 B; it must be 0"),
        (struct.pack("<4i2i", 20, 2012, 2, 0, 1, 2), ""),
        (struct.pack("<4i3i", 24, 2012, 2, 0, 1, 2, 3), "4 or 8"),
        (struct.pack("<4i2i", 20, 2016, 2, 0, 5, 0), "of 5 groups"),
        (struct.pack("<4i2i", 20, 2016, 2, 0, -1, 0), "of -1 groups"),
        (struct.pack("<4i2i", 20, 2016, 2, 0, 1, 0), "it must be 140"),
        (struct.pack("<4i4x", 16, 2020, 3, 1), "0 or 512"),
    ],
)
def test_what_is_wrong_is_named(data, words):
    found = codec.wire().decode(data)
    assert (isinstance(found, MalformedMessage) and words in found.reason) or not words


@pytest.mark.parametrize(
    "body",
    [
        MotionCtrl(0, 0, 200101, (0.0,) * 9),
        MotionCtrl(0, 0, 2**40),
        MotionCtrl(0, 0, "stop"),
        JointTrajPt(0, ZEROS, 1e39, 0.0),
        JointTrajPtFullEx(0, (JointFeedback(0, 7, 0.0, *[ZEROS] * 3),) * 5),
        JointFeedbackEx(1, ()),
        DhParameters(()),
    ],
)
def test_what_does_not_fit_is_refused(body):
    with pytest.raises(ValueError, match="cannot be sent"):
        codec.wire().encode(request(body))


def test_shared_bodies_must_say_their_type():
    with pytest.raises(ValueError, match="say which"):
        request(ReadIo(10010))
    with pytest.raises(ValueError, match="real_bytes"):
        WireFormat(real_bytes=2)
    with pytest.raises(ValueError, match="11 joints"):
        joints10([0.0] * 11)


def test_the_wire_is_found_from_a_message_with_reals():
    body = JointFeedback(0, 2, 0.0, *[ZEROS] * 3)
    for wire in WIRES:
        assert detect_wire(wire.encode(topic(body))) is wire
    assert detect_wire(b"\xff" * 16) is None


def test_old_numbers_of_the_messages_of_several_groups():
    points = (JointFeedback(0, 2, 0.0, *[ZEROS] * 3),) * 4
    old = topic(JointFeedbackEx(2, points), MessageType.OLD_JOINT_FEEDBACK_EX)
    assert codec.wire().decode(codec.wire().encode(old)) == old


@pytest.mark.parametrize(
    "codes",
    [v for v in vars(codes).values() if isinstance(v, type) and issubclass(v, enum.IntEnum)],
    ids=lambda c: c.__name__,
)
def test_codes_have_names(codes):
    for code in codes:
        assert name_of(codes, int(code)) == code.name
    assert name_of(codes, 987654) == "987654"
