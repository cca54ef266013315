"""The layers of simple message: worked bytes, every layer in both directions, and invalid bytes."""

import struct

import pytest
from hypothesis import given, settings, strategies as st
from scapy.layers.inet import TCP

from cardan_dissect import simple_message as sm
from cardan_dissect.simple_message import SimpleMessage, SimpleMessageBroken, malformed, remarks
from tests.examples import examples
from tests.protocols import worked

POSITIONS = [0.104, -0.2, 0.3, 0.0, -1.5707964]
WORKED = [
    (worked.START_TRAJ_MODE, sm.MotionCtrl(sequence=2, command_code=200121)),
    (worked.START_TRAJ_MODE_REPLY, sm.MotionReply(sequence=2, command_code=200121)),
    (
        worked.SERVO_OFF_REPLY,
        sm.MotionReply(sequence=1, command_code=200101, result=2, subcode=5006),
    ),
    (
        worked.TRAJECTORY_POINT,
        sm.JointTrajPtFull(
            sequence=1, valid_fields=7, time_s=0.04, positions=POSITIONS, velocities=[0.2]
        ),
    ),
    (worked.BUSY_REPLY, sm.MotionReply(sequence=1, command_code=14, result=1)),
    (
        worked.FEEDBACK,
        sm.JointFeedback(valid_fields=6, positions=[0.1, *POSITIONS[1:]], velocities=[0.05]),
    ),
    (worked.STATUS_READY, sm.RobotStatus(drives_powered=1, motion_possible=1)),
    (worked.STATUS_ESTOP, sm.RobotStatus(e_stopped=1, error_code=4107, in_error=1)),
    (worked.PING_REQUEST, sm.Ping()),
    (worked.PING_REPLY, sm.Ping(comm_type=3, reply_code=1)),
    (
        worked.JOINT_VELOCITY,
        sm.JointVelocity(
            sequence=5, valid_fields=5, time_s=1.25, velocities=[0.25, -0.1, 0, 0, 0, 0.5]
        ),
    ),
    (worked.RT_COMMAND, sm.RtJointCommand(message_id=7, groups=[sm.GroupCommand(0, (0.25,))])),
]


@pytest.mark.parametrize(("data", "layer"), WORKED)
def test_worked_bytes(data, layer):
    assert bytes(layer) == data
    found = SimpleMessage(data)
    assert type(found) is type(layer)
    assert malformed(found) is None
    assert not list(remarks(found))


i32 = st.integers(-(2**31), 2**31 - 1)
u32 = st.integers(0, 2**32 - 1)
real = st.floats(width=32, allow_nan=False)
ten = st.lists(real, min_size=10, max_size=10)
LAYERS = [(t, layer) for t, layers in sm.CATALOG.items() for layer in layers]


def record(kind):
    shape = [ten.map(tuple) if isinstance(v, tuple) else i32 if isinstance(v, int) else real
             for v in kind()]  # fmt: skip
    return st.tuples(*shape).map(lambda values: kind(*values))


def values(field):
    if isinstance(field, sm.RecordsField):
        most = field.fixed or sm.GROUPS
        return st.lists(record(field.record), min_size=most if most > 4 else 0, max_size=most)
    if isinstance(field, sm.RealsField):
        return ten
    if isinstance(field, sm.RealField):
        return real
    unsigned = isinstance(field, (sm.UnsignedField, sm.UnsignedEnumField))
    return u32 if unsigned else i32


@settings(max_examples=examples(200))
@given(st.data(), st.sampled_from(LAYERS), st.sampled_from("<>"), st.sampled_from([4, 8]))
def test_what_is_built_is_dissected(data, chosen, order, real_bytes):
    msg_type, layer = chosen
    fields = [f for f in layer(msg_type=msg_type).body_fields if f.name != "group_count"]
    given_values = {f.name: data.draw(values(f), f.name) for f in fields}
    built = layer(byte_order=order, real_bytes=real_bytes, msg_type=msg_type, **given_values)
    raw = bytes(built)
    assert struct.unpack_from(f"{order}i", raw)[0] == len(raw) - 4
    found = SimpleMessage(raw)
    assert type(found) is layer
    assert found.byte_order == order
    assert malformed(found) is None
    assert repr(found)
    list(remarks(found))
    for name, value in given_values.items():
        got = getattr(found, name)
        assert (got[: len(value)] if isinstance(value, list) else got) == value
    again = {f.name: found.getfieldval(f.name) for f in found.fields_desc if f.name != "prefix"}
    assert bytes(layer(**again)) == raw


@settings(max_examples=examples(300))
@given(st.binary(max_size=200), st.sampled_from([row[0] for row in WORKED]), st.integers(0, 40))
def test_arbitrary_bytes_never_raise(data, start, retained):
    for raw in (data, start[:retained] + data):
        layer = SimpleMessage(raw)
        assert bytes(SimpleMessage(raw)) == raw
        while isinstance(layer, SimpleMessage) and raw:
            if malformed(layer) is None:
                assert repr(layer)
                list(remarks(layer))
            else:
                assert layer.reason
            layer = layer.payload


@pytest.mark.parametrize("row", WORKED, ids=lambda row: type(row[1]).__name__)
def test_every_other_length_is_broken(row):
    for size in range(len(row[0])):
        assert isinstance(SimpleMessage(row[0][:size]), SimpleMessageBroken)


def framed(msg_type, body, comm_type=2, order="<"):
    return struct.pack(f"{order}4i", 12 + len(body), msg_type, comm_type, 0) + body


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty"),
        (b"ab", "shorter than its prefix"),
        (struct.pack("<4i", 11, 1, 2, 0), "prefix outside 12 to 65535"),
        (worked.FEEDBACK[:-1], "shorter than its prefix says"),
        (framed(77, b""), "unknown message type 77"),
        (framed(12, b""), "JOINT_TRAJ has no layout on the wire"),
        (framed(13, bytes(24)), "ROBOT_STATUS of 24 bytes"),
        (framed(2016, struct.pack("<2i", 5, 0) + bytes(660)), "JOINT_TRAJ_PT_FULL_EX of 668 bytes"),
        (framed(2016, struct.pack("<2i", 2, 0) + bytes(132)), "JOINT_TRAJ_PT_FULL_EX of 140 bytes"),
    ],
)
def test_what_is_wrong_is_named(data, reason):
    layer = SimpleMessage(data)
    assert isinstance(layer, SimpleMessageBroken)
    assert malformed(layer) == reason


def test_requests_and_replies_of_the_same_type_are_distinguished():
    for body, comm_type, layer in (
        (4, 2, sm.ReadRegister), (8, 3, sm.ReadRegisterReply), (8, 1, sm.ReadRegisterReply),
    ):  # fmt: skip
        assert type(SimpleMessage(framed(2012, bytes(body), comm_type))) is layer
    assert type(SimpleMessage(framed(2013, bytes(8), 2))) is sm.WriteRegister
    assert type(SimpleMessage(framed(2013, bytes(4), 3))) is sm.WriteRegisterReply
    assert type(SimpleMessage(bytes(sm.IoErrorReply(subcode=3003)))) is sm.IoErrorReply


def test_sizes_of_the_reference():
    for layer, total in (
        (sm.JointFeedbackEx(), 548), (sm.DhParameters(), 528), (sm.VelocityInfoReply(), 200),
        (sm.JointTrajPtFullEx(groups=[sm.GroupPoint()] * 2), 288), (sm.SelectTool(), 28),
        (sm.JointTrajPt(), 68), (sm.JointPosition(), 60), (sm.RtJointState(groups=[()]), 112),
    ):  # fmt: skip
        assert len(bytes(layer)) == total


def test_a_segment_holds_several_messages_and_ports_are_bound():
    segment = TCP(sport=50241, dport=40000) / sm.JointFeedback() / sm.RobotStatus()
    found = TCP(bytes(segment))
    assert isinstance(found.payload, sm.JointFeedback)
    assert isinstance(found.payload.payload, sm.RobotStatus)
    assert (TCP() / sm.MotionCtrl()).dport == 50240
    assert (TCP() / sm.MotionReply()).sport == 50240
    assert (TCP() / sm.RobotStatus()).sport == 50241
    assert (TCP() / sm.ReadIoBit()).dport == 50242
    with pytest.raises(ValueError, match="positions: 11 values, at most 10"):
        sm.JointFeedback(positions=[0.0] * 11)
