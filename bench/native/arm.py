"""An arm as the peers in C and C++ take it: peer.h."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_int32

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_se3
from cardan.robots import JointKind

MOST = 8

_JOINTS = c_double * MOST


class PeerArm(ctypes.Structure):
    """As peer.h has it."""

    _fields_ = (
        ("joints", c_int32),
        ("prismatic", c_int32 * MOST),
        ("rotation", (c_double * 9) * MOST),
        ("position", (c_double * 3) * MOST),
        ("axis", (c_double * 3) * MOST),
        ("tcp_rotation", c_double * 9),
        ("tcp_position", c_double * 3),
        ("lower", _JOINTS),
        ("upper", _JOINTS),
        ("velocity", _JOINTS),
        ("acceleration", _JOINTS),
        ("home", _JOINTS),
    )


def peer_arm(arm: ArmKinematics) -> PeerArm:
    """The arm, with the limits that its kinematics has. ValueError: it has too many joints."""
    if arm.joints > MOST:
        raise ValueError(f"{arm.joints} joints are more than {MOST}")
    made = PeerArm(joints=arm.joints)
    for i, joint in enumerate(arm.arm.joints):
        placement = to_se3(joint.placement)
        made.prismatic[i] = joint.kind is JointKind.PRISMATIC
        made.rotation[i][:] = placement.rotation.ravel().tolist()
        made.position[i][:] = placement.translation.tolist()
        made.axis[i][:] = joint.axis
    tcp = to_se3(arm.arm.tcp)
    made.tcp_rotation[:] = tcp.rotation.ravel().tolist()
    made.tcp_position[:] = tcp.translation.tolist()
    for name in ("lower", "upper", "velocity", "acceleration"):
        getattr(made, name)[: arm.joints] = getattr(arm, name)
    made.home[: arm.joints] = arm.arm.home
    return made
