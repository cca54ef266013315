"""Requirements for a Leap Motion tracking service, in version 6 of its protocol."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

from cardan.conform.requirements import Requirements, Verdict, failed, not_seen, passed
from cardan_leap.conform.decoded import LeapTraffic
from cardan_leap.protocol import (
    DeviceEvent,
    Hand,
    Ignored,
    Malformed,
    Version,
)

LEAPJS = "leapmotion/leapjs, PROTOCOL.md and lib/protocol.js"
SDK = "Leap Motion documentation, API overview"
UNITS = f"{SDK}: mm, in the tracker's axes; {LEAPJS}"

ASKED_VERSION = 6
RATE_HZ = (20.0, 200.0)
SILENT_S = 0.1
REACH_MM = 1000.0
"""A tracker sees 600 mm far."""
UNIT = 0.05
CONFIDENCE = 0.3
STILL_MM_S = 3000.0
CLOCK_SHARE = 0.02
FRAMES = ("empty", "enter", "hand", "leave", "focused")

requires: Requirements[LeapTraffic] = Requirements("LEAP")
_NO_FRAMES = "no frames were asked for"


def _bad(
    found: Iterable[tuple[int, str]], of: int, good: str, nothing: str = _NO_FRAMES
) -> Verdict:
    wrong = list(found)
    if wrong:
        return failed(f"{len(wrong)} of {of}: {wrong[0][1]}", (n for n, _ in wrong))
    return passed(good) if of else not_seen(nothing)


@requires(1, f"{LEAPJS}: any path /vN.json of a version that it knows")
def the_service_accepts(decoded: LeapTraffic) -> Verdict:
    """The service takes a connection that asks for version 6, and keeps it."""
    return (
        failed(decoded.ended[0][1], (n for n, _ in decoded.ended))
        if decoded.ended
        else passed("kept")
    )


@requires(2, f"{LEAPJS}: the first message")
def the_version_comes_first(decoded: LeapTraffic) -> Verdict:
    """The first message is the version, 1 to 6, with the service's own."""
    if not decoded.said:
        return failed("nothing came")
    first = decoded.said[0]
    if not isinstance(first.value, Version):
        return failed(f"a {type(first.value).__name__} came first", [first.number])
    said = f"version {first.value.version}, service {first.value.service_version or 'unknown'}"
    good = 1 <= first.value.version <= ASKED_VERSION
    return passed(said) if good else failed(said, [first.number])


@requires(3, f"{LEAPJS}: a device event for each tracker, since version 5")
def the_tracker_is_reported(decoded: LeapTraffic) -> Verdict:
    """A device event says that a tracker is attached and streams."""
    found = [each for each in decoded.during("listen") if isinstance(each.value, DeviceEvent)]
    if not found:
        return failed("none came")
    event = found[-1].value
    assert isinstance(event, DeviceEvent)
    said = f"{event.type}, attached {event.attached}, streaming {event.streaming}"
    good = event.attached and event.streaming
    return passed(said) if good else failed(said, [found[-1].number])


@requires(4, f"{LEAPJS}: frames need the focus or background")
def nobody_is_sent_frames_unasked(decoded: LeapTraffic) -> Verdict:
    """Before it is asked it sends no frames."""
    found = [each.number for each in decoded.frames("listen")]
    if not decoded.said:
        return not_seen("nothing came")
    return failed(f"{len(found)} frames", found) if found else passed("none came")


@requires(5, f"{LEAPJS}: one JSON object in each text message")
def messages_are_objects(decoded: LeapTraffic) -> Verdict:
    """Every message is one JSON object, and its parts are of their types."""
    wrong = [
        (each.number, f"a message {each.value.reason}")
        for each in decoded.said
        if isinstance(each.value, Malformed)
    ]
    return _bad(wrong, len(decoded.said), f"{len(decoded.said)} messages", "nothing came")


@requires(6, f"{LEAPJS}: version, event, frame")
def kinds_are_known(decoded: LeapTraffic) -> Verdict:
    """Every message is a version, an event or a frame."""
    wrong = [
        (each.number, f"keys {', '.join(each.value.keys)}")
        for each in decoded.said
        if isinstance(each.value, Ignored)
    ]
    return _bad(wrong, len(decoded.said), f"{len(decoded.said)} messages", "nothing came")


@requires(101, f"{LEAPJS}, background: frames without the focus")
def frames_come_in_the_background(decoded: LeapTraffic) -> Verdict:
    """Asked to in the background it sends frames, without a hand, too."""
    if decoded.phase("empty") is None:
        return not_seen(_NO_FRAMES)
    found = decoded.frames("empty")
    hands = [each.number for each in found if each.value.hands]
    if hands:
        return failed("there is a hand in them", hands)
    return passed(f"{len(found)} frames") if found else failed("none came")


@requires(102, f"{SDK}: 20 to 200 a second by mode and load")
def the_rate_is_a_trackers(decoded: LeapTraffic) -> Verdict:
    """Frames come 20 to 200 times a second."""
    found = decoded.frames("hand")
    if len(found) < 10:
        return not_seen("fewer than 10 frames")
    rate = (len(found) - 1) / (found[-1].time_s - found[0].time_s)
    said = f"{rate:.0f} a second"
    return passed(said) if RATE_HZ[0] <= rate <= RATE_HZ[1] else failed(said)


@requires(103, f"{LEAPJS}: without hands frames go on, empty")
def frames_do_not_cease(decoded: LeapTraffic) -> Verdict:
    """Once they come, frames are never missing for more than 0.1 s."""
    count, longest, wrong = 0, 0.0, []
    for name in FRAMES:
        phase, found = decoded.phase(name), decoded.frames(name)
        if phase is None:
            continue
        count += len(found)
        start_s = phase.start_s if name != "empty" else (found[0].time_s if found else phase.end_s)
        times = [start_s, *(each.time_s for each in found), phase.end_s]
        for n, (a, b) in enumerate(pairwise(times)):
            longest = max(longest, b - a)
            if b - a > SILENT_S:
                at = found[min(n, len(found) - 1)].number if found else phase.first
                wrong.append((at, f"{(b - a) * 1e3:.0f} ms"))
    if wrong:
        said = f"{len(wrong)} silences: {wrong[0][1]}"
        return failed(said, (n for n, _ in wrong), longest * 1e3, "ms")
    if not count:
        return not_seen("no frames came")
    return passed(f"longest {longest * 1e3:.0f} ms", longest * 1e3, "ms")


def _ids(decoded: LeapTraffic) -> list[tuple[int, int, int]]:
    """Number of the event, and the frame ids before it and in it."""
    found = [(each.number, each.value.id) for each in decoded.frames(*FRAMES)]
    known = [(number, frame_id) for number, frame_id in found if frame_id is not None]
    return [(number, before, after) for (_, before), (number, after) in pairwise(known)]


@requires(104, f"{SDK}, Frame.id")
def frame_ids_go_up(decoded: LeapTraffic) -> Verdict:
    """A frame's id is higher than that of the frame before."""
    found = _ids(decoded)
    wrong = ((n, f"{after} after {before}") for n, before, after in found if after <= before)
    return _bad(wrong, len(found), f"{len(found)} frames")


@requires(105, f"{SDK}, Frame.id: consecutive where no frame is dropped")
def frames_are_not_left_out(decoded: LeapTraffic) -> Verdict:
    """Of the frames that the ids count, no more than 2 % are left out."""
    found = [(n, after - before - 1) for n, before, after in _ids(decoded) if after > before]
    if not found:
        return not_seen(_NO_FRAMES)
    lost = sum(count for _, count in found)
    share = lost / (lost + len(found))
    said = f"{100 * share:.1f} %"
    if share > 0.02:
        return failed(said, (n for n, count in found if count), share * 100, "%")
    return passed(said, share * 100, "%")


@requires(106, f"{LEAPJS}, timestamp: microseconds of the service's clock")
def the_clock_runs(decoded: LeapTraffic) -> Verdict:
    """Time stamps advance as time does, to 2 %."""
    found = [(e, e.value.timestamp_us) for e in decoded.frames("hand")]
    stamps = [(each, stamp) for each, stamp in found if stamp is not None]
    if len(stamps) < 10:
        return not_seen("fewer than 10 frames")
    (one, first), (other, last) = stamps[0], stamps[-1]
    share = (last - first) * 1e-6 / (other.time_s - one.time_s)
    said = f"{100 * share:.1f} %"
    return passed(said) if abs(share - 1.0) < CLOCK_SHARE else failed(said, [other.number])


def _hands(decoded: LeapTraffic) -> list[tuple[int, float, Hand]]:
    return [(e.number, e.time_s, hand) for e in decoded.frames("hand") for hand in e.value.hands]


_NO_HAND = "no hand was held above the tracker"


@requires(107, f"{LEAPJS}: id, palmPosition, palmNormal and direction of every hand")
def hands_are_whole(decoded: LeapTraffic) -> Verdict:
    """Every hand has an id, a palm and its directions, all of them numbers."""
    found = decoded.frames("enter", "hand")
    wrong = [(e.number, "it cannot be read") for e in found if e.value.unreadable_hands]
    count = sum(len(each.value.hands) + each.value.unreadable_hands for each in found)
    return _bad(wrong, count, f"{count} hands", _NO_HAND)


@requires(108, UNITS)
def hands_are_in_reach(decoded: LeapTraffic) -> Verdict:
    """A hand is no further than 1 m from the tracker, and above it."""
    found = _hands(decoded)
    wrong = []
    for number, _, hand in found:
        x, y, z = hand.palm_position_mm
        if math.hypot(x, y, z) > REACH_MM or y < 0.0:
            wrong.append((number, f"at {x:.0f}, {y:.0f}, {z:.0f} mm"))
    return _bad(wrong, len(found), f"{len(found)} hands", _NO_HAND)


@requires(109, f"{SDK}: out of the palm, and towards the fingers")
def directions_are_units(decoded: LeapTraffic) -> Verdict:
    """The palm's normal and the fingers' direction have the length 1, and are square to each other,
    all to 5 %."""
    found = _hands(decoded)
    wrong = []
    for number, _, hand in found:
        n, d = hand.palm_normal, hand.direction
        lengths = (math.hypot(*n), math.hypot(*d))
        dot = sum(a * b for a, b in zip(n, d, strict=True))
        if any(abs(each - 1.0) > UNIT for each in lengths) or abs(dot) > UNIT:
            wrong.append((number, f"lengths {lengths[0]:.2f}, {lengths[1]:.2f}, product {dot:.2f}"))
    return _bad(wrong, len(found), f"{len(found)} hands", _NO_HAND)


@requires(110, f"{SDK}, Hand.id: kept while it is seen")
def a_hand_keeps_its_id(decoded: LeapTraffic) -> Verdict:
    """A hand that is held still keeps its id."""
    found = _hands(decoded)
    wrong = [
        (number, f"{other.id} after {one.id}")
        for (_, _, one), (number, _, other) in pairwise(found)
        if other.id != one.id
    ]
    return _bad(wrong, len(found), f"{len(found)} hands", _NO_HAND)


@requires(111, f"{SDK}, Hand.confidence: how well the model fits")
def a_plain_hand_is_recognized(decoded: LeapTraffic) -> Verdict:
    """A hand that is held still and flat is seen with a confidence of 0.3 and more."""
    found = [(number, hand.confidence) for number, _, hand in _hands(decoded)]
    reported = [(number, value) for number, value in found if value is not None]
    wrong = ((number, f"{value:.2f}") for number, value in reported if value < CONFIDENCE)
    return _bad(wrong, len(reported), f"{len(reported)} hands", _NO_HAND)


@requires(112, f"{SDK}: x right, y up, z towards the operator; palm down is (0, -1, 0)")
def axes_have_their_signs(decoded: LeapTraffic) -> Verdict:
    """A right hand with its palm down is called right, and its normal points down, its fingers
    away."""
    found = _hands(decoded)
    if not found:
        return not_seen(_NO_HAND)
    number, _, hand = found[len(found) // 2]
    said = f"{hand.type}, normal y {hand.palm_normal.y:.2f}, direction z {hand.direction.z:.2f}"
    good = hand.type == "right" and hand.palm_normal.y < -0.7 and hand.direction.z < -0.7
    return passed(said) if good else failed(said, [number])


@requires(113, f"{LEAPJS}, device events on each change")
def the_tracker_stays(decoded: LeapTraffic) -> Verdict:
    """The tracker does not cease to stream while it is used."""
    found = [e for e in decoded.during("listen", *FRAMES) if isinstance(e.value, DeviceEvent)]
    wrong = [
        each.number
        for each in found
        if isinstance(each.value, DeviceEvent) and not each.value.streaming
    ]
    if decoded.phase("empty") is None:
        return not_seen(_NO_FRAMES)
    return failed("an event says that it did", wrong) if wrong else passed("it did not")


@requires(114, f"{LEAPJS}, focused and background")
def without_both_there_are_no_frames(decoded: LeapTraffic) -> Verdict:
    """Without focus and background it sends no frames any more."""
    if decoded.phase("unheard") is None or not decoded.frames(*FRAMES):
        return not_seen(_NO_FRAMES)
    found = [each.number for each in decoded.frames("unheard")]
    return failed(f"{len(found)} frames", found) if found else passed("none came")


@requires(301, f"{LEAPJS}, device events on each change")
def unplugging_is_reported(decoded: LeapTraffic) -> Verdict:
    """The tracker unplugged, an event says so, and no more frames come."""
    found = [e for e in decoded.during("unplug") if isinstance(e.value, DeviceEvent)]
    gone = [e for e in found if isinstance(e.value, DeviceEvent) and not e.value.streaming]
    if not gone:
        return not_seen("no event reported it")
    after = [each.number for each in decoded.frames("unplug") if each.number > gone[-1].number]
    return failed(f"{len(after)} frames after it", after) if after else passed("reported")
