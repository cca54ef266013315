"""Arm models as data (a URDF and a few lines of TOML), and their loader."""

from cardan.robots.arm_file import SolidTable as SolidTable
from cardan.robots.arm_loader import (
    arm_names as arm_names,
    load_arm as load_arm,
    parse_urdf as parse_urdf,
    require_same_arm as require_same_arm,
)
from cardan.robots.arm_model import (
    TIME_TO_FULL_SPEED_S as TIME_TO_FULL_SPEED_S,
    ArmJoint as ArmJoint,
    ArmModel as ArmModel,
    BodyShape as BodyShape,
    Capsule as Capsule,
    JointKind as JointKind,
    OrientedBox as OrientedBox,
    Shape as Shape,
    SixWeights as SixWeights,
)
from cardan.robots.urdf import limits_in as limits_in
