"""Encoding of EGM values as datagrams: every message, every field.

Fields that are None are left out; zeros are written, because EGM distinguishes zero from absent.
Integers wrap to the width of their field. The two answers of every cycle have a faster encoder:
:mod:`cardan.protocols.egm.replies`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cardan.protocols.egm import schema
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
)
from cardan.protocols.egm.units import MM_PER_M, degrees

_Fields = dict[str, Any]


def encode_robot(message: EgmRobot) -> bytes:
    """Encode a controller's datagram.

    A force whose `fc_active` is None is written in RobotWare 6's layout, otherwise in 7's.
    """
    force = message.measured_force
    layout = schema.Robot
    force_fields: _Fields | None = None
    if force is not None:
        force_fields = {"force": force.force}
        if force.fc_active is None:
            layout = schema.RobotRW6
        else:
            force_fields["fcActive"] = force.fc_active
    collision = message.collision_info
    return _serialized(
        layout,
        header=_header(message.header),
        feedBack=_motion(message.feed_back),
        planned=_motion(message.planned),
        motorState=_state(message.motor_state),
        mciState=_state(message.mci_state),
        mciConvergenceMet=message.mci_convergence_met,
        testSignals=_list("signals", message.test_signals),
        rapidExecState=_state(message.rapid_exec_state),
        measuredForce=force_fields,
        utilizationRate=message.utilization_rate,
        moveIndex=_unsigned(message.move_index),
        CollisionInfo=collision
        and {
            "collsionTriggered": collision.collision_triggered,
            "collDetQuota": collision.coll_det_quota,
        },
        RAPIDfromRobot=_rapid_data(message.rapid_from_robot),
        torqueRef=_list("joints", message.torque_ref),
    )


def encode_sensor(message: EgmSensor) -> bytes:
    """Encode a PC's datagram that guides the robot."""
    return _serialized(
        schema.Sensor,
        header=_header(message.header),
        planned=_motion(message.planned),
        speedRef=_speed_ref(message.speed_ref),
        RAPIDtoRobot=_rapid_data(message.rapid_to_robot),
    )


def encode_path_corr(message: EgmSensorPathCorr) -> bytes:
    """Encode a PC's datagram that corrects a programmed path."""
    return _serialized(
        schema.SensorPathCorr,
        header=_header(message.header),
        pathCorr={"pos": _millimeters(message.pos), "age": _unsigned(message.age_ms)},
    )


def encode_rapid_to_robot(data: EgmRapidData) -> bytes:
    """Encode the field RAPIDtoRobot alone, as the end of an EgmSensor (`suffix` of the replies)."""
    return _serialized(schema.Sensor, RAPIDtoRobot=_rapid_data(data))


def _serialized(message_class: Any, **fields: Any) -> bytes:
    encoded: bytes = message_class(**fields).SerializeToString()
    return encoded


def _header(header: EgmHeader | None) -> _Fields | None:
    if header is None:
        return None
    return {
        "seqno": _unsigned(header.seqno),
        "tm": _unsigned(header.tm_ms),
        "mtype": _signed(header.mtype),
    }


def _motion(motion: EgmMotion | None) -> _Fields | None:
    if motion is None:
        return None
    return {
        "joints": _angles(motion.joints),
        "cartesian": _pose(motion.cartesian),
        "externalJoints": _list("joints", motion.external_joints),
        "time": _time(motion.time_us, 1_000_000, "usec"),
        "timeStamp": _time(motion.time_stamp_ns, 1_000_000_000, "nsec"),
    }


def _pose(pose: EgmPose | None) -> _Fields | None:
    if pose is None:
        return None
    fields: _Fields = {"pos": pose.pos and _millimeters(pose.pos)}
    if pose.orient is not None:
        fields["orient"] = dict(zip(("u0", "u1", "u2", "u3"), pose.orient, strict=True))
    if pose.euler is not None:
        fields["euler"] = dict(zip("xyz", degrees(pose.euler), strict=True))
    return fields


def _speed_ref(speed: EgmSpeedRef | None) -> _Fields | None:
    if speed is None:
        return None
    values = speed.cartesians
    if values is not None:
        values = (*[value * MM_PER_M for value in values[:3]], *degrees(values[3:]))
    return {
        "joints": _angles(speed.joints),
        "cartesians": _list("value", values),
        "externalJoints": _list("joints", speed.external_joints),
    }


def _rapid_data(data: EgmRapidData | None) -> _Fields | None:
    return None if data is None else {"digVal": data.dig_val, "dnum": data.dnum}


def _millimeters(position: Sequence[float]) -> _Fields:
    return {axis: value * MM_PER_M for axis, value in zip("xyz", position, strict=True)}


def _angles(radians: Sequence[float] | None) -> _Fields | None:
    return None if radians is None else {"joints": degrees(radians)}


def _list(name: str, values: Sequence[float] | None) -> _Fields | None:
    return None if values is None else {name: values}


def _time(time: int | None, per_second: int, fraction_name: str) -> _Fields | None:
    if time is None:
        return None
    sec, fraction = divmod(time, per_second)
    return {"sec": sec & 0xFFFF_FFFF_FFFF_FFFF, fraction_name: fraction}


def _state(number: int | None) -> _Fields | None:
    return None if number is None else {"state": _signed(number)}


def _unsigned(number: int | None) -> int | None:
    return None if number is None else number & 0xFFFF_FFFF


def _signed(number: int) -> int:
    return (number + 0x8000_0000 & 0xFFFF_FFFF) - 0x8000_0000
