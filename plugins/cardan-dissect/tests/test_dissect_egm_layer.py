"""The EGM layers: worked datagrams, in both directions, and damaged ones."""

import math
import struct

import pytest
from hypothesis import given, strategies as st

from cardan_dissect import EGM_PORTS
from cardan_dissect._scapy import UDP, Packet
from cardan_dissect.egm import (
    CORRECTION,
    DATA,
    PATH_CORRECTION,
    EgmCartesian,
    EgmCartesianSpeed,
    EgmClock,
    EgmCollisionInfo,
    EgmEuler,
    EgmFeedBack,
    EgmFromPc,
    EgmHeader,
    EgmJoints,
    EgmMCIState,
    EgmMeasuredForce,
    EgmMeasuredForceRW6,
    EgmMotorState,
    EgmPathCorr,
    EgmPlanned,
    EgmPose,
    EgmQuaternion,
    EgmRapidCtrlExecState,
    EgmRAPIDdata,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
    EgmTestSignals,
    EgmTimestamp,
    malformed,
    remarks,
)
from cardan_dissect.protobuf import ProtoMessage, faults, tagged, unknown_numbers, varint
from tests.protocols import worked

JOINTS = [0, 0, 0, 0, 30, 0]
FORCE = [1.5, -2.25, 10, 0.125, 0, -0.5]
COS_30 = 0.8660254037844386


def joints(*values):
    return EgmJoints(joints=values)


def pose(y=0.0, euler=None):
    return EgmPose(
        pos=EgmCartesian(x=597.5, y=y, z=837.75),
        orient=EgmQuaternion(u0=0.5, u1=0, u2=COS_30, u3=0),
        euler=euler,
    )


def motion(kind, first_joint, usec):
    return kind(
        joints=joints(first_joint, *JOINTS[1:]),
        cartesian=pose(euler=EgmEuler(x=180, y=60, z=180)),
        time=EgmClock(sec=1700000001, usec=usec),
    )


def header(seqno, tm, mtype):
    return EgmHeader(seqno=seqno, tm=tm, mtype=mtype)


WORKED = {
    "R0": (
        worked.R0,
        EgmRobot(
            header=header(0, 0, DATA),
            feedBack=EgmFeedBack(joints=joints(*JOINTS)),
            motorState=EgmMotorState(state="MOTORS_ON"),
            mciState=EgmMCIState(state="MCI_STOPPED"),
            mciConvergenceMet=False,
            rapidExecState=EgmRapidCtrlExecState(state="RAPID_RUNNING"),
        ),
    ),
    "R1": (
        worked.R1,
        EgmRobot(
            header=header(300, 1210, DATA),
            feedBack=motion(EgmFeedBack, 0, 208000),
            planned=motion(EgmPlanned, 0.5, 212032),
            motorState=EgmMotorState(state="MOTORS_ON"),
            mciState=EgmMCIState(state="MCI_RUNNING"),
            mciConvergenceMet=True,
            rapidExecState=EgmRapidCtrlExecState(state="RAPID_RUNNING"),
            measuredForce=EgmMeasuredForce(fcActive=True, force=FORCE),
            utilizationRate=12.5,
            moveIndex=1,
        ),
    ),
    "S1": (
        worked.S1,
        EgmSensor(
            header=header(300, 1210, CORRECTION),
            planned=EgmPlanned(joints=joints(0.5, 0, 0, 0, 30, 0)),
        ),
    ),
    "S2": (
        worked.S2,
        EgmSensor(header=header(301, 1214, CORRECTION), planned=EgmPlanned(cartesian=pose(1))),
    ),
    "S3": (
        worked.S3,
        EgmSensor(
            header=header(302, 1218, CORRECTION),
            speedRef=EgmSpeedRef(cartesians=EgmCartesianSpeed(value=[0, 0, 50, 0, 0, 5])),
        ),
    ),
    "S4": (
        worked.S4,
        EgmSensor(
            header=header(303, 1222, CORRECTION),
            planned=EgmPlanned(joints=joints(0.5, 0, 0, 0, 30, 0)),
            speedRef=EgmSpeedRef(joints=joints(2.5, 0, 0, 0, 0, 0)),
            RAPIDtoRobot=EgmRAPIDdata(digVal=True, dnum=[1, -2]),
        ),
    ),
    "C1": (
        worked.C1,
        EgmSensorPathCorr(
            header=header(5, 240, PATH_CORRECTION),
            pathCorr=EgmPathCorr(pos=EgmCartesian(x=0, y=2.5, z=-1), age=1),
        ),
    ),
    "F6": (worked.F6, EgmRobot(measuredForce=EgmMeasuredForceRW6(force=FORCE))),
    "F7": (worked.F7, EgmRobot(measuredForce=EgmMeasuredForce(fcActive=True, force=FORCE))),
}


@pytest.mark.parametrize("name", WORKED)
def test_builds_the_worked_bytes(name):
    data, message = WORKED[name]
    assert bytes(message) == data


@pytest.mark.parametrize("name", WORKED)
def test_dissects_the_worked_bytes(name):
    data, message = WORKED[name]
    dissected = type(message)(data)
    assert dissected == message
    assert bytes(dissected) == data
    assert malformed(dissected) is None
    assert not unknown_numbers(dissected)


def test_named_values_are_those_of_the_wire():
    robot = EgmRobot(worked.R1)
    assert (robot.header.seqno, robot.header.tm, robot.header.mtype) == (300, 1210, DATA)
    assert robot.feedBack.joints.joints == JOINTS
    assert robot.feedBack.cartesian.orient.u2 == COS_30
    assert robot.feedBack.cartesian.euler.y == 60
    assert robot.planned.time.usec == 212032
    assert robot.mciState.state == 3
    assert robot.mciConvergenceMet is True
    assert robot.measuredForce.force == FORCE
    assert robot.utilizationRate == 12.5
    assert robot.torqueRef is None


def test_a_change_two_messages_down_is_built():
    robot = EgmRobot(worked.R1)
    robot.feedBack.cartesian.pos.x = 1.0
    robot.planned.joints.joints[0] = 2.0
    again = EgmRobot(bytes(robot))
    assert again.feedBack.cartesian.pos.x == 1.0
    assert again.planned.joints.joints[0] == 2.0


def test_the_field_called_time_is_not_the_capture_time():
    robot = EgmRobot(worked.R1)
    copy = robot.copy()
    copy.feedBack.time.usec = 1
    assert robot.feedBack.time.usec == 208000
    robot.feedBack.time = EgmClock(sec=1, usec=2)
    assert EgmRobot(bytes(robot)).feedBack.time == EgmClock(sec=1, usec=2)
    assert EgmRobot(bytes(copy)).feedBack.time.usec == 1
    assert EgmFeedBack().time is None


def test_no_field_hides_behind_an_attribute_of_scapy():
    todo, layers = [ProtoMessage], []
    while todo:
        layers.append(todo.pop())
        todo += layers[-1].__subclasses__()
    names = {field.name for layer in layers for field in layer.fields_desc}
    assert {"seqno", "time", "RAPIDtoRobot"} <= names
    assert names & {*dir(Packet), *Packet.__slots__} == {"time"}


def test_every_later_field_both_ways():
    robot = EgmRobot(
        header=header(2**32 - 1, 2**32 - 1, DATA),
        feedBack=EgmFeedBack(
            externalJoints=joints(1.5), timeStamp=EgmTimestamp(sec=2**40, nsec=999_999_999)
        ),
        testSignals=EgmTestSignals(signals=[1, 2]),
        CollisionInfo=EgmCollisionInfo(collsionTriggered=True, collDetQuota=[0.5] * 6),
        RAPIDfromRobot=EgmRAPIDdata(digVal=False, dnum=[float(n) for n in range(40)]),
        torqueRef=joints(*range(6)),
    )
    again = EgmRobot(bytes(robot))
    assert again == robot
    assert malformed(again) is None
    assert list(remarks(again)) == []


def test_packed_doubles_are_read():
    packed = tagged(1, 2, struct.pack("<3d", 1, 2, 3))
    robot = EgmRobot(tagged(14, 2, packed + tagged(1, 1, struct.pack("<d", 4))))
    assert robot.torqueRef.joints == [1, 2, 3, 4]


def test_packed_force_of_robotware_6_is_distinguished_from_7():
    old = EgmRobot(tagged(9, 2, tagged(1, 2, struct.pack("<2d", 1, 2))))
    assert isinstance(old.measuredForce, EgmMeasuredForceRW6)
    assert old.measuredForce.force == [1, 2]
    new = EgmRobot(tagged(9, 2, tagged(2, 2, struct.pack("<2d", 1, 2))))
    assert isinstance(new.measuredForce, EgmMeasuredForce)
    assert new.measuredForce.fcActive is None


def test_repeated_messages_merge_and_the_last_scalar_counts():
    twice = bytes(EgmRobot(header=EgmHeader(seqno=1, tm=5))) + bytes(
        EgmRobot(header=EgmHeader(seqno=2, mtype=DATA))
    )
    assert EgmRobot(twice).header == header(2, 5, DATA)


def test_a_broken_message_is_not_mended_by_its_repetition():
    broken = tagged(2, 2, b"\x0a\x04")
    robot = EgmRobot(broken + tagged(2, 2, b"abcd"))
    assert list(faults(robot)) == [
        "EgmFeedBack: ends inside a field",
        "EgmRobot: repeats a broken sub-message",
    ]
    assert bytes(robot) == robot.original


def test_unknown_fields_are_kept_and_named():
    group = tagged(30, 3, tagged(1, 0, b"\x05") + tagged(31, 3, tagged(31, 4, b""))) + tagged(
        30, 4, b""
    )
    extra = tagged(20, 2, b"abc") + tagged(21, 5, b"1234") + group
    wrong_type = tagged(6, 2, b"x")
    data = worked.R0 + extra + wrong_type
    robot = EgmRobot(data)
    assert robot.unknown == extra + wrong_type
    assert robot.mciConvergenceMet is False
    assert malformed(robot) is None
    assert unknown_numbers(robot) == [20, 21, 30, 6]
    assert bytes(robot) == data


def test_direction_and_content_choose_the_layer():
    assert isinstance(EgmFromPc(worked.S1), EgmSensor)
    assert isinstance(EgmFromPc(worked.C1), EgmSensorPathCorr)
    path_correction = WORKED["C1"][1].pathCorr
    no_type = bytes(EgmSensorPathCorr(header=EgmHeader(seqno=1), pathCorr=path_correction))
    assert isinstance(EgmFromPc(no_type), EgmSensorPathCorr)
    no_type = bytes(EgmSensor(planned=EgmPlanned(joints=joints(1, 2, 3, 4, 5, 6))))
    assert isinstance(EgmFromPc(no_type), EgmSensor)
    for port in EGM_PORTS:
        assert isinstance(UDP(bytes(UDP(sport=9, dport=port) / worked.R0)).payload, EgmRobot)
        assert isinstance(UDP(bytes(UDP(sport=port, dport=9) / worked.S1)).payload, EgmSensor)
        path = UDP(bytes(UDP(sport=port, dport=9) / worked.C1)).payload
        assert isinstance(path, EgmSensorPathCorr)
    assert (UDP() / EgmRobot()).dport == EGM_PORTS[0]
    assert (UDP() / EgmSensor()).sport == EGM_PORTS[0]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty datagram"),
        (worked.R0[:1], "EgmRobot: ends inside a varint"),
        (worked.R0[:7], "EgmRobot: ends inside a field"),
        (tagged(1, 2, b"\x08\xff"), "EgmHeader: ends inside a varint"),
        (tagged(1, 2, b"\x08" + b"\x80" * 10 + b"\x01"), "EgmHeader: varint longer than 10 bytes"),
        (b"\x02\x00", "EgmRobot: field number out of range"),
        (worked.R0 + b"\x0f", "EgmRobot: wire type 7 where a value should begin"),
        (worked.R0 + tagged(30, 3, b""), "EgmRobot: ends inside a group"),
        (
            worked.R0 + tagged(30, 3, tagged(31, 4, b"")),
            "EgmRobot: group closed by another field number",
        ),
        (
            tagged(14, 2, tagged(1, 2, b"1234567")),
            "EgmJoints: packed doubles of a length that is no multiple of 8",
        ),
        (tagged(4, 2, b""), "EgmMotorState lacks state"),
        (
            bytes(EgmRobot(feedBack=EgmFeedBack(cartesian=EgmPose(pos=EgmCartesian(x=1, y=2))))),
            "EgmCartesian lacks z",
        ),
        (tagged(99, 2, b"hello"), "no field of an EGM message"),
    ],
)
def test_malformed_datagrams_are_named(data, reason):
    assert malformed(EgmRobot(data)) == reason


def test_wrong_datagrams_can_be_built():
    from scapy.fields import RawVal

    assert malformed(EgmRobot(bytes(EgmRobot(motorState=EgmMotorState())))) is not None
    raw = bytes(EgmRobot(header=RawVal(b"\x0a\x05ab")))
    assert raw == b"\x0a\x05ab"
    assert bytes(EgmRobot(header=b"ab")) == b"\x0a\x02ab"
    assert bytes(EgmSensor(unknown=tagged(9, 0, varint(1)), rest=b"\xff")) == b"\x48\x01\xff"
    too_wide = bytes(EgmHeader(seqno=2**40 + 7))
    assert EgmHeader(too_wide).seqno == 7
    strange = EgmMotorState(bytes(EgmMotorState(state=-1)))
    assert strange.state == -1


@pytest.mark.parametrize(
    ("message", "remark"),
    [
        (EgmRobot(header=header(1, 1, CORRECTION)), "mtype MSGTYPE_CORRECTION"),
        (EgmSensor(header=EgmHeader(seqno=1)), "mtype absent"),
        (EgmRobot(moveIndex=1), "no header"),
        (
            EgmSensor(
                header=header(1, 1, CORRECTION), planned=EgmPlanned(joints=joints(*range(7)))
            ),
            "more than 6 joints",
        ),
        (
            EgmSensor(header=header(1, 1, CORRECTION), planned=EgmPlanned(joints=joints(math.nan))),
            "joints not finite",
        ),
        (
            EgmRobot(header=header(1, 1, DATA), utilizationRate=math.inf),
            "EgmRobot.utilizationRate not finite",
        ),
        (
            EgmSensor(
                header=header(1, 1, CORRECTION),
                planned=EgmPlanned(
                    cartesian=EgmPose(orient=EgmQuaternion(u0=0.9, u1=0, u2=0, u3=0))
                ),
            ),
            "quaternion not of norm 1",
        ),
        (
            EgmRobot(header=header(1, 1, DATA), unknown=tagged(90, 2, bytes(1200))),
            "larger than 1113 bytes",
        ),
    ],
)
def test_remarks(message, remark):
    dissected = type(message)(bytes(message))
    assert malformed(dissected) is None
    assert list(remarks(dissected)) == [remark]
    assert repr(dissected)


@pytest.mark.parametrize("name", WORKED)
def test_every_truncation_is_dissected_and_builds_back(name):
    data, message = WORKED[name]
    for size in range(len(data)):
        cut = type(message)(data[:size])
        list(remarks(cut))
        assert repr(cut)
        if size:  # scapy does not dissect empty bytes.
            assert bytes(cut) == data[:size]


@given(st.binary(max_size=200), st.sampled_from([EgmRobot, EgmSensor, EgmFromPc]))
def test_random_bytes_never_raise(data, layer):
    message = layer(data)
    malformed(message)
    list(remarks(message))
    assert repr(message)


@given(st.data())
def test_damaged_datagrams_never_raise(data):
    damaged = bytearray(worked.R1)
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at] = data.draw(st.integers(0, 255))
    message = EgmRobot(bytes(damaged))
    malformed(message)
    list(remarks(message))
    assert repr(message)


def test_faults_of_a_sub_message_are_found():
    robot = EgmRobot(worked.R0)
    robot.mciState.state = None
    assert list(faults(robot)) == ["EgmMCIState lacks state"]
