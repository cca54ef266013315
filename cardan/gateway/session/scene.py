"""Scene of an arm for display: obstacles, workspace, and the shapes of its own bodies.

A JSON object, published once and again when it changes. Lengths in m, angles in rad, base axes,
orientations as x y z w.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.session.arm_assembly import (
    has_rigid_arm,
    make_neighbor_bodies,
    make_obstacle,
    own_model,
    own_topic,
)
from cardan.gateway.session.config import SessionConfig
from cardan.robots import ArmModel, BodyShape, Capsule, JointKind, OrientedBox, Shape
from cardan.types import Pose

if TYPE_CHECKING:
    from cardan.gateway.kinematics.collision import HalfSpace


def scene_of(config: SessionConfig) -> str:
    """Return the scene of a session's arm, as JSON.

    ``workspace_m``: for x, y and z the range that the TCP keeps to, or null. ``reach_m``: the
    ranges within the joints' limits, null without an arm's model. ``obstacles``: each with its
    ``name`` and a ``box``, a ``capsule`` or a ``plane``. ``shapes``: those of the arm, likewise, in
    the frame that is fixed to the link after ``joint``; "" is the base. ``obstacle_m`` and
    ``own_body_m``: the least distances to obstacles and between the arm's own bodies; null if
    collisions are not avoided. ``links_without_body``: their number and names, as text; "" if all
    have one. ``neighbors``: each with its ``name``, the ``topic`` of its joint states,
    ``max_age_s`` of these, its ``base`` in this one, its ``shapes``, as those of the arm, and its
    ``joints`` from the base on: each by ``name``, its pose at zero in the previous body, and its
    ``axis``, along which it ``slides`` or about which it turns. ``visuals``: the console's key of
    each visual mesh, by its name in the arm's description; ``visuals_left_out``: meshes that the
    console lacks, as text. ``home``: joints to begin from, null if none are known.
    """
    table = config.arm if has_rigid_arm(config) else None
    avoids = table is not None and table.collisions
    neighbors = make_neighbor_bodies(config)
    shapes: list[dict[str, Any]] = []
    home = reach_m = None
    bare = left_out = ""
    visuals: dict[str, str] = {}
    if table is not None:
        # Sessions without an arm's model run without its libraries.
        from cardan.gateway.kinematics.arm import ArmKinematics
        from cardan.gateway.kinematics.reach import tcp_range_m
        from cardan.robots.visuals import keep_visuals

        model = own_model(config)
        shapes = _shapes(model, model.shapes)
        home, bare = list(model.home), model.links_without_body()
        stored = keep_visuals(table.model)
        visuals, left_out = stored.keys, stored.in_words()
        reach_m = tcp_range_m(ArmKinematics(model, table.tool()))
    return json.dumps(
        {
            "workspace_m": [each and list(each) for each in config.limits.workspace_m],
            "reach_m": reach_m,
            "obstacles": [
                {"name": each.name, **_shape(make_obstacle(each).shape)}
                for each in config.obstacles
            ],
            "shapes": shapes,
            "neighbors": [
                {
                    "name": each.name,
                    "topic": own_topic(config, named.topic),
                    "max_age_s": named.max_age_s,
                    "base": _pose(each.base),
                    "joints": [
                        {
                            "name": joint.name,
                            **_pose(joint.placement),
                            "axis": list(joint.axis),
                            "slides": joint.kind is JointKind.PRISMATIC,
                        }
                        for joint in each.model.joints
                    ],
                    "shapes": _shapes(each.model, each.shapes),
                }
                for named, each in zip(config.neighbors, neighbors, strict=True)
            ],
            "links_without_body": bare,
            "visuals": visuals,
            "visuals_left_out": left_out,
            "obstacle_m": table.safety_distance_m if table is not None and avoids else None,
            "own_body_m": ServoOptions.self_distance_m if avoids else None,
            "home": home,
        }
    )


def _shapes(model: ArmModel, shapes: Sequence[BodyShape]) -> list[dict[str, Any]]:
    joints = ("", *model.joint_names)
    return [
        {"name": each.name, "joint": joints[each.body], **_shape(each.shape)} for each in shapes
    ]


def _shape(shape: Shape | HalfSpace) -> dict[str, Any]:
    if isinstance(shape, Capsule):
        return {
            "capsule": {
                "start": list(shape.start),
                "end": list(shape.end),
                "radius_m": shape.radius_m,
            }
        }
    if isinstance(shape, OrientedBox):
        return {"box": {**_pose(shape.pose), "size_m": list(shape.size_m)}}
    return {"plane": {"normal": list(shape.normal), "offset_m": shape.offset_m}}


def _pose(pose: Pose) -> dict[str, Any]:
    w, x, y, z = pose.orientation
    return {"position": list(pose.position), "orientation": [x, y, z, w]}
