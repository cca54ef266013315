"""Checks of what a program gives to functions; a ValueError says what is wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from cardan.sim_peers.kinematics import AXES
from cardan.sim_peers.ur_controller.kinematics import frame_of
from cardan.sim_peers.ur_controller.values import Pose, is_number
from cardan.types import Pose as Frame

LARGEST: Final = 1e6
"""Of a number that has to do with motion: no arm's is larger, and what is computed stays finite."""
SMALLEST: Final = 1e-6
"""Of a speed, an acceleration or a time that is not 0."""


def number(name: str, value: Any) -> float:
    """A number that motion can have."""
    if not is_number(value) or not abs(value) <= LARGEST:
        raise ValueError(f"{name} is {value!r}, which is no number up to {LARGEST:.0f}")
    return float(value)


def not_below_zero(name: str, value: Any) -> float:
    """0 or more."""
    if number(name, value) < 0.0:
        raise ValueError(f"{name} is {value!r}, which is below 0")
    return float(value)


def above_zero(name: str, value: Any) -> float:
    """More than 0."""
    if number(name, value) < SMALLEST:
        raise ValueError(f"{name} is {value!r}, which is not above 0")
    return float(value)


def time(value: Any) -> float:
    """A time in s; 0: none is given."""
    if 0.0 < not_below_zero("t", value) < SMALLEST:
        raise ValueError(f"t is {value!r}, which is not above 0")
    return float(value)


def whole(name: str, value: Any, lowest: int, highest: int) -> int:
    """A whole number of a range."""
    if not is_number(value) or value != value // 1 or not lowest <= value <= highest:
        raise ValueError(f"{name} is {value!r}, which is not {lowest} to {highest}")
    return int(value)


def vector(name: str, value: Any, count: int = AXES) -> tuple[float, ...]:
    """So many numbers, as a list or a pose."""
    if not isinstance(value, (list, Pose)) or len(value) != count:
        raise ValueError(f"{name} is {value!r}, which is not {count} numbers")
    return tuple(number(name, each) for each in value)


def joints(name: str, value: Any) -> tuple[float, ...]:
    """A list of joints."""
    if not isinstance(value, list) or len(value) != AXES:
        raise ValueError(f"{name} is {value!r}, which is not {AXES} joints")
    return tuple(number(name, each) for each in value)


def pose(name: str, value: Any) -> Pose:
    """A pose."""
    if not isinstance(value, Pose) or len(value) != AXES:
        raise ValueError(f"{name} is {value!r}, which is not a pose")
    return Pose(number(name, each) for each in value)


def frame(name: str, value: Any) -> Frame:
    """A pose, as a frame."""
    return frame_of(pose(name, value))


def shown(values: Sequence[float]) -> str:
    """For messages."""
    return "[" + ", ".join(f"{math.floor(v * 1e4 + 0.5) / 1e4:g}" for v in values) + "]"
