"""Selection of the operator's hand among those in view, its pose, and its clutch."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType

from cardan.spatial import norm, rotation_between, subtract
from cardan.types import IDENTITY_POSE, ZERO3, Pose
from cardan_leap.driver.options import LeapOptions
from cardan_leap.driver.smoothing import PoseFilter
from cardan_leap.protocol import Hand, TrackingFrame, hand_orientation, position_from_leap

LOST_AFTER_S = 0.1
"""A hand without a usable measurement for longer than this is lost."""

STRONG, WEAK = 0.8, 0.3
"""Strengths with hysteresis: a grab or pinch begins at STRONG and ends below WEAK."""

CLOSING = 0.5
"""An open hand that grabs more strongly than this releases the clutch."""

STILL_M, STILL_S = 0.005, 0.3
"""Bounds of a still hand: it has stayed within STILL_M of one place for STILL_S; the tremor of a
hand and the tracker's noise are some 2 mm, and a hand that passes by at more than 17 mm/s goes
farther."""

REACH_M = 1.0
"""Distance from the tracker beyond which a palm's measurement is invalid."""

JUMP_M, JUMP_SPEED_M_S = 0.1, 3.0
"""Distance and speed beyond which a palm's motion since its last measurement is implausible:
another object was taken for it."""

FLIP_RAD, FLIP_SPEED_RAD_S = 0.8, 15.0
"""The same for its orientation: trackers confuse the palm and the back of a hand."""

COUNTERS: Mapping[str, str] = MappingProxyType(
    {
        "hands_lost": f"times a hand in view was not measured for {LOST_AFTER_S:.1f} s",
        "absurd": f"hands beyond {REACH_M:g} m or without an attitude",
        "jumps": "hands that jumped or flipped over",
        "unsure": "hands with too low a confidence",
        "unreadable": "hands without id, palm, direction, or a confidence in 0..1",
    }
)
"""Counters, and the text of each."""


class HandTracker:
    """Tracker of a hand by its id, from its selection to its loss.

    Nothing carries over to the next hand: a new id must engage the clutch again. Times are the
    local monotonic ones of reception, s. Faults are counted in `counts`.
    """

    def __init__(self, options: LeapOptions, counts: Counter[str]) -> None:
        self._options = options
        self._filter = PoseFilter(options.cutoff_hz, options.cutoff_rise_1_m, options.max_speed_m_s)
        self._counts = counts
        self.hint = ""
        """Reason why no hand in view is used; empty when one is, or none is in view."""
        self.at_rest = False
        """True if the newest frame shows no hand whose present posture could hold the clutch."""
        self._seen: dict[int, float] = {}
        self._forget()

    def _forget(self) -> None:
        self.id: int | None = None
        """Id of the followed hand; None: no hand is followed."""
        self.pose: Pose | None = None
        """Pose of that hand, smoothed: operator's axes, m."""
        self.engaged = False
        """True if that hand holds the clutch."""
        self.grabbing = False
        self.pinching = False
        self._armed = False
        self._measured_s = 0.0
        self._raw = IDENTITY_POSE
        self._place = ZERO3
        self._place_s = 0.0
        self._filter.reset()

    def drop(self) -> None:
        """Discard every hand: the frames cannot be trusted."""
        self._forget()
        self._seen.clear()
        self.at_rest = False
        self.hint = ""

    def watch(self, now_s: float) -> bool:
        """Lose the hand if it was not measured for too long; return True then."""
        if self.id is None or now_s - self._measured_s <= LOST_AFTER_S:
            return False
        self._counts["hands_lost"] += 1
        self._forget()
        return True

    def on_frame(self, frame: TrackingFrame, now_s: float, dt_s: float, may_engage: bool) -> None:
        """Process a frame that came `dt_s` after the previous one."""
        self._counts["unreadable"] += frame.unreadable_hands
        self.watch(now_s)
        self.hint = ""
        followed: Hand | None = None
        """The hand in this frame, if it was measured."""
        if self.id is not None:
            newest = next((hand for hand in frame.hands if hand.id == self.id), None)
            if newest is not None and self._is_meant(newest):
                pose = self._measure(newest, now_s)
                if pose is not None:
                    followed = newest
                    self._take(newest, pose, now_s, dt_s, may_engage)
            elif newest is not None or not frame.unreadable_hands:
                self._forget()
        self._remember(frame, now_s)
        if self.id is None:
            followed = self._choose(frame, now_s)
            if followed is not None:
                self._take(followed, self._lock(followed, now_s), now_s, dt_s, may_engage)
        self.at_rest = self._is_at_rest(frame, followed)

    # -- selection of the hand -------------------------------------------------------------------

    def _is_meant(self, hand: Hand) -> bool:
        return self._options.hand in ("first", hand.type)

    def _remember(self, frame: TrackingFrame, now_s: float) -> None:
        """Record since when each hand has been in view."""
        if not frame.hands and not self._seen:
            return
        before = self._seen
        self._seen = {hand.id: before.get(hand.id, now_s) for hand in frame.hands}

    def _choose(self, frame: TrackingFrame, now_s: float) -> Hand | None:
        """Select the hand to follow from now on."""
        best: Hand | None = None
        best_key = (math.inf, 0)
        options = self._options
        for hand in frame.hands:
            if not self._is_meant(hand):
                kind = f"a {hand.type} hand" if hand.type else "a hand that may be left or right"
                self.hint = f"{kind} is in view, but hand is {options.hand!r}"
                continue
            if hand.confidence is not None and hand.confidence < options.min_confidence:
                self.hint = f"the hand is seen with a confidence of only {hand.confidence:.2f}"
                continue
            since_s = self._seen[hand.id]
            visible_s = now_s - since_s if hand.time_visible_s is None else hand.time_visible_s
            if visible_s < options.min_visible_s or not _is_sound(hand):
                continue
            if (since_s, hand.id) < best_key:
                best, best_key = hand, (since_s, hand.id)
        if best is not None:
            self.hint = ""
        return best

    def _lock(self, hand: Hand, now_s: float) -> Pose:
        self._forget()
        self.id = hand.id
        orientation = hand_orientation(hand.direction, hand.palm_normal)
        assert orientation is not None, "chosen hands have an orientation"
        self._place = position_from_leap(hand.palm_position_mm)
        self._place_s = now_s
        return Pose(self._place, orientation)

    # -- pose -----------------------------------------------------------------------------------

    def _measure(self, hand: Hand, now_s: float) -> Pose | None:
        """Return the hand's pose; None if it is implausible."""
        if hand.confidence is not None and hand.confidence < self._options.min_confidence:
            self._counts["unsure"] += 1
            self.hint = f"the hand is seen with a confidence of only {hand.confidence:.2f}"
            return None
        position = position_from_leap(hand.palm_position_mm)
        orientation = hand_orientation(hand.direction, hand.palm_normal)
        if orientation is None or norm(position) > REACH_M:
            self._counts["absurd"] += 1
            return None
        elapsed_s = max(0.0, now_s - self._measured_s)
        moved_m = norm(subtract(position, self._raw.position))
        turned_rad = norm(rotation_between(self._raw.orientation, orientation))
        if (
            moved_m > JUMP_M + JUMP_SPEED_M_S * elapsed_s
            or turned_rad > FLIP_RAD + FLIP_SPEED_RAD_S * elapsed_s
        ):
            self._counts["jumps"] += 1
            return None
        return Pose(position, orientation)

    def _take(self, hand: Hand, raw: Pose, now_s: float, dt_s: float, may_engage: bool) -> None:
        self._measured_s = now_s
        self._raw = raw
        self.pose = self._filter(raw, dt_s)
        grab, pinch = hand.grab_strength, hand.pinch_strength
        self.grabbing = _holds(grab, self.grabbing)
        # In a fist the thumb touches the fingers, too; that is not a pinch.
        self.pinching = _holds(pinch, self.pinching) and (self.pinching or not self.grabbing)
        self._clutch(grab, pinch, now_s, may_engage)

    # -- clutch ---------------------------------------------------------------------------------

    def _clutch(
        self, grab: float | None, pinch: float | None, now_s: float, may_engage: bool
    ) -> None:
        clutch = self._options.clutch
        if clutch == "still":
            self.engaged = may_engage and (self.engaged or self._is_still(now_s))
        elif clutch == "open":
            self._clutch_open(grab, now_s, may_engage)
        else:
            strength = grab if clutch == "grab" else pinch
            holding = self.grabbing if clutch == "grab" else self.pinching
            # A hand that comes into view as a fist has not closed in view.
            self._armed = self._armed or (strength is not None and strength < WEAK)
            self.engaged = may_engage and self._armed and holding

    def _clutch_open(self, grab: float | None, now_s: float, may_engage: bool) -> None:
        if grab is None or not may_engage or grab > CLOSING:
            self.engaged = False
        if not self.engaged:
            if grab is None or grab >= WEAK:
                self._place, self._place_s = self._raw.position, now_s
            self.engaged = self._is_still(now_s) and may_engage

    def _is_still(self, now_s: float) -> bool:
        if norm(subtract(self._raw.position, self._place)) > STILL_M:
            self._place, self._place_s = self._raw.position, now_s
        return now_s - self._place_s >= STILL_S

    def _is_at_rest(self, frame: TrackingFrame, followed: Hand | None) -> bool:
        if followed is None:
            return not frame.unreadable_hands and not any(
                self._is_meant(hand) or not hand.type for hand in frame.hands
            )
        clutch = self._options.clutch
        if clutch == "still":
            return False
        if clutch == "open":
            return followed.grab_strength is None or followed.grab_strength >= STRONG
        strength = followed.grab_strength if clutch == "grab" else followed.pinch_strength
        return strength is None or strength < WEAK


def _is_sound(hand: Hand) -> bool:
    return (
        norm(position_from_leap(hand.palm_position_mm)) <= REACH_M
        and hand_orientation(hand.direction, hand.palm_normal) is not None
    )


def _holds(strength: float | None, before: bool) -> bool:
    if strength is None:
        return False
    return strength >= (WEAK if before else STRONG)
