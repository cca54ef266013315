"""Requirements for a Wii Remote."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_applicable,
    not_seen,
    passed,
)
from cardan.conform.second_reading import read_twice
from cardan_wiimote.conform.decoded import Memory, Report, WiimoteTraffic
from cardan_wiimote.conform.scenario import DATA_MODE, EXTENSION_MODE, LONG_READ
from cardan_wiimote.protocol import (
    ACCELEROMETER_CALIBRATION_ADDRESSES,
    EEPROM,
    INPUT_SIZES,
    READ_PIECE_BYTES,
    REGISTERS,
    UNKNOWN_ID,
    Ack,
    Data,
    DataMode,
    Extension,
    Leds,
    MalformedReport,
    ReadData,
    Status,
    WriteMemory,
    decode_accelerometer_calibration,
    decode_nunchuk,
    extension_of,
)

WIIBREW = "WiiBrew, Wiimote/Protocol"
EXTENSIONS = "WiiBrew, Wiimote/Extension Controllers"
DOLPHIN = "Dolphin, its emulated remote"

PERIOD_S = (0.004, 0.02)
"""A remote sends 100 reports a second, with Linux at times 200."""
SILENT_S = 0.1
ANSWER_S = 0.2
ONE_G = 0.15
RUNNING = ("stream", "after-status", "extension-stream")

requires: Requirements[WiimoteTraffic] = Requirements("WII")
_NOTHING = "no reports came"
_NOT_ASKED = "nothing was asked"


def _bad(found: Iterable[tuple[int, str]], of: int, good: str, nothing: str = _NOTHING) -> Verdict:
    wrong = list(found)
    if wrong:
        return failed(f"{len(wrong)} of {of}: {wrong[0][1]}", (n for n, _ in wrong))
    return passed(good) if of else not_seen(nothing)


@requires(1, "Bluetooth, L2CAP channels 0x11 and 0x13; the system's HID driver")
def it_can_be_opened(decoded: WiimoteTraffic) -> Verdict:
    """The remote can be connected to."""
    return failed("it was refused", decoded.refused) if decoded.refused else passed("opened")


@requires(2, f"{WIIBREW}: 0x20 to 0x22, 0x30 to 0x37, 0x3D to 0x3F")
def report_ids_are_known(decoded: WiimoteTraffic) -> Verdict:
    """Every report has an id of the protocol."""
    wrong = (
        (each.number, f"id {each.value.report_id:#04x}")
        for each in decoded.reports
        if isinstance(each.value, MalformedReport) and each.value.reason == UNKNOWN_ID
    )
    return _bad(wrong, len(decoded.reports), f"{len(decoded.reports)} reports")


@requires(3, WIIBREW)
def reports_are_whole(decoded: WiimoteTraffic) -> Verdict:
    """Every report has the length of its id."""
    wrong = [
        (each.number, f"id {each.raw[0]:#04x} with {len(each.raw)} bytes" if each.raw else "empty")
        for each in decoded.reports
        if not each.raw or len(each.raw) != INPUT_SIZES.get(each.raw[0], len(each.raw) - 1) + 1
    ]
    return _bad(wrong, len(decoded.reports), f"{len(decoded.reports)} reports")


def _buttons(found: list[Report]) -> list[int]:
    return [
        each.value.buttons
        for each in found
        if isinstance(each.value, Data) and each.value.buttons is not None
    ]


@requires(4, f"{WIIBREW}: mode 0x30 is the default, reports on changes")
def buttons_are_reported(decoded: WiimoteTraffic) -> Verdict:
    """Every press and release of a button is reported at once."""
    if decoded.refused or decoded.phase("release") is None:
        return not_seen("none was pressed")
    down, up = _buttons(decoded.during("press")), _buttons(decoded.during("release"))
    if not any(down):
        return failed("pressing was not reported")
    return (
        passed("pressed and let go")
        if up and not up[-1]
        else failed("the release was not reported")
    )


@requires(5, "the system's HID driver")
def the_link_stays(decoded: WiimoteTraffic) -> Verdict:
    """The remote does not end the link while it is used."""
    phase = decoded.phase("power-off")
    wrong = [number for number in decoded.lost if phase is None or number < phase.first]
    if decoded.refused:
        return not_seen("it was never opened")
    return failed("it ended", wrong) if wrong else passed("it stayed")


@requires(6, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: WiimoteTraffic) -> Verdict:
    """A second reader, the scapy layers, knows every report, and builds the same bytes of it."""

    def differs(each: Report, layers: Any) -> str:
        layer = layers.WiimoteInput(each.raw)
        same = layer.id == each.raw[0] and bytes(layer) == each.raw
        return "" if same else "it builds other bytes"

    found = [each for each in decoded.reports if not isinstance(each.value, MalformedReport)]
    return read_twice(found, "wiimote", differs, "reports", _NOTHING, 40)


@requires(101, f"{WIIBREW}, 0x15 and 0x20")
def status_is_reported(decoded: WiimoteTraffic) -> Verdict:
    """A request for the status is answered within 0.2 s."""
    phase = decoded.phase("ask")
    if phase is None:
        return not_seen(_NOT_ASKED)
    found = [each for each in decoded.during("ask") if isinstance(each.value, Status)]
    if not found:
        return failed("none came", [phase.first])
    after_ms = (found[0].time_s - phase.start_s) * 1e3
    said = f"after {after_ms:.0f} ms"
    if after_ms > ANSWER_S * 1e3:
        return failed(said, [found[0].number], after_ms, "ms")
    return passed(said, after_ms, "ms")


@requires(102, f"{WIIBREW}, 0x22: on request, and to every write")
def what_wants_an_answer_gets_one(decoded: WiimoteTraffic) -> Verdict:
    """Reports that ask for an acknowledgment get one within 0.2 s, without an error."""
    asked = [
        each
        for each in decoded.asked
        if isinstance(each.value, WriteMemory)
        or (isinstance(each.value, (Leds, DataMode)) and each.value.ack)
    ]
    acks = [each for each in decoded.reports if isinstance(each.value, Ack)]
    wrong = []
    ends = [*(each.time_s for each in decoded.asked), math.inf][1:]
    nexts = dict(zip((each.number for each in decoded.asked), ends, strict=True))
    for each in asked:
        found = [a for a in acks if a.number > each.number and a.time_s <= nexts[each.number]]
        if not found:
            wrong.append((each.number, f"none of {type(each.value).__name__}"))
        elif found[0].time_s - each.time_s > ANSWER_S:
            wrong.append((found[0].number, f"after {found[0].time_s - each.time_s:.2f} s"))
        elif isinstance(found[0].value, Ack) and found[0].value.error:
            wrong.append((found[0].number, f"error {found[0].value.error}"))
    return _bad(wrong, len(asked), f"{len(asked)} times", _NOT_ASKED)


@requires(103, f"{WIIBREW}, 0x17 and 0x21: pieces of 16 bytes")
def memory_is_read(decoded: WiimoteTraffic) -> Verdict:
    """Reads of memory are answered in whole, without an error, in pieces in their order."""
    wrong = []
    found = decoded.reads()
    for each in found:
        value = each.asked.value
        assert not isinstance(value, MalformedReport)
        size, start = getattr(value, "size", 0), getattr(value, "address", 0) & 0xFFFF
        if each.error:
            wrong.append((each.pieces[-1].number, f"error {each.error}"))
            continue
        if len(each.data) != size:
            wrong.append((each.asked.number, f"{len(each.data)} of {size} bytes"))
            continue
        at = [p.value.address for p in each.pieces if isinstance(p.value, ReadData)]
        if at != [start + READ_PIECE_BYTES * n for n in range(len(at))]:
            wrong.append((each.asked.number, "out of order"))
    return _bad(wrong, len(found), f"{len(found)} reads", _NOT_ASKED)


@requires(104, f"{WIIBREW}; libcwiid waits a second at most")
def memory_is_quick(decoded: WiimoteTraffic) -> Verdict:
    """The first piece of a read comes within 0.2 s."""
    found = [(e, e.pieces[0].time_s - e.asked.time_s) for e in decoded.reads() if e.pieces]
    if not found:
        return not_seen("nothing was read")
    late_s = max(took for _, took in found)
    said = f"within {late_s * 1e3:.0f} ms"
    slow = [each.pieces[0].number for each, took in found if took > ANSWER_S]
    return failed(said, slow, late_s * 1e3, "ms") if slow else passed(said, late_s * 1e3, "ms")


def _calibrations(decoded: WiimoteTraffic) -> list[Memory]:
    return [
        each
        for each in decoded.reads()
        if getattr(each.asked.value, "space", None) == EEPROM
        and getattr(each.asked.value, "address", -1) in ACCELEROMETER_CALIBRATION_ADDRESSES
        and getattr(each.asked.value, "size", 0) < LONG_READ
        and each.data
    ]


@requires(105, f"{WIIBREW}, EEPROM: two copies, each with its checksum")
def the_calibration_is_sound(decoded: WiimoteTraffic) -> Verdict:
    """Both copies of the accelerometer's calibration have a right checksum and are plausible."""
    found = _calibrations(decoded)
    wrong = [
        (each.asked.number, f"the copy at {getattr(each.asked.value, 'address', 0):#x}")
        for each in found
        if decode_accelerometer_calibration(each.data) is None
    ]
    return _bad(wrong, len(found), f"{len(found)} copies", "it was not read")


@requires(106, f"{WIIBREW}: about 100 a second where they are continuous")
def data_are_continuous(decoded: WiimoteTraffic) -> Verdict:
    """Told to send 0x31 continuously, it sends 50 to 250 a second and is never silent for 0.1 s."""
    phase = decoded.phase("stream")
    if phase is None:
        return not_seen(_NOT_ASKED)
    found = [each for each in decoded.during("stream") if isinstance(each.value, Data)]
    if len(found) < 3:
        return failed(f"{len(found)} reports")
    times = [phase.start_s, *(each.time_s for each in found), phase.end_s]
    longest = max(b - a for a, b in pairwise(times))
    mean = (found[-1].time_s - found[0].time_s) / (len(found) - 1)
    said = f"every {mean * 1e3:.1f} ms, longest {longest * 1e3:.0f} ms"
    good = PERIOD_S[0] <= mean <= PERIOD_S[1] and longest < SILENT_S
    if not good:
        return failed(said, [found[-1].number], longest * 1e3, "ms")
    return passed(said, longest * 1e3, "ms")


@requires(107, f"{WIIBREW}, 0x12")
def the_mode_is_the_one_set(decoded: WiimoteTraffic) -> Verdict:
    """Data come in the mode that was set, and in no other."""
    wrong, count = [], 0
    for name in RUNNING:
        mode = EXTENSION_MODE if name.startswith("extension") else DATA_MODE
        for each in decoded.during(name):
            if isinstance(each.value, Data):
                count += 1
                if each.value.mode != mode:
                    wrong.append((each.number, f"{each.value.mode:#04x} instead of {mode:#04x}"))
    return _bad(wrong, count, f"{count} reports", _NOT_ASKED)


@requires(108, f"{WIIBREW}: x left, y to the tail, z up; flat on a table z is 1 g")
def gravity_is_measured(decoded: WiimoteTraffic) -> Verdict:
    """Flat on a table it measures 1 g upwards, to 0.15 g."""
    blocks = [decode_accelerometer_calibration(each.data) for each in _calibrations(decoded)]
    known = [each for each in blocks if each is not None]
    counts = [
        each.value.accelerometer
        for each in decoded.during("stream")
        if isinstance(each.value, Data) and each.value.accelerometer is not None
    ]
    if not known or not counts:
        return not_seen("it has no calibration, or no data came")
    mean = [sum(axis) / len(counts) for axis in zip(*counts, strict=True)]
    zero, one = known[0].zero, known[0].one_g
    x, y, z = ((m - a) / (b - a) for m, a, b in zip(mean, zero, one, strict=True))
    said = f"{x:.2f}, {y:.2f}, {z:.2f} g"
    good = abs(x) < ONE_G and abs(y) < ONE_G and abs(z - 1.0) < ONE_G
    return passed(said) if good else failed(said)


@requires(109, f"{WIIBREW}, 0x20: only a change of the extension ends the data")
def a_status_ends_no_data(decoded: WiimoteTraffic) -> Verdict:
    """After a status that was asked for data go on."""
    if decoded.phase("after-status") is None:
        return not_seen(_NOT_ASKED)
    if not any(isinstance(each.value, Data) for each in decoded.during("stream")):
        return not_seen("no data came before it")
    found = [each for each in decoded.during("after-status") if isinstance(each.value, Data)]
    return passed(f"{len(found)} reports") if len(found) > 5 else failed(f"{len(found)} reports")


@requires(110, f"{WIIBREW}, 0x20: unasked when the extension comes or goes")
def the_extension_stays(decoded: WiimoteTraffic) -> Verdict:
    """No status comes unasked: nothing is plugged in or out while it is used."""
    if decoded.phase("memory") is None:
        return not_seen(_NOT_ASKED)
    unasked = [
        each.number
        for each in decoded.during("memory", "extension-id", "data", *RUNNING)
        if isinstance(each.value, Status)
    ]
    return failed("a status came", unasked) if unasked else passed("none came")


@requires(111, f"{EXTENSIONS}: A4 20 00 00 of a Nunchuk")
def the_nunchuk_says_what_it_is(decoded: WiimoteTraffic) -> Verdict:
    """An extension reported by the status has a readable id, and a Nunchuk's stick is centered."""
    reported = [e.value for e in decoded.during("ask") if isinstance(e.value, Status)]
    if not reported:
        return not_seen(_NOT_ASKED)
    if not reported[0].extension:
        return not_applicable("nothing is plugged in")
    reads = [e for e in decoded.reads() if getattr(e.asked.value, "space", None) == REGISTERS]
    if not reads or not reads[-1].data:
        return failed("it does not say", [e.asked.number for e in reads])
    kind = extension_of(reads[-1].data)
    data = [
        each.value.extension
        for each in decoded.during("extension-stream")
        if isinstance(each.value, Data) and each.value.extension
    ]
    if kind is not Extension.NUNCHUK or not data:
        return passed(f"{kind}") if kind is not None else failed(reads[-1].data.hex(" "))
    nunchuk = decode_nunchuk(data[-1][:6])
    if nunchuk is None:
        return failed("its data are not those of a Nunchuk")
    said = f"a Nunchuk, stick {nunchuk.stick_x}, {nunchuk.stick_y}"
    good = 90 < nunchuk.stick_x < 166 and 90 < nunchuk.stick_y < 166
    return passed(said) if good else failed(said)


@requires(112, f"{WIIBREW}, 0x20: the flag below 0x20")
def the_battery_is_not_empty(decoded: WiimoteTraffic) -> Verdict:
    """No status says that the battery is low."""
    found = [(e, e.value) for e in decoded.reports if isinstance(e.value, Status)]
    wrong = ((each.number, f"{s.battery} of 200") for each, s in found if s.battery_low)
    return _bad(wrong, len(found), f"{found[-1][1].battery if found else 0} of 200", _NOT_ASKED)


@requires(113, f"{DOLPHIN}: a scale of each axis, all of them upwards")
def one_g_is_above_zero(decoded: WiimoteTraffic) -> Verdict:
    """The calibration's 1 g is above its zero by 50 to 200 counts on every axis."""
    blocks = [decode_accelerometer_calibration(each.data) for each in _calibrations(decoded)]
    known = [each for each in blocks if each is not None]
    if not known:
        return not_seen("there is no calibration")
    spans = [b - a for a, b in zip(known[0].zero, known[0].one_g, strict=True)]
    said = f"{spans} counts"
    good = all(50 <= each <= 200 for each in spans)
    return passed(said) if good else failed(said)


@requires(301, "Bluetooth: the link ends")
def switching_off_is_reported(decoded: WiimoteTraffic) -> Verdict:
    """Switched off, the remote ends the link, and nothing more comes."""
    phase = decoded.phase("power-off")
    gone = [] if phase is None else [number for number in decoded.lost if number >= phase.first]
    if not gone:
        return not_seen("it was not switched off")
    after = [each.number for each in decoded.reports if each.number > gone[0]]
    return (
        failed("reports come from the switched-off remote", after) if after else passed("reported")
    )
