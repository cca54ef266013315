"""Interpreter of a handheld device's frames, without any I/O and in the caller's time.

Frames come 30 to 60 times a second, whether or not the device moves, and each says whether the
operator holds the dead-man control. Silence is therefore always a fault. After any interruption
other than a release, the device counts again only once the dead-man control was seen released:

- A hidden page, lost tracking, a missing sensor, or a position jump: the link is NEEDS_NEUTRAL,
  deflections are zero, buttons released.
- No frame that is young enough: STALE. The page that published has left: LOST.
- Of two pages on one topic, the first one heard counts, while it sends.

An alignment belongs to one reference. When the reference has changed, or may have (by the page,
after a position jump, or after lost tracking), the alignment is void and must be repeated.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

from cardan.drivers.handheld.options import HandheldOptions, PhoneOptions, XrOptions
from cardan.drivers.ros2_nodes.core import BusCore
from cardan.drivers.shaping import Deflections, Shaper
from cardan.protocols.handheld.frames import (
    BUTTONS,
    MalformedFrame,
    OperatorFrame,
    PhoneFrame,
    XrFrame,
    decode_frame,
)
from cardan.protocols.handheld.motion import (
    Held,
    PoseSample,
    Yaw,
    drag_on_screen,
    elsewhere,
    jump,
    pitched,
)
from cardan.protocols.handheld.orientation import from_angles, orientation_from_xr, position_from_xr
from cardan.spatial import add, rotate, scale, subtract
from cardan.types import (
    NEUTRAL,
    ZERO3,
    Axes,
    DeviceLink,
    Inertia,
    Pose,
    Vector3,
)

FRAME_TYPE = "cardan_msgs/msg/OperatorFrame"

HOLD = "hold"
"""The dead-man control as a button."""
ALIGN = "align"

NOT_ALIGNED = "not aligned"

SETTLE_S = 0.016
"""Time after a silence in which a release does not count, s: it may be in queued frames."""

OLDEST_S = 3600.0
"""Largest age of a frame."""


class TrackedPose(NamedTuple):
    """Position and orientation of the device in a frame."""

    sample: PoseSample
    reference: int
    """Number of its reference, counted by the page."""
    drag: Vector3 = ZERO3
    """Motion of the second finger along the reference's axes; 1 is a third of the screen."""


class HandheldCore(BusCore):
    """State of a handheld device."""

    message_type = FRAME_TYPE

    _counters: ClassVar[Mapping[str, str]] = {
        "silences": "silences of the page",
        "late": "duplicate or late frames, ignored",
        "old": "frames that the network delayed too much, ignored",
        "jumps": "jumps of the tracking",
        "others": "frames of a second page on the same topic, ignored: close one of the two",
    }

    kind: ClassVar[str]
    """Kind of its frames."""
    no_sensor: ClassVar[str]
    """Reason why a device whose link is fine has no position, with advice."""
    to_align: ClassVar[str]
    """Instruction for aligning with the robot's x axis; follows the reason in messages."""

    def __init__(self, options: HandheldOptions) -> None:
        super().__init__()
        self._hand_options = options
        self._shaper = Shaper(options)
        self._full_rad = math.radians(options.full_turn_deg)
        self._asks = options.heading == "asked"
        self._yaw: Yaw | None = None
        self._unaligned = NOT_ALIGNED
        """Reason why there is no alignment."""
        self._reading: TrackedPose | None = None
        self._placed: TrackedPose | None = None
        """Last known position."""
        self._interrupted = False
        """True if tracking or the link was lost since then."""
        self._held: Held | None = None
        """Set while the dead-man control is held and counts."""
        self._dragged = ZERO3
        """Sum of all drags along the robot's axes, m."""

    @property
    def labels(self) -> tuple[str, ...]:
        return (HOLD, *(each for each in BUTTONS[self.kind] if each != ALIGN))

    @abstractmethod
    def _read(self, frame: OperatorFrame) -> TrackedPose | None:
        """Return the position in a frame of this device; None if it has none."""

    @abstractmethod
    def _heading(self, reading: TrackedPose) -> Yaw:
        """Direction in which it points."""

    def _is_mine(self, frame: OperatorFrame) -> bool:
        """True if a frame of this kind is from the selected hand."""
        return True

    def on_opened(self, now_s: float) -> None:
        self._forget_sender(now_s)
        self._on_other_sender()
        self._begin("let go of the control on the page once", now_s)

    def _on_other_sender(self) -> None:
        # A new page has another reference, in which the robot's place is unknown.
        self._yaw, self._unaligned = None, NOT_ALIGNED
        self._reading = self._placed = None
        self._dragged = ZERO3

    # -- frames --------------------------------------------------------------------------------

    def _on_data(self, data: bytes, now_s: float) -> None:
        if (message := self._decoded(data)) is None:
            return
        age_s = message["age"]
        if not 0.0 <= age_s <= OLDEST_S:
            self._on_malformed("with an age that is out of range")
            return
        frame = decode_frame(bytes(message["frame"]))
        if isinstance(frame, MalformedFrame):
            self._on_malformed(frame.reason)
            return
        if frame.kind != self.kind:
            self._on_malformed(f"of the kind {frame.kind}, not {self.kind}")
            return
        if not self._is_mine(frame):
            return
        if frame.hold and age_s > self._hand_options.stale_after_s:
            self._counts["old"] += 1
            return
        self._take(frame, age_s, now_s)

    def _take(self, frame: OperatorFrame, age_s: float, now_s: float) -> None:
        if self._link is DeviceLink.STALE:
            self._resume("the page fell silent: let go of the control once", SETTLE_S, now_s)
            self._interrupted = True
        self._heard, self._stamp_s = True, now_s
        self._last_s = max(self._last_s, now_s - age_s)
        self._reading = self._read(frame)
        before = self._placed
        why = self._why_not(frame)
        if why:
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, why, now_s)
            if frame.hold:
                self._buttons.mask((HOLD,))
            return
        assert self._reading is not None
        down = frame.held_buttons
        if ALIGN in down and not frame.hold:
            self._yaw = self._heading(self._reading)
        buttons = [each for each in down if each != ALIGN]
        self._buttons.set([HOLD, *buttons] if frame.hold else buttons, now_s)
        if self._link is DeviceLink.NEEDS_NEUTRAL:
            self._settle(frame, now_s)
        self._grasp(frame, before)
        self._cached = None

    def _why_not(self, frame: OperatorFrame) -> str:
        """Return why the device does not count; empty if it does."""
        if not frame.visible:
            why = "the page is hidden: show it, and let go of the control once"
        elif not frame.tracking:
            why = "the tracking is lost: hold still, and let go of the control once"
        elif self._reading is None:
            why = self.no_sensor
        else:
            return self._moved(self._reading)
        self._interrupted = True
        return why

    def _moved(self, reading: TrackedPose) -> str:
        """Return why the device cannot have moved there; empty if it can."""
        before, self._placed = self._placed, reading
        interrupted, self._interrupted = self._interrupted, False
        if before is None:
            return ""
        if reading.reference != before.reference:
            why = "the page's reference frame was reset"
        elif interrupted:
            # The device or its reference has moved; which of them is unknown.
            if elsewhere(before.sample, reading.sample):
                self._unalign("the device was lost and is found elsewhere")
            return ""
        elif why := jump(before.sample, reading.sample):
            self._counts["jumps"] += 1
        else:
            return ""
        self._unalign(why)
        return f"{why}: let go of the control once"

    def _unalign(self, why: str) -> None:
        """Void the alignment."""
        if self._yaw is not None:
            self._yaw, self._unaligned = None, f"not aligned any more, since {why}"

    def _settle(self, frame: OperatorFrame, now_s: float) -> None:
        if self._asks and self._yaw is None:
            self._reason = f"{self._unaligned}: {self.to_align}"
        elif frame.hold:
            self._reason = "let go of the control on the page once"
        elif now_s >= self._ignore_rest_until_s:
            self._link = DeviceLink.LIVE

    def _grasp(self, frame: OperatorFrame, before: TrackedPose | None) -> None:
        """Begin, continue or end the hold."""
        reading = self._reading
        assert reading is not None
        if not frame.hold or self._link is not DeviceLink.LIVE:
            self._held = None
            return
        if self._held is None:
            if not self._asks:
                self._yaw = self._heading(reading)
            self._held = Held(reading.sample)
        if before is not None and self._yaw is not None:
            self._drag(before.drag, reading.drag)

    def _drag(self, before: Vector3, now: Vector3) -> None:
        """Process a motion of the second finger."""

    # -- output -----------------------------------------------------------------------------------

    def _watch(self, now_s: float) -> None:
        stale_s = self._hand_options.stale_after_s
        silent = now_s - self._last_s > stale_s
        if self._open and silent and self._link is not DeviceLink.STALE:
            self._fall_silent(
                f"no frame for {1e3 * stale_s:.0f} ms: is the page open and shown, and the network "
                "good?",
                now_s,
            )

    def _drop_input(self, now_s: float) -> None:
        self._held = None

    def _translation(self) -> Vector3:
        """Return the translation since the hold began, as deflections along the reference's
        axes."""
        raise NotImplementedError

    def _axes(self, now_s: float) -> Axes:
        held, reading, yaw = self._held, self._reading, self._yaw
        if held is None or reading is None or yaw is None:
            return NEUTRAL
        way = yaw.vector(self._translation())
        turn = scale(yaw.vector(held.turn(reading.sample)), 1.0 / self._full_rad)
        x, y, z, roll, pitch, yawing = (max(-1.0, min(1.0, each)) for each in (*way, *turn))
        deflections: Deflections = (x, y, z, roll, pitch, yawing)
        return self._shaper(deflections)


class PhoneCore(HandheldCore):
    """A phone: its orientation, and the drag of a second finger."""

    kind = "phone"
    no_sensor = (
        "the phone reports no orientation: press Start on the page and allow its sensors (they "
        "need https), and let go of the control once"
    )
    to_align = "point the phone's top edge along the robot's x axis, and press Align on the page"

    def __init__(self, options: PhoneOptions) -> None:
        super().__init__(options)
        self._drag_m = options.drag_m
        self._sensed: Inertia | None = None

    def _read(self, frame: OperatorFrame) -> TrackedPose | None:
        body = frame.body
        assert isinstance(body, PhoneFrame)
        self._sensed = _inertia_of(body)
        if body.angles_deg is None:
            return None
        q = from_angles(*body.angles_deg)
        drag = drag_on_screen(body.drag_right, body.drag_up, body.screen_quarters)
        return TrackedPose(PoseSample(1e-6 * frame.time_us, q), body.reference, rotate(q, drag))

    def _heading(self, reading: TrackedPose) -> Yaw:
        return Yaw.of_phone(reading.sample.orientation)

    def _translation(self) -> Vector3:
        reading = self._reading
        return ZERO3 if reading is None else reading.drag

    def _drag(self, before: Vector3, now: Vector3) -> None:
        # Lifting the finger does not undo its drag.
        if any(now) and self._yaw is not None:
            way = scale(self._yaw.vector(subtract(now, before)), self._drag_m)
            self._dragged = add(self._dragged, way)

    def _pose(self) -> Pose | None:
        reading, yaw = self._reading, self._yaw
        if reading is None or yaw is None:
            return None
        return Pose(self._dragged, yaw.orientation(reading.sample.orientation))

    def _inertia(self, now_s: float) -> Inertia | None:
        heard = self._open and self._link is not DeviceLink.STALE
        return self._sensed if heard else None


class XrCore(HandheldCore):
    """A controller or the viewer of a WebXR session."""

    kind = "xr"
    no_sensor = "the device reports no position"
    to_align = (
        "point along the robot's x axis, and press the stick or touchpad (of a phone: "
        "Align on the page)"
    )

    def __init__(self, options: XrOptions) -> None:
        super().__init__(options)
        self._part = options.part
        self._full_way_m = options.full_way_m
        self._grip_rad = math.radians(options.grip_deg)

    def _is_mine(self, frame: OperatorFrame) -> bool:
        body = frame.body
        return isinstance(body, XrFrame) and body.part.word == self._part

    def _read(self, frame: OperatorFrame) -> TrackedPose | None:
        body = frame.body
        assert isinstance(body, XrFrame)
        # The frame has the direction of the grip's axis; the device points below it.
        q = pitched(orientation_from_xr(body.orientation), -self._grip_rad)
        sample = PoseSample(1e-6 * frame.time_us, q, position_from_xr(body.position_m))
        return TrackedPose(sample, body.reference)

    def _heading(self, reading: TrackedPose) -> Yaw:
        return Yaw.of_xr(reading.sample.orientation)

    def _translation(self) -> Vector3:
        if self._held is None or self._reading is None:
            return ZERO3
        return scale(self._held.way(self._reading.sample), 1.0 / self._full_way_m)

    def _pose(self) -> Pose | None:
        reading, yaw = self._reading, self._yaw
        if reading is None or yaw is None or reading.sample.position is None:
            return None
        position = yaw.vector(reading.sample.position)
        return Pose(position, yaw.orientation(reading.sample.orientation))


def _inertia_of(body: PhoneFrame) -> Inertia | None:
    """Convert to x forward, y left, z up of a phone that lies in front of the operator."""
    force, rates = body.acceleration_m_s2, body.rates_rad_s
    if force is None:
        return None
    turned = None if rates is None else Vector3(rates.y, -rates.x, rates.z)
    return Inertia(Vector3(force.y, -force.x, force.z), turned)
