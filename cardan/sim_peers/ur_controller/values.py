"""Values of URScript that Python does not have by itself."""

from __future__ import annotations

from typing import Any


class Pose(tuple[float, ...]):
    """`p[x, y, z, rx, ry, rz]`: a position in m and a rotation vector in rad."""

    __slots__ = ()


def is_number(value: Any) -> bool:
    """Whether it is a number of URScript; True and False are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
