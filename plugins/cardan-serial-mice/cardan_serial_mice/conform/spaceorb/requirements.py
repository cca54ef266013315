"""Requirements for a SpaceOrb 360 on its serial line."""

from __future__ import annotations

from itertools import pairwise

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_seen,
    passed,
)
from cardan.conform.second_reading import second_description
from cardan_serial_mice.conform.puck import checks
from cardan_serial_mice.conform.spaceorb.packets import NULL_REGION, POLL, OrbTraffic
from cardan_serial_mice.protocol import OrbError, OrbKeys, OrbReset, OrbText
from cardan_serial_mice.protocol.spaceorb import HEARTBEAT_S, QUERY

KERNEL = "Linux drivers/input/joystick/spaceorb.c"
CAPTURES = (
    "published descriptions and captures of the SpaceOrb (plugins/cardan-serial-mice/README.md)"
)

FASTEST_S, SLOWEST_S = 0.028, 0.040
SILENT_S = 0.2
MOST_COUNTS = 510
"""508 by Linux's driver, and the noise of a held cap."""
BEAT_S = 1.3 * HEARTBEAT_S
ANSWER_S = 0.25

requires: Requirements[OrbTraffic] = Requirements("ORB")


@requires(1, "the system's serial driver")
def it_can_be_opened(decoded: OrbTraffic) -> Verdict:
    """The port can be opened."""
    return checks.opened(decoded)


@requires(2, f"{CAPTURES}: R, a second after power")
def it_says_what_it_is(decoded: OrbTraffic) -> Verdict:
    """Within 2 s of power it reports its identity, and names itself a Spaceball."""
    if decoded.refused:
        return not_seen("it was never opened")
    found = [e for e in decoded.during("rest") if isinstance(e.value, OrbReset)]
    if not found or not isinstance(found[0].value, OrbReset):
        return failed("nothing came")
    said = found[0].value.text
    return passed(repr(said)) if "paceball" in said else failed(repr(said), [found[0].number])


@requires(3, f"{CAPTURES}: R, a second after power")
def it_starts_once(decoded: OrbTraffic) -> Verdict:
    """It starts once, and does not restart while it is used."""
    found = [each.number for each in decoded.packets if isinstance(each.value, OrbReset)]
    if not found:
        return not_seen("it never said that it has started")
    return failed(f"{len(found)} times", found[1:]) if len(found) > 1 else passed("once")


@requires(4, f"{KERNEL}; {CAPTURES}: data with bit 7 set, and a checksum")
def packets_are_whole(decoded: OrbTraffic) -> Verdict:
    """Every packet has a known letter, its length, and a right checksum."""
    return checks.whole(decoded)


@requires(5, f"{CAPTURES}: K once a second and more")
def it_says_that_it_is_there(decoded: OrbTraffic) -> Verdict:
    """At rest it reports its buttons every 1.3 s and more often."""
    phase = decoded.phase("beats")
    if phase is None or decoded.refused:
        return not_seen("it was never opened")
    found = [e.time_s for e in decoded.during("beats") if isinstance(e.value, OrbKeys)]
    times = [phase.start_s, *found, phase.end_s]
    longest = max(b - a for a, b in pairwise(times))
    said = f"{longest:.2f} s at most"
    return passed(said, longest, "s") if longest <= BEAT_S else failed(said, (), longest, "s")


@requires(6, KERNEL)
def it_is_well(decoded: OrbTraffic) -> Verdict:
    """It reports no error."""
    found = [each.number for each in decoded.packets if isinstance(each.value, OrbError)]
    if not decoded.packets:
        return not_seen(checks.NOTHING)
    return failed(f"{len(found)} times", found) if found else passed("none")


@requires(7, f"{CAPTURES}: D while it is deflected")
def deflection_is_reported(decoded: OrbTraffic) -> Verdict:
    """Deflected, it sends motion without having been told to."""
    return checks.reported(decoded)


@requires(8, f"{CAPTURES}: 33 ms")
def the_rate_is_an_orbs(decoded: OrbTraffic) -> Verdict:
    """Held deflected, it sends a packet every 28 to 40 ms."""
    return checks.rate(decoded, FASTEST_S, SLOWEST_S)


@requires(9, f"{CAPTURES}: D while it is deflected")
def deflection_is_never_silent(decoded: OrbTraffic) -> Verdict:
    """Held deflected, it is never silent for more than 0.2 s."""
    return checks.silent(decoded, SILENT_S)


@requires(10, f"{CAPTURES}: one zero packet, then none")
def the_last_value_is_zero(decoded: OrbTraffic) -> Verdict:
    """Let go, it sends zero on all axes as the last of the motion."""
    return checks.ends_with_zero(decoded)


@requires(11, f"{CAPTURES}: one zero packet, then none")
def rest_is_silent(decoded: OrbTraffic) -> Verdict:
    """Let go, it then sends no motion."""
    return checks.silent_at_rest(decoded)


@requires(12, f"{KERNEL}: +-508")
def counts_are_in_range(decoded: OrbTraffic) -> Verdict:
    """No axis goes beyond +-510."""
    return checks.in_range(decoded, MOST_COUNTS, MOST_COUNTS)


@requires(13, f"{CAPTURES}: X right, Y up, Z towards the operator; right-handed")
def axes_have_their_signs(decoded: OrbTraffic) -> Verdict:
    """Pushed to the right X is positive and the largest translation; twisted clockwise the rotation
    about Y is negative and the largest."""
    return checks.signs(decoded)


@requires(14, f"{CAPTURES}, K")
def buttons_are_reported(decoded: OrbTraffic) -> Verdict:
    """Every press and release of a button is reported, alone."""
    return checks.buttons(decoded)


@requires(15, "the system's serial driver")
def stays_connected(decoded: OrbTraffic) -> Verdict:
    """The port does not go while it is used."""
    return checks.stays(decoded)


@requires(16, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: OrbTraffic) -> Verdict:
    """A second reader, the scapy layers, finds as many broken packets as the first one."""
    layers = second_description("serial_mice")
    return checks.read_twice(
        decoded, _pieces, lambda piece: isinstance(layers.SpaceOrbPacket(piece), layers.Broken)
    )


def _pieces(stream: bytes) -> list[bytes]:
    """Split a stream into packets: a letter, and bytes with bit 7 set; the last packet, which may
    be incomplete, is left out."""
    pieces: list[bytearray] = []
    for byte in stream:
        if byte < 0x80 or not pieces:
            pieces.append(bytearray())
        if byte != 0x0D:
            pieces[-1].append(byte)
    return [bytes(each) for each in pieces[:-1] if each]


# -- level 1: asked -------------------------------------------------------------------------------


@requires(101, f"{CAPTURES}: ?")
def it_can_be_asked_what_it_is(decoded: OrbTraffic) -> Verdict:
    """? is answered within 0.25 s, with two packets of information."""
    asked = decoded.sent_command(QUERY)
    verdict = checks.answered(asked, ANSWER_S)
    found = [
        each.value
        for each in decoded.during("ask")
        if isinstance(each.value, OrbText) and each.value.letter == ord("!")
    ]
    if asked is not None and asked.answer is not None and len(found) != 2:
        return failed(f"{len(found)} packets", [asked.number])
    return verdict


@requires(102, f"{CAPTURES}: n")
def the_null_region_can_be_asked_for(decoded: OrbTraffic) -> Verdict:
    """n is answered with the null region within 0.25 s."""
    return checks.answered(decoded.sent_command(NULL_REGION), ANSWER_S)


@requires(103, f"{CAPTURES}: d")
def motion_can_be_asked_for(decoded: OrbTraffic) -> Verdict:
    """d is answered with a motion within 0.25 s, which is zero at rest."""
    asked = decoded.sent_command(POLL)
    if asked is not None and asked.answer is not None and any(asked.answer.counts):
        return failed(f"{asked.answer.counts}", [asked.answer.number])
    return checks.answered(asked, ANSWER_S)


@requires(104, f"{CAPTURES}: D while it is deflected")
def it_reports_again(decoded: OrbTraffic) -> Verdict:
    """After it was asked it reports motion as before."""
    return checks.reported_again(decoded)


@requires(301, "the system's serial driver")
def unplugging_is_reported(decoded: OrbTraffic) -> Verdict:
    """Its port unplugged, the system says that it is gone, and nothing more comes."""
    return checks.unplugged(decoded)
