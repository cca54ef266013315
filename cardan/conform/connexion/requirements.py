"""Requirements of a 3Dconnexion device that speaks HID."""

from __future__ import annotations

from itertools import pairwise, takewhile
from typing import Any

from cardan.conform.connexion.decoded import ConnexionTraffic, DeviceReport
from cardan.conform.requirements import (
    Findings,
    Over,
    Requirements,
    Verdict,
    Words,
    at_most,
    failed,
    met,
    must,
    not_applicable,
    passed,
    some,
)
from cardan.conform.second_reading import read_twice
from cardan.conform.timing import never_silent
from cardan.protocols.connexion import devices, reports
from cardan.protocols.connexion.reports import (
    BATTERY_ID,
    HALF_BYTES,
    KEY_ARRAY_BYTES,
    KEYS_DOWN_ID,
    LONG_PRESS_BITS_ID,
    LONG_PRESS_ID,
    LONGEST_BUTTONS_BYTES,
    MOTION_BYTES,
)
from cardan.protocols.hid import UNKNOWN_ID, MalformedReport

DESCRIPTOR = "report descriptors of the devices (docs/spacemouse.md)"
SPACENAVD = "FreeSpacenav spacenavd, src/dev_usb_linux.c"
RATE = "captures of SpaceNavigator and SpaceMouse Wireless"

PERIOD_S = {devices.Family.SPLIT: 0.008, devices.Family.ONE: 0.016}
PERIOD_TOLERANCE = 0.15
LINK_LOST_S = 0.1
"""Six periods: after this silence of a deflected device a driver considers it gone."""
LENGTHS = {
    BATTERY_ID: {3},
    KEYS_DOWN_ID: {KEY_ARRAY_BYTES},
    LONG_PRESS_ID: {KEY_ARRAY_BYTES},
    LONG_PRESS_BITS_ID: {5},
    1: {HALF_BYTES, MOTION_BYTES},
    2: {HALF_BYTES},
    3: set(range(2, LONGEST_BUTTONS_BYTES + 1)),
}
LOW_PERCENT = 10
ZEROS_AT_MOST = 8
HELD = ("push-held", "twist-held")

_NOTHING = "no reports came"
requires: Requirements[ConnexionTraffic] = Requirements("HID3D", _NOTHING)


@requires(1, "the system's HID driver")
def it_can_be_opened(decoded: ConnexionTraffic) -> Verdict:
    """The device can be opened to be read."""
    return failed("it was refused", decoded.refused) if decoded.refused else passed("opened")


@requires(2, RATE)
def deflection_is_reported(decoded: ConnexionTraffic) -> Verdict:
    """Deflected, it sends motion reports."""
    some(not decoded.refused and decoded.phase("push-held"), "it was never deflected")
    found = [each for each in decoded.during("push", "push-held") if any(each.counts)]
    return passed(f"{len(found)} reports") if found else failed("none came")


REPORTS: Over[ConnexionTraffic, DeviceReport] = Over(lambda decoded: decoded.reports, "{} reports")


@requires.each(3, DESCRIPTOR, REPORTS)
def report_ids_are_known(each: DeviceReport) -> str:
    """Reports have the ids 1, 2, 3, 16h, 17h, 1Ch and 1Dh, and no others."""
    bad = each.value if isinstance(each.value, MalformedReport) else None
    return f"id {bad.report_id:#04x}" if bad and bad.reason == UNKNOWN_ID else ""


@requires.each(4, DESCRIPTOR, REPORTS)
def reports_are_not_short(each: DeviceReport) -> str:
    """No report is shorter than its id has it, and every value is one that it can have."""
    bad = each.value if isinstance(each.value, MalformedReport) else None
    return f"id {bad.report_id:#04x}, {bad.reason}" if bad and bad.reason != UNKNOWN_ID else ""


@requires.each(5, DESCRIPTOR, REPORTS)
def reports_are_not_padded(each: DeviceReport) -> str:
    """No report is longer than its id has it."""
    size = len(each.raw)
    long = each.raw and size > max(LENGTHS.get(each.raw[0], {size}))
    return f"id {each.raw[0]:#04x} with {size} bytes" if long else ""


@requires(6, f"{DESCRIPTOR}: ids 1 and 2 of 7 bytes, or id 1 of 13")
def the_family_is_one(decoded: ConnexionTraffic) -> Verdict:
    """All motion comes in halves (ids 1 and 2), or all of it whole (id 1 of 13 bytes)."""
    motions = some(decoded.motions, _NOTHING)
    whole = [isinstance(each.value, reports.MotionReport) for each in motions]
    odd = [each.number for each, one in zip(motions, whole, strict=True) if one != whole[0]]
    return failed("both kinds come", odd) if odd else passed("whole" if whole[0] else "halves")


@requires(7, "device tables of spacenavd, Blender and PySpaceMouse")
def the_family_is_the_models(decoded: ConnexionTraffic) -> Verdict:
    """Motion comes as the model sends it, which its vendor and product id say."""
    if decoded.model is None:
        return not_applicable("its model is not known")
    family = some(decoded.family, _NOTHING)
    said = f"{decoded.model.name}: {family.value}"
    return met(family is decoded.model.family, said, [decoded.motions[0].number])


def _moving(decoded: ConnexionTraffic) -> list[list[DeviceReport]]:
    """Return the motion reports of each phase in which it was held deflected."""
    held = ([each for each in decoded.during(name) if each.is_motion] for name in HELD)
    return [each for each in held if len(each) > 1]


@requires(8, f"{RATE}: one half every 8 ms, in turn")
def halves_take_turns(decoded: ConnexionTraffic) -> Findings:
    """Translations and rotations come in turn, one of each."""
    if decoded.family is devices.Family.ONE:
        return not_applicable("motion comes whole")
    for motion in _moving(decoded):
        for one, other in pairwise(motion):
            twice = type(one.value) is type(other.value)
            words = f"two {type(one.value).__name__.lower()}s in a row"
            yield other.number, words if twice else ""
    return Words("{} in turn")


@requires(9, RATE)
def the_rate_is_the_families(decoded: ConnexionTraffic) -> Verdict:
    """Held deflected, it sends a half every 8 ms, or a whole motion every 16 ms, to 15 %."""
    moving, period_s = some(_moving(decoded), _NOTHING), PERIOD_S[some(decoded.family, _NOTHING)]
    periods = [(m[-1].time_s - m[0].time_s) / (len(m) - 1) for m in moving]
    worst = max(periods, key=lambda each: abs(each - period_s))
    return met(abs(worst / period_s - 1.0) < PERIOD_TOLERANCE, f"{worst * 1e3:.2f} ms")


@requires(10, f"{RATE}: while deflected the device keeps sending")
def deflection_is_never_silent(decoded: ConnexionTraffic) -> Verdict:
    """Held deflected, it is never silent for more than 100 ms."""
    return never_silent(
        ((decoded.phase(name), [e for e in decoded.during(name) if e.is_motion]) for name in HELD),
        LINK_LOST_S,
    )


@requires(11, f"{RATE}: three zero pairs, then silence")
def rest_is_silent(decoded: ConnexionTraffic) -> Verdict:
    """Let go, it sends a few zeros, and then nothing."""
    some(decoded.phase("push-rest"), "it was never released")
    rest = decoded.during("rest", "push-rest", "twist-rest")
    talks = [each.number for each in rest if each.is_motion]
    return failed(f"{len(talks)} motion reports at rest", talks) if talks else passed("silent")


@requires(12, f"{RATE}: the last value of a motion is zero")
def the_last_value_is_zero(decoded: ConnexionTraffic) -> Findings:
    """The last reports of every motion say zero on all axes, and there are at most 8 of them."""
    least = 2 if decoded.family is devices.Family.SPLIT else 1
    for name in ("push", "twist"):
        found = [each for each in decoded.during(f"{name}-held", f"{name}-over") if each.is_motion]
        if any(any(each.counts) for each in found):
            zeros = len(list(takewhile(lambda each: not any(each.counts), reversed(found))))
            few = least <= zeros <= ZEROS_AT_MOST
            yield found[-1].number, "" if few else f"{zeros} zeros at the end"
    return Words("{} motions", "it was never deflected")


@requires(13, f"{DESCRIPTOR}: logical range -350 to 350")
def counts_are_in_range(decoded: ConnexionTraffic) -> Verdict:
    """No axis goes beyond the range that the descriptor declares, +-350."""
    found = [(max(map(abs, each.counts)), each.number) for each in decoded.motions]
    most = max(some(found, _NOTHING))[0]
    top = 350 if decoded.model is None else decoded.model.full_scale
    beyond = (number for far, number in found if far > top)
    return at_most(top, float(most), "counts", f"{most} counts at most", beyond)


def _mean(found: list[DeviceReport], kind: type, at: int) -> list[float]:
    rows = [each.counts for each in found if isinstance(each.value, kind)]
    whole = [each.counts for each in found if isinstance(each.value, reports.MotionReport)]
    rows = [row[at : at + 3] for row in whole] if whole else rows
    return [sum(axis) / len(rows) for axis in zip(*rows, strict=True)] if rows else []


@requires(14, "posted captures; spacenavd, Blender: +X is right, +Rz clockwise from above")
def axes_have_their_signs(decoded: ConnexionTraffic) -> Verdict:
    """Pushed to the right X is positive and the largest of the three; twisted clockwise, so is
    Rz."""
    if decoded.model is not None and decoded.model.serial_axes:
        return not_applicable("the model has another frame")
    push = _mean(decoded.during("push-held"), reports.Translation, 0)
    twist = _mean(decoded.during("twist-held"), reports.Rotation, 3)
    some(push and twist, "it was not pushed and twisted")
    said = f"X {push[0]:.0f}, Rz {twist[2]:.0f} counts"
    return met(push[0] == max(push, key=abs) > 0 and twist[2] == max(twist, key=abs) > 0, said)


@requires(15, DESCRIPTOR)
def buttons_are_reported(decoded: ConnexionTraffic) -> Verdict:
    """A button that is pressed is reported at once, and again when it is let go."""
    if decoded.model is not None and not decoded.model.buttons:
        return not_applicable("the model has none")
    some(decoded.phase("release") and not decoded.refused, "none was pressed")
    down, up = _buttons(decoded.during("press")), _buttons(decoded.during("release"))
    must(down and down[-1], "pressing was not reported")
    must(up, "the release was not reported")
    return passed("pressed and let go") if not up[-1] else failed("it stays down")


def _buttons(found: list[DeviceReport]) -> list[bool]:
    """Return for each report of buttons if any is down."""
    kinds = reports.ButtonBits, reports.KeysDown
    return [any(each.value) for each in found if isinstance(each.value, kinds)]


@requires(16, f"{DESCRIPTOR}, battery strength")
def the_battery_is_not_empty(decoded: ConnexionTraffic) -> Findings:
    """The battery, where it is reported, has 10 % and more."""
    percent = 0
    for each in decoded.reports:
        if isinstance(each.value, reports.Battery):
            percent = each.value.percent
            yield each.number, f"{percent} %" if percent < LOW_PERCENT else ""
    return Words(f"{percent} %", not_applicable("no battery was reported"))


@requires(17, "the system's HID driver")
def stays_connected(decoded: ConnexionTraffic) -> Verdict:
    """The device stays connected while it is used."""
    phase = decoded.phase("unplug")
    wrong = [index for index in decoded.lost if phase is None or index < phase.first]
    some(not decoded.refused, "it was never opened")
    return failed("it disconnected", wrong) if wrong else passed("connected all the time")


@requires(18, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: ConnexionTraffic) -> Verdict:
    """A second reader, the scapy layers, sees the same axes and buttons."""

    def differs(each: DeviceReport, layers: Any) -> str:
        layer = layers.ConnexionInput(each.raw)
        if layer.id != each.raw[0]:
            return "another id"
        for name, value in each.value._asdict().items():
            read = getattr(layer, name, None)
            if read is None or (tuple(read) if isinstance(value, tuple) else read) != value:
                return f"another {name}"
        return ""

    found = [each for each in decoded.reports if not isinstance(each.value, MalformedReport)]
    return read_twice(found, "connexion", differs, "reports", _NOTHING)


@requires(101, f"{SPACENAVD}: output report 4")
def the_led_disturbs_nothing(decoded: ConnexionTraffic) -> Verdict:
    """Told to switch its LED on and off, the device sends on as before."""
    some(decoded.phase("push-again") and not decoded.refused, "it was not reported")
    if decoded.model is not None and not decoded.model.led:
        return not_applicable("the model has no LED")
    found = [each for each in decoded.during("push-again") if any(each.counts)]
    return passed(f"{len(found)} reports") if found else failed("nothing came afterwards")


@requires(301, "the system's HID driver")
def unplugging_is_reported(decoded: ConnexionTraffic) -> Verdict:
    """Unplugged, the device is reported gone, and sends nothing more."""
    phase = decoded.phase("unplug")
    gone = [] if phase is None else [index for index in decoded.lost if index >= phase.first]
    some(gone, "it was not unplugged")
    after = [each.number for each in decoded.reports if each.number > gone[0]]
    return failed("reports come from the unplugged device", after) if after else passed("reported")
