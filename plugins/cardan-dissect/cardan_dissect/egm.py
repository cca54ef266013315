"""scapy layers of ABB Externally Guided Motion, with the protocol's names and units.

Lengths are mm, angles degrees, quaternions u0..u3 = w, x, y, z, `tm` and `age` ms. Written from the
message tables of the application manual "Externally Guided Motion" (3HAC073318-001, RW 7.16;
3HAC073319-001, RW 6) and the public message schema, independent of Cardan's codec, for
cross-checks.

A datagram is one protobuf message over UDP. To the PC's port it is an EgmRobot, from it an
EgmSensor or an EgmSensorPathCorr; :class:`EgmFromPc` chooses between those two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from cardan_dissect._scapy import UDP, EDecimal, Packet, bind_bottom_up, bind_top_down
from cardan_dissect.ports import EGM_PORTS
from cardan_dissect.protobuf import (
    TAIL,
    VARINT,
    Bool,
    Double,
    Doubles,
    Enum,
    Message,
    ProtoMessage,
    UInt,
    WireError,
    faults,
    scan,
)

MESSAGE_TYPES = (
    "MSGTYPE_UNDEFINED",
    "MSGTYPE_COMMAND",
    "MSGTYPE_DATA",
    "MSGTYPE_CORRECTION",
    "MSGTYPE_PATH_CORRECTION",
)
MOTOR_STATES = ("MOTORS_UNDEFINED", "MOTORS_ON", "MOTORS_OFF")
MCI_STATES = ("MCI_UNDEFINED", "MCI_ERROR", "MCI_STOPPED", "MCI_RUNNING")
RAPID_STATES = ("RAPID_UNDEFINED", "RAPID_STOPPED", "RAPID_RUNNING")
DATA, CORRECTION, PATH_CORRECTION = 2, 3, 4

MAX_DATAGRAM_BYTES = 1113
"""The largest EgmRobot of RobotWare 7: every optional field, six external axes, 40 dnum."""
MAX_DNUM = 40
QUATERNION_NORM_TOLERANCE = 1e-3
"""Larger than the rounding error of a few digits."""


class EgmHeader(ProtoMessage):
    fields_desc = [UInt("seqno", 1), UInt("tm", 2), Enum("mtype", 3, MESSAGE_TYPES), *TAIL]


class EgmCartesian(ProtoMessage):
    fields_desc = [Double("x", 1, True), Double("y", 2, True), Double("z", 3, True), *TAIL]


class EgmQuaternion(ProtoMessage):
    fields_desc = [*(Double(f"u{i}", i + 1, True) for i in range(4)), *TAIL]


class EgmEuler(ProtoMessage):
    fields_desc = [Double("x", 1, True), Double("y", 2, True), Double("z", 3, True), *TAIL]


class EgmClock(ProtoMessage):
    fields_desc = [UInt("sec", 1, True, 64), UInt("usec", 2, True, 64), *TAIL]


class EgmTimestamp(ProtoMessage):
    fields_desc = [UInt("sec", 1, bits=64), UInt("nsec", 2, bits=64), *TAIL]


class EgmPose(ProtoMessage):
    fields_desc = [
        Message("pos", 1, EgmCartesian),
        Message("orient", 2, EgmQuaternion),
        Message("euler", 3, EgmEuler),
        *TAIL,
    ]


class EgmCartesianSpeed(ProtoMessage):
    fields_desc = [Doubles("value", 1), *TAIL]


class EgmJoints(ProtoMessage):
    fields_desc = [Doubles("joints", 1), *TAIL]


class EgmExternalJoints(ProtoMessage):
    """Declared in the schema, used by no other message."""

    fields_desc = [Doubles("joints", 1), *TAIL]


class _TimeIsAField:
    """Hides the capture time scapy gives every packet behind the field of that name.

    A separate base class, because scapy takes an attribute next to fields_desc for the field's
    default.
    """

    @property
    def time(self: Any) -> Any:
        return self.getfieldval("time")

    @time.setter
    def time(self: Any, value: Any) -> None:
        # scapy sets its floats on new packets, and the getter's value on a copy.
        if not isinstance(value, float | EDecimal) and value != self.time:
            self.setfieldval("time", value)


class _Motion(_TimeIsAField, ProtoMessage):
    fields_desc = [
        Message("joints", 1, EgmJoints),
        Message("cartesian", 2, EgmPose),
        Message("externalJoints", 3, EgmJoints),
        Message("time", 4, EgmClock),
        Message("timeStamp", 5, EgmTimestamp),
        *TAIL,
    ]


class EgmPlanned(_Motion):
    pass


class EgmFeedBack(_Motion):
    pass


class EgmSpeedRef(ProtoMessage):
    fields_desc = [
        Message("joints", 1, EgmJoints),
        Message("cartesians", 2, EgmCartesianSpeed),
        Message("externalJoints", 3, EgmJoints),
        *TAIL,
    ]


class EgmPathCorr(ProtoMessage):
    fields_desc = [Message("pos", 1, EgmCartesian, True), UInt("age", 2, True), *TAIL]


class EgmMotorState(ProtoMessage):
    fields_desc = [Enum("state", 1, MOTOR_STATES, True), *TAIL]


class EgmMCIState(ProtoMessage):
    fields_desc = [Enum("state", 1, MCI_STATES, True), *TAIL]


class EgmRapidCtrlExecState(ProtoMessage):
    fields_desc = [Enum("state", 1, RAPID_STATES, True), *TAIL]


class EgmTestSignals(ProtoMessage):
    fields_desc = [Doubles("signals", 1), *TAIL]


class EgmMeasuredForce(ProtoMessage):
    """The layout of RobotWare 7."""

    fields_desc = [Bool("fcActive", 1), Doubles("force", 2), *TAIL]


class EgmMeasuredForceRW6(ProtoMessage):
    """The layout of RobotWare 6."""

    fields_desc = [Doubles("force", 1), *TAIL]


class EgmCollisionInfo(ProtoMessage):
    fields_desc = [Bool("collsionTriggered", 1), Doubles("collDetQuota", 2), *TAIL]


class EgmRAPIDdata(ProtoMessage):
    fields_desc = [Bool("digVal", 1), Doubles("dnum", 2, MAX_DNUM), *TAIL]


def _tolerant(data: bytes) -> list[Any]:
    """Return the items of `data` up to the first byte that is not protobuf."""
    items = []
    try:
        for item in scan(data):
            items.append(item)  # noqa: PERF402 - keeps what came before the error
    except WireError:
        pass
    return items


def _force_layout(data: bytes) -> Packet:
    """Choose the layout: RobotWare 6 has the values in field 1, where RobotWare 7 has a varint."""
    first = next((item for item in _tolerant(data) if item.number == 1), None)
    old = first is not None and first.wire_type != VARINT
    return EgmMeasuredForceRW6(data) if old else EgmMeasuredForce(data)


class EgmRobot(ProtoMessage):
    """Controller to PC."""

    fields_desc = [
        Message("header", 1, EgmHeader),
        Message("feedBack", 2, EgmFeedBack),
        Message("planned", 3, EgmPlanned),
        Message("motorState", 4, EgmMotorState),
        Message("mciState", 5, EgmMCIState),
        Bool("mciConvergenceMet", 6),
        Message("testSignals", 7, EgmTestSignals),
        Message("rapidExecState", 8, EgmRapidCtrlExecState),
        Message("measuredForce", 9, _force_layout),
        Double("utilizationRate", 10),
        UInt("moveIndex", 11),
        Message("CollisionInfo", 12, EgmCollisionInfo),
        Message("RAPIDfromRobot", 13, EgmRAPIDdata),
        Message("torqueRef", 14, EgmJoints),
        *TAIL,
    ]


class EgmSensor(ProtoMessage):
    """PC to controller, guidance."""

    fields_desc = [
        Message("header", 1, EgmHeader),
        Message("planned", 2, EgmPlanned),
        Message("speedRef", 3, EgmSpeedRef),
        Message("RAPIDtoRobot", 4, EgmRAPIDdata),
        *TAIL,
    ]


class EgmSensorPathCorr(ProtoMessage):
    """PC to controller, path correction."""

    fields_desc = [Message("header", 1, EgmHeader), Message("pathCorr", 2, EgmPathCorr), *TAIL]


EXPECTED_MTYPE = {EgmRobot: DATA, EgmSensor: CORRECTION, EgmSensorPathCorr: PATH_CORRECTION}


def symbol(message: ProtoMessage, name: str) -> str | None:
    """Return the schema's name of an enum's value, None if it is absent."""
    value, field = message.getfieldval(name), message.get_field(name)
    return field.symbol(value) if isinstance(field, Enum) and value is not None else None


def message_type(data: bytes) -> int:
    """Return header.mtype of a datagram, 0 if absent."""
    content = b"".join(i.value for i in _tolerant(data) if (i.number, i.wire_type) == (1, 2))
    return (EgmHeader(content).mtype or 0) if content else 0


class EgmFromPc(ProtoMessage):
    """Dissects to EgmSensor or EgmSensorPathCorr: by mtype, else by the shape of field 2.

    Only a path correction has a varint (age) as field 2 of its field 2.
    """

    name = "EGM from the PC"

    @classmethod
    def dispatch_hook(cls, _pkt: bytes = b"", *args: Any, **kwargs: Any) -> type[ProtoMessage]:
        mtype = message_type(_pkt)
        if mtype in (CORRECTION, PATH_CORRECTION):
            return EgmSensorPathCorr if mtype == PATH_CORRECTION else EgmSensor
        content = b"".join(i.value for i in _tolerant(_pkt) if (i.number, i.wire_type) == (2, 2))
        age = any((i.number, i.wire_type) == (2, VARINT) for i in _tolerant(content))
        return EgmSensorPathCorr if age else EgmSensor


def malformed(message: ProtoMessage) -> str | None:
    """Return why a dissected datagram is not an EGM message; None if it is."""
    if not message.original:
        return "empty datagram"
    reason = next(faults(message), None)
    if reason is None and message.fields.keys() <= {"unknown"}:
        return "no field of an EGM message"
    return reason


def remarks(message: ProtoMessage) -> Iterator[str]:
    """Yield readable values that the protocol forbids or a controller may refuse."""
    if len(message.original) > MAX_DATAGRAM_BYTES:
        yield f"larger than {MAX_DATAGRAM_BYTES} bytes"
    if message.header is None:
        yield "no header"
    elif message.header.mtype != EXPECTED_MTYPE[type(message)]:
        yield f"mtype {symbol(message.header, 'mtype') or 'absent'}"
    yield from _value_remarks(message)


def _value_remarks(message: ProtoMessage) -> Iterator[str]:
    for field in message.fields_desc:
        value = message.getfieldval(field.name)
        if isinstance(value, ProtoMessage):
            yield from _value_remarks(value)
        elif isinstance(field, Doubles) and value is not None:
            if len(value) > field.most:
                yield f"more than {field.most} {field.name}"
            if not all(map(math.isfinite, value)):
                yield f"{field.name} not finite"
        elif isinstance(field, Double) and value is not None and not math.isfinite(value):
            yield f"{type(message).__name__}.{field.name} not finite"
    if isinstance(message, EgmQuaternion):
        norm = math.hypot(*(message.getfieldval(f"u{i}") or 0.0 for i in range(4)))
        if abs(norm - 1) > QUATERNION_NORM_TOLERANCE:
            yield "quaternion not of norm 1"


for _port in EGM_PORTS:
    bind_bottom_up(UDP, EgmRobot, dport=_port)
    bind_bottom_up(UDP, EgmFromPc, sport=_port)
bind_top_down(UDP, EgmRobot, dport=EGM_PORTS[0])
bind_top_down(UDP, EgmSensor, sport=EGM_PORTS[0])
bind_top_down(UDP, EgmSensorPathCorr, sport=EGM_PORTS[0])
