"""The action FollowJointTrajectory, by which MoveIt executes its plans. Source:
control_msgs/action/FollowJointTrajectory; error codes as in joint_trajectory_controller of
ros2_controllers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, TypeVar

from cardan.errors import CardanError, MotionRefusedError
from cardan.gateway.bus.commands import ActionCommand, Instant
from cardan.gateway.motion.joint_trajectory import (
    GOAL_TOLERANCE,
    MAX_POINTS,
    PATH_TOLERANCE,
    JointTrajectory,
)
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.interfaces import SINCE_KILTED
from cardan.protocols.ros2.messages import default_message

FOLLOW = "control_msgs/action/FollowJointTrajectory"

SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, OLD_HEADER_TIMESTAMP = 0, -1, -2, -3
PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = -4, -5

BEGINS_S = 1.0
"""Largest distance of a trajectory's requested begin from now, s; 0 in it is now. The arm begins at
once: it covers clock differences and transmission."""


_DefaultT = TypeVar("_DefaultT", float, None)


class TrajectoryError(MotionRefusedError):
    """Error: a goal is no trajectory of this arm."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(f"trajectory: {message}")
        self.code = code


def follow_joint_trajectory(
    controller: str, joints: Sequence[str], since_kilted: bool = False
) -> ActionCommand:
    """Return the action of a controller of this name, for an arm with these joints; `since_kilted`:
    with the feedback of control_msgs 6.3 and later."""
    names = tuple(joints)
    type_name = FOLLOW + SINCE_KILTED * since_kilted

    def feedback(now: Instant) -> Message:
        return _feedback(f"{type_name}_Feedback", names, now)

    return ActionCommand(
        f"{controller}/follow_joint_trajectory",
        type_name,
        "trajectory",
        lambda goal: trajectory_of(goal, names, time.time_ns()),
        result_of,
        feedback,
    )


def trajectory_of(goal: Message, joints: Sequence[str], now_ns: int) -> JointTrajectory:
    """Return the trajectory of a goal, in the arm's order of joints. Raises TrajectoryError or
    MotionRefusedError; `now_ns`: since the epoch."""
    given = goal["trajectory"]
    names, points = given["joint_names"], given["points"]
    if sorted(names) != sorted(joints):
        raise TrajectoryError(
            INVALID_JOINTS, f"it is for {', '.join(names)[:200]}; the arm has {', '.join(joints)}"
        )
    if goal["multi_dof_trajectory"]["points"] or goal["multi_dof_trajectory"]["joint_names"]:
        raise TrajectoryError(
            INVALID_GOAL, "joints with several degrees of freedom are not supported"
        )
    if not 1 <= len(points) <= MAX_POINTS:
        raise TrajectoryError(INVALID_GOAL, f"it has {len(points)} points, not 1 to {MAX_POINTS}")
    order = [names.index(name) for name in joints]
    times = [_seconds(point["time_from_start"]) for point in points]
    _check_begin(given["header"]["stamp"], times[-1], now_ns)
    if any(point["effort"] for point in points):
        raise TrajectoryError(INVALID_GOAL, "it has efforts; positions are followed")
    positions = _rows(points, "positions", order)
    if positions is None:
        raise TrajectoryError(INVALID_GOAL, "it has no positions")
    return JointTrajectory(
        times,
        positions,
        _rows(points, "velocities", order),
        _rows(points, "accelerations", order),
        _tolerances(goal, "path_tolerance", joints, 0.0),
        _tolerances(goal, "goal_tolerance", joints, None),
        max(0.0, _seconds(goal["goal_time_tolerance"])),
    )


def _check_begin(stamp: Message, duration_s: float, now_ns: int) -> None:
    begin_ns = stamp["sec"] * 10**9 + stamp["nanosec"]
    if not begin_ns:
        return
    late_s = (now_ns - begin_ns) * 1e-9
    if late_s > BEGINS_S:
        raise TrajectoryError(
            OLD_HEADER_TIMESTAMP, f"it was to begin {late_s:.1f} s ago, and takes {duration_s:g} s"
        )
    if late_s < -BEGINS_S:
        raise TrajectoryError(
            INVALID_GOAL, f"it is to begin in {-late_s:.1f} s; send it then, or with a stamp of 0"
        )


def _rows(points: Sequence[Message], name: str, order: Sequence[int]) -> list[list[float]] | None:
    """Return the values `name` of all points, in the arm's order; None if no point has them."""
    counts = {len(point[name]) for point in points}
    if counts == {0}:
        return None
    if counts != {len(order)}:
        raise TrajectoryError(INVALID_GOAL, f"not all points have {len(order)} {name}")
    return [[point[name][index] for index in order] for point in points]


def _tolerances(
    goal: Message, name: str, joints: Sequence[str], default: _DefaultT
) -> list[float | _DefaultT] | None:
    """Return tolerances by joint; 0: any distance, which a message expresses by a number below 0. 0
    in a message is the `default`, as is the value of a joint that is not named."""
    if goal[f"component_{name}"]:
        raise TrajectoryError(INVALID_GOAL, f"component_{name}: there are no such joints")
    if not goal[name]:
        return None
    found: list[float | _DefaultT] = [default] * len(joints)
    for each in goal[name]:
        if each["name"] not in joints:
            raise TrajectoryError(INVALID_JOINTS, f"{name}: no joint {each['name']!r:.60}")
        if any(each[part] > 0.0 for part in ("velocity", "acceleration")):
            raise TrajectoryError(INVALID_GOAL, f"{name}: only positions are watched")
        position = each["position"]
        if not position < float("inf"):
            raise TrajectoryError(INVALID_GOAL, f"{name}: {position} is not a tolerance")
        found[joints.index(each["name"])] = max(0.0, position) if position else default
    return found


def _seconds(duration: Message) -> float:
    return float(duration["sec"] + 1e-9 * duration["nanosec"])


def result_of(reason: str, error: CardanError | None) -> Message:
    """Make the result from the reason why a trajectory was not executed; "": it was."""
    code = SUCCESSFUL
    if reason:
        code = INVALID_GOAL
        for begin, kind in (
            (PATH_TOLERANCE, PATH_TOLERANCE_VIOLATED),
            (GOAL_TOLERANCE, GOAL_TOLERANCE_VIOLATED),
        ):
            if reason.startswith(begin):
                code = kind
    if isinstance(error, TrajectoryError):
        code = error.code
    return {"error_code": code, "error_string": reason}


def _feedback(type_name: str, joints: Sequence[str], now: Instant) -> Message:
    message = default_message(type_name)
    message["header"] = {
        "stamp": {"sec": now.stamp_ns // 10**9, "nanosec": now.stamp_ns % 10**9},
        "frame_id": now.frame,
    }
    message["joint_names"] = list(joints)
    actual = now.robot
    moving = actual.velocities if len(actual.velocities) == len(joints) else ()
    message["actual"] = _point(actual.joints, moving)
    if now.desired is not None and len(actual.joints) == len(joints):
        positions, velocities, point = now.desired
        if "index" in message:
            message["index"] = point
        message["desired"] = _point(positions, velocities)
        following_error = [a - b for a, b in zip(positions, actual.joints, strict=True)]
        slower = [a - b for a, b in zip(velocities, moving, strict=True)] if moving else []
        message["error"] = _point(following_error, slower)
    return message


def _point(positions: Sequence[float], velocities: Sequence[float]) -> dict[str, Any]:
    point = default_message("trajectory_msgs/msg/JointTrajectoryPoint")
    return point | {
        "positions": [float(each) for each in positions],
        "velocities": [float(each) for each in velocities],
    }
