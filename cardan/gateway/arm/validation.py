"""Validation of every command before anything else: length, numbers, rotation, names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from cardan.errors import MotionRefusedError
from cardan.gateway.arm.status import OPERATOR
from cardan.gateway.arm.vocab import Action, vocab, vocab_text
from cardan.spatial import from_rotation_vector, is_finite, normalized, to_rotation_vector
from cardan.types import Frame, Pose, Vector3

Six = tuple[float, float, float, float, float, float]
Target = Pose | Sequence[float]
"""A pose, or its six numbers: position (m) and rotation vector (rad)."""


class FramedPose(NamedTuple):
    """A pose in a frame of its own, whatever the parameter referenceFrame says."""

    pose: Target
    frame: Frame
    """Frame of the pose: BASE, or TOOL, relative to the present TCP."""


LARGEST_NUMBER = 1e4
"""Largest accepted m, rad, m/s, N or N·m: more is a mistake of units, and could overflow."""

UNIT_TOLERANCE = 1e-3
"""Largest deviation of a quaternion's length from 1 that can be rounding."""

LONGEST_NAME = 64
"""Characters of a source's name."""

LARGEST_SEQUENCE = 1 << 53
"""Largest number of a streamed command: every reader of JSON keeps it exactly."""

_GRIPPER = {Action.CLOSE: "close", Action.OPEN: "open", Action.STOP: "stop"}


def _finite_numbers(verb: str, values: Any, many: str) -> tuple[float, ...]:
    """Return `values` as finite floats; `many`: how many the verb takes, in words."""
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError, OverflowError):
        raise MotionRefusedError(f"{verb} takes {many}, not {brief(values)}") from None
    for index, number in enumerate(numbers, 1):
        if not math.isfinite(number):
            raise MotionRefusedError(f"{verb}: number {index} of {len(numbers)} is {number}")
        if abs(number) > LARGEST_NUMBER:
            raise MotionRefusedError(
                f"{verb}: number {index} of {len(numbers)} is {number:g}; no arm goes beyond "
                f"{LARGEST_NUMBER:g}"
            )
    return numbers


def six_numbers(verb: str, values: Sequence[float]) -> Six:
    """Return `values` as six finite floats. Raises MotionRefusedError that names the fault."""
    numbers = _finite_numbers(verb, values, "six numbers")
    if len(numbers) != 6:
        raise MotionRefusedError(f"{verb} takes six numbers, not {len(numbers)}")
    x, y, z, rx, ry, rz = numbers
    return x, y, z, rx, ry, rz


def joint_numbers(verb: str, values: Sequence[float], joints: int | None) -> tuple[float, ...]:
    """Return `values` as finite floats, one for each of the `joints` (None: unknown number). Raises
    MotionRefusedError."""
    numbers = _finite_numbers(verb, values, "numbers, one for each joint")
    if joints not in (None, len(numbers)):
        raise MotionRefusedError(f"{verb} takes {joints} numbers, not {len(numbers)}")
    return numbers


def brief(value: object) -> str:
    """Return `value` as a short text for a message."""
    words = repr(value)
    return words if len(words) <= LONGEST_NAME else f"{words[:LONGEST_NAME]}…"


def checked_name(verb: str, name: object) -> str:
    """Return `name` as that of a source. Raises MotionRefusedError."""
    if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME:
        raise MotionRefusedError(
            f"{verb}: takes a name of 1 to {LONGEST_NAME} characters, not {brief(name)}"
        )
    return name


def checked_source(verb: str, name: object) -> str:
    """Return `name` as that of a source which is a program. Raises MotionRefusedError."""
    if name == OPERATOR:
        raise MotionRefusedError(f"{verb}: {OPERATOR!r} is the operator device, not a program")
    return checked_name(verb, name)


def checked_sequence(verb: str, number: object) -> int:
    """Return `number` as that of a streamed command. Raises MotionRefusedError."""
    if (
        isinstance(number, bool)
        or not isinstance(number, int)
        or not 0 <= number <= LARGEST_SEQUENCE
    ):
        raise MotionRefusedError(
            f"{verb}: the sequence number {brief(number)} is not an integer from 0 to "
            f"{LARGEST_SEQUENCE}"
        )
    return number


def checked_timeout(verb: str, timeout_s: float) -> float:
    """Return `timeout_s` if it is finite and at least 0. Raises MotionRefusedError."""
    try:
        if 0.0 <= timeout_s < math.inf:
            return float(timeout_s)
    except TypeError:
        pass
    raise MotionRefusedError(f"{verb}: a timeout is a number >= 0, not {brief(timeout_s)}")


def checked_distance(verb: str, distance_m: float) -> float:
    """Return `distance_m` if it is finite and at least 0. Raises MotionRefusedError."""
    (distance,) = _finite_numbers(verb, (distance_m,), "a distance in m")
    if distance < 0.0:
        raise MotionRefusedError(f"{verb}: a distance is a number >= 0, not {distance:g}")
    return distance


def checked_action(code: Action | int | str) -> Action:
    """Return a gripper's action. Raises MotionRefusedError."""
    try:
        action = Action(vocab(code) if isinstance(code, str) else code)
    except ValueError:
        action = Action.NONE
    if action not in _GRIPPER:
        allowed = ", ".join(f"{vocab_text(each)} ({word})" for each, word in _GRIPPER.items())
        raise MotionRefusedError(f"act: allowed are {allowed}, not {brief(code)}")
    return action


def checked_pose(verb: str, target: Target) -> Pose:
    """Return `target` as a pose. Raises MotionRefusedError."""
    if isinstance(target, Pose):
        position, orientation = target.position, target.orientation
        if not is_finite((*position, *orientation)):
            raise MotionRefusedError(f"{verb}: the pose has values that are not numbers: {target}")
        if max(map(abs, position)) > LARGEST_NUMBER:
            raise MotionRefusedError(f"{verb}: no arm reaches the position {tuple(position)}")
        length = math.sqrt(sum(c * c for c in orientation))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise MotionRefusedError(
                f"{verb}: the quaternion {tuple(orientation)} has length {length:.4g}, not 1"
            )
        return Pose(Vector3(*position), normalized(orientation), Frame.BASE)
    x, y, z, rx, ry, rz = six_numbers(verb, target)
    return Pose(Vector3(x, y, z), from_rotation_vector(Vector3(rx, ry, rz)), Frame.BASE)


def six_of(pose: Pose) -> Six:
    """Return position (m) and rotation vector (rad, length at most pi) of a pose."""
    rotation = to_rotation_vector(pose.orientation)
    return (*pose.position, *rotation)
