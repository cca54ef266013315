"""The EGM codec: worked datagrams, round trips, units, rejected data."""

import math
import random

import pytest
from hypothesis import given, settings

from cardan.protocols.egm.decode import decode_from_pc, decode_robot
from cardan.protocols.egm.encode import (
    encode_path_corr,
    encode_rapid_to_robot,
    encode_robot,
    encode_sensor,
)
from cardan.protocols.egm.messages import (
    EgmCollisionInfo,
    EgmHeader,
    EgmMeasuredForce,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
    Fault,
    MalformedEgmMessage,
    MCIState,
    MotorState,
    RapidState,
)
from cardan.protocols.egm.replies import encode_joint_reply, encode_pose_reply
from cardan.types import Frame, Pose, Quaternion, Twist, Vector3
from tests.examples import examples
from tests.protocols.worked import C1, F6, F7, R0, R1, S1, S2, S3, S4

from . import egm_values as values
from .egm_wire import double, tagged, varint

bounded = settings(max_examples=examples(150), derandomize=True)

SIXTH = math.pi / 6
JOINTS = (0.0, 0.0, 0.0, 0.0, SIXTH, 0.0)
HALF_DEGREE = math.radians(0.5)
POS = Vector3(0.5975, 0.0, 0.83775)
ORIENT = Quaternion(0.5, 0.0, 0.8660254037844386, 0.0)
FORCE = (1.5, -2.25, 10.0, 0.125, 0.0, -0.5)
POSE = EgmPose(POS, ORIENT, Vector3(math.pi, math.pi / 3, math.pi))
CORRECTION = EgmMessageType.CORRECTION

WORKED_ROBOTS = {
    "R0": (
        R0,
        EgmRobot(
            header=EgmHeader(0, 0, EgmMessageType.DATA),
            feed_back=EgmMotion(joints=JOINTS),
            motor_state=MotorState.ON,
            mci_state=MCIState.STOPPED,
            mci_convergence_met=False,
            rapid_exec_state=RapidState.RUNNING,
        ),
    ),
    "R1": (
        R1,
        EgmRobot(
            header=EgmHeader(300, 1210, EgmMessageType.DATA),
            feed_back=EgmMotion(JOINTS, POSE, None, 1_700_000_001_208_000),
            planned=EgmMotion((HALF_DEGREE, *JOINTS[1:]), POSE, None, 1_700_000_001_212_032),
            motor_state=MotorState.ON,
            mci_state=MCIState.RUNNING,
            mci_convergence_met=True,
            rapid_exec_state=RapidState.RUNNING,
            measured_force=EgmMeasuredForce(FORCE, True),
            utilization_rate=12.5,
            move_index=1,
        ),
    ),
    "F6": (
        R0 + F6,
        EgmRobot(
            header=EgmHeader(0, 0, EgmMessageType.DATA),
            feed_back=EgmMotion(joints=JOINTS),
            motor_state=MotorState.ON,
            mci_state=MCIState.STOPPED,
            mci_convergence_met=False,
            rapid_exec_state=RapidState.RUNNING,
            measured_force=EgmMeasuredForce(FORCE, None),
        ),
    ),
    "F7": (
        R0 + F7,
        EgmRobot(
            header=EgmHeader(0, 0, EgmMessageType.DATA),
            feed_back=EgmMotion(joints=JOINTS),
            motor_state=MotorState.ON,
            mci_state=MCIState.STOPPED,
            mci_convergence_met=False,
            rapid_exec_state=RapidState.RUNNING,
            measured_force=EgmMeasuredForce(FORCE, True),
        ),
    ),
}
S1_PLANNED = EgmMotion((HALF_DEGREE, *JOINTS[1:]))
WORKED_SENSORS = {
    "S1": (S1, EgmSensor(EgmHeader(300, 1210, CORRECTION), S1_PLANNED)),
    "S2": (
        S2,
        EgmSensor(
            EgmHeader(301, 1214, CORRECTION),
            EgmMotion(cartesian=EgmPose(POS._replace(y=0.001), ORIENT)),
        ),
    ),
    "S3": (
        S3,
        EgmSensor(
            EgmHeader(302, 1218, CORRECTION),
            speed_ref=EgmSpeedRef(cartesians=(0.0, 0.0, 0.05, 0.0, 0.0, math.radians(5))),
        ),
    ),
    "S4": (
        S4,
        EgmSensor(
            EgmHeader(303, 1222, CORRECTION),
            S1_PLANNED,
            EgmSpeedRef(joints=(math.radians(2.5), 0.0, 0.0, 0.0, 0.0, 0.0)),
            EgmRapidData(True, (1.0, -2.0)),
        ),
    ),
}
WORKED_PATH_CORR = EgmSensorPathCorr(
    EgmHeader(5, 240, EgmMessageType.PATH_CORRECTION), Vector3(0.0, 0.0025, -0.001), 1
)


def near(found, expected):
    """Return whether both are equal up to the grid of encoded angles."""
    if isinstance(expected, tuple):
        return type(found) is type(expected) and all(map(near, found, expected))
    if isinstance(expected, float):
        return found is not None and math.isclose(found, expected, rel_tol=1e-12, abs_tol=1e-14)
    return found == expected and type(found) is type(expected)


def assert_near(found, expected):
    assert near(found, expected), f"\n{found}\nis not\n{expected}"


# --- worked datagrams


@pytest.mark.parametrize(("data", "value"), WORKED_ROBOTS.values(), ids=WORKED_ROBOTS)
def test_worked_robots_both_ways(data, value):
    assert_near(decode_robot(data), value)
    assert encode_robot(value) == data
    assert encode_robot(decode_robot(data)) == data


@pytest.mark.parametrize(("data", "value"), WORKED_SENSORS.values(), ids=WORKED_SENSORS)
def test_worked_sensors_both_ways(data, value):
    assert_near(decode_from_pc(data), value)
    assert encode_sensor(value) == data
    assert encode_sensor(decode_from_pc(data)) == data


def test_worked_path_correction_both_ways():
    assert_near(decode_from_pc(C1), WORKED_PATH_CORR)
    assert encode_path_corr(WORKED_PATH_CORR) == C1
    assert encode_path_corr(decode_from_pc(C1)) == C1


def test_worked_replies():
    planned = S1_PLANNED.joints
    pose = Pose(POS._replace(y=0.001), ORIENT, Frame.BASE)
    assert encode_joint_reply(300, 1210, planned, None) == S1
    assert encode_pose_reply(301, 1214, pose, None) == S2
    velocities = (math.radians(2.5), 0.0, 0.0, 0.0, 0.0, 0.0)
    suffix = encode_rapid_to_robot(EgmRapidData(True, (1.0, -2.0)))
    assert encode_joint_reply(303, 1222, planned, velocities, suffix) == S4


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_kind_of_buffer_is_read(kind):
    assert decode_robot(kind(R1)) == decode_robot(R1)
    assert decode_from_pc(kind(S4)) == decode_from_pc(S4)


def test_known_states_come_as_their_enums_and_unknown_ones_as_numbers():
    short = decode_robot(R1)
    general = decode_robot(R0)
    for robot in (short, general):
        assert type(robot.header.mtype) is EgmMessageType
        assert type(robot.motor_state) is MotorState
        assert type(robot.mci_state) is MCIState
        assert type(robot.rapid_exec_state) is RapidState
        assert type(robot.mci_convergence_met) is bool
    unknown = R1.replace(b"\x2a\x02\x08\x03", b"\x2a\x02\x08\x09")
    assert decode_robot(unknown) == short._replace(mci_state=9)


# --- round trips


@bounded
@given(values.robot)
def test_any_robot_comes_back(robot):
    assert_close_robot(decode_robot(encode_robot(robot)), robot)


def assert_close_robot(found, expected):
    """Assert equality; states compare as numbers."""
    assert isinstance(found, EgmRobot), found
    states = ("motor_state", "mci_state", "rapid_exec_state")
    for name in states:
        assert getattr(found, name) == getattr(expected, name)
    without = dict.fromkeys(states)
    found, expected = found._replace(**without), expected._replace(**without)
    if expected.header is not None:
        assert found.header == expected.header
        found, expected = found._replace(header=None), expected._replace(header=None)
    assert_near(found, expected)


@bounded
@given(values.sensor)
def test_any_sensor_comes_back(sensor):
    found = decode_from_pc(encode_sensor(sensor))
    assert found.header == sensor.header
    assert_near(found._replace(header=None), sensor._replace(header=None))


@bounded
@given(values.path_corr)
def test_any_path_correction_comes_back(path_corr):
    found = decode_from_pc(encode_path_corr(path_corr))
    assert found.header == path_corr.header
    assert_near(found._replace(header=None), path_corr._replace(header=None))


@bounded
@given(values.u32, values.u32, values.vector, values.quaternion, values.six, values.rapid_data)
def test_replies_are_what_the_general_encoder_writes(seqno, tm, position, orient, six, rapid):
    header = EgmHeader(seqno, tm, CORRECTION)
    suffix = encode_rapid_to_robot(rapid)
    pose = Pose(position, orient, Frame.BASE)
    twist = Twist(Vector3(*six[:3]), Vector3(*six[3:]), Frame.BASE)
    at_pose = EgmMotion(cartesian=EgmPose(position, orient))
    at_joints = EgmMotion(joints=six)
    for reply, planned, speed in (
        (encode_pose_reply(seqno, tm, pose, twist, suffix), at_pose, EgmSpeedRef(None, six)),
        (encode_pose_reply(seqno, tm, pose, None, suffix), at_pose, None),
        (encode_joint_reply(seqno, tm, six, six, suffix), at_joints, EgmSpeedRef(six)),
        (encode_joint_reply(seqno, tm, six, None, suffix), at_joints, None),
    ):
        assert reply == encode_sensor(EgmSensor(header, planned, speed, rapid))


# --- numbers and units


def test_every_half_degree_comes_back_to_the_bit():
    for half_degrees in range(-720, 721):
        joint = half_degrees / 2
        data = S1.replace(double(0.5), double(joint))
        assert encode_sensor(decode_from_pc(data)) == data.replace(double(-0.0), double(0.0))


def test_sequence_number_and_clock_wrap():
    joints = (0.0,) * 6
    wrapped = decode_from_pc(encode_joint_reply(2**32 + 5, -1, joints, None))
    assert wrapped.header == EgmHeader(5, 2**32 - 1, CORRECTION)
    for longer in (2**7, 2**14, 2**21, 2**28):  # each a byte longer than the previous one
        header = EgmHeader(longer, longer - 1, CORRECTION)
        reply = encode_joint_reply(*header[:2], joints, None)
        assert decode_from_pc(reply).header == header
    sensor = EgmSensor(EgmHeader(2**32, 2**40 + 7, CORRECTION))
    assert decode_from_pc(encode_sensor(sensor)).header == EgmHeader(0, 7, CORRECTION)
    robot = EgmRobot(feed_back=EgmMotion(), move_index=-1)
    assert decode_robot(encode_robot(robot)).move_index == 2**32 - 1
    path = WORKED_PATH_CORR._replace(age_ms=2**32 + 1)
    assert decode_from_pc(encode_path_corr(path)).age_ms == 1


def test_wide_numbers_are_taken_modulo_their_width():
    header = b"\x08" + varint(2**32 + 300) + b"\x10" + varint(2**63 + 1210) + b"\x18\x02"
    assert decode_robot(tagged(1, header) + R1[10:]) == decode_robot(R1)


@pytest.mark.parametrize("huge", [1.7e308, -1.7e308])
def test_encoders_take_any_finite_number(huge):
    six = (huge,) * 6
    vector, quaternion = Vector3(huge, huge, huge), Quaternion(huge, huge, huge, huge)
    motion = EgmMotion(six, EgmPose(vector, quaternion, vector), six, -1, -1)
    header = EgmHeader(-1, -1, 2**40)
    pose = Pose(vector, quaternion, Frame.BASE)
    for data in (
        encode_robot(
            EgmRobot(header, motion, motion, 2**40, -(2**40), True, six, 7, utilization_rate=huge)
        ),
        encode_sensor(EgmSensor(header, motion, EgmSpeedRef(six, six, six))),
        encode_path_corr(EgmSensorPathCorr(header, vector, -1)),
        encode_pose_reply(-1, -1, pose, Twist(vector, vector, Frame.BASE)),
        encode_joint_reply(-1, -1, six, six),
    ):
        assert data


def test_numbers_whose_sum_overflows_are_accepted():
    motion = EgmMotion((0.0,) * 6, POSE, None, 1_700_000_001_208_000)
    usual = decode_robot(R1)._replace(feed_back=motion)
    data = encode_robot(usual).replace(double(0.0) + b"\x09", double(1e308) + b"\x09")
    assert decode_robot(data).feed_back.joints[0] == math.radians(1e308)


# --- tolerance


def test_packed_numbers_are_read():
    packed = tagged(2, tagged(1, tagged(1, b"".join(map(double, range(6))))))
    robot = decode_robot(packed)
    assert robot.feed_back.joints == tuple(map(math.radians, range(6)))


@pytest.mark.parametrize("layout", [1, 2])
def test_packed_force_is_read_in_both_layouts(layout):
    force = tagged(9, tagged(layout, b"".join(map(double, FORCE))))
    expected = EgmMeasuredForce(FORCE, None if layout == 1 else False)
    assert decode_robot(R0 + force).measured_force == expected


def test_inactive_force_control_keeps_the_values():
    raw = F7.replace(b"\x08\x01", b"\x08\x00", 1)
    assert decode_robot(R0 + raw).measured_force == EgmMeasuredForce(FORCE, False)


def test_unknown_fields_and_any_order_mean_the_same():
    unknown = (
        tagged(15, b"\xff\xff") + varint(99 << 3 | 1) + double(1.0) + varint(77 << 3) + b"\x05"
    )
    expected = decode_robot(R1)
    header, rest = R1[:10], R1[10:]
    assert decode_robot(R1 + unknown) == expected
    assert decode_robot(unknown + R1) == expected
    assert decode_robot(rest + header) == expected


def test_a_repeated_field_after_the_usual_start_is_merged():
    again = tagged(4, b"\x08\x02")
    assert decode_robot(R1 + again) == decode_robot(R1)._replace(motor_state=MotorState.OFF)


def test_absent_header_numbers_are_none():
    robot = decode_robot(tagged(1, b"\x18\x02") + tagged(2, b""))
    assert robot == EgmRobot(EgmHeader(None, None, EgmMessageType.DATA), EgmMotion())


def test_every_optional_field_of_robotware_7_16():
    full = decode_robot(R1)._replace(
        test_signals=FORCE,
        collision_info=EgmCollisionInfo(False, FORCE),
        rapid_from_robot=EgmRapidData(True, tuple(map(float, range(40)))),
        torque_ref=FORCE,
    )
    full = full._replace(feed_back=full.feed_back._replace(external_joints=FORCE, time_stamp_ns=5))
    data = encode_robot(full)
    assert decode_robot(data) == full


@pytest.mark.parametrize("mtype", [None, 0, 1, 2, 9])
def test_path_corrections_are_known_by_their_shape_where_mtype_does_not_tell(mtype):
    fields = b"" if mtype is None else b"\x18" + varint(mtype)
    found = decode_from_pc(tagged(1, fields) + C1[9:])
    assert found == WORKED_PATH_CORR._replace(header=EgmHeader(None, None, mtype or 0))


@pytest.mark.parametrize("mtype", [None, 0, 1, 2, 9])
@pytest.mark.parametrize("data", [S1, S2, S3, S4], ids=["S1", "S2", "S3", "S4"])
def test_guidance_is_known_by_its_shape_where_mtype_does_not_tell(mtype, data):
    fields = b"" if mtype is None else b"\x18" + varint(mtype)
    found = decode_from_pc(tagged(1, fields) + data[10:])
    expected = decode_from_pc(data)
    assert found == expected._replace(header=EgmHeader(None, None, mtype or 0))


def test_a_header_alone_is_guidance():
    assert decode_from_pc(S1[:10]) == EgmSensor(EgmHeader(300, 1210, CORRECTION))


# --- refusals


def joints(count, number=0.0):
    return tagged(1, (b"\x09" + double(number)) * count)


NAN, INF = math.nan, math.inf
BAD_ROBOTS = {
    "empty": (b"", Fault.EMPTY),
    "oversized": (R1 + tagged(15, bytes(2048 - len(R1))), Fault.OVERSIZED),
    "oversized and unusual": (R0 + tagged(15, bytes(2048)), Fault.OVERSIZED),
    "a length beyond the end": (R1[:-1], Fault.TRUNCATED),
    "group never closed": (R0 + b"\x7b", Fault.TRUNCATED),
    "group never opened": (R0 + b"\x7c", Fault.TRUNCATED),
    "varint of 11 bytes": (R0 + b"\x58" + b"\xff" * 10 + b"\x01", Fault.TRUNCATED),
    "field number 0": (R0 + b"\x00\x01", Fault.TRUNCATED),
    "wire type 7": (R0 + b"\x5f\x01", Fault.TRUNCATED),
    "half a packed double": (R0 + tagged(14, tagged(1, bytes(7))), Fault.TRUNCATED),
    "position without y and z": (tagged(2, tagged(2, joints(1))), Fault.WRONG_TYPE),
    "state without a number": (tagged(2, b"") + tagged(5, b""), Fault.WRONG_TYPE),
    "guidance": (S1, Fault.WRONG_TYPE),
    "path correction": (C1, Fault.WRONG_TYPE),
    "reserved mtype": (R1.replace(b"\x18\x02", b"\x18\x01", 1), Fault.WRONG_TYPE),
    "header only": (R1[:10], Fault.WRONG_TYPE),
    "unknown fields only": (tagged(15, b"hello"), Fault.WRONG_TYPE),
    "seven joints": (tagged(2, joints(7)), Fault.WRONG_COUNT),
    "seven external joints": (tagged(3, tagged(3, joints(7)[2:])), Fault.WRONG_COUNT),
    "seven forces": (R0 + tagged(9, (b"\x11" + double(0.0)) * 7), Fault.WRONG_COUNT),
    "41 dnum": (R0 + tagged(13, (b"\x11" + double(0.0)) * 41), Fault.WRONG_COUNT),
    "NaN joint": (tagged(2, joints(6, NAN)), Fault.NOT_FINITE),
    "infinite joint": (tagged(3, joints(6, INF)), Fault.NOT_FINITE),
    "NaN dnum": (R0 + tagged(13, b"\x11" + double(NAN)), Fault.NOT_FINITE),
    "NaN external joint": (tagged(2, tagged(3, joints(1, NAN)[2:])), Fault.NOT_FINITE),
    "NaN position": (R1.replace(double(597.5), double(NAN), 1), Fault.NOT_FINITE),
    "NaN quaternion": (R1.replace(double(0.8660254037844386), double(-INF)), Fault.NOT_FINITE),
    "NaN Euler angle": (R1.replace(double(60.0), double(NAN)), Fault.NOT_FINITE),
    "NaN force": (R1.replace(double(-2.25), double(NAN)), Fault.NOT_FINITE),
    "NaN force, old layout": (R0 + F6.replace(double(-2.25), double(NAN)), Fault.NOT_FINITE),
}


@pytest.mark.parametrize(("data", "fault"), BAD_ROBOTS.values(), ids=BAD_ROBOTS)
def test_bad_robots_are_refused_with_a_reason(data, fault):
    refused = decode_robot(data)
    assert isinstance(refused, MalformedEgmMessage)
    assert refused.fault is fault
    assert refused.detail


def from_pc(*fields):
    return tagged(1, b"\x18\x03") + b"".join(fields)


def path_corr(x=0.0, age=b"\x10\x01"):
    position = b"\x09" + double(x) + b"\x11" + double(0.0) + b"\x19" + double(0.0)
    return tagged(1, b"\x18\x04") + tagged(2, tagged(1, position) + age)


BAD_FROM_PC = {
    "empty": (b"", Fault.EMPTY),
    "oversized": (S1 + tagged(15, bytes(2048)), Fault.OVERSIZED),
    "a length beyond the end": (S1[:-1], Fault.TRUNCATED),
    "broken header": (b"\x0a\x01\xff", Fault.TRUNCATED),
    "unknown fields only": (tagged(15, b"hello"), Fault.WRONG_TYPE),
    "path correction without one": (C1[:9], Fault.WRONG_TYPE),
    "path correction without age": (path_corr(age=b""), Fault.WRONG_TYPE),
    "NaN path correction": (path_corr(NAN), Fault.NOT_FINITE),
    "NaN joint": (from_pc(tagged(2, joints(6, NAN))), Fault.NOT_FINITE),
    "infinite joint speed": (from_pc(tagged(3, joints(6, INF))), Fault.NOT_FINITE),
    "NaN speed": (from_pc(tagged(3, tagged(2, joints(6, NAN)[2:]))), Fault.NOT_FINITE),
    "five speeds": (from_pc(tagged(3, tagged(2, joints(5)[2:]))), Fault.WRONG_COUNT),
    "no speeds": (from_pc(tagged(3, tagged(2, b""))), Fault.WRONG_COUNT),
    "seven speeds": (from_pc(tagged(3, tagged(2, joints(7)[2:]))), Fault.WRONG_COUNT),
    "seven joint speeds": (from_pc(tagged(3, joints(7))), Fault.WRONG_COUNT),
    "seven joints": (from_pc(tagged(2, joints(7))), Fault.WRONG_COUNT),
    "41 dnum": (from_pc(tagged(4, (b"\x11" + double(0.0)) * 41)), Fault.WRONG_COUNT),
    "infinite dnum": (from_pc(tagged(4, b"\x11" + double(INF))), Fault.NOT_FINITE),
    "NaN external speed": (from_pc(tagged(3, tagged(3, joints(1, NAN)[2:]))), Fault.NOT_FINITE),
}


@pytest.mark.parametrize(("data", "fault"), BAD_FROM_PC.values(), ids=BAD_FROM_PC)
def test_bad_messages_from_a_pc_are_refused_with_a_reason(data, fault):
    refused = decode_from_pc(data)
    assert isinstance(refused, MalformedEgmMessage)
    assert refused.fault is fault
    assert refused.detail


def test_the_refusal_names_what_was_wrong():
    refused = decode_robot(tagged(2, joints(7)))
    assert "feedBack.joints has 7 values" in refused.detail
    refused = decode_robot(tagged(3, tagged(2, joints(1))))
    assert "planned.cartesian.pos.y" in refused.detail


def test_what_only_informs_may_be_anything():
    signals = tagged(7, (b"\x09" + double(NAN)) * 9)
    rate = b"\x51" + double(INF)
    quotas = tagged(12, (b"\x11" + double(NAN)) * 9)
    torques = tagged(14, (b"\x09" + double(INF)) * 9)
    robot = decode_robot(R0 + signals + rate + quotas + torques)
    assert len(robot.test_signals) == len(robot.collision_info.coll_det_quota) == 9
    assert robot.utilization_rate == INF
    assert robot.torque_ref == (INF,) * 9


def test_a_short_group_of_axes_is_legal_here():
    assert decode_robot(tagged(2, joints(5))).feed_back.joints == (0.0,) * 5
    assert decode_from_pc(from_pc(tagged(2, joints(0)))).planned.joints == ()


# --- nothing raises


def test_every_cut_of_a_datagram_is_typed():
    whole = decode_robot(R1)
    for end in range(len(R1)):
        found = decode_robot(R1[:end])
        assert isinstance(found, EgmRobot | MalformedEgmMessage)
        assert found != whole
    for end in range(len(S4)):
        assert isinstance(decode_from_pc(S4[:end]), EgmSensor | MalformedEgmMessage)


def test_random_bytes_are_typed():
    source = random.Random(20)
    for _ in range(3000):
        data = source.randbytes(source.randrange(0, 80))
        assert isinstance(decode_robot(data), EgmRobot | MalformedEgmMessage)
        assert isinstance(decode_from_pc(data), EgmSensor | EgmSensorPathCorr | MalformedEgmMessage)
