"""EGM datagrams to values.

protobuf parses a datagram; this module converts its messages to values in SI units, and refuses
values that must not move a robot or an operator's device.

Numbers that move a robot, a haptic device or a RAPID program (joints, poses, speeds, forces, dnum)
must be finite and no more than the protocol allows. Informative values (test signals, collision
quotas, utilization, torque references) are passed on unchecked.

Source: ABB Application manual, Externally Guided Motion (3HAC073318-001), "The EGM sensor
protocol".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from google.protobuf.message import DecodeError

from cardan.protocols.egm import schema
from cardan.protocols.egm.messages import (
    DNUM_MAX,
    MAX_DATAGRAM_BYTES,
    EgmCollisionInfo,
    EgmFeedback,
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
from cardan.protocols.egm.units import MM_PER_M, RAD_PER_DEG, radians
from cardan.spatial import from_euler_zyx
from cardan.types import Quaternion, Vector3

AXES_MAX = 6
"""Largest count of values of a group of axes, and of a force."""

_MESSAGE_TYPES = {member.value: member for member in EgmMessageType}
_MOTOR_STATES = tuple(MotorState)
_MCI_STATES = tuple(MCIState)
_RAPID_STATES = tuple(RapidState)
"""Enum members by number."""

_FROM_CONTROLLER = (2, 0)
"""EgmMessageType DATA and UNDEFINED as plain numbers, for the comparison in every cycle."""

_new = tuple.__new__
_isfinite = math.isfinite


def decode_robot(data: bytes | bytearray | memoryview) -> EgmRobot | MalformedEgmMessage:
    """Decode a controller's datagram. Never raises.

    Refused as WRONG_TYPE: an mtype that is neither DATA nor UNDEFINED, and a message with neither
    feedBack nor planned. A message without header is legal.
    """
    data = bytes(data)
    try:
        return _robot(data)
    except _RefusedError as refused:
        return refused.malformed


def decode_feedback(data: bytes) -> EgmFeedback | MalformedEgmMessage:
    """Decode the part of a controller's message that an answer depends on.

    Never raises. All of the datagram must be protobuf; values that are not returned are not
    checked. Refused as WRONG_TYPE, beyond what `decode_robot` refuses: no sequence number, no
    feedBack. This runs before every answer, so it avoids all dispensable objects and checks.
    """
    try:
        m = _parse_robot(data)
        has = m.HasField
        header = m.header
        seqno = header.seqno
        if not seqno and not header.HasField("seqno"):
            raise _RefusedError(Fault.WRONG_TYPE, "it has no sequence number")
        if not has("feedBack"):
            raise _RefusedError(Fault.WRONG_TYPE, "it has no feedBack")
        tm_ms: int | None = header.tm
        if not tm_ms and not header.HasField("tm"):
            tm_ms = None
        feedback = m.feedBack
        joints = feedback.joints.joints[:]
        if len(joints) > AXES_MAX or not _isfinite(sum(joints)):
            _axes(joints, "feedBack", "joints")
        cartesian = feedback.cartesian
        pos: Vector3 | None = None
        orient: Quaternion | None = None
        p = cartesian.pos
        x, y, z = p.x, p.y, p.z
        q = cartesian.orient
        u0, u1, u2, u3 = q.u0, q.u1, q.u2, q.u3
        if _isfinite(x + y + z + u0 + u1 + u2 + u3) and (u0 or u1 or u2 or u3) and (x or y or z):
            pos = _new(Vector3, (x / MM_PER_M, y / MM_PER_M, z / MM_PER_M))
            orient = _new(Quaternion, (u0, u1, u2, u3))
        elif feedback.HasField("cartesian"):
            pos, orient, euler = _pose(cartesian, "feedBack")
            if orient is None and euler is not None:
                orient = from_euler_zyx(*euler)
        external: tuple[float, ...] = ()
        if feedback.HasField("externalJoints"):
            external = _axes(feedback.externalJoints.joints, "feedBack", "externalJoints")
        time = feedback.time
        time_us: int | None = time.sec * 1_000_000 + time.usec
        if not time_us and not feedback.HasField("time"):
            time_us = None
        return _new(
            EgmFeedback,
            (
                seqno,
                tm_ms,
                tuple([value * RAD_PER_DEG for value in joints]),
                pos,
                orient,
                external,
                time_us,
                (m.motorState.state, m.mciState.state, m.rapidExecState.state),
                _force(m.measuredForce, data).force if has("measuredForce") else (),
                m.utilizationRate if has("utilizationRate") else None,
            ),
        )
    except _RefusedError as refused:
        return refused.malformed


def decode_from_pc(
    data: bytes | bytearray | memoryview,
) -> EgmSensor | EgmSensorPathCorr | MalformedEgmMessage:
    """Decode a PC's datagram, guidance or path correction. Never raises.

    mtype tells which; if it is neither CORRECTION nor PATH_CORRECTION (some clients leave it out),
    a complete pathCorr makes it a path correction. Refused as WRONG_TYPE: a message with none of
    the known fields.
    """
    data = bytes(data)
    try:
        if not 0 < len(data) <= MAX_DATAGRAM_BYTES:
            raise _wrong_size(data)
        mtype = _parse(schema.Envelope, data).header.mtype
        if mtype == EgmMessageType.PATH_CORRECTION:
            return _path_corr(_parse_complete(schema.SensorPathCorr, data))
        if mtype != EgmMessageType.CORRECTION:
            try:
                message = _parse_complete(schema.SensorPathCorr, data)
            except _RefusedError:
                pass
            else:
                if message.HasField("pathCorr"):
                    return _path_corr(message)
        return _sensor(_parse_complete(schema.Sensor, data))
    except _RefusedError as refused:
        return refused.malformed


class _RefusedError(Exception):
    """Abort of decoding a datagram."""

    def __init__(self, fault: Fault, detail: str) -> None:
        super().__init__(detail)
        self.malformed = MalformedEgmMessage(fault, detail)


def _wrong_size(data: bytes) -> _RefusedError:
    if not data:
        return _RefusedError(Fault.EMPTY, "the datagram has no bytes")
    return _RefusedError(
        Fault.OVERSIZED, f"{len(data)} bytes, but EGM has at most {MAX_DATAGRAM_BYTES}"
    )


def _parse(message_class: Any, data: bytes) -> Any:
    """Parse a protobuf message of `message_class`, which may lack required fields."""
    try:
        return message_class.FromString(data)
    except DecodeError as error:
        raise _RefusedError(Fault.TRUNCATED, str(error)) from None


def _parse_complete(message_class: Any, data: bytes) -> Any:
    """Parse a protobuf message of `message_class` with all required fields."""
    message = _parse(message_class, data)
    if not message.IsInitialized():
        missing = ", ".join(message.FindInitializationErrors())
        raise _RefusedError(Fault.WRONG_TYPE, f"required fields are missing: {missing}")
    return message


def _parse_robot(data: bytes) -> Any:
    """Parse a controller's protobuf EgmRobot with all required fields."""
    if not 0 < len(data) <= MAX_DATAGRAM_BYTES:
        raise _wrong_size(data)
    m = _parse_complete(schema.Robot, data)
    mtype = m.header.mtype
    if mtype not in _FROM_CONTROLLER:
        raise _RefusedError(
            Fault.WRONG_TYPE, f"mtype {mtype} is not a controller's ({EgmMessageType.DATA:d}, DATA)"
        )
    return m


def _robot(data: bytes) -> EgmRobot:
    m = _parse_robot(data)
    has = m.HasField
    if not has("feedBack") and not has("planned"):
        raise _RefusedError(Fault.WRONG_TYPE, "there is neither feedBack nor planned")
    return EgmRobot(
        _header(m),
        _motion(m.feedBack, "feedBack") if has("feedBack") else None,
        _motion(m.planned, "planned") if has("planned") else None,
        _state(m.motorState.state, _MOTOR_STATES) if has("motorState") else None,
        _state(m.mciState.state, _MCI_STATES) if has("mciState") else None,
        m.mciConvergenceMet if has("mciConvergenceMet") else None,
        _list(m.testSignals.signals) if has("testSignals") else None,
        _state(m.rapidExecState.state, _RAPID_STATES) if has("rapidExecState") else None,
        _force(m.measuredForce, data) if has("measuredForce") else None,
        m.utilizationRate if has("utilizationRate") else None,
        m.moveIndex if has("moveIndex") else None,
        _collision(m.CollisionInfo) if has("CollisionInfo") else None,
        _rapid_data(m.RAPIDfromRobot, "RAPIDfromRobot") if has("RAPIDfromRobot") else None,
        _list(m.torqueRef.joints) if has("torqueRef") else None,
    )


def _sensor(m: Any) -> EgmSensor:
    sensor = EgmSensor(
        header=_header(m),
        planned=_motion(m.planned, "planned") if m.HasField("planned") else None,
        speed_ref=_speed_ref(m.speedRef) if m.HasField("speedRef") else None,
        rapid_to_robot=(
            _rapid_data(m.RAPIDtoRobot, "RAPIDtoRobot") if m.HasField("RAPIDtoRobot") else None
        ),
    )
    if sensor == EgmSensor():
        raise _RefusedError(Fault.WRONG_TYPE, "there is no field of EgmSensor")
    return sensor


def _path_corr(m: Any) -> EgmSensorPathCorr:
    if not m.HasField("pathCorr"):
        raise _RefusedError(Fault.WRONG_TYPE, "a path correction without pathCorr")
    return EgmSensorPathCorr(_header(m), _position(m.pathCorr.pos, "pathCorr"), m.pathCorr.age)


def _header(m: Any) -> EgmHeader | None:
    if not m.HasField("header"):
        return None
    h = m.header
    return EgmHeader(
        h.seqno if h.HasField("seqno") else None,
        h.tm if h.HasField("tm") else None,
        _MESSAGE_TYPES.get(h.mtype, h.mtype),
    )


def _state(number: int, known: Sequence[int]) -> int:
    return known[number] if 0 <= number < len(known) else number


def _motion(m: Any, where: str) -> EgmMotion:
    has = m.HasField
    joints = cartesian = external = time_us = stamp_ns = None
    if has("joints"):
        joints = radians(_axes(m.joints.joints, where, "joints"))
    if has("cartesian"):
        cartesian = _pose(m.cartesian, where)
    if has("externalJoints"):
        external = _axes(m.externalJoints.joints, where, "externalJoints")
    if has("time"):
        time_us = m.time.sec * 1_000_000 + m.time.usec
    if has("timeStamp"):
        stamp_ns = m.timeStamp.sec * 1_000_000_000 + m.timeStamp.nsec
    return EgmMotion(joints, cartesian, external, time_us, stamp_ns)


def _pose(m: Any, where: str) -> EgmPose:
    pos = orient = euler = None
    if m.HasField("pos"):
        pos = _position(m.pos, where)
    if m.HasField("orient"):
        q = m.orient
        orient = Quaternion(q.u0, q.u1, q.u2, q.u3)
        _check_finite(orient, where, "orient")
    if m.HasField("euler"):
        e = m.euler
        euler = Vector3(*radians((e.x, e.y, e.z)))
        _check_finite(euler, where, "euler")
    return EgmPose(pos, orient, euler)


def _position(m: Any, where: str) -> Vector3:
    position = Vector3(m.x / MM_PER_M, m.y / MM_PER_M, m.z / MM_PER_M)
    _check_finite(position, where, "pos")
    return position


def _speed_ref(m: Any) -> EgmSpeedRef:
    joints = cartesians = external = None
    if m.HasField("joints"):
        joints = radians(_axes(m.joints.joints, "speedRef", "joints"))
    if m.HasField("cartesians"):
        values = _axes(m.cartesians.value, "speedRef", "cartesians")
        if len(values) != 6:
            raise _RefusedError(
                Fault.WRONG_COUNT, f"speedRef.cartesians has {len(values)} values instead of 6"
            )
        x, y, z = values[:3]
        cartesians = (x / MM_PER_M, y / MM_PER_M, z / MM_PER_M, *radians(values[3:]))
    if m.HasField("externalJoints"):
        external = _axes(m.externalJoints.joints, "speedRef", "externalJoints")
    return EgmSpeedRef(joints, cartesians, external)


def _force(m: Any, data: bytes) -> EgmMeasuredForce:
    values = m.force
    fc_active: bool | None = m.fcActive
    if not values and not m.HasField("fcActive"):
        values = _parse(schema.RobotRW6, data).measuredForce.force
        fc_active = None
    return EgmMeasuredForce(_axes(values, "measuredForce", "force"), fc_active)


def _collision(m: Any) -> EgmCollisionInfo:
    triggered = m.collsionTriggered if m.HasField("collsionTriggered") else None
    return EgmCollisionInfo(triggered, _list(m.collDetQuota))


def _rapid_data(m: Any, where: str) -> EgmRapidData:
    dig_val = m.digVal if m.HasField("digVal") else None
    return EgmRapidData(dig_val, _axes(m.dnum, where, "dnum", DNUM_MAX))


def _axes(values: Any, where: str, name: str, most: int = AXES_MAX) -> tuple[float, ...]:
    axes = _list(values)
    if len(axes) > most:
        raise _RefusedError(
            Fault.WRONG_COUNT, f"{where}.{name} has {len(axes)} values, at most {most} may come"
        )
    _check_finite(axes, where, name)
    return axes


def _list(values: Any) -> tuple[float, ...]:
    # Slicing a repeated field is twice as fast as iterating it.
    return tuple(values[:])


def _check_finite(values: tuple[float, ...], where: str, name: str) -> None:
    if not all(map(math.isfinite, values)):
        raise _RefusedError(Fault.NOT_FINITE, f"{where}.{name} is {tuple(values)}")
