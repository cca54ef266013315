"""An arm as the peers in C and C++ receive it: peer.h."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_int32
from typing import Any

import coal

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_se3
from cardan.gateway.kinematics.collision import CollisionModel, HalfSpace, Solid
from cardan.gateway.servo.bounds import JointBounds
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import closing_decelerations, safety_distances
from cardan.robots import JointKind
from cardan.robots.arm_bodies import coal_shape

MOST = 8

_JOINTS = c_double * MOST


class PeerArm(ctypes.Structure):
    """Arm struct of peer.h."""

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
        ("weights", c_double * 6),
    )


class PeerShape(ctypes.Structure):
    """Shape struct of peer.h."""

    _fields_ = (
        ("kind", c_int32),
        ("body", c_int32),
        ("rotation", c_double * 9),
        ("position", c_double * 3),
        ("size", c_double * 3),
    )


class PeerPair(ctypes.Structure):
    """Pair struct of peer.h."""

    _fields_ = (
        ("first", c_int32),
        ("second", c_int32),
        ("safety_m", c_double),
        ("deceleration_m_s2", c_double),
        ("sweep", _JOINTS),
    )


CAPSULE, SPHERE, BOX = range(3)


def peer_arm(arm: ArmKinematics) -> PeerArm:
    """Return the arm with the limits of its kinematics. Raises ValueError if it has too many
    joints."""
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
    made.weights[:] = arm.arm.task.weights
    return made


def peer_shape(solid: Solid) -> PeerShape:
    """Return the geometry that the Python servo gives to Coal. Raises ValueError for a
    half-space."""
    if isinstance(solid.shape, HalfSpace):
        raise ValueError(f"{solid.name}: the peers know no half-space")
    shape, placement = coal_shape(solid.shape)
    made = PeerShape(body=solid.body)
    made.rotation[:] = placement.rotation.ravel().tolist()
    made.position[:] = placement.translation.tolist()
    if isinstance(shape, coal.Capsule):
        made.kind, made.size[:2] = CAPSULE, (shape.radius, 2.0 * shape.halfLength)
    elif isinstance(shape, coal.Sphere):
        made.kind, made.size[0] = SPHERE, shape.radius
    else:
        made.kind, made.size[:] = BOX, (2.0 * shape.halfSide).tolist()
    return made


def peer_pairs(arm: ArmKinematics, collision: CollisionModel, options: ServoOptions) -> Any:
    """Return the pairs that the servo with these options keeps apart, as an array."""
    made = (PeerPair * len(collision.pairs))()
    bounds = JointBounds(arm, options.speed_share, options.acceleration_share)
    for pair, (first, second), clearance_m, deceleration, sweep in zip(
        made,
        collision.pair_solids,
        safety_distances(options, collision),
        closing_decelerations(options, bounds, collision).tolist(),
        collision.sweeps.tolist(),
        strict=True,
    ):
        pair.first, pair.second = first, second
        pair.safety_m, pair.deceleration_m_s2 = clearance_m, deceleration
        pair.sweep[: len(sweep)] = sweep
    return made
