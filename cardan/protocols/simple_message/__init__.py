"""ROS-Industrial simple message as MotoROS uses it, and the velocity mode added to it.

Sources: ROS-Industrial simple_message and motoman_driver (MotoROS 1.9.12). The velocity mode
(2040 to 2042, START_VEL_MODE, STOP_VEL_MODE) is docs/protocols/simple-message.md.
"""

from cardan.protocols.simple_message.codec import (
    wire as wire,
)
from cardan.protocols.simple_message.codes import (
    IO_PORT as IO_PORT,
    MOTION_PORT as MOTION_PORT,
    STATE_PORT as STATE_PORT,
    ActiveMode as ActiveMode,
    CommType as CommType,
    ControllerMode as ControllerMode,
    InvalidSubcode as InvalidSubcode,
    IoResult as IoResult,
    MessageType as MessageType,
    MotionCommand as MotionCommand,
    MotionResult as MotionResult,
    NotReadySubcode as NotReadySubcode,
    ReplyCode as ReplyCode,
    ValidFields as ValidFields,
)
from cardan.protocols.simple_message.framing import (
    ByteOrder as ByteOrder,
    FrameReader as FrameReader,
    detect_byte_order as detect_byte_order,
)
from cardan.protocols.simple_message.messages import (
    ZEROS as ZEROS,
    Body as Body,
    Empty as Empty,
    JointFeedback as JointFeedback,
    Joints as Joints,
    JointTrajPtFull as JointTrajPtFull,
    JointTrajPtFullEx as JointTrajPtFullEx,
    JointVelocity as JointVelocity,
    JointVelocityEx as JointVelocityEx,
    MalformedMessage as MalformedMessage,
    Message as Message,
    MotionCtrl as MotionCtrl,
    MotionReply as MotionReply,
    Raw as Raw,
    ReadIo as ReadIo,
    ReadIoReply as ReadIoReply,
    RobotStatus as RobotStatus,
    VelocityInfo as VelocityInfo,
    VelocityInfoRequest as VelocityInfoRequest,
    joints10 as joints10,
    request as request,
    topic as topic,
)
