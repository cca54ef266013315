"""Names of observations and actions, and the representation of orientations.

Names are LeRobot's where it has one: those of its gamepad (``delta_*``), of its phone
(``target_*``), of its kinematics (``ee.*``), and of joints (``*.pos``).
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence

from cardan.errors import OptionError
from cardan.robots import ArmModel
from cardan.spatial import compose, from_rotation_vector, normalized, to_rotation_vector
from cardan.types import Frame, Pose, Vector3

AXES = ("x", "y", "z", "wx", "wy", "wz")


class ActionKind(enum.Enum):
    """Meaning of an action's numbers."""

    DELTA = "delta"
    """Velocity of the TCP, as shares of full speed."""
    TARGET = "target"
    """Pose of the TCP, relative to where it was when the operator engaged the device."""
    POSE = "pose"
    """Pose of the TCP in the arm's base frame."""


CLOSE, STAY, OPEN = 0.0, 1.0, 2.0
"""Values of "gripper": its present motion."""

CLOSING, OPENING = -1.0, 1.0
"""Values of "gripper_vel"; 0: the gripper stays."""

CLOSED, WIDE = 0.0, 100.0
"""Limits of "gripper.pos" and "ee.gripper_pos", percent."""

MOTIONS: Mapping[ActionKind, tuple[str, ...]] = {
    ActionKind.DELTA: tuple(f"delta_{axis}" for axis in AXES),
    ActionKind.TARGET: ("enabled", *(f"target_{axis}" for axis in AXES)),
    ActionKind.POSE: tuple(f"ee.{axis}" for axis in AXES),
}
"""Names of an action's numbers for the TCP."""

GRIPPERS: Mapping[ActionKind, str] = {
    ActionKind.DELTA: "gripper",
    ActionKind.TARGET: "gripper_vel",
    ActionKind.POSE: "ee.gripper_pos",
}
"""Name of an action's number for the gripper."""

GRIPPER = "gripper.pos"
"""Name of the gripper in an observation."""


def action_kind(name: str, allowed: Sequence[ActionKind]) -> ActionKind:
    """Return the kind with this name. Raises OptionError."""
    for each in allowed:
        if each.value == name:
            return each
    raise OptionError("action", name, f"one of {', '.join(each.value for each in allowed)}")


def action_names(kind: ActionKind, gripper: bool) -> tuple[str, ...]:
    """Return the names of an action's numbers, in order."""
    return (*MOTIONS[kind], GRIPPERS[kind]) if gripper else MOTIONS[kind]


def observation_names(joints: Sequence[str], gripper: bool) -> tuple[str, ...]:
    """Return the names of an observation's numbers, in order: measured joints (rad, or m for
    prismatic ones), the measured TCP in the base (m, rotation vector in rad), the gripper."""
    names = (*(f"{joint}.pos" for joint in joints), *MOTIONS[ActionKind.POSE])
    return (*names, GRIPPER) if gripper else names


def pose_of(six: Sequence[float]) -> Pose:
    """Return the pose of a position in m and a rotation vector in rad."""
    return Pose(Vector3(*six[:3]), from_rotation_vector(Vector3(*six[3:])), Frame.BASE)


def six_of(pose: Pose) -> tuple[float, ...]:
    """Return position in m and rotation vector in rad of a pose."""
    return (*pose.position, *to_rotation_vector(normalized(pose.orientation)))


LONG_RAD = 2.6
"""Length of a rotation vector above which its sign is ambiguous: a tool that points down is turned
by about pi, where both signs mean nearly the same."""


def reference_of(model: ArmModel, tool: Pose) -> Vector3:
    """Return the rotation vector of an arm's TCP with this tool at its home, for `Continuous`. It
    is the same for all sessions and data sets of the arm."""
    home = compose(model.home_tcp, tool)
    return _signed(to_rotation_vector(normalized(home.orientation)))


class Continuous:
    """Choice of rotation vectors that do not jump when a rotation passes pi.

    The same orientation is w and w - 2 pi w/|w|: the one nearer to the reference is taken. The
    result depends on the orientation and the reference alone, not on earlier calls.
    """

    def __init__(self, reference: Vector3 | None = None) -> None:
        """`reference`: see `reference_of`; None, if no model of the arm is known: the first
        orientation is used."""
        self.reference = reference

    def of(self, six: Sequence[float]) -> tuple[float, ...]:
        """Return position and rotation vector of a pose, the latter without jumps."""
        turn = Vector3(*six[3:])
        if self.reference is None:
            self.reference = _signed(turn)
        reference, angle = self.reference, math.hypot(*turn)
        if angle > 0.0:
            turn = min(turn, _other(turn, angle), key=lambda each: math.dist(each, reference))
        return (*six[:3], *turn)


def _signed(turn: Vector3) -> Vector3:
    """Return `turn`, or if it is long perhaps its alternative: the one whose first component of at
    least half the largest is positive. This keeps noise from deciding when two components are
    alike."""
    angle = math.hypot(*turn)
    if angle <= LONG_RAD:
        return turn
    most = 0.5 * max(map(abs, turn))
    first = next(each for each in turn if abs(each) >= most)
    return _other(turn, angle) if first < 0.0 else turn


def _other(turn: Vector3, angle: float) -> Vector3:
    factor = (angle - 2.0 * math.pi) / angle
    return Vector3(turn.x * factor, turn.y * factor, turn.z * factor)
