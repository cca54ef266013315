"""The structures of the compiled servo, as declared in kernel/kernel.h."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_int32

from cardan.common.native import layout_of

MAX_JOINTS, MAX_PARTS, MAX_ROWS = 9, 3, 16
UNKNOWNS, CONSTRAINTS = MAX_JOINTS + MAX_PARTS, MAX_JOINTS + MAX_PARTS + MAX_ROWS

_JOINTS = c_double * MAX_JOINTS
_THREE, _FOUR, _SIX, _NINE = c_double * 3, c_double * 4, c_double * 6, c_double * 9

MAX_SHAPES, MAX_PAIRS = 256, 4096
"""Largest numbers of shapes and pairs."""

CAPSULE, BOX, HALF_SPACE = range(3)

SLIDE, WITH_RATE = 1, 2
"""Flags of a tick."""

BAD_JOINTS = 2
"""Reason for joints that it cannot take."""

GOOD, BAD_INPUT, BAD_PERIOD, NO_SOLUTION = range(4)
"""Problems of a tick."""

REASONS = (
    "",
    "there is no memory for it",
    "it takes 1 to 9 joints with orthogonal placements and unit axes",
    "its limits are not in order, or not numbers",
    "its task has weights that are not 0 or more, or none above 0",
    "an option of the servo is not a number from 0 to 1e9",
    "a shape is not a capsule, box or half-space with numbers for sizes, or there are too many",
    "a pair of shapes is not two of different bodies, or there are too many",
)
"""Reasons for not making a kernel, by its return code."""


class CArm(ctypes.Structure):
    _fields_ = (
        ("joints", c_int32),
        ("prismatic", c_int32 * MAX_JOINTS),
        ("rotation", _NINE * MAX_JOINTS),
        ("position", _THREE * MAX_JOINTS),
        ("axis", _THREE * MAX_JOINTS),
        ("lower", _JOINTS),
        ("upper", _JOINTS),
        ("velocity", _JOINTS),
        ("acceleration", _JOINTS),
        ("weights", _SIX),
    )


OPTIONS = (
    "length_m",
    "gain_1_s",
    "linear_speed_m_s",
    "angular_speed_rad_s",
    "linear_deceleration_m_s2",
    "angular_deceleration_rad_s2",
    "joint_gain_1_s",
    "damping",
    "singular_below",
    "damping_floor",
    "path_stiffness",
    "posture_gain_1_s",
    "posture_weight",
)
"""Options of the servo that the kernel takes unchanged."""


class COptions(ctypes.Structure):
    _fields_ = tuple((name, c_double) for name in OPTIONS)


class CShape(ctypes.Structure):
    _fields_ = (
        ("kind", c_int32),
        ("body", c_int32),
        ("start", _THREE),
        ("end", _THREE),
        ("radius_m", c_double),
        ("rotation", _NINE),
        ("position", _THREE),
        ("half_m", _THREE),
        ("normal", _THREE),
        ("offset_m", c_double),
    )


class CPair(ctypes.Structure):
    _fields_ = (
        ("first", c_int32),
        ("second", c_int32),
        ("safety_m", c_double),
        ("deceleration_m_s2", c_double),
        ("sweep", _JOINTS),
    )


class CState(ctypes.Structure):
    _fields_ = (
        ("q", _JOINTS),
        ("v", _JOINTS),
        ("goal_position", _THREE),
        ("goal_orientation", _FOUR),
        ("goal_twist", _SIX),
        ("joint_rate", _JOINTS),
        ("goal_joints", _JOINTS),
        ("goal_rate", _JOINTS),
        ("posture", _JOINTS),
        ("twist", _SIX),
        ("motion", _SIX),
        ("reachable_position", _THREE),
        ("reachable_orientation", _FOUR),
        ("pose_joints", _JOINTS),
        ("pose_position", _THREE),
        ("pose_orientation", _FOUR),
        ("joint_error", c_double),
        ("path_speed", c_double),
        ("smallest_singular_value", c_double),
        ("damping", c_double),
        ("distance_m", c_double),
        ("error_m", c_double),
        ("error_rad", c_double),
        ("unreachable_m_s", c_double),
        ("unreachable_rad_s", c_double),
        ("has_posture", c_int32),
        ("reach", c_int32),
        ("problem", c_int32),
        ("active", c_int32),
        ("nearest", c_int32),
        ("limiting", c_int32),
        ("iterations", c_int32),
        ("most_iterations", c_int32),
        ("failures", c_int32),
        ("moving", c_int32),
    )


class CProgram(ctypes.Structure):
    """The program's data and solution; the solver's own workspace follows."""

    _fields_ = (
        ("unknowns", c_int32),
        ("rows", c_int32),
        ("hessian", (c_double * UNKNOWNS) * UNKNOWNS),
        ("linear", c_double * UNKNOWNS),
        ("lowest", c_double * UNKNOWNS),
        ("highest", c_double * UNKNOWNS),
        ("row", (c_double * UNKNOWNS) * MAX_ROWS),
        ("least", c_double * MAX_ROWS),
        ("row_name", c_int32 * MAX_ROWS),
        ("x", c_double * UNKNOWNS),
        ("multiplier", c_double * CONSTRAINTS),
        ("iterations", c_int32),
        ("warm_count", c_int32),
        ("warm_name", c_int32 * CONSTRAINTS),
        ("warm_multiplier", c_double * CONSTRAINTS),
        ("factor", (c_double * UNKNOWNS) * UNKNOWNS),
        ("inverse", (c_double * UNKNOWNS) * UNKNOWNS),
        ("shift", c_double * UNKNOWNS),
        ("y", c_double * UNKNOWNS),
        ("normal", (c_double * UNKNOWNS) * CONSTRAINTS),
        ("size", c_double * CONSTRAINTS),
        ("low", c_double * CONSTRAINTS),
        ("high", c_double * CONSTRAINTS),
        ("count", c_int32),
        ("member", c_int32 * CONSTRAINTS),
        ("is_high", c_int32 * CONSTRAINTS),
        ("position", c_int32 * CONSTRAINTS),
        ("lambda", c_double * CONSTRAINTS),
        ("target", c_double * CONSTRAINTS),
        ("gram", (c_double * CONSTRAINTS) * CONSTRAINTS),
        ("lower", (c_double * CONSTRAINTS) * CONSTRAINTS),
        ("diagonal", c_double * CONSTRAINTS),
    )


def expected_layout() -> list[int]:
    """Return sizes and field offsets that `kernel_layout` of the compiled library must match."""
    return layout_of(CArm, COptions, CShape, CPair, CState, CProgram)
