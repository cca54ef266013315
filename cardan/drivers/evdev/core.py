"""Base interpreter of a Linux input device's events, without any I/O.

The kernel reports changes only, so silence while deflected is normal. The known state stays valid
while the reader finds no waiting events and the device present; the time of that check, or of the
newest event, is the stamp of the state.

Until the first frame of a device that was plugged in or opened, the kernel reports zeros, whatever
is deflected. The state therefore counts only from that frame on, and buttons that it shows pressed
count after a release. When events were lost (SYN_DROPPED, garbled packets), the device's state is
read as a whole, and the device counts again once it is seen at rest.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from cardan.drivers.core import DeviceCore
from cardan.drivers.evdev.nodes import EvdevDeviceInfo, EvdevState
from cardan.protocols.evdev.events import (
    EV_ABS,
    EV_KEY,
    EV_MAX,
    EV_SYN,
    KEY_DOWN,
    KEY_UP,
    SYN_DROPPED,
    SYN_REPORT,
    InputEvent,
    MalformedPacket,
    decode_events,
)
from cardan.protocols.evdev.requests import BUS_BLUETOOTH
from cardan.types import NEVER_S, DeviceLink

UNREAD_AFTER_S = 0.09
"""Time without a read after which a deflected device does not count any more, s. The limit is 0.1
s; the difference is for one cycle of the reader."""

LONGEST_FRAME = 256
"""Most events between two SYN_REPORT; no device sends more."""

FRAME_WITHIN_S = 0.05
"""Longest frame, s: the kernel delivers frames whole, so a longer one is garbled."""

DROPPED_REASON = "the system dropped its events, since they were not read in time"
GARBLED_REASON = "it sent bytes that are not events"
UNREAD_REASON = f"deflected, but not read for {UNREAD_AFTER_S:g} s: this computer is too busy"
UNANSWERED_REASON = f"deflected, but the simulated device hangs for {UNREAD_AFTER_S:g} s"


class EvdevCore(DeviceCore):
    """The state of one device. Times are monotonic, s."""

    _counters: ClassVar[Mapping[str, str]] = {
        "dropped": "times the system dropped events that were not read in time",
        "garbled": "packets that are not events, ignored",
        "overlong_frames": "frames without an end, ignored",
        "silences": "silences while deflected",
    }

    def __init__(self, touch_words: str, release_words: str, stale_after_s: float = 0.0) -> None:
        super().__init__()
        self._touch_words = touch_words
        """Instruction that makes an untouched device report ("press any button once")."""
        self._release_words = release_words
        """Instruction that brings the device to rest ("release the sticks")."""
        self._stale_after_s = stale_after_s
        self.description = EvdevDeviceInfo("", 0, 0, frozenset(), {}, frozenset())
        self.needs_snapshot = False
        """True: the known state is void until `on_snapshot`."""
        self._down: set[int] = set()
        self._values: dict[int, int] = {}
        self._frame: list[InputEvent] = []
        self._frame_s = NEVER_S
        self._skipping = False
        """True after SYN_DROPPED, until the end of the frame."""
        self._unanswered = False
        """True while a request for a sign of life is unanswered."""
        self._event_s = NEVER_S

    # -- defined by the kind of device ------------------------------------------------------------

    _radio_words: ClassVar[str]
    """Warning about a radio link that is lost while the device is deflected, and its remedy."""

    @abstractmethod
    def _labels(self) -> list[str]:
        """Labels of the buttons that are down."""

    @abstractmethod
    def _away_from_rest(self) -> str:
        """Name of the deflected control; empty at rest."""

    @abstractmethod
    def _on_description(self) -> None:
        """React to a new `description`."""

    def _on_key(self, code: int, pressed: bool, now_s: float) -> None:
        """React to a key's press or release, which `_down` already shows."""

    # -- events of the device ---------------------------------------------------------------------

    def on_opened(self, description: EvdevDeviceInfo, snapshot: EvdevState, now_s: float) -> None:
        """Start after the device was opened (again) and its values were read: earlier state is
        void."""
        self.description = description
        self._on_description()
        self._open = True
        self._skipping = self._heard = self._unanswered = False
        self._renew(snapshot, "not heard of yet", now_s)

    def on_snapshot(self, snapshot: EvdevState, now_s: float) -> None:
        """Replace the state by `snapshot`, read from the device since events had been lost."""
        if self._open:
            self._renew(snapshot, self._reason, now_s)

    def on_packet(self, data: bytes, now_s: float) -> None:
        """Process the events of one read. Never raises."""
        if not self._open:
            return
        events = decode_events(data)
        if isinstance(events, MalformedPacket):
            self._void("garbled", GARBLED_REASON, now_s)
            return
        if any(event.type > EV_MAX for event in events):
            self._void("garbled", GARBLED_REASON, now_s)
            return
        self.on_checked(now_s)
        for event in events:
            if event.type != EV_SYN:
                if not self._skipping:
                    if not self._frame:
                        self._frame_s = now_s
                    self._frame.append(event)
            elif event.code == SYN_REPORT:
                if not self._skipping:
                    self._take(now_s)
                self._frame.clear()
                self._skipping = False
            elif event.code == SYN_DROPPED:
                self._void("dropped", DROPPED_REASON, now_s)
                self._skipping = True
        if len(self._frame) > LONGEST_FRAME or (
            self._frame and now_s - self._frame_s > FRAME_WITHIN_S
        ):
            self._void("overlong_frames", GARBLED_REASON, now_s)

    def on_checked(self, now_s: float) -> None:
        """Record that the device is present and all its events have been read."""
        if not self._open:
            return
        self._watch(now_s)
        self._stamp_s = now_s
        self._unanswered = False
        self._cached = None
        if self._link is DeviceLink.STALE and self._reason in (UNREAD_REASON, UNANSWERED_REASON):
            self._link = DeviceLink.NEEDS_NEUTRAL
            self._settle()

    def on_unanswered(self, now_s: float) -> None:
        """Handle a request for a sign of life that was not answered in time."""
        self._unanswered = True

    @property
    def has_to_answer(self) -> bool:
        """True if the device must show that it is present: it is deflected, or was when it fell
        silent."""
        if self._link is DeviceLink.LIVE:
            return bool(self._buttons.held or self._away_from_rest())
        return self._link is DeviceLink.STALE

    def _figures(self, now_s: float) -> dict[str, float]:
        return {"event_age_s": now_s - self._event_s, "checked_age_s": now_s - self._stamp_s}

    def _notes(self, now_s: float) -> list[str]:
        by_radio = self._open and self.description.bustype == BUS_BLUETOOTH
        return [self._radio_words] if by_radio and not self._stale_after_s else []

    # -- inside --------------------------------------------------------------------------------

    def _take(self, now_s: float) -> None:
        """Apply a whole frame."""
        if not self._frame or self.needs_snapshot:
            return
        first = not self._heard
        for event in self._frame:
            if event.type == EV_ABS and event.code in self._values:
                self._values[event.code] = event.value
            elif event.type == EV_KEY and event.value in (KEY_UP, KEY_DOWN):
                pressed = event.value == KEY_DOWN
                (self._down.add if pressed else self._down.discard)(event.code)
                self._on_key(event.code, pressed, now_s)
                if not first:
                    self._buttons.set(self._labels(), now_s)
            else:
                continue
            self._event_s = now_s
            self._heard = True
            if self._link is DeviceLink.STALE:
                self._link = DeviceLink.NEEDS_NEUTRAL
        if first and self._heard:
            self._buttons.mask(self._labels())
        self._buttons.set(self._labels(), now_s)
        self._settle()

    def _settle(self) -> None:
        """Accept a device that is seen at rest: link LIVE."""
        self._cached = None
        if (
            self._link is DeviceLink.NEEDS_NEUTRAL
            and self._heard
            and not (self.needs_snapshot or self._away_from_rest())
        ):
            self._link, self._reason = DeviceLink.LIVE, ""

    def _watch(self, now_s: float) -> None:
        if self._link is not DeviceLink.LIVE:
            return
        if now_s - self._stamp_s > UNREAD_AFTER_S:
            if self._buttons.held or self._away_from_rest():
                self._fall_silent(UNANSWERED_REASON if self._unanswered else UNREAD_REASON, now_s)
        elif 0.0 < self._stale_after_s < now_s - self._event_s and self._away_from_rest():
            self._fall_silent(
                f"deflected, but no event for {self._stale_after_s:g} s (stale_after_s)", now_s
            )

    def _why(self) -> str:
        if self._link is not DeviceLink.NEEDS_NEUTRAL:
            return self._reason
        away = self._away_from_rest()
        todo = f"{self._release_words} ({away})" if away else self._touch_words
        return f"{self._reason}: {todo}"

    def _void(self, counter: str, reason: str, now_s: float) -> None:
        """Void the state after lost events: request the device's values, and wait for rest."""
        self._counts[counter] += 1
        self._frame.clear()
        self.needs_snapshot = True
        self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, reason, now_s)

    def _renew(self, snapshot: EvdevState, reason: str, now_s: float) -> None:
        """Restart from the device's current values."""
        self._frame.clear()
        self.needs_snapshot = False
        self._down = {*snapshot.keys}
        self._values = dict(snapshot.values)
        self._stamp_s = now_s
        self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, reason, now_s)
        # Buttons that were held, and are released by now, count again.
        self._buttons.set(self._labels(), now_s)
        self._settle()

    def _end(self, link: DeviceLink, reason: str, now_s: float) -> None:
        self._down.clear()
        self._values.clear()
        self._frame.clear()
        self._heard = self.needs_snapshot = False
        super()._end(link, reason, now_s)

    def _drop_input(self, now_s: float) -> None:
        # A pressed button counts again after a release.
        self._buttons.mask(self._labels())
