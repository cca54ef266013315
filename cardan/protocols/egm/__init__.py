"""ABB Externally Guided Motion (EGM): datagrams to values in SI units and back.

Source: ABB Application manual, Externally Guided Motion, RobotWare 7.16 (3HAC073318-001), and the
published ``egm.proto`` of RobotWare 6.08 to 7.16.
"""

from cardan.protocols.egm.decode import decode_feedback, decode_from_pc, decode_robot
from cardan.protocols.egm.encode import (
    encode_path_corr,
    encode_rapid_to_robot,
    encode_robot,
    encode_sensor,
)
from cardan.protocols.egm.messages import (
    DNUM_MAX,
    MAX_DATAGRAM_BYTES,
    EgmCollisionInfo,
    EgmFeedback,
    EgmHeader,
    EgmMeasuredForce,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
    Fault,
    Malformed,
    MCIState,
    MessageType,
    MotorState,
    RapidState,
)
from cardan.protocols.egm.reader import FeedbackReader
from cardan.protocols.egm.replies import encode_joint_reply, encode_pose_reply

__all__ = [
    "DNUM_MAX",
    "MAX_DATAGRAM_BYTES",
    "EgmCollisionInfo",
    "EgmFeedback",
    "EgmHeader",
    "EgmMeasuredForce",
    "EgmMotion",
    "EgmPose",
    "EgmRapidData",
    "EgmRobot",
    "EgmSensor",
    "EgmSensorPathCorr",
    "EgmSpeedRef",
    "Fault",
    "FeedbackReader",
    "MCIState",
    "Malformed",
    "MessageType",
    "MotorState",
    "RapidState",
    "decode_feedback",
    "decode_from_pc",
    "decode_robot",
    "encode_joint_reply",
    "encode_path_corr",
    "encode_pose_reply",
    "encode_rapid_to_robot",
    "encode_robot",
    "encode_sensor",
]
