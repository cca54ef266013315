"""Conversion of an arm's model to Pinocchio and Coal."""

from __future__ import annotations

from typing import Any, cast

from cardan.common.arm_libraries import coal, np, npt, pin
from cardan.robots.arm_model import ArmModel, Capsule, JointKind, Shape, SixWeights
from cardan.spatial import norm, scale, subtract
from cardan.types import Pose

FloatArray = npt.NDArray[np.float64]
SE3 = Any
"""pinocchio.SE3; Pinocchio has no type stubs."""

CHARACTERISTIC_LENGTH_M = 0.3
"""Weight of rad against m: 1 rad of tool orientation counts as 0.3 m, about the forearm of typical
arms; half or twice of it changes convergence little."""

WEIGHTS = np.array((1.0, 1.0, 1.0, *(CHARACTERISTIC_LENGTH_M,) * 3))
"""Weights of a motion of the TCP, linear part first: all in m."""


def to_se3(pose: Pose) -> SE3:
    """Convert a pose to Pinocchio's."""
    x, y, z = pose.position
    w, i, j, k = pose.orientation
    return pin.XYZQUATToSE3(np.array((x, y, z, i, j, k, w)))


def pinocchio_model(arm: ArmModel) -> Any:
    """Make Pinocchio's model of its joints and masses, with the TCP as the frame "tcp"."""
    model = pin.Model()
    model.name = arm.name
    parent = 0
    for joint, inertia in zip(arm.joints, arm.inertias, strict=True):
        axis = np.array(joint.axis)
        kind = (
            pin.JointModelPrismaticUnaligned(axis)
            if joint.kind is JointKind.PRISMATIC
            else _revolute(axis)
        )
        parent = model.addJoint(parent, kind, to_se3(joint.placement), joint.name)
        xx, xy, xz, yy, yz, zz = inertia.moments
        model.appendBodyToJoint(
            parent,
            pin.Inertia(
                inertia.mass_kg,
                np.array(inertia.center_m),
                np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))),
            ),
            pin.SE3.Identity(),
        )
    model.addFrame(pin.Frame("tcp", parent, to_se3(arm.tcp), pin.FrameType.OP_FRAME))
    return model


def _revolute(axis: FloatArray) -> Any:
    """Name the revolute joint type: joints about x, y and z cost less than those about other
    axes."""
    for index, aligned in enumerate((pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)):
        if axis[index] > 1.0 - 1e-12:
            return aligned()
    return pin.JointModelRevoluteUnaligned(axis)


def coal_shape(shape: Shape) -> tuple[Any, SE3]:
    """Return coal's geometry, and its placement in the frame of `shape`."""
    if isinstance(shape, Capsule):
        along = subtract(shape.end, shape.start)
        length = norm(along)
        middle = np.array(shape.start) + 0.5 * np.array(along)
        if length < 1e-9:
            return coal.Sphere(shape.radius_m), pin.SE3(np.eye(3), middle)
        z = np.array(scale(along, 1.0 / length))
        turn = pin.Quaternion.FromTwoVectors(np.array((0.0, 0.0, 1.0)), z).matrix()
        return coal.Capsule(shape.radius_m, length), pin.SE3(turn, middle)
    return coal.Box(np.array(shape.size_m)), to_se3(shape.pose)


def smallest_singular_value(jacobian: FloatArray, weights: SixWeights) -> float:
    """Smallest singular value of `jacobian` (6×n, TCP axes, linear part first; 1 rad counts as 0.3
    m) in the directions along TCP axes whose weight is above 0; 0 if the arm is singular."""
    return float(smallest_singular_values(jacobian[None], weights)[0])


def smallest_singular_values(jacobians: FloatArray, weights: SixWeights) -> FloatArray:
    """The same for several Jacobians: (m×6×n) to (m,). For one joint (m×6) is accepted, as from
    Pinocchio."""
    followed = np.array(weights) > 0.0
    weighted = (WEIGHTS[:, None] * jacobians.reshape(len(jacobians), 6, -1))[:, followed]
    return cast("FloatArray", np.linalg.svd(weighted, compute_uv=False)[:, -1])
