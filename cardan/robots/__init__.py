"""Arm models as data (URDF of primitives and a few lines of TOML), and their loader."""

from cardan.robots.arm_model import (
    TIME_TO_FULL_SPEED_S as TIME_TO_FULL_SPEED_S,
    ArmModel as ArmModel,
    BodyShape as BodyShape,
    Box as Box,
    Capsule as Capsule,
    JointKind as JointKind,
    Shape as Shape,
    SixWeights as SixWeights,
    SolidTable as SolidTable,
    arm_names as arm_names,
    limits_in as limits_in,
    load_arm as load_arm,
    parse_urdf as parse_urdf,
)
