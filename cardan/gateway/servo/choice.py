"""Choice of the servo that moves an arm: the compiled one if possible."""

from __future__ import annotations

from cardan.common.native import NativePartError
from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import Kinematics
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import Servo
from cardan.robots import SixWeights

AnyServo = Servo | CompiledServo


def choose_servo(
    kinematics: Kinematics,
    collision: CollisionModel | None = None,
    options: ServoOptions | None = None,
    weights: SixWeights = (1.0,) * 6,
) -> AnyServo:
    """Return the compiled servo if it takes the arm and was compiled, else the one in Python, which
    moves the arm alike, takes longer, and gives the reason in `not_compiled`."""
    if isinstance(kinematics, ArmKinematics):
        try:
            return CompiledServo(kinematics, collision, options, weights)
        except (NativePartError, ConfigurationError) as error:
            reason = str(error)
    else:
        reason = "the compiled servo takes chains of rigid links only"
    servo = Servo(kinematics, collision, options, weights)
    servo.not_compiled = reason
    return servo
