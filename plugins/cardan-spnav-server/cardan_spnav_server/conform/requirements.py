"""Requirements for a daemon at spacenavd's socket."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from itertools import pairwise

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_applicable,
    not_seen,
    passed,
)
from cardan.conform.timing import never_silent
from cardan.protocols.spnav.codes import (
    DEVICE_TYPES,
    MASK_V1,
    NEWEST_VERSION,
    UNKNOWN_DEVICE,
    Code,
    EventMask,
    LedMode,
)
from cardan.protocols.spnav.records import (
    MAX_BUTTONS,
    STATUS,
    Button,
    ConfigChange,
    DeviceChange,
    MalformedRecord,
    MotionEvent,
)
from cardan.protocols.spnav.streams import Handshake
from cardan_spnav_server.conform.decoded import Asked, Record, SpnavTraffic
from cardan_spnav_server.conform.scapy_check import readings_differ
from cardan_spnav_server.conform.scenario import (
    NEW,
    NEW_FACTOR,
    OLD,
    OLD_FACTOR,
    OTHER,
    SETTINGS,
    STRINGS,
    UNKNOWN,
)
from cardan_spnav_server.protocol import StringAssembler, float_of

PROTOCOL = "FreeSpacenav, spacenavd's description of its protocol"
LIBSPNAV = "FreeSpacenav libspnav, src/spnav.c"
ON_CHANGE = "FreeSpacenav spacenavd, src/event.c: what changes is passed on, and a hand trembles"

ANSWER_S = 0.3
"""Silence after which libspnav assumes a daemon of version 0."""
SILENT_S = 0.5
FASTEST_HZ = 200.0
MOST_COUNTS = 512
PERIOD_SHARE, PERIOD_S = 0.1, 0.1
OTHERS_SHARE = 0.1
FACTOR_SHARE = 0.05
USB_TYPES = 0x200
"""First of the device types that are USB's."""
HELD = ("push-held", "twist-held")

requires: Requirements[SpnavTraffic] = Requirements("SPNAV")
_NO_MOTION = "no motion came"
_NOT_ASKED = "it was not asked"


def _bad(found: Iterable[tuple[int, str]], of: int, good: str, nothing: str) -> Verdict:
    wrong = list(found)
    if wrong:
        return failed(f"{len(wrong)} of {of}: {wrong[0][1]}", (n for n, _ in wrong))
    return passed(good) if of else not_seen(nothing)


@requires(1, f"{PROTOCOL}: a stream socket, several clients at a time")
def the_daemon_keeps_connections(decoded: SpnavTraffic) -> Verdict:
    """The daemon takes connections, and keeps them."""
    return (
        failed(decoded.ended[0][1], (n for n, _ in decoded.ended))
        if decoded.ended
        else passed("kept")
    )


@requires(2, f"{PROTOCOL}: version 0 has no handshake")
def silent_programs_get_motion(decoded: SpnavTraffic) -> Verdict:
    """A program that says nothing gets motion of a deflected device."""
    if decoded.phase("push-held") is None or not decoded.taken:
        return not_seen("it was never deflected")
    found = [each for each in decoded.motions(OLD, "push", "push-held") if any(each.counts)]
    return passed(f"{len(found)} motions") if found else failed("none came")


@requires(3, f"{PROTOCOL}: eight words of 32 bits, the first says what it is")
def records_are_whole(decoded: SpnavTraffic) -> Verdict:
    """Every record has 32 bytes, a known type, and values that it can have."""
    wrong = (
        (each.number, f"a record {each.value.reason}")
        for each in decoded.records
        if isinstance(each.value, MalformedRecord)
    )
    return _bad(wrong, len(decoded.records), f"{len(decoded.records)} records", "no records came")


@requires(4, f"{PROTOCOL}: events of version 0 are motion and buttons")
def version_0_gets_motion_and_buttons(decoded: SpnavTraffic) -> Verdict:
    """A program that says nothing gets nothing but motion and buttons."""
    found = decoded.during(OLD)
    wrong = (
        (each.number, type(each.value).__name__)
        for each in found
        if not isinstance(each.value, (MotionEvent, Button, MalformedRecord))
    )
    return _bad(wrong, len(found), f"{len(found)} records", "no records came")


def _mean(found: list[Record]) -> list[float]:
    rows = [each.counts for each in found]
    return [sum(axis) / len(rows) for axis in zip(*rows, strict=True)]


@requires(5, f"{PROTOCOL}: x right, y up, z away; rotations about them by the right hand")
def axes_have_their_signs(decoded: SpnavTraffic) -> Verdict:
    """Pushed to the right x is positive and the largest; twisted clockwise ry is negative and the
    largest."""
    push, twist = decoded.motions(OLD, "push-held"), decoded.motions(OLD, "twist-held")
    if not push or not twist:
        return not_seen("it was not pushed and twisted")
    one, other = _mean(push), _mean(twist)
    said = f"x {one[0]:.0f}, ry {other[4]:.0f} counts"
    good = one[0] == max(one, key=abs) > 0 and other[4] == max(other, key=abs) < 0
    return passed(said) if good else failed(said)


@requires(6, "devices report 125 times a second at most; spacenavd's repeat-interval is off")
def motion_comes_as_it_is_reported(decoded: SpnavTraffic) -> Verdict:
    """Held deflected, motion comes no more than 200 times a second."""
    rates = []
    for name in HELD:
        phase, found = decoded.phase(name), decoded.motions(OLD, name)
        if phase is not None and found and phase.end_s > phase.start_s:
            rates.append(len(found) / (phase.end_s - phase.start_s))
    if not rates:
        return not_seen(_NO_MOTION)
    said = f"{max(rates):.0f} a second"
    return passed(said) if max(rates) <= FASTEST_HZ else failed(said)


@requires(7, ON_CHANGE)
def deflection_is_never_silent(decoded: SpnavTraffic) -> Verdict:
    """Held deflected by hand, it is never silent for more than 0.5 s."""
    return never_silent(
        ((decoded.phase(name), decoded.motions(OLD, name)) for name in HELD), SILENT_S
    )


@requires(8, "programs keep the last motion that they got")
def the_last_value_is_zero(decoded: SpnavTraffic) -> Verdict:
    """Let go, the last motion is zero on all axes."""
    wrong, count = [], 0
    for name in ("push", "twist"):
        found = decoded.motions(OLD, f"{name}-held", f"{name}-over", f"{name}-rest")
        if any(any(each.counts) for each in found):
            count += 1
            if any(found[-1].counts):
                wrong.append((found[-1].number, f"{found[-1].counts}"))
    return _bad(wrong, count, f"{count} motions", "it was never deflected")


@requires(9, ON_CHANGE)
def rest_is_silent(decoded: SpnavTraffic) -> Verdict:
    """At rest no motion comes."""
    if decoded.phase("push-rest") is None or not decoded.motions(OLD):
        return not_seen(_NO_MOTION)
    talks = [each.number for each in decoded.motions(OLD, "push-rest", "twist-rest")]
    return failed(f"{len(talks)} motions at rest", talks) if talks else passed("silent")


@requires(10, "350 to 500 for a full deflection of the devices that spacenavd knows")
def counts_are_in_range(decoded: SpnavTraffic) -> Verdict:
    """At a sensitivity of 1 no axis goes beyond +-512."""
    found = decoded.motions(OLD, "rest", "push", "twist", *HELD)
    if not found:
        return not_seen(_NO_MOTION)
    most = max(abs(count) for each in found for count in each.counts)
    wrong = [each.number for each in found if max(map(abs, each.counts)) > MOST_COUNTS]
    said = f"{most} counts at most"
    if wrong:
        return failed(said, wrong, float(most), "counts")
    return passed(said, float(most), "counts")


@requires(11, f"{PROTOCOL}: ms since the motion before")
def periods_are_those_of_motion(decoded: SpnavTraffic) -> Verdict:
    """The periods that motions report add up to the time between them, to 10 %, and none is off by
    more than 0.1 s."""
    reported_s, took_s, wrong = 0.0, 0.0, []
    for name in HELD:
        for one, other in pairwise(decoded.motions(OLD, name)):
            assert isinstance(other.value, MotionEvent)
            period_s, between_s = 1e-3 * other.value.period_ms, other.time_s - one.time_s
            reported_s, took_s = reported_s + period_s, took_s + between_s
            if abs(period_s - between_s) > PERIOD_S:
                words = f"{1e3 * period_s:.0f} ms after {1e3 * between_s:.0f} ms"
                wrong.append((other.number, words))
    if wrong:
        return failed(f"{len(wrong)} are off: {wrong[0][1]}", (n for n, _ in wrong))
    if not took_s:
        return not_seen(_NO_MOTION)
    said = f"{100 * reported_s / took_s:.0f} % of the time"
    return passed(said) if abs(reported_s / took_s - 1.0) < PERIOD_SHARE else failed(said)


@requires(12, f"{PROTOCOL}: events 1 and 2")
def buttons_are_reported(decoded: SpnavTraffic) -> Verdict:
    """Every press and release of a button is reported."""
    if decoded.phase("release") is None or decoded.ended:
        return not_seen("none was pressed")
    down = {edge.number for _, edge in decoded.buttons(OLD, "press") if edge.pressed}
    up = {edge.number for _, edge in decoded.buttons(OLD, "release") if not edge.pressed}
    if not down:
        return failed("pressing was not reported")
    return passed("pressed and let go") if down <= up else failed("the release was not reported")


@requires(13, f"{PROTOCOL}: events 1 and 2")
def edges_take_turns(decoded: SpnavTraffic) -> Verdict:
    """A press of a button is reported only when it is up, a release only when it is down."""
    wrong, count = [], 0
    for channel in (OLD, NEW, OTHER):
        down: set[int] = set()
        for number, edge in decoded.buttons(channel):
            count += 1
            if edge.pressed is (edge.number in down):
                reported = "pressed" if edge.pressed else "let go"
                wrong.append((number, f"button {edge.number} {reported} twice"))
            (down.add if edge.pressed else down.discard)(edge.number)
    return _bad(wrong, count, f"{count} edges", "no button was pressed")


@requires(14, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: SpnavTraffic) -> Verdict:
    """A second reader, the scapy layers, cuts and reads the records alike."""
    return readings_differ(decoded)


# -- level 1: asked -------------------------------------------------------------------------------


def _granted(decoded: SpnavTraffic, channel: str) -> Verdict:
    greeted = decoded.greeted.get(channel)
    if greeted is None:
        return not_seen("no version was asked for")
    number, asked_s = greeted
    found = [e for e in decoded.during(channel) if isinstance(e.value, Handshake)]
    if not found or not isinstance(found[0].value, Handshake):
        return failed("no version was granted", [number])
    after_ms = (found[0].time_s - asked_s) * 1e3
    said = f"version {found[0].value.version} after {after_ms:.0f} ms"
    good = found[0].value.version == NEWEST_VERSION and after_ms <= ANSWER_S * 1e3
    if good:
        return passed(said, after_ms, "ms")
    return failed(said, [found[0].number])


@requires(101, f"{PROTOCOL}; {LIBSPNAV}: it waits 0.3 s")
def version_1_is_granted(decoded: SpnavTraffic) -> Verdict:
    """Asked for version 1, the daemon grants it within 0.3 s."""
    return _granted(decoded, NEW)


@requires(102, f"{PROTOCOL}: the lower of both versions is granted")
def later_versions_are_granted_as_1(decoded: SpnavTraffic) -> Verdict:
    """Asked for version 9, it grants version 1 within 0.3 s."""
    return _granted(decoded, OTHER)


def _asked(decoded: SpnavTraffic) -> list[Asked]:
    return [each for each in decoded.asked if each.request.code != Code.SET_NAME]


@requires(103, f"{PROTOCOL}; {LIBSPNAV}")
def requests_are_answered(decoded: SpnavTraffic) -> Verdict:
    """Every request is answered within 0.3 s, with its first word."""
    found, wrong, worst_ms = _asked(decoded), [], 0.0
    for each in found:
        code = f"{each.request.code:#06x}"
        if each.reply is None:
            wrong.append((each.number, f"{code} was not answered"))
            continue
        after_s = each.answers[0].time_s - each.time_s
        worst_ms = max(worst_ms, after_s * 1e3)
        if each.reply.word != each.request.word:
            wrong.append((each.answers[0].number, f"{code} was answered {each.reply.word:#010x}"))
        elif after_s > ANSWER_S:
            wrong.append((each.answers[0].number, f"{code} after {after_s * 1e3:.0f} ms"))
    if wrong or not found:
        return _bad(wrong, len(found), "", _NOT_ASKED)
    return passed(f"{len(found)}, {worst_ms:.0f} ms at most", worst_ms, "ms")


@requires(104, f"{PROTOCOL}: SET_NAME has no reply")
def names_are_not_answered(decoded: SpnavTraffic) -> Verdict:
    """A program's name is not answered: it would be taken for the next answer."""
    found = [each for each in decoded.asked if each.request.code == Code.SET_NAME]
    wrong = ((each.answers[0].number, "a reply came") for each in found if each.answers)
    return _bad(wrong, len(found), "no reply", "none was sent")


@requires(105, f"{PROTOCOL}: status -1 for unknown requests")
def unknown_requests_are_refused(decoded: SpnavTraffic) -> Verdict:
    """A request that there is not is answered, and refused."""
    found = decoded.sent_request(UNKNOWN)
    if found is None:
        return not_seen("none was sent")
    if found.reply is None:
        return failed("no answer", [found.number])
    return failed("it was granted", [found.number]) if found.reply.ok else passed("refused")


def _mask(asked: Asked | None) -> int | None:
    reply = None if asked is None else asked.reply
    return None if reply is None or not reply.ok else reply.data[0]


@requires(106, f"{PROTOCOL}: motion, buttons and devices until a program sets another mask")
def the_mask_is_kept(decoded: SpnavTraffic) -> Verdict:
    """After the handshake the event mask is 7; a mask that was set is returned on request."""
    found = [each for each in decoded.asked if each.request.code == Code.GET_EVMASK]
    if not found:
        return not_seen(_NOT_ASKED)
    masks = [_mask(each) for each in found]
    wanted = [MASK_V1, MASK_V1 | EventMask.CONFIG][: len(masks)]
    said = ", ".join(map(str, masks))
    return passed(said) if masks == wanted else failed(said, (each.number for each in found))


def _value(decoded: SpnavTraffic, code: int) -> int | None:
    return _mask(decoded.sent_request(code, "ask"))


@requires(107, f"{PROTOCOL}, DEV_NAXES and DEV_NBUTTONS")
def axes_and_buttons_are_counted(decoded: SpnavTraffic) -> Verdict:
    """The device has six axes, and every button that was reported is below the number of its
    buttons."""
    if decoded.sent_request(Code.DEV_NAXES, "ask") is None:
        return not_seen(_NOT_ASKED)
    axes, buttons = _value(decoded, Code.DEV_NAXES), _value(decoded, Code.DEV_NBUTTONS)
    if axes is None or buttons is None:
        return failed("refused")
    said = f"{axes} axes, {buttons} buttons"
    beyond = [number for number, edge in decoded.buttons(OLD) if edge.number >= buttons]
    good = axes == 6 and 0 <= buttons <= MAX_BUTTONS and not beyond
    return passed(said) if good else failed(said, beyond)


@requires(108, f"{PROTOCOL}: strings of 24 bytes a record, with what is left")
def strings_are_whole(decoded: SpnavTraffic) -> Verdict:
    """The device has a name; name and path, where they are sent, come whole and in order."""
    found = [asked for code in STRINGS if (asked := decoded.sent_request(code, "ask")) is not None]
    if not found:
        return not_seen(_NOT_ASKED)
    texts = []
    for each in found:
        if each.reply is None or not each.reply.ok:
            texts.append("")
            continue
        strings, text = StringAssembler(), None
        for answer in each.answers:
            # Parts of a reply only, as all of them are.
            text = strings.take(getattr(answer.value, "data"))  # noqa: B009
        whole = each.reply.data[STATUS]
        if not isinstance(text, str) or len(text.encode()) < whole:
            why = (
                "a piece is out of order"
                if isinstance(text, MalformedRecord)
                else "its end is missing"
            )
            return failed(why, (answer.number for answer in each.answers))
        texts.append(text)
    return passed(repr(texts[0])) if texts[0] else failed("it has no name", [found[0].number])


@requires(109, f"{PROTOCOL}, DEV_TYPE and DEV_USBID: no USB id of serial devices")
def the_type_is_known(decoded: SpnavTraffic) -> Verdict:
    """The device's type is one of the protocol, and it has a USB id if it is one of USB."""
    asked = decoded.sent_request(Code.DEV_TYPE, "ask")
    if asked is None:
        return not_seen(_NOT_ASKED)
    kind, vendor = _value(decoded, Code.DEV_TYPE), _value(decoded, Code.DEV_USBID)
    if kind is None or kind not in DEVICE_TYPES:
        return failed(f"type {kind}", [asked.number])
    said = f"{DEVICE_TYPES[kind]}, vendor {vendor or 0:#06x}"
    good = kind == UNKNOWN_DEVICE or bool(vendor) == (kind >= USB_TYPES)
    return passed(said) if good else failed(said, [asked.number])


def _implausible(code: int, data: tuple[int, ...]) -> str:
    """Return the fault of a setting's value; empty: none."""
    if code in (Code.GCFG_SENS, Code.GCFG_SENS_AXIS):
        factors = [float_of(word) for word in data[: 1 if code == Code.GCFG_SENS else 6]]
        return "" if all(map(math.isfinite, factors)) else "no number"
    if code == Code.GCFG_LED:
        return "" if data[0] in tuple(LedMode) else f"mode {data[0]}"
    flags = {Code.GCFG_INVERT: 6, Code.GCFG_SWAPYZ: 1, Code.GCFG_GRAB: 1}.get(Code(code), 0)
    return "" if all(each in (0, 1) for each in data[:flags]) else "neither 0 nor 1"


@requires(110, f"{PROTOCOL}, GCFG_...")
def settings_are_plausible(decoded: SpnavTraffic) -> Verdict:
    """Settings that the daemon reports have values that they can have."""
    asked = [each for code in SETTINGS if (each := decoded.sent_request(code, "ask")) is not None]
    reported = [(each, each.reply) for each in asked if each.reply is not None and each.reply.ok]
    wrong = []
    for each, reply in reported:
        why = _implausible(each.request.code, reply.data)
        if why:
            wrong.append((each.answers[0].number, f"{Code(each.request.code).name} {why}"))
    return _bad(wrong, len(reported), f"{len(reported)} of {len(asked)} told", _NOT_ASKED)


@requires(111, "FreeSpacenav spacenavd, repeat-interval: repeated motion looks like a hand's")
def nothing_is_repeated(decoded: SpnavTraffic) -> Verdict:
    """The daemon does not repeat motion by itself, where it reports that."""
    if decoded.sent_request(Code.GCFG_REPEAT, "ask") is None:
        return not_seen(_NOT_ASKED)
    interval = _value(decoded, Code.GCFG_REPEAT)
    if interval is None:
        return not_applicable("it does not report it")
    return passed("off") if interval < 0 else failed(f"every {interval} ms")


@requires(112, f"{PROTOCOL}, event 4: a setting was changed")
def settings_are_reported_to_others(decoded: SpnavTraffic) -> Verdict:
    """If the LED's mode is set to its present value, and that is granted, other programs that asked
    for such events get an event, and no others do."""
    asked = decoded.sent_request(Code.SCFG_LED)
    if asked is None:
        return not_seen("it has no LED, or does not report it")
    if asked.reply is not None and not asked.reply.ok:
        return not_applicable("it is not for programs to set")
    events = [e for e in decoded.during(OTHER, "led") if isinstance(e.value, ConfigChange)]
    beside = [e.number for e in decoded.during(OLD) if isinstance(e.value, ConfigChange)]
    if beside:
        return failed("a program was informed that had not asked for it", beside)
    return passed("reported") if events else failed("no event came", [asked.number])


def _pushed(decoded: SpnavTraffic, name: str) -> list[str]:
    return [f"{name}{part}" for part in ("", "-held", "-over", "-rest")]


@requires(113, f"{PROTOCOL}: all clients get all events")
def all_programs_get_the_same(decoded: SpnavTraffic) -> Verdict:
    """Programs of both versions get the same motions, to a tenth of them."""
    if decoded.phase("same-held") is None:
        return not_seen("it was not deflected for several")
    names = _pushed(decoded, "same")
    found = {c: Counter(e.counts for e in decoded.motions(c, *names)) for c in (OLD, NEW, OTHER)}
    most = max(sum(each.values()) for each in found.values())
    if not most:
        return failed(_NO_MOTION)
    lost = max((one - other).total() for one in found.values() for other in found.values())
    said = f"{lost} of {most} differ"
    return passed(said) if lost <= max(1.0, OTHERS_SHARE * most) else failed(said)


def _factor(decoded: SpnavTraffic, channel: str, wanted: float) -> Verdict:
    """Check if a connection gets `wanted` times the counts of the other connection."""
    names = _pushed(decoded, "scaled")
    ours, others = decoded.motions(channel, *names), decoded.motions(OTHER, *names)
    if decoded.phase("scaled-held") is None:
        return not_seen("it was not deflected with a sensitivity")
    if not ours or not others:
        return failed(_NO_MOTION)
    one, other = (max(abs(c) for e in found for c in e.counts) for found in (ours, others))
    if not other:
        return failed(_NO_MOTION)
    said = f"{one / other:.2f} times"
    return passed(said) if abs(one / other / wanted - 1.0) < FACTOR_SHARE else failed(said)


@requires(114, f"{PROTOCOL}, SET_SENS and GET_SENS")
def sensitivity_acts(decoded: SpnavTraffic) -> Verdict:
    """A sensitivity of 2 doubles the counts of the program that set it, and is returned to it on
    request."""
    asked = decoded.sent_request(Code.GET_SENS)
    if asked is None:
        return not_seen(_NOT_ASKED)
    reply = asked.reply
    if reply is None or not reply.ok or float_of(reply.data[0]) != NEW_FACTOR:
        return failed("another one is reported", [asked.number])
    return _factor(decoded, NEW, NEW_FACTOR)


@requires(115, f"{PROTOCOL}: a float of a client of version 0")
def sensitivity_of_version_0_acts(decoded: SpnavTraffic) -> Verdict:
    """A sensitivity of 3 triples the counts of a program of version 0."""
    return _factor(decoded, OLD, OLD_FACTOR)


@requires(116, f"{PROTOCOL}, SET_EVMASK")
def masked_events_do_not_come(decoded: SpnavTraffic) -> Verdict:
    """With a mask of buttons no motion comes, not even zeros."""
    if decoded.phase("masked-held") is None:
        return not_seen("no mask was set")
    names = _pushed(decoded, "masked")
    if not decoded.motions(OTHER, *names):
        return not_seen("it was not deflected with a mask")
    found = [each.number for each in decoded.motions(NEW, *names)]
    return failed(f"{len(found)} motions", found) if found else passed("none came")


@requires(117, f"{PROTOCOL}, SET_EVMASK")
def unmasked_events_come(decoded: SpnavTraffic) -> Verdict:
    """With a mask of buttons those come as to other programs."""
    if decoded.phase("masked-held") is None:
        return not_seen("no mask was set")
    names = _pushed(decoded, "masked")
    ours, others = ([e for _, e in decoded.buttons(c, *names)] for c in (NEW, OTHER))
    if not others:
        return not_seen("no button was pressed")
    said = f"{len(ours)} edges"
    return passed(said) if ours == others else failed(said)


@requires(118, f"{PROTOCOL}: several clients at a time")
def a_program_that_leaves_disturbs_nobody(decoded: SpnavTraffic) -> Verdict:
    """When a program has left, the others get motion as before."""
    if decoded.phase("alone-held") is None:
        return not_seen("none has left")
    counts = [len(decoded.motions(c, "alone", "alone-held")) for c in (OLD, NEW)]
    return passed(f"{min(counts)} motions") if all(counts) else failed(_NO_MOTION)


# -- level 3: by hand -----------------------------------------------------------------------------


def _change(decoded: SpnavTraffic, phase: str, added: bool) -> Verdict:
    if decoded.phase(phase) is None:
        return not_seen("nobody did it")
    found = [e.value for e in decoded.during(NEW, phase) if isinstance(e.value, DeviceChange)]
    if not [each for each in found if each.added is added]:
        return failed("no event reported it")
    return passed("reported")


@requires(301, f"{PROTOCOL}, event 3")
def unplugging_is_reported(decoded: SpnavTraffic) -> Verdict:
    """The device unplugged, an event says so to programs of version 1."""
    return _change(decoded, "unplug", False)


@requires(302, f"{PROTOCOL}: requests about a device fail without one")
def nothing_is_said_of_a_device_that_is_gone(decoded: SpnavTraffic) -> Verdict:
    """The device unplugged, the number of its axes is refused."""
    asked = decoded.sent_request(Code.DEV_NAXES, "unplugged")
    if asked is None:
        return not_seen(_NOT_ASKED)
    if asked.reply is None:
        return failed("no answer", [asked.number])
    return failed("it was reported", [asked.number]) if asked.reply.ok else passed("refused")


@requires(303, f"{PROTOCOL}, event 3")
def plugging_in_is_reported(decoded: SpnavTraffic) -> Verdict:
    """The device plugged in again, an event says so to programs of version 1."""
    return _change(decoded, "replug", True)
