"""What a serial device that speaks Magellan's protocol must do."""

from __future__ import annotations

from itertools import pairwise

from cardan.conform.magellan.pilot import UNKNOWN
from cardan.conform.magellan.seen import Asked, MagellanSeen, Packet
from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_applicable,
    not_seen,
    passed,
)
from cardan.errors import ExtraMissingError
from cardan.protocols.connexion_serial import (
    MagellanCompressedMotion,
    MagellanError,
    MagellanVersion,
    Malformed,
)
from cardan.protocols.connexion_serial.magellan import (
    EXTENDED_COMPRESSED,
    MODE_3D,
    QUERY_EXTENDED,
    QUERY_KEYS,
    QUERY_VERSION,
)

MANUAL = "LogiCad3D, Magellan programmer's manual"
KERNEL = f"{MANUAL}; Linux drivers/input/joystick/magellan.c"
SPACENAVD = "FreeSpacenav spacenavd, src/serial"
RATE = f"{MANUAL}: periods of (n + 1) 20 ms; 58 ms were measured"

FASTEST_S, SLOWEST_S = 0.018, 0.075
"""Of a Turbo model, and of the default setting p22 with a tolerance."""
SILENT_S = 0.2
VERSION_WITHIN_S = 0.25
MOST_COUNTS = 512
HELD = ("push-held", "twist-held")

requires: Requirements[MagellanSeen] = Requirements("MAG")
_NOTHING = "no packets came"


@requires(1, "the system's serial driver")
def it_can_be_opened(seen: MagellanSeen) -> Verdict:
    """The port can be opened."""
    return failed("it was refused", seen.refused) if seen.refused else passed("opened")


@requires(2, f"{MANUAL}: mode 3 is the default")
def deflection_is_reported(seen: MagellanSeen) -> Verdict:
    """Deflected, it sends motion packets without having been told to."""
    if seen.refused or seen.phase("push-held") is None:
        return not_seen("it was never deflected")
    found = [each for each in seen.motions("push", "push-held") if any(each.counts)]
    return passed(f"{len(found)} packets") if found else failed("none came")


@requires(3, KERNEL)
def packets_are_whole(seen: MagellanSeen) -> Verdict:
    """Every packet has a known letter, its length, and no byte or sum that cannot be."""
    if not seen.packets:
        return not_seen(_NOTHING)
    wrong = [
        (each.number, f"{chr(each.value.letter)!r} {each.value.reason}")
        for each in seen.packets
        if isinstance(each.value, Malformed)
    ]
    if wrong:
        words = f"{len(wrong)} of {len(seen.packets)}: {wrong[0][1]}"
        return failed(words, (n for n, _ in wrong))
    return passed(f"{len(seen.packets)} packets")


@requires(4, RATE)
def the_rate_is_a_magellans(seen: MagellanSeen) -> Verdict:
    """Held deflected, it sends a packet every 18 to 75 ms."""
    periods = []
    for name in HELD:
        found = seen.motions(name)
        if len(found) > 3:
            periods.append((found[-1].time_s - found[0].time_s) / (len(found) - 1))
    if not periods:
        return not_seen(_NOTHING)
    worst = max(periods)
    said = f"{worst * 1e3:.0f} ms"
    good = min(periods) >= FASTEST_S and worst <= SLOWEST_S
    return passed(said, worst * 1e3, "ms") if good else failed(said)


@requires(5, f"{MANUAL}: data are sent periodically while they are not zero")
def deflection_is_never_silent(seen: MagellanSeen) -> Verdict:
    """Held deflected, it is never silent for more than 0.2 s."""
    longest, wrong, count = 0.0, [], 0
    for name in HELD:
        phase = seen.phase(name)
        if phase is None:
            continue
        found = seen.motions(name)
        times = [phase.start_s, *(each.time_s for each in found), phase.end_s]
        count += 1
        for n, (a, b) in enumerate(pairwise(times)):
            longest = max(longest, b - a)
            if b - a > SILENT_S:
                at = found[min(n, len(found) - 1)].number if found else phase.first
                wrong.append((at, f"{(b - a) * 1e3:.0f} ms"))
    if wrong:
        said = f"{len(wrong)} silences: {wrong[0][1]}"
        return failed(said, (n for n, _ in wrong), longest * 1e3, "ms")
    if not count:
        return not_seen("it was never held deflected")
    return passed(f"longest {longest * 1e3:.0f} ms", longest * 1e3, "ms")


@requires(6, f"{MANUAL}: one zero packet, then silence")
def the_last_value_is_zero(seen: MagellanSeen) -> Verdict:
    """Let go, it sends zero on all axes, once or twice, as the last of the motion."""
    wrong, count = [], 0
    for name in ("push", "twist"):
        found = seen.motions(f"{name}-held", f"{name}-over")
        if not any(any(each.counts) for each in found):
            continue
        count += 1
        if any(found[-1].counts):
            wrong.append(found[-1].number)
    if wrong:
        return failed("the last one is not zero", wrong)
    return passed(f"{count} motions") if count else not_seen("it was never deflected")


@requires(7, f"{MANUAL}: one zero packet, then silence")
def rest_is_silent(seen: MagellanSeen) -> Verdict:
    """Let go, it then sends nothing."""
    if seen.phase("push-rest") is None or not seen.packets:
        return not_seen("it was never let go")
    talks = [each.number for each in seen.motions("rest", "push-rest", "twist-rest")]
    return failed(f"{len(talks)} packets at rest", talks) if talks else passed("silent")


@requires(8, "+-360 (Linux) to +-512 at the default sensitivity")
def counts_are_in_range(seen: MagellanSeen) -> Verdict:
    """At the default sensitivity no axis goes beyond +-512."""
    found = [each for each in seen.packets if each.counts]
    if not found:
        return not_seen(_NOTHING)
    most = max(abs(c) for each in found for c in each.counts)
    wrong = [each.number for each in found if max(map(abs, each.counts)) > MOST_COUNTS]
    said = f"{most} counts at most"
    if wrong:
        return failed(said, wrong, float(most), "counts")
    return passed(said, float(most), "counts")


def _mean(found: list[Packet]) -> list[float]:
    rows = [each.counts for each in found]
    return [sum(axis) / len(rows) for axis in zip(*rows, strict=True)]


@requires(9, f"{MANUAL}: X right, Y up, Z towards the operator; right-handed")
def axes_have_their_signs(seen: MagellanSeen) -> Verdict:
    """Pushed to the right X is positive and the largest; twisted clockwise B is negative and the
    largest."""
    push, twist = seen.motions("push-held"), seen.motions("twist-held")
    if not push or not twist:
        return not_seen("it was not pushed and twisted")
    one, other = _mean(push), _mean(twist)
    said = f"X {one[0]:.0f}, B {other[4]:.0f} counts"
    good = one[0] == max(one, key=abs) > 0 and other[4] == max(other, key=abs) < 0
    return passed(said) if good else failed(said)


@requires(10, f"{MANUAL}, k")
def buttons_are_told(seen: MagellanSeen) -> Verdict:
    """A button that is pressed is told, and again when it is let go."""
    if seen.phase("release") is None or seen.refused:
        return not_seen("none was pressed")
    down, up = seen.keys("press"), seen.keys("release")
    if not down or not down[-1]:
        return failed("pressing was not told")
    if not up:
        return failed("letting go was not told")
    return passed("pressed and let go") if not up[-1] else failed("it stays down")


@requires(11, "the system's serial driver")
def it_stays(seen: MagellanSeen) -> Verdict:
    """The port does not go while it is used."""
    hand = seen.phase("unplug")
    wrong = [index for index in seen.lost if hand is None or index < hand.first]
    if seen.refused:
        return not_seen("it was never opened")
    return failed("it went", wrong) if wrong else passed("it stayed")


@requires(12, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(seen: MagellanSeen) -> Verdict:
    """A second reader, the scapy layers, sees packets where the first one does."""
    try:
        from cardan.dissect.connexion_serial import Broken, MagellanPacket
    except ExtraMissingError as missing:
        return not_applicable(str(missing))
    if not seen.lines:
        return not_seen(_NOTHING)
    refused = [
        index for index, line in seen.lines if isinstance(MagellanPacket(line + b"\r"), Broken)
    ]
    known = [each.number for each in seen.packets if isinstance(each.value, Malformed)]
    alone = sorted(set(refused) ^ set(known))
    if alone:
        return failed(f"they differ on {len(alone)} packets", alone)
    return passed(f"{len(seen.lines)} packets read twice")


# -- level 1: asked -------------------------------------------------------------------------------


def _asked(seen: MagellanSeen, command: bytes) -> Asked | None:
    return next((each for each in seen.asked if each.command == command), None)


@requires(101, f"{SPACENAVD}: it waits a quarter of a second for the version")
def the_version_is_told(seen: MagellanSeen) -> Verdict:
    """vQ is answered with a version within 0.25 s."""
    found = _asked(seen, QUERY_VERSION)
    if found is None:
        return not_seen("it was not asked")
    if found.answer is None or not isinstance(found.answer.value, MagellanVersion):
        return failed("no version came", [found.number])
    after_ms = (found.answer.time_s - found.time_s) * 1e3
    said = f"{found.answer.value.text!r} complete after {after_ms:.0f} ms"
    # The line itself takes 1.1 ms a byte.
    first_ms = after_ms - 1.2 * len(found.answer.value.text)
    if first_ms > VERSION_WITHIN_S * 1e3:
        return failed(said, [found.answer.number], first_ms, "ms")
    return passed(said, max(0.0, first_ms), "ms")


@requires(102, f"{MANUAL}: a command that sets something is echoed")
def settings_are_echoed(seen: MagellanSeen) -> Verdict:
    """m3 and c33 are echoed."""
    found = [_asked(seen, command) for command in (MODE_3D, EXTENDED_COMPRESSED)]
    asked = [each for each in found if each is not None]
    if not asked:
        return not_seen("nothing was set")
    wrong = [
        each.number
        for each in asked
        if each.answer is None or getattr(each.answer.value, "command", b"") != each.command
    ]
    return failed("no such echo", wrong) if wrong else passed("both")


@requires(103, f"{MANUAL}, kQ")
def keys_can_be_asked_for(seen: MagellanSeen) -> Verdict:
    """kQ is answered with the keys, of which none is down."""
    found = _asked(seen, QUERY_KEYS)
    if found is None:
        return not_seen("it was not asked")
    mask = getattr(found.answer.value, "mask", None) if found.answer else None
    if mask is None:
        return failed("no keys came", [found.number])
    return passed("none is down") if not mask else failed(f"mask {mask:#x}", [found.number])


@requires(104, f"{MANUAL}, e: 1 is an illegal command")
def unknown_commands_are_refused(seen: MagellanSeen) -> Verdict:
    """What is no command is answered with an error."""
    if _asked(seen, UNKNOWN) is None:
        return not_seen("none was sent")
    found = [each.value for each in seen.during("ask") if isinstance(each.value, MagellanError)]
    return passed(f"error {found[0].code}") if found else failed("no error came")


@requires(105, f"{MANUAL}, c: compressed data with a checksum")
def motion_is_compressed(seen: MagellanSeen) -> Verdict:
    """After c33 motion comes compressed."""
    found = seen.motions("push-again")
    told = _asked(seen, EXTENDED_COMPRESSED)
    if told is None or told.answer is None or not found:
        return not_seen("no motion came after it")
    wrong = [e.number for e in found if not isinstance(e.value, MagellanCompressedMotion)]
    if wrong:
        return failed(f"{len(wrong)} of {len(found)} did not", wrong)
    return passed(f"{len(found)} packets")


@requires(106, f"{MANUAL}, cQ")
def settings_last(seen: MagellanSeen) -> Verdict:
    """What was set is still so later: cQ is answered c33."""
    set_, found = _asked(seen, EXTENDED_COMPRESSED), _asked(seen, QUERY_EXTENDED)
    if set_ is None or found is None or set_.answer is None:
        return not_seen("nothing was set")
    said = getattr(found.answer.value, "command", b"") if found.answer else b""
    if said == EXTENDED_COMPRESSED:
        return passed("c33")
    return failed(f"answered {said.decode('ascii', 'replace')!r}", [found.number])


@requires(107, f"{MANUAL}, d")
def it_reports_again(seen: MagellanSeen) -> Verdict:
    """After it was set up it reports motion as before."""
    if seen.phase("push-again") is None or seen.refused:
        return not_seen("it was not asked")
    found = [each for each in seen.motions("push-again") if any(each.counts)]
    return passed(f"{len(found)} packets") if found else failed("none came")


@requires(301, "the system's serial driver")
def unplugging_is_told(seen: MagellanSeen) -> Verdict:
    """Its port unplugged, the system says that it is gone, and nothing more comes."""
    phase = seen.phase("unplug")
    gone = [] if phase is None else [index for index in seen.lost if index >= phase.first]
    if not gone:
        return not_seen("it was not unplugged, or its port stays without it")
    after = [each.number for each in seen.packets if each.number > gone[0]]
    return failed("packets come from what is gone", after) if after else passed("told")
