"""EGM's protobuf schema, built here: every message of RobotWare 6.08 to 7.16.

It has its own descriptor pool, because other EGM packages of the same process register the same
message names in protobuf's default pool.

Source: the published ``egm.proto`` of RobotWare 6.10 and 7, and ABB's application manual
3HAC073318-001. In every message the fields are numbered from 1 without gaps, so the order below
is the numbering.
"""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_ROBOT = (
    "header:EgmHeader feedBack:EgmMotion planned:EgmMotion motorState:EgmState mciState:EgmState "
    "mciConvergenceMet:bool testSignals:EgmTestSignals rapidExecState:EgmState "
    "measuredForce:{force} utilizationRate:double moveIndex:uint32 "
    "CollisionInfo:EgmCollisionInfo RAPIDfromRobot:EgmRAPIDdata torqueRef:EgmJoints"
)

# "!" marks required fields, "*" repeated ones. EgmMotion is EgmFeedBack and EgmPlanned, which are
# the same; EgmState is the three state messages. Enums are int32: a closed proto2 enum would make
# a state that a later RobotWare adds look like a missing required field.
_MESSAGES = {
    "EgmHeader": "seqno:uint32 tm:uint32 mtype:int32",
    "EgmCartesian": "x:!double y:!double z:!double",
    "EgmQuaternion": "u0:!double u1:!double u2:!double u3:!double",
    "EgmEuler": "x:!double y:!double z:!double",
    "EgmClock": "sec:!uint64 usec:!uint64",
    "EgmTimestamp": "sec:uint64 nsec:uint64",
    "EgmPose": "pos:EgmCartesian orient:EgmQuaternion euler:EgmEuler",
    "EgmCartesianSpeed": "value:*double",
    "EgmJoints": "joints:*double",
    "EgmMotion": (
        "joints:EgmJoints cartesian:EgmPose externalJoints:EgmJoints time:EgmClock "
        "timeStamp:EgmTimestamp"
    ),
    "EgmSpeedRef": "joints:EgmJoints cartesians:EgmCartesianSpeed externalJoints:EgmJoints",
    "EgmPathCorr": "pos:!EgmCartesian age:!uint32",
    "EgmState": "state:!int32",
    "EgmTestSignals": "signals:*double",
    "EgmMeasuredForce": "fcActive:bool force:*double",
    "EgmMeasuredForceRW6": "force:*double",
    "EgmCollisionInfo": "collsionTriggered:bool collDetQuota:*double",
    "EgmRAPIDdata": "digVal:bool dnum:*double",
    "EgmRobot": _ROBOT.format(force="EgmMeasuredForce"),
    "EgmRobotRW6": _ROBOT.format(force="EgmMeasuredForceRW6"),
    "EgmSensor": (
        "header:EgmHeader planned:EgmMotion speedRef:EgmSpeedRef RAPIDtoRobot:EgmRAPIDdata"
    ),
    "EgmSensorPathCorr": "header:EgmHeader pathCorr:EgmPathCorr",
    "Envelope": "header:EgmHeader",
}

_PACKAGE = "cardan.egm"
_Field = descriptor_pb2.FieldDescriptorProto
_LABELS = {"!": _Field.LABEL_REQUIRED, "*": _Field.LABEL_REPEATED}
_TYPES = {
    "double": _Field.TYPE_DOUBLE,
    "bool": _Field.TYPE_BOOL,
    "int32": _Field.TYPE_INT32,
    "uint32": _Field.TYPE_UINT32,
    "uint64": _Field.TYPE_UINT64,
}


def _build() -> dict[str, Any]:
    """Return the message classes by name."""
    file = descriptor_pb2.FileDescriptorProto(
        name="cardan/egm.proto", package=_PACKAGE, syntax="proto2"
    )
    for message_name, fields in _MESSAGES.items():
        message = file.message_type.add(name=message_name)
        for number, field in enumerate(fields.split(), 1):
            name, kind = field.split(":")
            label = _LABELS.get(kind[0], _Field.LABEL_OPTIONAL)
            kind = kind.lstrip("!*")
            if kind in _TYPES:
                message.field.add(name=name, number=number, label=label, type=_TYPES[kind])
            else:
                message.field.add(
                    name=name,
                    number=number,
                    label=label,
                    type=_Field.TYPE_MESSAGE,
                    type_name=f".{_PACKAGE}.{kind}",
                )
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}"))
        for name in _MESSAGES
    }


_CLASSES = _build()

Robot = _CLASSES["EgmRobot"]
RobotRW6 = _CLASSES["EgmRobotRW6"]
"""EgmRobot whose measuredForce has RobotWare 6's layout: the values in field 1."""
Sensor = _CLASSES["EgmSensor"]
SensorPathCorr = _CLASSES["EgmSensorPathCorr"]
Envelope = _CLASSES["Envelope"]
"""Beginning that all messages share: enough to tell them apart."""
