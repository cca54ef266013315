"""Generator of handheld_vectors.json, test vectors for the codecs of Cardan and of its page.

python -m tests.protocols.handheld_vectors
"""

import json
import math
import random
from pathlib import Path

from cardan.protocols.handheld.frames import (
    BodyPart,
    GamepadFrame,
    JogJoints,
    JogTwist,
    OperatorFrame,
    PhoneFrame,
    XrFrame,
    encode_frame,
)
from cardan.protocols.handheld.motion import drag_on_screen
from cardan.protocols.handheld.orientation import from_angles, orientation_from_xr, position_from_xr
from cardan.types import Frame, Quaternion, Vector3

FILE = Path(__file__).with_name("handheld_vectors.json")

FRAMES = {
    "jog rests": OperatorFrame(JogTwist(Vector3(0, 0, 0), Vector3(0, 0, 0)), False),
    "jog in the base": OperatorFrame(
        JogTwist(Vector3(0.25, -0.5, 0.125), Vector3(0, 0, -1)), True, True, True, 3, 77, 123456789
    ),
    "jog in the tool": OperatorFrame(
        JogTwist(Vector3(0, 0, 0.0625), Vector3(0.5, 0, 0), Frame.TOOL), True, sequence=2**32 - 1
    ),
    "jog, mixed": OperatorFrame(
        JogTwist(Vector3(0, 0.03125, 0), Vector3(0, 0.25, 0), Frame.MIXED), True, time_us=2**53
    ),
    "jog of six joints": OperatorFrame(
        JogJoints((0.5, 0.0, -0.25, 0.0, 0.0, 1.5)), True, channel=255, sequence=1, time_us=1
    ),
    "jog of one joint": OperatorFrame(JogJoints((-0.125,)), True),
    "phone without sensors": OperatorFrame(PhoneFrame(None), False, tracking=False),
    "phone, all there is": OperatorFrame(
        PhoneFrame(
            Vector3(350, -45, 20.5), -0.5, 0.75, Vector3(0.125, -2, 0.5),
            Vector3(0.5, 9.75, -0.25), 0b101, 3, 255,
        ),
        True, True, True, 1, 1000, 5_000_000,
    ),
    "phone, angles alone, hidden": OperatorFrame(
        PhoneFrame(Vector3(10, 20, 30)), False, visible=False, channel=1, sequence=4
    ),
    "left hand": OperatorFrame(
        XrFrame(
            BodyPart.LEFT, Vector3(-0.25, 1.5, -0.5), Quaternion(1, 0, 0, 0), 0b1, 0.5, -0.5, 0.75,
            0.25, 7,
        ),
        True, sequence=9, time_us=9_000,
    ),
    "right hand, lost": OperatorFrame(
        XrFrame(BodyPart.RIGHT, Vector3(0, 0, 0), Quaternion(0, 0, 0, 1)), False, tracking=False
    ),
    "viewer": OperatorFrame(
        XrFrame(BodyPart.VIEWER, Vector3(1, 2, 3), Quaternion(0.5, -0.5, 0.5, 0.5), 0b1110000), True
    ),
    "gamepad": OperatorFrame(GamepadFrame(-1, 1, 0.5, -0.25, 0.125, 1, 1 << 16 | 1 << 4), True),
}  # fmt: skip

HEAD = "c1{kind:02x}0700" + "00000000" + "0000000000000000"
REFUSED = {
    "nothing": "",
    "half a header": "c1010700000000",
    "another version": HEAD.replace("c1", "c2", 1).format(kind=1) + "00" * 28,
    "unknown flags": HEAD.replace("0700", "0f00").format(kind=1) + "00" * 28,
    "no kind": HEAD.format(kind=0),
    "unknown kind": HEAD.format(kind=8) + "00" * 28,
    "jog cut short": HEAD.format(kind=1) + "00" * 27,
    "jog too long": HEAD.format(kind=1) + "00" * 29,
    "jog with NaN": HEAD.format(kind=1) + "00" * 24 + "0000c07f",
    "jog with infinity": HEAD.format(kind=1) + "00" * 24 + "0000807f",
    "jog in no frame": HEAD.format(kind=1) + "03" + "00" * 27,
    "no joints": HEAD.format(kind=2) + "00000000",
    "17 joints": HEAD.format(kind=2) + "11000000" + "00" * 68,
    "joints cut short": HEAD.format(kind=2) + "02000000" + "00" * 7,
    "phone with one angle": HEAD.format(kind=3) + "00000000" + "0000c07f" * 2 + "00" * 36,
    "phone with a drag that is none": HEAD.format(kind=3) + "00" * 12 + "0000c07f" + "00" * 32,
    "phone turned by four quarters": HEAD.format(kind=3) + "00" * 46 + "0400",
    "hand without an orientation": HEAD.format(kind=4) + "00" * 48,
    "gamepad with NaN": HEAD.format(kind=7) + "0000c07f" + "00" * 24,
}
"""Bytes that are refused, in hexadecimal."""


def body_table(body):
    """Return a frame's body in JSON's types."""
    if isinstance(body, JogTwist):
        return {"linear": body.linear, "angular": body.angular, "frame": body.frame.value}
    if isinstance(body, XrFrame):
        w, x, y, z = body.orientation
        table = {**body._asdict(), "part": body.part.word}
        return {**table, "orientation": {"w": w, "x": x, "y": y, "z": z}}
    return body._asdict()


def vectors():
    """Return all vectors in JSON's types."""
    chosen = random.Random(17)
    angles = [
        (0, 90, 0), (90, 0, 0), (0, 0, 45), (10, 20, 30), (350, -45, 20), (0, -90, 0), (45, 90, 10),
        *((chosen.uniform(0, 360), chosen.uniform(-180, 180), chosen.uniform(-90, 90))
          for _ in range(20)),
    ]  # fmt: skip
    poses = [
        (Vector3(0, 0, -1), Quaternion(1, 0, 0, 0)),
        (Vector3(1, 2, 3), Quaternion(math.sqrt(0.5), 0, math.sqrt(0.5), 0)),
        (Vector3(-0.5, 0.25, 4), Quaternion(0.5, -0.5, 0.5, 0.5)),
    ]
    return {
        "frames": [
            {
                "name": name,
                "bytes": encode_frame(frame).hex(),
                "frame": {
                    **frame._asdict(), "kind": frame.kind, "body": body_table(frame.body),
                    "held_buttons": frame.held_buttons,
                },
            }
            for name, frame in FRAMES.items()
        ],
        "refused": [{"name": name, "bytes": data} for name, data in REFUSED.items()],
        "orientations": [
            {"angles_deg": each, "quaternion": from_angles(*each)._asdict()} for each in angles
        ],
        "xr": [
            {
                "position": p, "orientation": q._asdict(),
                "ours": {
                    "position": position_from_xr(p),
                    "orientation": orientation_from_xr(q)._asdict(),
                },
            }
            for p, q in poses
        ],
        "screens": [
            {
                "quarters": quarters, "right": 0.25, "up": 0.5,
                "on_phone": drag_on_screen(0.25, 0.5, quarters)[:2],
            }
            for quarters in range(4)
        ],
    }  # fmt: skip


def text():
    """Return the file's text."""
    return json.dumps(vectors(), indent=1, allow_nan=False) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
