"""Messages of simple message as values, with MotoROS's spelling.

Angles are in rad (m for linear axes), speeds in rad/s, times in s. Arrays of joints have ten
entries, base to tool, for every arm: `joints10` pads one. Group numbers count from 0.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Annotated, NamedTuple

from cardan.protocols.simple_message.codes import CommType, MessageType, ReplyCode

JOINTS = 10
"""ROS_MAX_JOINT: length of every array of joints."""
MAX_GROUPS = 4
"""MOT_MAX_GR: most groups of a controller; JOINT_FEEDBACK_EX always has this many."""
DH_LINKS = 8

Unsigned = Annotated[int, "without sign"]
"""An unsigned word on the wire; `int` is a signed one."""
Joints = tuple[float, ...]
"""Ten values, one per joint."""
ZEROS: Joints = (0.0,) * JOINTS


def joints10(values: Iterable[float]) -> Joints:
    """Pad `values` with zeros to ten. Raises ValueError if there are more."""
    found = tuple(values)
    if len(found) > JOINTS:
        raise ValueError(f"{len(found)} joints are more than the {JOINTS} of a message")
    return found + ZEROS[len(found) :]


class Empty(NamedTuple):
    """Body of PING, GET_VERSION and the request of GET_DH_PARAMETERS: empty."""


class JointPosition(NamedTuple):
    """JOINT_POSITION 10 (deprecated)."""

    sequence: int
    pos: Joints


class JointTrajPt(NamedTuple):
    """JOINT_TRAJ_PT 11. The meaning of `velocity` depends on the driver, often a share of the
    highest."""

    sequence: int
    pos: Joints
    velocity: float
    duration: float


class RobotStatus(NamedTuple):
    """ROBOT_STATUS 13. Switches are -1 unknown, 0 off, 1 on."""

    drives_powered: int
    e_stopped: int
    error_code: int
    """First active alarm; 0 if there is none."""
    in_error: int
    in_motion: int
    mode: int
    """A ControllerMode."""
    motion_possible: int


class JointTrajPtFull(NamedTuple):
    """JOINT_TRAJ_PT_FULL 14. Sequence 0 begins a trajectory."""

    group: int
    sequence: int
    valid_fields: int
    time: float
    pos: Joints
    vel: Joints
    acc: Joints


class JointFeedback(NamedTuple):
    """JOINT_FEEDBACK 15, and one group of the EX messages."""

    group: int
    valid_fields: int
    time: float
    pos: Joints
    vel: Joints
    acc: Joints


class MotionCtrl(NamedTuple):
    """MOTO_MOTION_CTRL 2001."""

    group: int
    sequence: int
    command: int
    """A MotionCommand."""
    data: Joints = ZEROS


class MotionReply(NamedTuple):
    """MOTO_MOTION_REPLY 2002.

    `command` is the answered MotionCommand, or the type of the answered message. If an I/O server
    did not understand a message, result and subcode are in `group` and `sequence`.
    """

    group: int
    sequence: int
    command: int
    result: int
    """A MotionResult."""
    subcode: int
    data: Joints = ZEROS


class ReadIo(NamedTuple):
    """MOTO_READ_IO_BIT 2003 and MOTO_READ_IO_GROUP 2007."""

    address: Unsigned


class ReadIoReply(NamedTuple):
    """MOTO_READ_IO_BIT_REPLY 2004 and MOTO_READ_IO_GROUP_REPLY 2008."""

    value: Unsigned
    result: Unsigned
    """An IoResult."""


class WriteIo(NamedTuple):
    """MOTO_WRITE_IO_BIT 2005 and MOTO_WRITE_IO_GROUP 2009."""

    address: Unsigned
    value: Unsigned


class WriteIoReply(NamedTuple):
    """MOTO_WRITE_IO_BIT_REPLY 2006 and MOTO_WRITE_IO_GROUP_REPLY 2010."""

    result: Unsigned
    """An IoResult."""


class IoCtrlReply(NamedTuple):
    """MOTO_IOCTRL_REPLY 2011; declared, never sent."""

    result: int
    subcode: int


class ReadRegister(NamedTuple):
    """Request of MOTO_READ_MREGISTER 2012."""

    register: Unsigned


class ReadRegisterReply(NamedTuple):
    """Reply of MOTO_READ_MREGISTER 2012, which has the same type."""

    value: Unsigned
    result: Unsigned
    """An IoResult."""


class WriteRegister(NamedTuple):
    """Request of MOTO_WRITE_MREGISTER 2013."""

    register: Unsigned
    value: Unsigned


class WriteRegisterReply(NamedTuple):
    """Reply of MOTO_WRITE_MREGISTER 2013, which has the same type."""

    result: Unsigned
    """An IoResult."""


class JointTrajPtFullEx(NamedTuple):
    """MOTO_JOINT_TRAJ_PT_FULL_EX 2016: a point for several groups at once."""

    sequence: int
    points: tuple[JointFeedback, ...]
    """A point for each group, at most MAX_GROUPS."""


class JointFeedbackEx(NamedTuple):
    """MOTO_JOINT_FEEDBACK_EX 2017."""

    groups: int
    """Number of valid items of `feedback`."""
    feedback: tuple[JointFeedback, ...]
    """Always MAX_GROUPS."""


class SelectTool(NamedTuple):
    """MOTO_SELECT_TOOL 2018; the reply is a MotionReply."""

    group: int
    tool: int
    """0 to 63."""
    sequence: int


class DhLink(NamedTuple):
    """Denavit-Hartenberg parameters of one link."""

    theta: float
    d: float
    a: float
    alpha: float


class DhParameters(NamedTuple):
    """Reply of MOTO_GET_DH_PARAMETERS 2020: MAX_GROUPS groups of DH_LINKS links."""

    groups: tuple[tuple[DhLink, ...], ...]


class RtGroupState(NamedTuple):
    """State of a group in RtJointState."""

    group: int
    pos: Joints
    vel: Joints


class RtJointState(NamedTuple):
    """MOTO_RT_JOINT_STATE_EX 2030 (NTNU's fork, UDP)."""

    message_id: int
    mode: int
    """0 idle, 1 joint position, 2 joint velocity."""
    states: tuple[RtGroupState, ...]


class RtGroupCommand(NamedTuple):
    """Command of a group in RtJointCommand."""

    group: int
    command: Joints
    """rad/s."""


class RtJointCommand(NamedTuple):
    """MOTO_RT_JOINT_COMMAND_EX 2031 (NTNU's fork, UDP)."""

    message_id: int
    """Echo of the state's."""
    commands: tuple[RtGroupCommand, ...]


class JointVelocity(NamedTuple):
    """MOTO_JOINT_VELOCITY 2040 (velocity mode), laid out as JOINT_TRAJ_PT_FULL."""

    group: int
    sequence: int
    valid_fields: int
    time: float
    pos: Joints
    vel: Joints
    acc: Joints


class JointVelocityEx(NamedTuple):
    """MOTO_JOINT_VELOCITY_EX 2041 (velocity mode)."""

    sequence: int
    commands: tuple[JointFeedback, ...]


class VelocityInfoRequest(NamedTuple):
    """Request of MOTO_VELOCITY_INFO 2042 (velocity mode)."""

    group: int


class VelocityInfo(NamedTuple):
    """Reply of MOTO_VELOCITY_INFO 2042 (velocity mode)."""

    version: int
    ipc_us: int
    watchdog_ms: int
    active_mode: int
    """An ActiveMode."""
    groups: int
    axes: int
    v_max: Joints
    a_max: Joints
    pos_min: Joints
    pos_max: Joints


class Raw(NamedTuple):
    """The body of a message whose type is not known here."""

    data: bytes


Body = (
    Empty
    | JointPosition
    | JointTrajPt
    | RobotStatus
    | JointTrajPtFull
    | JointFeedback
    | MotionCtrl
    | MotionReply
    | ReadIo
    | ReadIoReply
    | WriteIo
    | WriteIoReply
    | IoCtrlReply
    | ReadRegister
    | ReadRegisterReply
    | WriteRegister
    | WriteRegisterReply
    | JointTrajPtFullEx
    | JointFeedbackEx
    | SelectTool
    | DhParameters
    | RtJointState
    | RtJointCommand
    | JointVelocity
    | JointVelocityEx
    | VelocityInfoRequest
    | VelocityInfo
    | Raw
)


class Message(NamedTuple):
    """Message: header and body."""

    msg_type: int
    """A MessageType."""
    comm_type: int
    """A CommType."""
    reply_code: int
    """A ReplyCode."""
    body: Body


class MalformedMessage(NamedTuple):
    """Reason why bytes are not a message."""

    reason: str
    msg_type: int = 0


BODIES: dict[MessageType, tuple[type[Body], ...]] = {
    MessageType.PING: (Empty,),
    MessageType.GET_VERSION: (Empty,),
    MessageType.JOINT_POSITION: (JointPosition,),
    MessageType.JOINT_TRAJ_PT: (JointTrajPt,),
    MessageType.ROBOT_STATUS: (RobotStatus,),
    MessageType.JOINT_TRAJ_PT_FULL: (JointTrajPtFull,),
    MessageType.JOINT_FEEDBACK: (JointFeedback,),
    MessageType.OLD_JOINT_TRAJ_PT_FULL_EX: (JointTrajPtFullEx,),
    MessageType.OLD_JOINT_FEEDBACK_EX: (JointFeedbackEx,),
    MessageType.MOTO_MOTION_CTRL: (MotionCtrl,),
    MessageType.MOTO_MOTION_REPLY: (MotionReply,),
    MessageType.MOTO_READ_IO_BIT: (ReadIo,),
    MessageType.MOTO_READ_IO_BIT_REPLY: (ReadIoReply,),
    MessageType.MOTO_WRITE_IO_BIT: (WriteIo,),
    MessageType.MOTO_WRITE_IO_BIT_REPLY: (WriteIoReply,),
    MessageType.MOTO_READ_IO_GROUP: (ReadIo,),
    MessageType.MOTO_READ_IO_GROUP_REPLY: (ReadIoReply,),
    MessageType.MOTO_WRITE_IO_GROUP: (WriteIo,),
    MessageType.MOTO_WRITE_IO_GROUP_REPLY: (WriteIoReply,),
    MessageType.MOTO_IOCTRL_REPLY: (IoCtrlReply,),
    MessageType.MOTO_READ_MREGISTER: (ReadRegister, ReadRegisterReply),
    MessageType.MOTO_WRITE_MREGISTER: (WriteRegister, WriteRegisterReply),
    MessageType.MOTO_JOINT_TRAJ_PT_FULL_EX: (JointTrajPtFullEx,),
    MessageType.MOTO_JOINT_FEEDBACK_EX: (JointFeedbackEx,),
    MessageType.MOTO_SELECT_TOOL: (SelectTool,),
    MessageType.MOTO_GET_DH_PARAMETERS: (Empty, DhParameters),
    MessageType.MOTO_RT_JOINT_STATE_EX: (RtJointState,),
    MessageType.MOTO_RT_JOINT_COMMAND_EX: (RtJointCommand,),
    MessageType.MOTO_JOINT_VELOCITY: (JointVelocity,),
    MessageType.MOTO_JOINT_VELOCITY_EX: (JointVelocityEx,),
    MessageType.MOTO_VELOCITY_INFO: (VelocityInfoRequest, VelocityInfo),
}
"""Bodies by type; if a type has several bodies, their lengths differ."""


def _types() -> dict[type[Body], MessageType]:
    """Type of each body that has only one; for others it must be given."""
    old = (MessageType.OLD_JOINT_TRAJ_PT_FULL_EX, MessageType.OLD_JOINT_FEEDBACK_EX)
    found = [(body, each) for each in BODIES if each not in old for body in BODIES[each]]
    counts = Counter(body for body, _ in found)
    return {body: each for body, each in found if counts[body] == 1}


_TYPES = _types()


def _type_of(body: Body, msg_type: int | None) -> int:
    if msg_type is not None:
        return msg_type
    found = _TYPES.get(type(body))
    if found is None:
        raise ValueError(f"{type(body).__name__} is the body of several types; say which: msg_type")
    return found


def request(body: Body, msg_type: int | None = None) -> Message:
    """Make a SERVICE_REQUEST; `msg_type` is only for bodies that several types share."""
    return Message(_type_of(body, msg_type), CommType.SERVICE_REQUEST, ReplyCode.INVALID, body)


def topic(body: Body, msg_type: int | None = None) -> Message:
    """Make a TOPIC, which gets no answer."""
    return Message(_type_of(body, msg_type), CommType.TOPIC, ReplyCode.INVALID, body)


def reply(body: Body, reply_code: int = ReplyCode.SUCCESS, msg_type: int | None = None) -> Message:
    """Make a SERVICE_REPLY."""
    return Message(_type_of(body, msg_type), CommType.SERVICE_REPLY, reply_code, body)
