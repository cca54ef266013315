"""Arm models as data (URDF of primitives and a few lines of TOML), and their loader."""

from cardan.robots.arm_model import (
    TIME_TO_FULL_SPEED_S,
    ArmModel,
    BodyShape,
    Box,
    Capsule,
    JointKind,
    Shape,
    SixWeights,
    arm_names,
    load_arm,
    parse_urdf,
)

__all__ = [
    "TIME_TO_FULL_SPEED_S",
    "ArmModel",
    "BodyShape",
    "Box",
    "Capsule",
    "JointKind",
    "Shape",
    "SixWeights",
    "arm_names",
    "load_arm",
    "parse_urdf",
]
