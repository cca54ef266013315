"""Core of the Leap driver: tracking messages to device state; no I/O, time is an argument. Frames
continue while no hand is in view, so silence is always a fault:

- Without a frame for `STALE_AFTER_S` the link is STALE; a tracker that the service calls unplugged
  is LOST, one that sends no data is STALE, whatever else arrives.
- Late frames (see :mod:`.lag`) are rejected: the link is STALE while they arrive, and the age of an
  accepted frame counts from when it should have arrived.
- After opening and after a fault the link is NEEDS_NEUTRAL until a frame shows no hand whose
  present posture could hold the clutch: no hand at all, or a hand that is open (clutch "grab"),
  with thumb and fingers apart ("pinch"), or closed ("open").
- The hand's pose and the button "clutch" appear and disappear together, in the same state.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from cardan.drivers.core import DeviceCore
from cardan.types import NEVER_S, DeviceLink, Pose
from cardan_leap.driver.lag import Lag
from cardan_leap.driver.options import LeapOptions
from cardan_leap.driver.tracking import COUNTERS as TRACKING_COUNTERS, HandTracker
from cardan_leap.protocol import (
    SKELETON_SINCE,
    DeviceEvent,
    Malformed,
    ServiceMessage,
    TrackingFrame,
    Version,
)

BUTTONS = ("hand", "clutch", "grab", "pinch")
"""Buttons that the driver reports: a hand is followed, it holds the clutch, it is a fist, it
pinches."""

STALE_AFTER_S = 0.09
"""Silence, or delay of a frame, after which the link is STALE: ten frames at the usual rate. The
state must be neutral within 0.1 s; the difference is for one cycle of the reader."""

CONNECT_ANEW_S = 3.0
"""Time of late frames after which the driver reconnects, which drops the queue that delays them."""

SETTLE_S = 0.02
"""Time after a silence in which frames may be old ones that were queued meanwhile."""

LONGEST_STEP_S = 0.1
"""Longest time step assumed between two frames of one hand."""

RESTARTED_AFTER = 10
"""Number of successive frames, too old but in order, after which the service's counter counts as
restarted."""

OPENED_REASON = "connected, no frame yet"

LATE_REASON = (
    f"frames come more than {STALE_AFTER_S:g} s late: is the network slow, or one of the "
    "machines busy?"
)

NEUTRAL_REASONS: Mapping[str, str] = MappingProxyType(
    {
        "still": "take the hand out of view once",
        "open": "close the hand, or take it out of view, once",
        "grab": "open the hand once",
        "pinch": "let go of the pinch once",
    }
)
"""Advice for releasing the clutch once before it works, by the option `clutch`."""


class LeapCore(DeviceCore):
    """State of one tracking service. Times are monotonic, s."""

    _counters: ClassVar[Mapping[str, str]] = {
        "silences": f"silences of more than {STALE_AFTER_S:g} s",
        "late_frames": f"frames that came more than {STALE_AFTER_S:g} s late",
        "clock_changes": "times the service's clock was set back",
        "undated": "frames without a time stamp",
        "old_frames": "frames that are not newer than the one before",
        **TRACKING_COUNTERS,
    }

    def __init__(self, options: LeapOptions) -> None:
        super().__init__()
        self._options = options
        self._tracker = HandTracker(options, self._counts)
        self._frames = 0
        self._lag = Lag()
        self._was_late = False
        """True if the newest frame was late and no later one was in time, on any connection."""
        self._lag_s = 0.0
        self._late_since_s: float | None = None
        """Time since which every frame has been late; None: the newest was not."""
        self._forget_service()

    def _forget_service(self) -> None:
        self.version: Version | None = None
        """Version that the service reported."""
        self._devices: dict[str, DeviceEvent] = {}
        self._stamp_s = NEVER_S
        self._silent_since_s = 0.0
        self._ignore_rest_until_s = NEVER_S
        self._frame_id: int | None = None
        self._timestamp_us: int | None = None
        self._old_id = 0
        self._old_run = 0
        self._rate_hz: float | None = None

    # -- what happens --------------------------------------------------------------------------

    def on_opened(self, now_s: float) -> None:
        """Discard the service's state after a (new) connection."""
        self._forget_service()
        if not self._was_late:  # Otherwise the clock may be the same, and its frames late again.
            self._lag.reset()
        self._late_since_s = None
        self._silent_since_s = now_s
        self._begin(OPENED_REASON, now_s)

    def on_message(self, message: ServiceMessage, now_s: float) -> None:
        """Process a message of `decode_service`, received at `now_s`. Never raises."""
        if not self._open:
            return
        if isinstance(message, TrackingFrame):
            self._on_frame(message, now_s)
        elif isinstance(message, Malformed):
            self._malformed[f"messages {message.reason}"] += 1
        elif isinstance(message, DeviceEvent):
            self._on_device(message, now_s)
        elif isinstance(message, Version):
            self.version = message

    # -- what it says --------------------------------------------------------------------------

    def failure(self, now_s: float) -> str:
        """Return why the driver must reconnect; empty if there is no reason."""
        late_since_s = self._late_since_s
        if late_since_s is None or now_s - late_since_s <= CONNECT_ANEW_S:
            return ""
        return f"frames have come late for {CONNECT_ANEW_S:g} s, now by {self._lag_s:.1f} s"

    def _pose(self) -> Pose | None:
        return self._tracker.pose

    def _figures(self, now_s: float) -> dict[str, float]:
        return {
            "frame_age_s": now_s - self._stamp_s,
            "frame_lag_s": self._lag_s,
            "service_rate_hz": self._rate_hz or 0.0,
            "frames": self._frames,
            "malformed_messages": self._malformed.total(),
        }

    def _notes(self, now_s: float) -> list[str]:
        words = [self._tracker.hint] if self._tracker.hint else []
        if self._heard and self.version is not None and self.version.version < SKELETON_SINCE:
            words.append(
                f"the service speaks version {self.version.version}, without left and right, grab "
                'and pinch: only hand = "first" with clutch = "still" works'
            )
        return words

    # -- inside --------------------------------------------------------------------------------

    def _on_device(self, event: DeviceEvent, now_s: float) -> None:
        self._devices[event.id] = event
        devices = self._devices.values()
        if any(device.attached and device.streaming for device in devices):
            if self._link in (DeviceLink.LOST, DeviceLink.STALE):
                self._silent_since_s = now_s
                self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, OPENED_REASON, now_s)
        elif any(device.attached for device in devices):
            self._invalidate_input(
                DeviceLink.STALE,
                "the tracker sends no frames: tracking is paused, or it is held up by USB",
                now_s,
            )
        else:
            self._invalidate_input(
                DeviceLink.LOST, "the tracker is unplugged: plug it into this machine", now_s
            )

    @property
    def _delivers(self) -> bool:
        """Return True if no tracker is listed by the service, or at least one delivers frames."""
        devices = self._devices.values()
        return not devices or any(device.attached and device.streaming for device in devices)

    def _on_frame(self, frame: TrackingFrame, now_s: float) -> None:
        self._watch(now_s)
        if frame.timestamp_us is None:  # Its age is not known.
            self._counts["undated"] += 1
            return
        if not self._is_new(frame.id):
            self._counts["old_frames"] += 1
            if self._old_run == RESTARTED_AFTER and self._link is DeviceLink.LIVE:
                self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, OPENED_REASON, now_s)
            return
        if self._lag.is_another_clock(frame.timestamp_us):
            self._counts["clock_changes"] += 1
            self._lag.reset()
            if self._link is DeviceLink.LIVE:
                self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, OPENED_REASON, now_s)
                self._ignore_rest_until_s = now_s + SETTLE_S
        step_s = self._step_s(frame.timestamp_us, now_s)
        self._lag_s = self._lag.update(frame.timestamp_us, now_s)
        self._frames += 1
        self._heard = True
        self._rate_hz = frame.current_frame_rate_hz
        if not self._delivers:
            return
        if self._lag_s > STALE_AFTER_S:
            self._on_late(now_s)
            return
        self._late_since_s = None
        self._was_late = False
        self._stamp_s = self._silent_since_s = now_s - self._lag_s
        if self._link is DeviceLink.STALE:
            self._resume(self._reason, SETTLE_S, now_s)
        live = self._link is DeviceLink.LIVE
        self._tracker.on_frame(frame, now_s, step_s, may_engage=live)
        if not live:
            # Whether the hand was closed on purpose is not known: it has to be seen open first.
            self._buttons.mask([label for label in self._labels() if label != BUTTONS[0]])
            self._reason = NEUTRAL_REASONS[self._options.clutch]
            if self._tracker.at_rest and now_s >= self._ignore_rest_until_s:
                self._link = DeviceLink.LIVE
        self._show(now_s)

    def _on_late(self, now_s: float) -> None:
        """Process a late frame: it shows a past position of the hand."""
        self._counts["late_frames"] += 1
        self._was_late = True
        if self._late_since_s is None:
            self._late_since_s = now_s
        if self._reason is not LATE_REASON or self._link is not DeviceLink.STALE:
            self._invalidate_input(DeviceLink.STALE, LATE_REASON, now_s)

    def _is_new(self, frame_id: int | None) -> bool:
        """Return True if a frame is newer than the newest; detects a restarted counter of the
        service."""
        last = self._frame_id
        if frame_id is None:
            return True
        if last is None or frame_id > last:
            self._frame_id, self._old_run = frame_id, 0
            return True
        self._old_run = self._old_run + 1 if frame_id > self._old_id else 1
        self._old_id = frame_id
        if self._old_run >= RESTARTED_AFTER:
            self._frame_id = None
        return False

    def _step_s(self, timestamp_us: int, now_s: float) -> float:
        """Return the time since the previous frame: by the service's clock if that is plausible,
        otherwise by ours."""
        last_us, self._timestamp_us = self._timestamp_us, timestamp_us
        if last_us is not None:
            step_s = (timestamp_us - last_us) * 1e-6
            if 0.0 < step_s <= LONGEST_STEP_S:
                return step_s
        return min(max(0.0, now_s - self._stamp_s), LONGEST_STEP_S)

    def _watch(self, now_s: float) -> None:
        """Check for silence of the service, or of its data about the hand."""
        if self._link not in (DeviceLink.LIVE, DeviceLink.NEEDS_NEUTRAL):
            return
        if now_s - self._silent_since_s > STALE_AFTER_S:
            self._fall_silent(
                f"no frame for {STALE_AFTER_S:g} s: is a tracker plugged in, tracking on, and "
                "the service alive?",
                now_s,
            )
        elif self._tracker.watch(now_s):
            self._show(now_s)

    def _show(self, now_s: float) -> None:
        """Set the buttons from the tracker's data."""
        self._buttons.set(self._labels() if self._link is DeviceLink.LIVE else (), now_s)
        self._cached = None

    def _labels(self) -> list[str]:
        tracker = self._tracker
        flags = (tracker.id is not None, tracker.engaged, tracker.grabbing, tracker.pinching)
        return [label for label, held in zip(BUTTONS, flags, strict=True) if held]

    def _drop_input(self, now_s: float) -> None:
        # Up, not masked: no operator releases `hand`, and the others are masked at the next frame.
        self._buttons.set((), now_s)
        self._tracker.drop()
