"""Requirements for a serial device that speaks Magellan's protocol."""

from __future__ import annotations

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_seen,
    passed,
)
from cardan.conform.second_reading import second_description
from cardan_serial_mice.conform.magellan.decoded import MagellanTraffic
from cardan_serial_mice.conform.magellan.scenario import UNKNOWN
from cardan_serial_mice.conform.puck import checks
from cardan_serial_mice.protocol import (
    MagellanCompressedMotion,
    MagellanError,
    MagellanVersion,
)
from cardan_serial_mice.protocol.magellan import (
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
"""Periods of a Turbo model, and of the default setting p22 with a tolerance."""
SILENT_S = 0.2
VERSION_WITHIN_S = 0.25
MOST_COUNTS = 512

requires: Requirements[MagellanTraffic] = Requirements("MAG")


@requires(1, "the system's serial driver")
def it_can_be_opened(decoded: MagellanTraffic) -> Verdict:
    """The port can be opened."""
    return checks.opened(decoded)


@requires(2, f"{MANUAL}: mode 3 is the default")
def deflection_is_reported(decoded: MagellanTraffic) -> Verdict:
    """Deflected, it sends motion packets without having been told to."""
    return checks.reported(decoded)


@requires(3, KERNEL)
def packets_are_whole(decoded: MagellanTraffic) -> Verdict:
    """Every packet has a known letter, its length, and no byte or sum that cannot be."""
    return checks.whole(decoded)


@requires(4, RATE)
def the_rate_is_a_magellans(decoded: MagellanTraffic) -> Verdict:
    """Held deflected, it sends a packet every 18 to 75 ms."""
    return checks.rate(decoded, FASTEST_S, SLOWEST_S)


@requires(5, f"{MANUAL}: data are sent periodically while they are not zero")
def deflection_is_never_silent(decoded: MagellanTraffic) -> Verdict:
    """Held deflected, it is never silent for more than 0.2 s."""
    return checks.silent(decoded, SILENT_S)


@requires(6, f"{MANUAL}: one zero packet, then silence")
def the_last_value_is_zero(decoded: MagellanTraffic) -> Verdict:
    """Let go, it sends zero on all axes, once or twice, as the last of the motion."""
    return checks.ends_with_zero(decoded)


@requires(7, f"{MANUAL}: one zero packet, then silence")
def rest_is_silent(decoded: MagellanTraffic) -> Verdict:
    """Let go, it then sends nothing."""
    return checks.silent_at_rest(decoded)


@requires(8, "+-360 (Linux) to +-512 at the default sensitivity")
def counts_are_in_range(decoded: MagellanTraffic) -> Verdict:
    """At the default sensitivity no axis goes beyond +-512."""
    return checks.in_range(decoded, MOST_COUNTS, MOST_COUNTS)


@requires(9, f"{MANUAL}: X right, Y up, Z towards the operator; right-handed")
def axes_have_their_signs(decoded: MagellanTraffic) -> Verdict:
    """Pushed to the right X is positive and the largest; twisted clockwise B is negative and the
    largest."""
    return checks.signs(decoded)


@requires(10, f"{MANUAL}, k")
def buttons_are_reported(decoded: MagellanTraffic) -> Verdict:
    """Every press and release of a button is reported."""
    return checks.buttons(decoded)


@requires(11, "the system's serial driver")
def stays_connected(decoded: MagellanTraffic) -> Verdict:
    """The port does not go while it is used."""
    return checks.stays(decoded)


@requires(12, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: MagellanTraffic) -> Verdict:
    """A second reader, the scapy layers, sees packets where the first one does."""
    layers = second_description("serial_mice")
    return checks.read_twice(
        decoded, checks.lines, lambda line: isinstance(layers.MagellanPacket(line), layers.Broken)
    )


# -- level 1: asked -------------------------------------------------------------------------------


@requires(101, f"{SPACENAVD}: it waits a quarter of a second for the version")
def the_version_is_reported(decoded: MagellanTraffic) -> Verdict:
    """vQ is answered with a version within 0.25 s."""
    found = decoded.sent_command(QUERY_VERSION)
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
def settings_are_echoed(decoded: MagellanTraffic) -> Verdict:
    """m3 and c33 are echoed."""
    found = [decoded.sent_command(command) for command in (MODE_3D, EXTENDED_COMPRESSED)]
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
def keys_can_be_asked_for(decoded: MagellanTraffic) -> Verdict:
    """kQ is answered with the keys, of which none is down."""
    found = decoded.sent_command(QUERY_KEYS)
    if found is None:
        return not_seen("it was not asked")
    mask = getattr(found.answer.value, "mask", None) if found.answer else None
    if mask is None:
        return failed("no keys came", [found.number])
    return passed("none is down") if not mask else failed(f"mask {mask:#x}", [found.number])


@requires(104, f"{MANUAL}, e: 1 is an illegal command")
def unknown_commands_are_refused(decoded: MagellanTraffic) -> Verdict:
    """Unknown commands are answered with an error."""
    if decoded.sent_command(UNKNOWN) is None:
        return not_seen("none was sent")
    found = [each.value for each in decoded.during("ask") if isinstance(each.value, MagellanError)]
    return passed(f"error {found[0].code}") if found else failed("no error came")


@requires(105, f"{MANUAL}, c: compressed data with a checksum")
def motion_is_compressed(decoded: MagellanTraffic) -> Verdict:
    """After c33 motion comes compressed."""
    found = decoded.motions("push-again")
    sent_command = decoded.sent_command(EXTENDED_COMPRESSED)
    if sent_command is None or sent_command.answer is None or not found:
        return not_seen("no motion came after it")
    wrong = [e.number for e in found if not isinstance(e.value, MagellanCompressedMotion)]
    if wrong:
        return failed(f"{len(wrong)} of {len(found)} did not", wrong)
    return passed(f"{len(found)} packets")


@requires(106, f"{MANUAL}, cQ")
def settings_last(decoded: MagellanTraffic) -> Verdict:
    """Settings last: cQ is answered c33 later."""
    set_, found = decoded.sent_command(EXTENDED_COMPRESSED), decoded.sent_command(QUERY_EXTENDED)
    if set_ is None or found is None or set_.answer is None:
        return not_seen("nothing was set")
    said = getattr(found.answer.value, "command", b"") if found.answer else b""
    if said == EXTENDED_COMPRESSED:
        return passed("c33")
    return failed(f"answered {said.decode('ascii', 'replace')!r}", [found.number])


@requires(107, f"{MANUAL}, d")
def it_reports_again(decoded: MagellanTraffic) -> Verdict:
    """After it was set up it reports motion as before."""
    return checks.reported_again(decoded)


@requires(301, "the system's serial driver")
def unplugging_is_reported(decoded: MagellanTraffic) -> Verdict:
    """Its port unplugged, the system says that it is gone, and nothing more comes."""
    return checks.unplugged(decoded)
