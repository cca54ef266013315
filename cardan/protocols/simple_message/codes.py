"""Numbers of simple message and their names.

Sources: ROS-Industrial simple_message (simple_message.h, shared types), MotoROS 1.9.12
(SimpleMessage.h, IoServer.h) and, for what is marked so, docs/protocols/simple-message.md.
"""

from __future__ import annotations

import enum

MOTION_PORT, STATE_PORT, IO_PORT = 50240, 50241, 50242
"""TCP ports of MotoROS. Generic ROS-Industrial drivers use 11000, 11002 and 11003."""


class CommType(enum.IntEnum):
    """Purpose of a message."""

    INVALID = 0
    TOPIC = 1
    """No answer is expected."""
    SERVICE_REQUEST = 2
    SERVICE_REPLY = 3


class ReplyCode(enum.IntEnum):
    """Result of a request in the header; 0 in topics and requests."""

    INVALID = 0
    SUCCESS = 1
    FAILURE = 2


class MessageType(enum.IntEnum):
    """Identifiers of messages."""

    PING = 1
    GET_VERSION = 2
    JOINT_POSITION = 10
    JOINT_TRAJ_PT = 11
    JOINT_TRAJ = 12
    ROBOT_STATUS = 13
    JOINT_TRAJ_PT_FULL = 14
    JOINT_FEEDBACK = 15
    OLD_JOINT_TRAJ_PT_FULL_EX = 16
    """Former number of 2016."""
    OLD_JOINT_FEEDBACK_EX = 17
    """Former number of 2017."""
    READ_INPUT = 20
    WRITE_OUTPUT = 21
    MOTO_MOTION_CTRL = 2001
    MOTO_MOTION_REPLY = 2002
    MOTO_READ_IO_BIT = 2003
    MOTO_READ_IO_BIT_REPLY = 2004
    MOTO_WRITE_IO_BIT = 2005
    MOTO_WRITE_IO_BIT_REPLY = 2006
    MOTO_READ_IO_GROUP = 2007
    MOTO_READ_IO_GROUP_REPLY = 2008
    MOTO_WRITE_IO_GROUP = 2009
    MOTO_WRITE_IO_GROUP_REPLY = 2010
    MOTO_IOCTRL_REPLY = 2011
    MOTO_READ_MREGISTER = 2012
    MOTO_WRITE_MREGISTER = 2013
    MOTO_JOINT_TRAJ_PT_FULL_EX = 2016
    MOTO_JOINT_FEEDBACK_EX = 2017
    MOTO_SELECT_TOOL = 2018
    MOTO_GET_DH_PARAMETERS = 2020
    MOTO_RT_JOINT_STATE_EX = 2030
    """NTNU's fork, UDP."""
    MOTO_RT_JOINT_COMMAND_EX = 2031
    """NTNU's fork, UDP."""
    MOTO_JOINT_VELOCITY = 2040
    """Velocity mode."""
    MOTO_JOINT_VELOCITY_EX = 2041
    """Velocity mode."""
    MOTO_VELOCITY_INFO = 2042
    """Velocity mode: its limits and groups, from a controller that has it."""


class MotionCommand(enum.IntEnum):
    """Commands of MOTO_MOTION_CTRL."""

    CHECK_MOTION_READY = 200101
    CHECK_QUEUE_CNT = 200102
    STOP_MOTION = 200111
    START_SERVOS = 200112
    STOP_SERVOS = 200113
    RESET_ALARM = 200114
    START_TRAJ_MODE = 200121
    STOP_TRAJ_MODE = 200122
    DISCONNECT = 200130
    START_RT = 200140
    """NTNU's fork."""
    STOP_RT = 200141
    """NTNU's fork."""
    CHECK_TIMEOUT_CNT = 200142
    """NTNU's fork; declared, never served."""
    START_VEL_MODE = 200151
    """Velocity mode."""
    STOP_VEL_MODE = 200152
    """Velocity mode."""


class MotionResult(enum.IntEnum):
    """Results in MOTO_MOTION_REPLY."""

    SUCCESS = 0
    """Also TRUE."""
    BUSY = 1
    FAILURE = 2
    """Also FALSE."""
    INVALID = 3
    ALARM = 4
    """Declared, never sent."""
    NOT_READY = 5
    MP_FAILURE = 6
    """Declared, never sent."""


class InvalidSubcode(enum.IntEnum):
    """Reason why a message was INVALID."""

    UNSPECIFIED = 3000
    MSGSIZE = 3001
    MSGHEADER = 3002
    MSGTYPE = 3003
    GROUPNO = 3004
    SEQUENCE = 3005
    """Negative."""
    COMMAND = 3006
    """Declared, never sent: an unknown command gets the previous reply again."""
    DATA = 3010
    DATA_START_POS = 3011
    """Point 0 is more than 30 pulses from the commanded position."""
    DATA_POSITION = 3012
    """Declared, never sent."""
    DATA_SPEED = 3013
    DATA_ACCEL = 3014
    """Declared, never sent."""
    DATA_INSUFFICIENT = 3015
    """Time, position and velocity must all be valid."""
    DATA_TIME = 3016
    """At 14400 s or more."""
    DATA_TOOLNO = 3017
    VEL_SEQUENCE = 3040
    """Velocity mode: not newer than the previous one."""
    VEL_NOT_FINITE = 3041
    """Velocity mode."""


class NotReadySubcode(enum.IntEnum):
    """Reason why the controller is NOT_READY."""

    UNSPECIFIED = 5000
    ALARM = 5001
    ERROR = 5002
    ESTOP = 5003
    NOT_PLAY = 5004
    NOT_REMOTE = 5005
    SERVO_OFF = 5006
    HOLD = 5007
    NOT_STARTED = 5008
    """The job INIT_ROS does not run."""
    WAITING_ROS = 5009
    """The job is not on its WAIT line."""
    SKILLSEND = 5010
    PFL_ACTIVE = 5011
    """Collaborative stop."""
    INC_MOVE_ERROR = 5012
    """Latched until START_TRAJ_MODE."""
    NOT_IN_VEL_MODE = 5040
    """Velocity mode."""
    VEL_WATCHDOG = 5041
    """Velocity mode; latched until sequence 0."""
    OTHER_MODE_ACTIVE = 5042
    """Velocity mode."""


class IoResult(enum.IntEnum):
    """Results in replies about inputs, outputs and registers."""

    OK = 0
    READ_ADDRESS_INVALID = 1001
    WRITE_ADDRESS_INVALID = 1002
    WRITE_VALUE_INVALID = 1003
    READ_API_ERROR = 1004
    WRITE_API_ERROR = 1005


class ValidFields(enum.IntFlag):
    """Flags for the valid fields of a point or of feedback."""

    TIME = 1
    POSITION = 2
    VELOCITY = 4
    ACCELERATION = 8


class ControllerMode(enum.IntEnum):
    """`mode` of ROBOT_STATUS."""

    UNKNOWN = -1
    MANUAL = 1
    """Teach."""
    AUTO = 2
    """Play."""


class ActiveMode(enum.IntEnum):
    """Velocity mode: `active_mode` of MOTO_VELOCITY_INFO."""

    NONE = 0
    TRAJECTORY = 1
    VELOCITY = 2


def name_of(codes: type[enum.IntEnum], value: int) -> str:
    """Return the name of `value` in `codes`, or the number itself."""
    try:
        return codes(value).name
    except ValueError:
        return str(value)
