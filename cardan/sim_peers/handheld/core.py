"""Frames of a page with a moved device, without I/O and in virtual time.

The device aligns once; then a script moves it by six deflections. Rotations are at most 30°;
translations are a drag of the second finger (phone), or at most 10 cm (XR).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal

from cardan.protocols.handheld.frames import (
    BUTTONS,
    BodyPart,
    OperatorFrame,
    PhoneFrame,
    XrFrame,
    encode_frame,
)
from cardan.protocols.handheld.orientation import orientation_to_xr, position_to_xr, to_angles
from cardan.sim_peers.base import FaultSwitch, TimedActions
from cardan.sim_peers.periodic import PERIODIC_FAULTS, HeldModel, HeldPeriodicDevice
from cardan.spatial import add, conjugate, from_rotation_vector, multiply, rotate, scale
from cardan.types import Quaternion, Vector3

HandheldKind = Literal["phone", "xr"]

FAULTS: Final = (
    *PERIODIC_FAULTS,
    FaultSwitch("null", "the sensors report nothing from VALUE s on", 3.0),
    FaultSwitch("lost", "the tracking is lost from VALUE s on", 3.0),
    FaultSwitch("hidden", "the page is hidden from VALUE s on", 3.0),
    FaultSwitch("jump", "the device jumps by half a meter and a right angle at VALUE s", 3.0),
    FaultSwitch(
        "recenter", "the reference frame is reset at VALUE s, and turned by a right angle", 3.0
    ),
    FaultSwitch(
        "stuck", "the control counts as held from VALUE s on, whatever the device does", 3.0
    ),
    FaultSwitch("late", "every frame is VALUE s on its way", 0.2),
    FaultSwitch.share("nan", "share of frames with a number that is NaN"),
)

PERIOD_S: Final = 1.0 / 60.0
"""Browsers draw, and sensors speak, 60 times a second."""

FULL_TURN_RAD: Final = math.radians(30.0)
FULL_WAY_M: Final = 0.1

NORTH_RAD: Final = 1.0
"""Heading of the robot's x axis in the device's first reference, which is arbitrary."""

ALIGNS_S: Final = 0.1
"""Time for which Align is pressed at the beginning."""

STANDS: Final = Vector3(0.3, 0.1, 1.2)
"""Position of the device at rest, m."""

HOLD: Final = "hold"


class SimulatedHandheld(HeldPeriodicDevice[bytes]):
    """Page and its device, which a script deflects (-1..1, robot frame)."""

    def __init__(
        self,
        kind: HandheldKind,
        faults: Mapping[str, float],
        seed: int = 0,
        part: BodyPart = BodyPart.RIGHT,
    ) -> None:
        super().__init__(PERIOD_S, faults, FAULTS)
        self.kind, self.part = kind, part
        names = [HOLD, *(each for each in BUTTONS[kind] if each != "align")]
        self.model = HeldModel(kind, dict(enumerate(names)))
        self.tracking = self.visible = self.senses = True
        self.stuck = self.jumped = False
        self.aligns_until_s = ALIGNS_S
        self.age_s = faults.get("late", 0.0)
        """Transmission time of each frame."""
        self._nan = faults.get("nan", 0.0)
        self._bad = 0.0
        self._sequence = 0
        self._reference = 0
        """Incremented at each new reference, as by the page."""
        self._north_rad = NORTH_RAD
        """Heading of the robot's x axis in the device's reference."""
        self._actions = TimedActions(
            faults,
            {
                "null": self.lose_sensors,
                "lost": self.lose_tracking,
                "hidden": self.hide,
                "jump": self.jump,
                "recenter": self.recenter,
                "stuck": self.stick,
            },
        )

    # -- device states ----------------------------------------------------------------------------

    def replug(self) -> None:
        """Open the page again, and press Align."""
        super().replug()
        self.align()

    def align(self) -> None:
        """Press Align."""
        self.aligns_until_s = self.next_due_s + ALIGNS_S

    def lose_sensors(self) -> None:
        """Stop the reports of the sensors."""
        self.senses = False

    def lose_tracking(self) -> None:
        """Lose the tracking."""
        self.tracking = False

    def hide(self) -> None:
        """Hide the page."""
        self.visible = False

    def jump(self) -> None:
        """Offset the tracked pose from now on."""
        self.jumped = True

    def recenter(self, turn_rad: float = 0.5 * math.pi, *, reported: bool = True) -> None:
        """Report all poses in another reference from now on, as after a headset's recentering.

        `reported`: the browser says so.
        """
        self._north_rad += turn_rad
        self._reference += reported

    def stick(self) -> None:
        """Hold the control permanently."""
        self.stuck = True

    # -- frames ---------------------------------------------------------------------------------

    def reports(self, now_s: float) -> list[bytes]:
        """Return the frames that the page sends from the last call until `now_s`."""
        for _, action in self._actions.due(now_s):
            action()
        return super().reports(now_s)

    def report(self) -> bytes:
        """Return the frame that the page sends now."""
        self._sequence += 1
        frame = OperatorFrame(
            self._phone() if self.kind == "phone" else self._xr(),
            HOLD in self.held or self.stuck,
            self.tracking and (self.senses or self.kind == "phone"),
            self.visible,
            sequence=self._sequence % 2**32,
            time_us=round(1e6 * self.next_due_s),
        )
        data = bytearray(encode_frame(frame))
        self._bad += self._nan
        if self._bad >= 1.0:
            self._bad -= 1.0
            data[16:20] = b"\0\0\xc0\x7f"  # Only the first number is NaN.
        return bytes(data)

    @property
    def _buttons(self) -> int:
        names = BUTTONS[self.kind]
        down = [*self.held, *(("align",) if self.next_due_s < self.aligns_until_s else ())]
        return sum(1 << names.index(each) for each in down if each != HOLD)

    @property
    def _north(self) -> Quaternion:
        """Return the rotation from the robot's axes to the reference's."""
        half = 0.5 * self._north_rad
        return Quaternion(math.cos(half), 0.0, 0.0, math.sin(half))

    @property
    def _turn(self) -> Quaternion:
        """Return the rotation of the device along the reference's axes."""
        turn = scale(Vector3(*self.axes[3:]), FULL_TURN_RAD)
        q = from_rotation_vector(rotate(self._north, turn))
        if self.jumped:
            q = multiply(q, from_rotation_vector(Vector3(0.5 * math.pi, 0.0, 0.0)))
        return q

    def _phone(self) -> PhoneFrame:
        # Flat, its top edge (y) along the robot's x axis.
        half = 0.5 * (self._north_rad - 0.5 * math.pi)
        q = multiply(self._turn, Quaternion(math.cos(half), 0.0, 0.0, math.sin(half)))
        drag = rotate(conjugate(q), rotate(self._north, Vector3(*self.axes[:3])))
        angles = Vector3(*to_angles(q)) if self.senses else None
        up = scale(rotate(conjugate(q), Vector3(0.0, 0.0, 1.0)), 9.81)
        return PhoneFrame(
            angles,
            drag.x,
            drag.y,
            Vector3(0.0, 0.0, 0.0),
            up,
            self._buttons,
            reference=self._reference % 256,
        )

    def _xr(self) -> XrFrame:
        way = rotate(self._north, scale(Vector3(*self.axes[:3]), FULL_WAY_M))
        if self.jumped:
            way = add(way, Vector3(0.5, 0.0, 0.0))
        q = orientation_to_xr(multiply(self._turn, self._north))
        position = position_to_xr(add(STANDS, way))
        return XrFrame(self.part, position, q, self._buttons, reference=self._reference % 256)
