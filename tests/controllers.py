"""Controllers for tests in virtual time, configured like those of sessions."""

from cardan.gateway.arm.commanded_arm import TaskSpaceArm
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.input import OperatorInput
from cardan.gateway.operator.mapping import MappingOptions, TwistMapping
from cardan.types import RobotCapabilities

PERIOD_S = 0.004


def controller_for_device(
    mapping=None,
    limits=None,
    watchdogs=None,
    filters=(),
    arm=None,
    period_s=PERIOD_S,
    authority=None,
    gripper=None,
):
    """Return the controller of a robot that one operator device moves, with `arm` as its model."""
    limits, watchdogs = limits or ReferenceLimits(), watchdogs or Watchdogs()
    operator = OperatorInput(
        TwistMapping(mapping or MappingOptions(), gripper),
        limits,
        filters,
        watchdogs.device_age_s,
    )
    output_limits = None
    if arm is not None:
        joints = arm.servo.joints
        capabilities = RobotCapabilities(frozenset(), period_s, joints, None, 0, 0)
        output_limits = arm.output_limits(capabilities)
    return ArmController(
        arm or TaskSpaceArm(limits),
        limits,
        watchdogs,
        operator,
        authority,
        period_s=period_s,
        output_limits=output_limits,
    )
