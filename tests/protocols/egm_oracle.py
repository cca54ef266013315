"""Independent decoder of EGM datagrams: protobuf's own parser, with explicit conversions.

The schema is written from the manual's tables, one line a field, and shares nothing with the
codec's. States are int32 here, too: the codec keeps numbers that no enum has a name for.
"""

import math

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from cardan.protocols.egm.messages import (
    EgmCollisionInfo,
    EgmHeader,
    EgmMeasuredForce,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
)
from cardan.types import Quaternion, Vector3

SCHEMA = """
EgmHeader
  1 optional uint32 seqno
  2 optional uint32 tm
  3 optional int32 mtype
EgmCartesian
  1 required double x
  2 required double y
  3 required double z
EgmQuaternion
  1 required double u0
  2 required double u1
  3 required double u2
  4 required double u3
EgmEuler
  1 required double x
  2 required double y
  3 required double z
EgmClock
  1 required uint64 sec
  2 required uint64 usec
EgmTimestamp
  1 optional uint64 sec
  2 optional uint64 nsec
EgmPose
  1 optional EgmCartesian pos
  2 optional EgmQuaternion orient
  3 optional EgmEuler euler
EgmCartesianSpeed
  1 repeated double value
EgmJoints
  1 repeated double joints
EgmPlanned
  1 optional EgmJoints joints
  2 optional EgmPose cartesian
  3 optional EgmJoints externalJoints
  4 optional EgmClock time
  5 optional EgmTimestamp timeStamp
EgmSpeedRef
  1 optional EgmJoints joints
  2 optional EgmCartesianSpeed cartesians
  3 optional EgmJoints externalJoints
EgmPathCorr
  1 required EgmCartesian pos
  2 required uint32 age
EgmFeedBack
  1 optional EgmJoints joints
  2 optional EgmPose cartesian
  3 optional EgmJoints externalJoints
  4 optional EgmClock time
  5 optional EgmTimestamp timeStamp
EgmMotorState
  1 required int32 state
EgmMCIState
  1 required int32 state
EgmTestSignals
  1 repeated double signals
EgmRapidCtrlExecState
  1 required int32 state
EgmMeasuredForce
  1 optional bool fcActive
  2 repeated double force
EgmOldMeasuredForce
  1 repeated double force
EgmCollisionInfo
  1 optional bool collsionTriggered
  2 repeated double collDetQuota
EgmRAPIDdata
  1 optional bool digVal
  2 repeated double dnum
EgmRobot
  1 optional EgmHeader header
  2 optional EgmFeedBack feedBack
  3 optional EgmPlanned planned
  4 optional EgmMotorState motorState
  5 optional EgmMCIState mciState
  6 optional bool mciConvergenceMet
  7 optional EgmTestSignals testSignals
  8 optional EgmRapidCtrlExecState rapidExecState
  9 optional EgmMeasuredForce measuredForce
  10 optional double utilizationRate
  11 optional uint32 moveIndex
  12 optional EgmCollisionInfo CollisionInfo
  13 optional EgmRAPIDdata RAPIDfromRobot
  14 optional EgmJoints torqueRef
EgmOldForceRobot
  9 optional EgmOldMeasuredForce measuredForce
EgmSensor
  1 optional EgmHeader header
  2 optional EgmPlanned planned
  3 optional EgmSpeedRef speedRef
  4 optional EgmRAPIDdata RAPIDtoRobot
EgmSensorPathCorr
  1 optional EgmHeader header
  2 optional EgmPathCorr pathCorr
"""


def _classes():
    proto = descriptor_pb2.FileDescriptorProto(name="oracle.proto", package="oracle")
    field_type = descriptor_pb2.FieldDescriptorProto
    for line in SCHEMA.strip().splitlines():
        words = line.split()
        if len(words) == 1:
            message = proto.message_type.add(name=words[0])
            continue
        number, label, kind, name = words
        field = message.field.add(name=name, number=int(number))
        field.label = field_type.Label.Value(f"LABEL_{label.upper()}")
        if kind.startswith("Egm"):
            field.type, field.type_name = field_type.TYPE_MESSAGE, f".oracle.{kind}"
        else:
            field.type = field_type.Type.Value(f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(proto.SerializeToString())
    return message_factory.GetMessageClassesForFiles(["oracle.proto"], pool)


CLASSES = {name.removeprefix("oracle."): cls for name, cls in _classes().items()}


class RefusedError(Exception):
    """Error for a datagram that must be refused."""


def parse(name, data):
    """Return the message as nested dictionaries of the present fields."""
    try:
        message = CLASSES[name].FromString(data)
    except DecodeError as error:
        raise RefusedError(str(error)) from None
    if not message.IsInitialized():
        raise RefusedError("required fields are missing")
    return tree(message)


def tree(message):
    found = {}
    for field, value in message.ListFields():
        if field.message_type is not None:
            found[field.name] = tree(value)
        else:
            found[field.name] = value if isinstance(value, (int, float)) else list(value)
    return found


def robot(data):
    """Return the EgmRobot in `data`; raise RefusedError if there is none."""
    size(data)
    t = parse("EgmRobot", data)
    if t.get("header", {}).get("mtype", 0) not in (0, 2) or not t.keys() & {"feedBack", "planned"}:
        raise RefusedError("not from a controller")
    return EgmRobot(
        header=opt(header, t.get("header")),
        feed_back=opt(motion, t.get("feedBack")),
        planned=opt(motion, t.get("planned")),
        motor_state=opt(dict.get, t.get("motorState"), "state"),
        mci_state=opt(dict.get, t.get("mciState"), "state"),
        mci_convergence_met=t.get("mciConvergenceMet"),
        test_signals=opt(numbers, t.get("testSignals"), "signals"),
        rapid_exec_state=opt(dict.get, t.get("rapidExecState"), "state"),
        measured_force=opt(force, t.get("measuredForce"), data),
        utilization_rate=t.get("utilizationRate"),
        move_index=t.get("moveIndex"),
        collision_info=opt(collision, t.get("CollisionInfo")),
        rapid_from_robot=opt(rapid_data, t.get("RAPIDfromRobot")),
        torque_ref=opt(numbers, t.get("torqueRef"), "joints"),
    )


def from_pc(data):
    """Return the EgmSensor or EgmSensorPathCorr in `data`; raise RefusedError if there is
    neither."""
    size(data)
    # Both have the same header, and a malformed one makes both malformed.
    try:
        mtype = parse("EgmSensorPathCorr", data).get("header", {}).get("mtype", 0)
    except RefusedError:
        mtype = parse("EgmSensor", data).get("header", {}).get("mtype", 0)
    if mtype == 4:
        return path_corr(data)
    if mtype != 3:
        try:
            t = parse("EgmSensorPathCorr", data)
        except RefusedError:
            t = {}
        if "pathCorr" in t:
            return path_corr(data)
    t = parse("EgmSensor", data)
    if not t:
        raise RefusedError("nothing in it")
    return EgmSensor(
        header=opt(header, t.get("header")),
        planned=opt(motion, t.get("planned")),
        speed_ref=opt(speed_ref, t.get("speedRef")),
        rapid_to_robot=opt(rapid_data, t.get("RAPIDtoRobot")),
    )


def path_corr(data):
    t = parse("EgmSensorPathCorr", data)
    if "pathCorr" not in t:
        raise RefusedError("no pathCorr")
    return EgmSensorPathCorr(
        opt(header, t.get("header")), position(t["pathCorr"]["pos"]), t["pathCorr"]["age"]
    )


def size(data):
    if not 0 < len(data) <= 2048:
        raise RefusedError("size")


def opt(function, value, *more):
    return None if value is None else function(value, *more)


def finite(values):
    if not all(math.isfinite(v) for v in values):
        raise RefusedError("not finite")
    return values


def numbers(t, name):
    return tuple(t.get(name, ()))


def limited(t, name, most=6):
    values = numbers(t, name)
    if len(values) > most:
        raise RefusedError("too many")
    return finite(values)


def angles(t, name="joints"):
    return tuple(math.radians(v) for v in limited(t, name))


def header(t):
    return EgmHeader(t.get("seqno"), t.get("tm"), t.get("mtype", 0))


def position(t):
    return Vector3(*finite([t[axis] * 1e-3 for axis in "xyz"]))


def pose(t):
    return EgmPose(
        opt(position, t.get("pos")),
        opt(lambda q: Quaternion(*finite([q[f"u{i}"] for i in range(4)])), t.get("orient")),
        opt(lambda e: Vector3(*finite([math.radians(e[a]) for a in "xyz"])), t.get("euler")),
    )


def motion(t):
    return EgmMotion(
        joints=opt(angles, t.get("joints")),
        cartesian=opt(pose, t.get("cartesian")),
        external_joints=opt(limited, t.get("externalJoints"), "joints"),
        time_us=opt(lambda c: c["sec"] * 10**6 + c["usec"], t.get("time")),
        time_stamp_ns=opt(lambda c: c.get("sec", 0) * 10**9 + c.get("nsec", 0), t.get("timeStamp")),
    )


def speed_ref(t):
    def cartesians(t):
        values = limited(t, "value")
        if len(values) != 6:
            raise RefusedError("not six")
        return (*[v * 1e-3 for v in values[:3]], *[math.radians(v) for v in values[3:]])

    return EgmSpeedRef(
        joints=opt(angles, t.get("joints")),
        cartesians=opt(cartesians, t.get("cartesians")),
        external_joints=opt(limited, t.get("externalJoints"), "joints"),
    )


def rapid_data(t):
    return EgmRapidData(t.get("digVal"), limited(t, "dnum", 40))


def collision(t):
    return EgmCollisionInfo(t.get("collsionTriggered"), numbers(t, "collDetQuota"))


def force(t, data):
    if t:
        return EgmMeasuredForce(limited(t, "force"), t.get("fcActive", False))
    old = parse("EgmOldForceRobot", data)["measuredForce"]
    return EgmMeasuredForce(limited(old, "force"), None)


def assert_same(found, expected, path="message"):
    """Assert equality up to the last digits of converted numbers; NaN equals NaN."""
    if isinstance(expected, tuple):
        assert type(found) is type(expected), path
        assert len(found) == len(expected), path
        names = getattr(expected, "_fields", range(len(expected)))
        for name, left, right in zip(names, found, expected, strict=True):
            assert_same(left, right, f"{path}.{name}")
    elif isinstance(expected, float) and found is not None:
        same = math.isclose(found, expected, rel_tol=1e-14, abs_tol=1e-300)
        assert same or (math.isnan(found) and math.isnan(expected)), (path, found, expected)
    else:
        assert found == expected, path
        assert isinstance(found, bool) is isinstance(expected, bool), path
