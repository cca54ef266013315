"""What functions of the controller ask of their arguments. All raise ValueError."""

from __future__ import annotations

import math
from typing import Any

from cardan.sim_peers.ur_controller.operators import text
from cardan.sim_peers.ur_controller.values import Pose, is_number


def number(name: str, value: Any) -> float:
    """A finite number."""
    if not is_number(value) or not math.isfinite(value):
        raise ValueError(f"{name} is {text(value)}, which is no number")
    return float(value)


def numbers(name: str, value: Any) -> list[float]:
    """A list, or a pose, of them."""
    if not isinstance(value, (list, Pose)):
        raise ValueError(f"{name} is {text(value)}, which is no list")
    return [number(name, each) for each in value]


def whole(name: str, value: Any, least: int, most: int) -> int:
    """A whole number in a range."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{text(value)} is not a whole number")
    if not least <= value <= most:
        raise ValueError(f"{name} is {value}, which is not {least} to {most}")
    return value


def truth(name: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {text(value)}, which is neither True nor False")
    return value


def words(name: str, value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise ValueError(f"{name} is {text(value)}, which is no text")
    return value
