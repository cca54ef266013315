"""ABB Externally Guided Motion (EGM): datagrams to values in SI units and back.

Source: ABB Application manual, Externally Guided Motion, RobotWare 7.16 (3HAC073318-001), and the
published ``egm.proto`` of RobotWare 6.08 to 7.16.
"""

from cardan.protocols.egm.decode import (
    decode_from_pc as decode_from_pc,
    decode_robot as decode_robot,
)
from cardan.protocols.egm.encode import (
    encode_sensor as encode_sensor,
)
from cardan.protocols.egm.messages import (
    EgmHeader as EgmHeader,
    EgmMessageType as EgmMessageType,
    EgmMotion as EgmMotion,
    EgmRobot as EgmRobot,
    EgmSensor as EgmSensor,
    EgmSensorPathCorr as EgmSensorPathCorr,
    MalformedEgmMessage as MalformedEgmMessage,
    MCIState as MCIState,
    MotorState as MotorState,
    RapidState as RapidState,
)
