"""Checks of the arguments of the controller's functions. All raise ValueError."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from cardan.sim_peers.kinematics import AXES
from cardan.sim_peers.ur_controller.kinematics import frame_of
from cardan.sim_peers.ur_controller.operators import text
from cardan.sim_peers.ur_controller.values import UrPose, is_number
from cardan.types import Pose as Frame

LARGEST: Final = 1e6
"""Largest number in a motion: beyond any arm's, and results of computations stay finite."""
SMALLEST: Final = 1e-6
"""Smallest value of a speed, an acceleration or a time that is not 0."""


def number(name: str, value: Any) -> float:
    """Return a finite number."""
    if not is_number(value) or not math.isfinite(value):
        raise ValueError(f"{name} is {text(value)}, which is not a number")
    return float(value)


def numbers(name: str, value: Any) -> list[float]:
    """Return the finite numbers of a list or a pose."""
    if not isinstance(value, (list, UrPose)):
        raise ValueError(f"{name} is {text(value)}, which is not a list")
    return [number(name, each) for each in value]


def whole(name: str, value: Any, least: int, most: int) -> int:
    """Return a whole number in a range."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{text(value)} is not a whole number")
    if not least <= value <= most:
        raise ValueError(f"{name} is {value}, which is not {least} to {most}")
    return value


def choice(name: str, value: Any, least: int, most: int) -> int:
    """Return a whole number in a range, also one that was computed, as 6 / 3."""
    computed = isinstance(value, float) and value.is_integer()
    return whole(name, int(value) if computed else value, least, most)


def truth(name: str, value: Any) -> bool:
    """Return True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {text(value)}, which is neither True nor False")
    return value


def words(name: str, value: Any) -> str:
    """Return a text."""
    if not isinstance(value, str):
        raise ValueError(f"{name} is {text(value)}, which is not a string")
    return value


# -- motion ----------------------------------------------------------------------------------------


def moderate(name: str, value: Any) -> float:
    """Return a number that a motion can have."""
    if not is_number(value) or not abs(value) <= LARGEST:
        raise ValueError(f"{name} is {text(value)}, which is not a number up to {LARGEST:.0f}")
    return float(value)


def not_below_zero(name: str, value: Any) -> float:
    """Return a number of 0 or more."""
    if moderate(name, value) < 0.0:
        raise ValueError(f"{name} is {text(value)}, which is below 0")
    return float(value)


def above_zero(name: str, value: Any) -> float:
    """Return a number above 0."""
    if moderate(name, value) < SMALLEST:
        raise ValueError(f"{name} is {text(value)}, which is not above 0")
    return float(value)


def share(name: str, value: Any) -> float:
    """Return a share above 0, at most 1."""
    if not above_zero(name, value) <= 1.0:
        raise ValueError(f"{name} is {text(value)}, which is above 1")
    return float(value)


def time(value: Any) -> float:
    """Return a time in s; 0: not given."""
    if 0.0 < not_below_zero("t", value) < SMALLEST:
        raise ValueError(f"t is {text(value)}, which is not above 0")
    return float(value)


def vector(name: str, value: Any, count: int = AXES) -> tuple[float, ...]:
    """Return `count` numbers of a list or a pose."""
    if not isinstance(value, (list, UrPose)) or len(value) != count:
        raise ValueError(f"{name} is {text(value)}, which is not {count} numbers")
    return tuple(moderate(name, each) for each in value)


def switches(name: str, value: Any) -> tuple[bool, ...]:
    """Return a switch, 0 or 1, for each axis."""
    found = vector(name, value)
    if not {0.0, 1.0}.issuperset(found):
        raise ValueError(f"{name} is {text(value)}, which is not 0 or 1 for each axis")
    return tuple(each == 1.0 for each in found)


def joints(name: str, value: Any) -> tuple[float, ...]:
    """Return a list of joints."""
    if not isinstance(value, list) or len(value) != AXES:
        raise ValueError(f"{name} is {text(value)}, which is not {AXES} joints")
    return tuple(moderate(name, each) for each in value)


def pose(name: str, value: Any) -> UrPose:
    """Return a pose."""
    if not isinstance(value, UrPose) or len(value) != AXES:
        raise ValueError(f"{name} is {text(value)}, which is not a pose")
    return UrPose(moderate(name, each) for each in value)


def frame(name: str, value: Any) -> Frame:
    """Return a pose as a frame."""
    return frame_of(pose(name, value))


def shown(values: Sequence[float]) -> str:
    """Format values for messages."""
    return "[" + ", ".join(f"{math.floor(v * 1e4 + 0.5) / 1e4:g}" for v in values) + "]"
