"""Values of URScript that Python does not have, and a test for numbers."""

from __future__ import annotations

from typing import Any


class UrPose(tuple[float, ...]):
    """x, y, z (m) and the rotation vector rx, ry, rz (rad)."""

    __slots__ = ()


def is_number(value: Any) -> bool:
    """Return True for an integer or a fraction; a boolean is not a number."""
    kind = value.__class__
    return kind is float or kind is int
