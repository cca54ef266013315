"""URScript's functions of poses that are independent of the arm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from cardan.sim_peers.ur_controller import checks
from cardan.sim_peers.ur_controller.kinematics import frame_of, pose_of
from cardan.sim_peers.ur_controller.language import POSE_STEPS, Function, costing
from cardan.sim_peers.ur_controller.math_functions import inverse_matrix
from cardan.sim_peers.ur_controller.values import UrPose
from cardan.spatial import (
    add,
    compose,
    conjugate,
    cross,
    from_euler_zyx,
    from_rotation_vector,
    inverse,
    multiply,
    norm,
    rotate,
    rotation_between,
    scale,
    subtract,
    to_euler_zyx,
    to_rotation_vector,
)
from cardan.types import Pose as Frame, Vector3


def pose_functions() -> Mapping[str, Function]:
    """Return the functions by name."""
    two = ("p_1", "p_2")
    functions = {
        "pose_trans": Function(("p_from", "p_from_to"), {}, _trans),
        "pose_inv": Function(("p_from",), {}, _inv),
        "inv": Function(("m",), {}, _inv_of_any),
        "pose_add": Function(two, {}, _add),
        "pose_sub": Function(("p_to", "p_from"), {}, _sub),
        "pose_dist": Function(("p_from", "p_to"), {}, _dist),
        "point_dist": Function(("p_from", "p_to"), {}, _point_dist),
        "interpolate_pose": Function(("p_from", "p_to", "alpha"), {}, _interpolated),
        "wrench_trans": Function(("T_from_to", "w_from"), {}, _wrench_trans),
        "rotvec2rpy": Function(("rotation_vector",), {}, _to_rpy),
        "rpy2rotvec": Function(("rpy_vector",), {}, _from_rpy),
    }
    return costing(POSE_STEPS, functions)


def _trans(outer: Any, inner: Any) -> UrPose:
    return pose_of(compose(checks.frame("p_from", outer), checks.frame("p_from_to", inner)))


def _inv(pose: Any) -> UrPose:
    return pose_of(inverse(checks.frame("p_from", pose)))


def _inv_of_any(value: Any) -> UrPose | list[list[float]]:
    return _inv(value) if isinstance(value, UrPose) else inverse_matrix(value)


def _add(first: Any, second: Any) -> UrPose:
    a, b = checks.frame("p_1", first), checks.frame("p_2", second)
    turned = multiply(a.orientation, b.orientation)
    return pose_of(Frame(add(a.position, b.position), turned))


def _sub(to: Any, start: Any) -> UrPose:
    a, b = checks.frame("p_to", to), checks.frame("p_from", start)
    turned = multiply(a.orientation, conjugate(b.orientation))
    return pose_of(Frame(subtract(a.position, b.position), turned))


def _point_dist(start: Any, to: Any) -> float:
    a, b = checks.frame("p_from", start), checks.frame("p_to", to)
    return norm(subtract(b.position, a.position))


def _dist(start: Any, to: Any) -> float:
    a, b = checks.frame("p_from", start), checks.frame("p_to", to)
    turn = rotation_between(a.orientation, b.orientation)
    return math.hypot(*subtract(b.position, a.position), *turn)


def _interpolated(start: Any, to: Any, alpha: Any) -> UrPose:
    a, b = checks.frame("p_from", start), checks.frame("p_to", to)
    share = checks.moderate("alpha", alpha)
    turn = from_rotation_vector(scale(rotation_between(a.orientation, b.orientation), share))
    way = scale(subtract(b.position, a.position), share)
    return pose_of(Frame(add(a.position, way), multiply(turn, a.orientation)))


def _wrench_trans(frame: Any, wrench: Any) -> list[float]:
    """Return the same wrench about another point, in its frame."""
    place = frame_of(checks.pose("T_from_to", frame))
    values = checks.vector("w_from", wrench)
    force, torque = Vector3(*values[:3]), Vector3(*values[3:])
    back = conjugate(place.orientation)
    about = subtract(torque, cross(place.position, force))
    return [*rotate(back, force), *rotate(back, about)]


def _to_rpy(turn: Any) -> list[float]:
    vector = Vector3(*checks.vector("rotation_vector", turn, 3))
    return list(to_euler_zyx(from_rotation_vector(vector)))


def _from_rpy(angles: Any) -> list[float]:
    return list(to_rotation_vector(from_euler_zyx(*checks.vector("rpy_vector", angles, 3))))
