"""Messages of the public page `teleop` (SpesRobotics, release 0.1.5), which LeRobot embeds.

A text frame ``{"type": "pose", "data": {"position": {x, y, z}, "orientation": {x, y, z, w}, "move":
bool, "scale": 1.0, "reservedButtonA": bool, "reservedButtonB": bool}}`` for each frame of a WebXR
session, in WebXR's axes. It has neither a time nor a number. ``{"type": "log", ...}`` is text for
the operator.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from cardan.protocols.handheld.frames import (
    BUTTONS,
    LARGEST,
    BodyPart,
    MalformedFrame,
    OperatorFrame,
    XrFrame,
)
from cardan.types import Quaternion, Vector3

LONGEST_TEXT: Final = 4096
"""Longest message, characters; a usual one has some 250."""


class TeleopPose(NamedTuple):
    """A pose of the phone or headset."""

    position_m: Vector3
    orientation: Quaternion
    move: bool
    """The dead-man control."""
    a: bool = False
    b: bool = False
    scale: float = 1.0
    """Speed by the page's slider; ignored in favor of the session's mapping."""

    def frame(self, sequence: int, time_us: int, channel: int) -> OperatorFrame:
        """Convert to an operator frame."""
        names = BUTTONS["xr"]
        buttons = self.a << names.index("a") | self.b << names.index("b")
        body = XrFrame(BodyPart.VIEWER, self.position_m, self.orientation, buttons)
        return OperatorFrame(body, self.move, channel=channel, sequence=sequence, time_us=time_us)


class TeleopLog(NamedTuple):
    """Text for the operator from the page; ignored."""


def decode_teleop(text: str) -> TeleopPose | TeleopLog | MalformedFrame | None:
    """Decode the message in a text frame; None if it is not teleop's. Never raises."""
    if len(text) > LONGEST_TEXT or '"type"' not in text:
        return None
    try:
        table = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(table, dict) or "op" in table or table.get("type") not in ("pose", "log"):
        return None
    if table["type"] == "log":
        return TeleopLog()
    data = table.get("data")
    if not isinstance(data, dict):
        return MalformedFrame("of teleop without its data")
    position, orientation = _numbers(data, "position", "xyz"), _numbers(data, "orientation", "wxyz")
    scale = data.get("scale", 1.0)
    if position is None or orientation is None or not _is_number(scale):
        return MalformedFrame("of teleop with numbers that are invalid or too large")
    length = math.sqrt(sum(each * each for each in orientation))
    if not 0.99 < length < 1.01:
        return MalformedFrame(f"of teleop with an orientation of the length {length:.3g}, not 1")
    unit = Quaternion(*(each / length for each in orientation))
    # Any value but true is a release of the control.
    move, a, b = (data.get(key) is True for key in ("move", "reservedButtonA", "reservedButtonB"))
    return TeleopPose(Vector3(*position), unit, move, a, b, float(scale))


def _numbers(data: Mapping[str, Any], key: str, names: str) -> list[float] | None:
    table = data.get(key)
    if not isinstance(table, dict):
        return None
    values = [table.get(name) for name in names]
    return [float(value) for value in values] if all(map(_is_number, values)) else None  # type: ignore[arg-type]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST
