"""ABB Externally Guided Motion (EGM): datagrams to values in SI units and back.

Source: ABB Application manual, Externally Guided Motion, RobotWare 7.16 (3HAC073318-001), and the
published ``egm.proto`` of RobotWare 6.08 to 7.16.
"""

from cardan.protocols.egm.decode import (
    decode_feedback as decode_feedback,
    decode_from_pc as decode_from_pc,
    decode_robot as decode_robot,
)
from cardan.protocols.egm.encode import (
    encode_path_corr as encode_path_corr,
    encode_rapid_to_robot as encode_rapid_to_robot,
    encode_robot as encode_robot,
    encode_sensor as encode_sensor,
)
from cardan.protocols.egm.messages import (
    DNUM_MAX as DNUM_MAX,
    MAX_DATAGRAM_BYTES as MAX_DATAGRAM_BYTES,
    EgmCollisionInfo as EgmCollisionInfo,
    EgmFeedback as EgmFeedback,
    EgmHeader as EgmHeader,
    EgmMeasuredForce as EgmMeasuredForce,
    EgmMessageType as EgmMessageType,
    EgmMotion as EgmMotion,
    EgmPose as EgmPose,
    EgmRapidData as EgmRapidData,
    EgmRobot as EgmRobot,
    EgmSensor as EgmSensor,
    EgmSensorPathCorr as EgmSensorPathCorr,
    EgmSpeedRef as EgmSpeedRef,
    Fault as Fault,
    MalformedEgmMessage as MalformedEgmMessage,
    MCIState as MCIState,
    MotorState as MotorState,
    RapidState as RapidState,
)
from cardan.protocols.egm.outline import (
    Outline as Outline,
    outline as outline,
)
from cardan.protocols.egm.reader import (
    FeedbackReader as FeedbackReader,
)
from cardan.protocols.egm.replies import (
    encode_joint_reply as encode_joint_reply,
    encode_pose_reply as encode_pose_reply,
)
