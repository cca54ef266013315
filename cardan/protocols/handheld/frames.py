"""Operator frames: one binary WebSocket message for each device state, little endian.

A header of 16 bytes, then the fields of the kind; docs/phone.md has the table. Every frame
repeats whether the operator holds the dead-man control: no frame starts or ends a motion. Floats
are of 32 bits. A missing value (of a phone without sensors) is NaN; no other value may be NaN.
"""

from __future__ import annotations

import enum
import math
import struct
from typing import Final, NamedTuple

from cardan.types import Frame, Quaternion, Vector3

VERSION: Final = 0xC1
"""First byte: 0xC for Cardan, and the version 1."""

MAX_JOINTS: Final = 16

LARGEST: Final = 1e4
"""Largest plausible number of a device, in m, m/s, m/s², rad/s, degrees or shares."""

LONGEST_US: Final = 2**53
"""Largest page time that a double holds exactly."""

_HOLD, _TRACKING, _VISIBLE = 1, 2, 4
_KNOWN_FLAGS = _HOLD | _TRACKING | _VISIBLE

_HEADER = struct.Struct("<BBBBIQ")
_TWIST = struct.Struct("<B3x6f")
_JOINTS = struct.Struct("<B3x")
_PHONE = struct.Struct("<3f2f3f3fHBB")
_XR = struct.Struct("<3f4fHBx4f")
_GAMEPAD = struct.Struct("<6fI")

_FRAMES = (Frame.BASE, Frame.TOOL, Frame.MIXED)


class BodyPart(enum.IntEnum):
    """Part of the body to which an XR frame belongs; the value is the frame's kind."""

    LEFT = 4
    RIGHT = 5
    VIEWER = 6
    """The phone or headset itself."""

    @property
    def word(self) -> str:
        """Name in options."""
        return self.name.lower()


BUTTONS: Final = {
    "phone": ("a", "b", "align"),
    "xr": ("trigger", "squeeze", "touchpad", "stick", "a", "b", "align"),
    "gamepad": (
        "south", "east", "west", "north", "left-shoulder", "right-shoulder", "left-trigger",
        "right-trigger", "back", "start", "left-stick", "right-stick", "dpad-up", "dpad-down",
        "dpad-left", "dpad-right", "guide",
    ),
}  # fmt: skip
"""Buttons of each kind in the order of their bits, the lowest first. Those of xr and gamepad are in
the order of the standard mappings (WebXR Gamepads Module; Gamepad, "standard")."""


class JogTwist(NamedTuple):
    """Velocity command for the TCP: m/s and rad/s along the axes of `frame`."""

    linear: Vector3
    angular: Vector3
    frame: Frame = Frame.BASE


class JogJoints(NamedTuple):
    """Velocity command for the joints in the arm's order: rad/s, of prismatic ones m/s."""

    rates: tuple[float, ...]


class PhoneFrame(NamedTuple):
    """A phone's sensors and touches of its screen."""

    angles_deg: Vector3 | None
    """alpha, beta and gamma of the DeviceOrientationEvent; None: no sensor, or no permission."""
    drag_right: float = 0.0
    drag_up: float = 0.0
    """Displacement of the second finger since it touched the screen, along the upright screen; 1 is
    a third of the shorter side."""
    rates_rad_s: Vector3 | None = None
    """Angular rates about the phone's x (right), y (top edge) and z (out of the screen)."""
    acceleration_m_s2: Vector3 | None = None
    """Specific force along the same axes: at rest 9.81 upwards."""
    buttons: int = 0
    screen_quarters: int = 0
    """screen.orientation.angle in quarter turns."""
    reference: int = 0
    """Reference of the angles: the page's count of references, modulo 256."""


class XrFrame(NamedTuple):
    """A controller or the viewer, in the axes of WebXR: x right, y up, -z forward."""

    part: BodyPart
    position_m: Vector3
    orientation: Quaternion
    buttons: int = 0
    stick_right: float = 0.0
    stick_down: float = 0.0
    trigger: float = 0.0
    squeeze: float = 0.0
    reference: int = 0
    """Reference of the pose: the page's count of sessions and their resets, modulo 256."""


class GamepadFrame(NamedTuple):
    """A gamepad of the Gamepad API with the standard mapping."""

    left_right: float
    left_down: float
    right_right: float
    right_down: float
    left_trigger: float = 0.0
    right_trigger: float = 0.0
    buttons: int = 0


Body = JogTwist | JogJoints | PhoneFrame | XrFrame | GamepadFrame


class OperatorFrame(NamedTuple):
    """State of a device on a page."""

    body: Body
    hold: bool
    """True while the dead-man control is held."""
    tracking: bool = True
    """True while the sensors know the device's position."""
    visible: bool = True
    """True while the page is visible."""
    channel: int = 0
    """Purpose for which the page has opened it."""
    sequence: int = 0
    """Count of the page's frames, modulo 2**32."""
    time_us: int = 0
    """The page's monotonic time, µs."""

    @property
    def kind(self) -> str:
        """One of: jog twist, jog joints, phone, xr, gamepad."""
        return _WORDS[type(self.body)]

    @property
    def held_buttons(self) -> tuple[str, ...]:
        """Names of the pressed buttons; empty for jog."""
        body = self.body
        if isinstance(body, (JogTwist, JogJoints)):
            return ()
        return tuple(name for bit, name in enumerate(BUTTONS[self.kind]) if body.buttons >> bit & 1)


class MalformedFrame(NamedTuple):
    """Bytes that are no frame."""

    reason: str


_WORDS: Final = {
    JogTwist: "jog twist",
    JogJoints: "jog joints",
    PhoneFrame: "phone",
    XrFrame: "xr",
    GamepadFrame: "gamepad",
}

_TWIST_KIND, _JOINTS_KIND, _PHONE_KIND, _GAMEPAD_KIND = 1, 2, 3, 7
_MISSING = (math.nan, math.nan, math.nan)


# -- encoding -------------------------------------------------------------------------------------


def encode_frame(frame: OperatorFrame) -> bytes:
    """Encode a frame as bytes. Raises struct.error for numbers out of range."""
    kind, body = _encoded(frame.body)
    flags = _HOLD * frame.hold | _TRACKING * frame.tracking | _VISIBLE * frame.visible
    head = _HEADER.pack(VERSION, kind, flags, frame.channel, frame.sequence, frame.time_us)
    return head + body


def _encoded(body: Body) -> tuple[int, bytes]:
    if isinstance(body, JogTwist):
        frame = _FRAMES.index(body.frame)
        return _TWIST_KIND, _TWIST.pack(frame, *body.linear, *body.angular)
    if isinstance(body, JogJoints):
        count = len(body.rates)
        return _JOINTS_KIND, _JOINTS.pack(count) + struct.pack(f"<{count}f", *body.rates)
    if isinstance(body, PhoneFrame):
        return _PHONE_KIND, _PHONE.pack(
            *(body.angles_deg or _MISSING),
            body.drag_right,
            body.drag_up,
            *(body.rates_rad_s or _MISSING),
            *(body.acceleration_m_s2 or _MISSING),
            body.buttons,
            body.screen_quarters,
            body.reference,
        )
    if isinstance(body, XrFrame):
        w, x, y, z = body.orientation
        sticks = body.stick_right, body.stick_down, body.trigger, body.squeeze
        rest = body.buttons, body.reference, *sticks
        return int(body.part), _XR.pack(*body.position_m, x, y, z, w, *rest)
    return _GAMEPAD_KIND, _GAMEPAD.pack(*body)


# -- decoding -------------------------------------------------------------------------------------


def decode_frame(data: bytes) -> OperatorFrame | MalformedFrame:
    """Decode the frame in `data`. Never raises."""
    if len(data) < _HEADER.size:
        return MalformedFrame(f"{len(data)} bytes, fewer than a header has")
    version, kind, flags, channel, sequence, time_us = _HEADER.unpack_from(data)
    if version != VERSION:
        return MalformedFrame(
            f"of version {version:#04x}, and this server reads {VERSION:#04x}: reload the page"
        )
    if flags & ~_KNOWN_FLAGS:
        return MalformedFrame(f"with flags {flags:#04x}, of which some are unknown")
    if time_us > LONGEST_US:
        return MalformedFrame("with an impossible time")
    body = _decoded(kind, data[_HEADER.size :])
    if isinstance(body, MalformedFrame):
        return body
    hold, tracking, visible = (bool(flags & bit) for bit in (_HOLD, _TRACKING, _VISIBLE))
    return OperatorFrame(body, hold, tracking, visible, channel, sequence, time_us)


def _decoded(kind: int, data: bytes) -> Body | MalformedFrame:
    if kind == _JOINTS_KIND:
        return _joints(data)
    layout = {_TWIST_KIND: _TWIST, _PHONE_KIND: _PHONE, _GAMEPAD_KIND: _GAMEPAD}.get(kind)
    if kind in _PARTS:
        layout = _XR
    if layout is None:
        return MalformedFrame(f"of the kind {kind}, which is unknown")
    if len(data) != layout.size:
        return MalformedFrame(f"of the kind {kind} with {len(data)} bytes, not {layout.size}")
    values = layout.unpack(data)
    if kind == _TWIST_KIND:
        return _twist(values)
    if kind == _PHONE_KIND:
        return _phone(values)
    if not _fine(values):
        return _NO_NUMBERS
    if kind == _GAMEPAD_KIND:
        return GamepadFrame(*values)
    return _xr(BodyPart(kind), values)


_PARTS: Final = frozenset(BodyPart)
_NO_NUMBERS: Final = MalformedFrame("with numbers that are invalid or too large")


def _fine(values: tuple[float, ...]) -> bool:
    # Integers have too few bits to be too large.
    return all(isinstance(value, int) or abs(value) <= LARGEST for value in values)


def _twist(values: tuple[float, ...]) -> JogTwist | MalformedFrame:
    frame, *numbers = values
    if not _fine(tuple(numbers)):
        return _NO_NUMBERS
    if frame >= len(_FRAMES):
        return MalformedFrame(f"with the frame {frame}; there are 0 base, 1 tool, 2 mixed")
    linear, angular = Vector3(*numbers[:3]), Vector3(*numbers[3:])
    return JogTwist(linear, angular, _FRAMES[int(frame)])


def _joints(data: bytes) -> JogJoints | MalformedFrame:
    count = data[0] if data else 0
    if not 0 < count <= MAX_JOINTS or len(data) != _JOINTS.size + 4 * count:
        return MalformedFrame(f"with {count} joints in {len(data)} bytes")
    rates = struct.unpack_from(f"<{count}f", data, _JOINTS.size)
    return JogJoints(rates) if _fine(rates) else _NO_NUMBERS


def _phone(values: tuple[float, ...]) -> PhoneFrame | MalformedFrame:
    right, up, buttons, quarters = values[3], values[4], int(values[11]), int(values[12])
    triples = [_triple(values[at : at + 3]) for at in (0, 5, 8)]
    if not _fine((right, up)) or any(isinstance(each, MalformedFrame) for each in triples):
        return _NO_NUMBERS
    if quarters > 3:
        return MalformedFrame(f"with a screen that is turned by {quarters} quarters")
    angles, rates, acceleration = (
        None if isinstance(each, MalformedFrame) else each for each in triples
    )
    return PhoneFrame(angles, right, up, rates, acceleration, buttons, quarters, int(values[13]))


def _triple(values: tuple[float, ...]) -> Vector3 | MalformedFrame | None:
    if all(map(math.isnan, values)):
        return None
    return Vector3(*values) if _fine(values) else _NO_NUMBERS


def _xr(part: BodyPart, values: tuple[float, ...]) -> XrFrame | MalformedFrame:
    x, y, z, w = values[3:7]
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not 0.99 < length < 1.01:
        return MalformedFrame(f"with an orientation of the length {length:.3g}, not 1")
    orientation = Quaternion(w / length, x / length, y / length, z / length)
    buttons, reference = int(values[7]), int(values[8])
    right, down, trigger, squeeze = values[9:]
    return XrFrame(
        part, Vector3(*values[:3]), orientation, buttons, right, down, trigger, squeeze, reference
    )
