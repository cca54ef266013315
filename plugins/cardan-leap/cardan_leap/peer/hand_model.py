"""Model of a hand in the tracking service: every field of a frame from a few numbers.

Points are first computed in the hand's own axes (right, up, back; mm) of a right hand, palm down,
fingers away; a left hand is its mirror image. The proportions are an adult's, after public
recordings of the service.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from cardan_leap.protocol import SKELETON_SINCE

Triple = tuple[float, float, float]

PALM_WIDTH_MM = 85.0
ARM_WIDTH_MM = 60.0
FOREARM_MM = 250.0
WRIST: Triple = (2.0, -4.0, 58.0)
SPHERE_RADII_MM = (80.0, 33.0)
"""Radii of the sphere that an open hand, and a fist, holds."""
INTERACTION_BOX = {"center": [0.0, 200.0, 0.0], "size": [235.247, 235.247, 147.751]}
NO_MOTION: dict[str, Any] = {
    "r": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "s": 1.0,
    "t": [0.0, 0.0, 0.0],
}
TOUCH_RANGE_MM = 100.0
STABILIZING_HZ = 2.0
"""Cut-off of the stabilized positions at rest; it rises with speed."""
STABILIZING_RISE_HZ_S_MM = 0.02
EXTENDED_BELOW = 0.5


class _Finger(NamedTuple):
    carpal: Triple
    knuckle: Triple
    splay_rad: float
    bones_mm: Triple
    width_mm: float


FINGERS = (
    _Finger((-22.0, -8.0, 32.0), (-22.0, -8.0, 32.0), -0.7, (46.0, 32.0, 22.0), 19.5),
    _Finger((-14.0, 0.0, 42.0), (-24.0, 2.0, -24.0), -0.12, (40.0, 23.0, 17.0), 18.6),
    _Finger((-4.0, 0.0, 44.0), (-3.0, 4.0, -28.0), 0.0, (45.0, 27.0, 18.0), 18.2),
    _Finger((6.0, 0.0, 42.0), (16.0, 2.0, -22.0), 0.1, (42.0, 26.0, 18.0), 17.4),
    _Finger((15.0, 0.0, 38.0), (32.0, -2.0, -12.0), 0.24, (33.0, 18.0, 16.0), 15.4),
)
"""Names from thumb to little finger; the thumb has no metacarpal bone, as in the service."""
_CURL_RAD = (1.3, 1.6, 1.0)
"""Bend of the three joints of a finger in a fist."""
_PINCH_RAD = (0.7, 0.8, 0.4)
_THUMB_SHARE = 0.45
_THUMB_ACROSS_RAD = 1.1


class HandPosture(NamedTuple):
    """Pose and posture of a hand: tracker's axes, mm, and its attitude as a rotation matrix by
    rows, whose columns are the hand's right, up and back."""

    palm_mm: Triple
    rows: tuple[Triple, Triple, Triple]
    grab: float
    pinch: float
    confidence: float


class HandModel:
    """Hand in view, with the service's id `hand_id`: from postures to JSON."""

    def __init__(self, hand_id: int, side: str, seen_s: float) -> None:
        self.id = hand_id
        self.side = side
        self.seen_s = seen_s
        self._last_s = seen_s
        self._palm: Triple | None = None
        self._stable: Triple = (0.0, 0.0, 0.0)
        self._tips: list[Triple] = []

    def measure(
        self, posture: HandPosture, now_s: float
    ) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """Return the hand and its five fingers in the service's newest version."""
        palm = posture.palm_mm
        rows = posture.rows
        dt_s = now_s - self._last_s
        self._last_s = now_s
        velocity = _rate(palm, self._palm, dt_s)
        speed = math.sqrt(_dot(velocity, velocity))
        cutoff_hz = STABILIZING_HZ + STABILIZING_RISE_HZ_S_MM * speed
        share = 1.0 if self._palm is None else -math.expm1(-math.tau * cutoff_hz * dt_s)
        self._palm = palm
        self._stable = _add(self._stable, _scale(_sub(palm, self._stable), share))
        lag = _sub(self._stable, palm)
        visible_s = now_s - self.seen_s
        back = _column(rows, 2)
        up = _column(rows, 1)
        wrist = self._place(posture, WRIST)
        radius = SPHERE_RADII_MM[0] + posture.grab * (SPHERE_RADII_MM[1] - SPHERE_RADII_MM[0])
        motion = {
            "r": [_numbers(row) for row in rows],
            "s": _number(1.0 + 0.002 * (palm[1] - 200.0)),
            "t": _numbers(palm),
        }
        hand: dict[str, Any] = {
            "id": self.id,
            "type": self.side,
            "palmPosition": _numbers(palm),
            "stabilizedPalmPosition": _numbers(self._stable),
            "palmVelocity": _numbers(velocity),
            "palmNormal": _numbers(_scale(up, -1.0)),
            "direction": _numbers(_scale(back, -1.0)),
            "grabStrength": _number(posture.grab),
            "pinchStrength": _number(posture.pinch),
            "confidence": _number(posture.confidence),
            "palmWidth": PALM_WIDTH_MM,
            "timeVisible": _number(visible_s),
            "armBasis": self._basis(rows, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
            "armWidth": ARM_WIDTH_MM,
            "wrist": _numbers(wrist),
            "elbow": _numbers(_add(wrist, _scale(back, FOREARM_MM))),
            "sphereCenter": _numbers(_add(palm, _scale(up, -radius))),
            "sphereRadius": _number(radius),
            **motion,
        }
        tips: list[Triple] = []
        fingers: list[dict[str, Any]] = []
        for kind in range(len(FINGERS)):
            finger, tip = self._finger(kind, posture)
            before = self._tips[kind] if self._tips else None
            touch = max(-1.0, min(1.0, tip[2] / TOUCH_RANGE_MM))
            extended = finger["extended"]
            finger.update(
                handId=self.id,
                id=10 * self.id + kind,
                tipPosition=_numbers(tip),
                stabilizedTipPosition=_numbers(_add(tip, lag)),
                tipVelocity=_numbers(_rate(tip, before, dt_s)),
                timeVisible=_number(visible_s),
                touchDistance=_number(touch),
                touchZone="none" if not extended else "touching" if touch <= 0.0 else "hovering",
            )
            tips.append(tip)
            fingers.append(finger)
        self._tips = tips
        return hand, fingers

    def _finger(self, kind: int, posture: HandPosture) -> tuple[dict[str, Any], Triple]:
        shape = FINGERS[kind]
        grab, pinch = posture.grab, posture.pinch
        thumb = kind == 0
        bend_share = _THUMB_SHARE if thumb else 1.0
        pinching = pinch if kind < 2 else 0.0
        splay = shape.splay_rad * (1.0 - grab)
        if thumb:
            splay = shape.splay_rad + _THUMB_ACROSS_RAD * max(grab, 0.6 * pinch)
        joints = [shape.carpal, shape.knuckle]
        directions = [_direction(*_angles(_sub(shape.knuckle, shape.carpal)))]
        rights = [_right(_angles(_sub(shape.knuckle, shape.carpal))[0])]
        if thumb:
            directions, rights = [_direction(splay, 0.0)], [_right(splay)]
        bend = 0.0
        for length, curl, squeeze in zip(shape.bones_mm, _CURL_RAD, _PINCH_RAD, strict=True):
            bend += bend_share * max(grab * curl, pinching * squeeze)
            directions.append(_direction(splay, bend))
            rights.append(_right(splay))
            joints.append(_add(joints[-1], _scale(directions[-1], length)))
        rows = posture.rows
        carp, mcp, pip, dip, end = (self._place(posture, joint) for joint in joints)
        # The tip is the middle of the fingertip's flesh, a little before the bone's end.
        tip = self._place(posture, _add(joints[-1], _scale(directions[-1], -4.0)))
        finger = {
            "type": kind,
            "tool": False,
            "extended": grab < EXTENDED_BELOW and pinching < EXTENDED_BELOW,
            "length": _number(sum(shape.bones_mm)),
            "width": shape.width_mm,
            "direction": _numbers(self._turn(rows, directions[2])),
            "carpPosition": _numbers(carp),
            "mcpPosition": _numbers(mcp),
            "pipPosition": _numbers(pip),
            "dipPosition": _numbers(dip),
            "btipPosition": _numbers(end),
            "bases": [
                self._basis(rows, right, _scale(direction, -1.0))
                for right, direction in zip(rights, directions, strict=True)
            ],
        }
        return finger, tip

    def _turn(self, rows: tuple[Triple, Triple, Triple], own: Triple) -> Triple:
        """Convert a vector from a right hand's own axes to the tracker's."""
        x, y, z = own
        if self.side == "left":
            x = -x
        a, b, c = rows
        return (
            a[0] * x + a[1] * y + a[2] * z,
            b[0] * x + b[1] * y + b[2] * z,
            c[0] * x + c[1] * y + c[2] * z,
        )

    def _place(self, posture: HandPosture, own: Triple) -> Triple:
        return _add(posture.palm_mm, self._turn(posture.rows, own))

    def _basis(
        self, rows: tuple[Triple, Triple, Triple], right: Triple, back: Triple
    ) -> list[list[float]]:
        """Return a bone's axes by rows; those of a left hand are left-handed."""
        return [_numbers(self._turn(rows, axis)) for axis in (right, _cross(back, right), back)]


def frame_document(
    frame_id: int,
    timestamp_us: int,
    rate_hz: float,
    measured: Iterable[tuple[dict[str, Any], list[dict[str, Any]]]],
) -> dict[str, Any]:
    """Return a frame in the newest version."""
    hands: list[dict[str, Any]] = []
    pointables: list[dict[str, Any]] = []
    for hand, fingers in measured:
        hands.append(hand)
        pointables += fingers
    motion = {key: hands[0][key] for key in ("r", "s", "t")} if len(hands) == 1 else NO_MOTION
    return {
        "id": frame_id,
        "timestamp": timestamp_us,
        "currentFrameRate": _number(rate_hz),
        "hands": hands,
        "pointables": pointables,
        "gestures": [],
        "devices": [],
        "interactionBox": INTERACTION_BOX,
        **motion,
    }


_SKELETON_KEYS = frozenset(
    {
        *("type", "grabStrength", "pinchStrength", "confidence", "palmWidth"),
        *("armBasis", "armWidth", "wrist", "elbow"),
        *("extended", "bases", "carpPosition"),
        *("mcpPosition", "pipPosition", "dipPosition", "btipPosition"),
    }
)


def as_version(document: dict[str, Any], version: int) -> dict[str, Any]:
    """Return the frame in the format of `version`."""
    if version >= SKELETON_SINCE:
        return document
    return {
        **document,
        **{
            part: [
                {key: value for key, value in entry.items() if key not in _SKELETON_KEYS}
                for entry in document[part]
            ]
            for part in ("hands", "pointables")
        },
    }


# ---------------------------------------------------------------------------------------------


def _angles(v: Triple) -> tuple[float, float]:
    """Return the splay and bend of a direction."""
    x, y, z = v
    return math.atan2(x, -z), math.atan2(-y, math.hypot(x, z))


def _direction(splay_rad: float, bend_rad: float) -> Triple:
    flat = math.cos(bend_rad)
    return (math.sin(splay_rad) * flat, -math.sin(bend_rad), -math.cos(splay_rad) * flat)


def _right(splay_rad: float) -> Triple:
    return (math.cos(splay_rad), 0.0, math.sin(splay_rad))


def _column(rows: tuple[Triple, Triple, Triple], index: int) -> Triple:
    return (rows[0][index], rows[1][index], rows[2][index])


def _add(a: Triple, b: Triple) -> Triple:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _sub(a: Triple, b: Triple) -> Triple:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _scale(a: Triple, factor: float) -> Triple:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Triple, b: Triple) -> Triple:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _rate(new: Triple, old: Triple | None, dt_s: float) -> Triple:
    if old is None or dt_s <= 0.0:
        return (0.0, 0.0, 0.0)
    return _scale(_sub(new, old), 1.0 / dt_s)


def _number(value: float) -> float:
    """Round a number to the six digits that the service prints."""
    return float(f"{value:.6g}") + 0.0


def _numbers(values: Iterable[float]) -> list[float]:
    return [_number(value) for value in values]
