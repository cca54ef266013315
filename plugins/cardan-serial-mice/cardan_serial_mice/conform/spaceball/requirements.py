"""Requirements for a Spaceball on its serial line."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from statistics import median

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_seen,
    passed,
)
from cardan.conform.second_reading import second_description
from cardan_serial_mice.conform.puck import checks
from cardan_serial_mice.conform.spaceball.packets import UNKNOWN, BallTraffic
from cardan_serial_mice.protocol import (
    SpaceballAdvancedKeys,
    SpaceballError,
    SpaceballKeys,
    SpaceballMotion,
    SpaceballReset,
    model_of_firmware,
)
from cardan_serial_mice.protocol.spaceball import (
    BINARY,
    PERIOD_UNIT_S,
    QUERY_KEYS,
    RATE_20_HZ,
    RESET,
    SEND_VECTORS,
    XOFF,
    XON,
)

HOSTS = "VRPN, Linux spaceball.c and inputattach (plugins/cardan-serial-mice/README.md)"
SPACENAVD = "FreeSpacenav spacenavd, src/serial"
KERNEL = "Linux drivers/input/joystick/spaceball.c"

FASTEST_S, SLOWEST_S = 0.045, 0.060
SILENT_S = 0.2
MOST_COUNTS, MOST_TURN_COUNTS = 10_000, 2000
"""A quarter more than the full deflection of Linux's driver at 20 Hz."""
RESET_WITHIN_S, ANSWER_S = 2.0, 0.25
PERIOD_SHARE, PERIOD_S = 0.1, 0.1
STEADY_SHARE, STEADY_COUNTS = 0.25, 400

requires: Requirements[BallTraffic] = Requirements("BALL")


@requires(1, "the system's serial driver")
def it_can_be_opened(decoded: BallTraffic) -> Verdict:
    """The port can be opened."""
    return checks.opened(decoded)


def _lines(decoded: BallTraffic, *phases: str) -> list[tuple[int, str]]:
    found = decoded.during(*phases) if phases else decoded.packets
    return [(e.number, e.value.text) for e in found if isinstance(e.value, SpaceballReset)]


def _banner(lines: Iterable[tuple[int, str]]) -> Verdict:
    texts = [text for _, text in lines]
    if not any(text.startswith("1") for text in texts):
        return failed("nothing came")
    firmware = [text for text in texts if text.startswith("2")]
    if not firmware:
        return failed("it does not name its firmware")
    model = model_of_firmware(firmware[0])
    return failed(repr(firmware[0])) if model is None else passed(model.name)


@requires(2, f"{SPACENAVD}: @1 and @2")
def it_says_what_it_is(decoded: BallTraffic) -> Verdict:
    """Within 2 s of power it says that it is alive, and names a firmware that is known."""
    return not_seen("it was never opened") if decoded.refused else _banner(_lines(decoded, "rest"))


@requires(3, f"{SPACENAVD}: @1 and @2")
def it_starts_once(decoded: BallTraffic) -> Verdict:
    """It starts with its power and with a reset, and at no other time."""
    asked = {number for number, _ in _lines(decoded, "rest", "reset")}
    found = [number for number, _ in _lines(decoded)]
    if not found:
        return not_seen("it never said that it has started")
    wrong = [number for number in found if number not in asked]
    return failed(f"{len(wrong)} lines come unasked", wrong) if wrong else passed("once")


@requires(4, f"{HOSTS}: a letter, data with escapes, and CR")
def packets_are_whole(decoded: BallTraffic) -> Verdict:
    """Every packet has a known letter, its length, and escapes that there are."""
    return checks.whole(decoded)


@requires(5, f"{HOSTS}: no ball data without M")
def it_waits_for_a_command(decoded: BallTraffic) -> Verdict:
    """It sends no motion before the command to do so."""
    if not decoded.packets:
        return not_seen(checks.NOTHING)
    found = [each.number for each in decoded.motions("rest", "press", "release", "reset")]
    return failed(f"{len(found)} packets", found) if found else passed("none")


@requires(6, f"{HOSTS}: K, and . of a 4000 FLX")
def buttons_are_reported(decoded: BallTraffic) -> Verdict:
    """Every press and release of a button is reported, alone."""
    return checks.buttons(decoded)


@requires(7, "the system's serial driver")
def stays_connected(decoded: BallTraffic) -> Verdict:
    """The port does not go while it is used."""
    return checks.stays(decoded)


@requires(8, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: BallTraffic) -> Verdict:
    """A second reader, the scapy layers, finds as many broken packets as the first one."""
    layers = second_description("serial_mice")
    return checks.read_twice(
        decoded, _pieces, lambda piece: isinstance(layers.SpaceballPacket(piece), layers.Broken)
    )


def _pieces(stream: bytes) -> list[bytes]:
    return checks.lines(stream.translate(None, bytes((XON, XOFF, 0x0A))))


@requires(9, f"{HOSTS}: bytes of keys carry bit 6")
def bytes_of_keys_are_marked(decoded: BallTraffic) -> Verdict:
    """Both bytes of every packet of keys have bit 6."""
    found = [
        (each.number, each.value)
        for each in decoded.packets
        if isinstance(each.value, (SpaceballKeys, SpaceballAdvancedKeys))
    ]
    wrong = [number for number, keys in found if not keys.high & keys.low & 0x40]
    if not found:
        return not_seen("no keys were reported")
    return failed(f"{len(wrong)} of {len(found)}", wrong) if wrong else passed(f"{len(found)}")


# -- level 1: asked -------------------------------------------------------------------------------


@requires(101, f"{SPACENAVD}: it waits 2 s for @1")
def it_can_be_reset(decoded: BallTraffic) -> Verdict:
    """After a reset it reports its identity within 2 s."""
    if decoded.sent_command(RESET) is None:
        return not_seen("it was not reset")
    said = _banner(_lines(decoded, "reset"))
    within = checks.answered(decoded.sent_command(RESET), RESET_WITHIN_S)
    return said if said.outcome.value == "failed" else within


@requires(102, f"{HOSTS}: a command that sets something is echoed")
def settings_are_echoed(decoded: BallTraffic) -> Verdict:
    """CB, P and M are echoed within 0.25 s."""
    asked = [decoded.sent_command(command) for command in (BINARY, RATE_20_HZ, SEND_VECTORS)]
    verdicts = [checks.answered(each, ANSWER_S) for each in asked]
    return next((each for each in verdicts if each.outcome.value == "failed"), verdicts[-1])


@requires(103, f"{HOSTS}: k")
def keys_can_be_asked_for(decoded: BallTraffic) -> Verdict:
    """k is answered within 0.25 s with the keys, of which none is down."""
    asked = decoded.sent_command(QUERY_KEYS)
    if asked is not None and asked.answer is not None and asked.answer.mask:
        return failed(f"mask {asked.answer.mask:#x}", [asked.answer.number])
    return checks.answered(asked, ANSWER_S)


@requires(104, f"{HOSTS}: ?")
def unknown_commands_are_refused(decoded: BallTraffic) -> Verdict:
    """Unknown commands are answered with ? within 0.25 s, and no others are."""
    sent_command = decoded.sent_command(UNKNOWN)
    if sent_command is None:
        return not_seen("none was sent")
    early = [
        each.number
        for each in decoded.packets
        if isinstance(each.value, SpaceballError) and each.number < sent_command.number
    ]
    return (
        failed("it refuses others, too", early)
        if early
        else checks.answered(sent_command, ANSWER_S)
    )


@requires(105, f"{HOSTS}: D while it is deflected")
def deflection_is_reported(decoded: BallTraffic) -> Verdict:
    """Told to, it sends motion while it is deflected."""
    return checks.reported(decoded)


@requires(106, f"{HOSTS}: P@r@r is 50 ms")
def the_rate_is_what_was_set(decoded: BallTraffic) -> Verdict:
    """Held deflected, it sends a packet every 45 to 60 ms."""
    return checks.rate(decoded, FASTEST_S, SLOWEST_S)


@requires(107, f"{HOSTS}: D while it is deflected")
def deflection_is_never_silent(decoded: BallTraffic) -> Verdict:
    """Held deflected, it is never silent for more than 0.2 s."""
    return checks.silent(decoded, SILENT_S)


@requires(108, f"{HOSTS}: zero, then none")
def the_last_value_is_zero(decoded: BallTraffic) -> Verdict:
    """Let go, it sends zero on all axes as the last of the motion."""
    return checks.ends_with_zero(decoded)


@requires(109, f"{HOSTS}: zero, then none")
def rest_is_silent(decoded: BallTraffic) -> Verdict:
    """Let go, it then sends no motion."""
    return checks.silent_at_rest(decoded)


@requires(110, f"{KERNEL}: +-8000 and +-1600")
def counts_are_in_range(decoded: BallTraffic) -> Verdict:
    """At 20 Hz no translation goes beyond +-10000 counts, and no rotation beyond +-2000."""
    return checks.in_range(decoded, MOST_COUNTS, MOST_TURN_COUNTS)


@requires(111, f"{HOSTS}: X right, Y up, Z away; rotations about them by the right hand")
def axes_have_their_signs(decoded: BallTraffic) -> Verdict:
    """Pushed to the right X is positive and the largest translation; twisted clockwise the rotation
    about Y is negative and the largest."""
    return checks.signs(decoded)


@requires(112, f"{HOSTS}: the period in sixteenths of a millisecond")
def periods_are_those_of_motion(decoded: BallTraffic) -> Verdict:
    """The periods that motions report add up to the time between them, to 10 %, and none is off by
    more than 0.1 s."""
    reported_s, took_s, wrong = 0.0, 0.0, []
    for name in checks.HELD:
        for one, other in pairwise(decoded.motions(name)):
            assert isinstance(other.value, SpaceballMotion)
            period_s, between_s = PERIOD_UNIT_S * other.value.period, other.time_s - one.time_s
            reported_s, took_s = reported_s + period_s, took_s + between_s
            if abs(period_s - between_s) > PERIOD_S:
                wrong.append(other.number)
    if wrong:
        return failed(f"{len(wrong)} are off", wrong)
    if not took_s:
        return not_seen(checks.NOTHING)
    said = f"{100.0 * reported_s / took_s:.0f} % of the time"
    return passed(said) if abs(reported_s / took_s - 1.0) < PERIOD_SHARE else failed(said)


@requires(113, "packets have no checksum: what is mangled shows as a jump")
def a_steady_hand_is_steady(decoded: BallTraffic) -> Verdict:
    """Held steadily, no axis jumps by a quarter of its size, or 400 counts where that is more."""
    wrong, count = [], 0
    for name in checks.HELD:
        found = decoded.motions(name)
        count += len(found)
        if not found:
            continue
        middles = [median(axis) for axis in zip(*(each.counts for each in found), strict=True)]
        for each in found:
            off = zip(each.counts, middles, strict=True)
            if any(abs(c - m) > max(STEADY_COUNTS, STEADY_SHARE * abs(m)) for c, m in off):
                wrong.append(each.number)
    if wrong:
        return failed(f"{len(wrong)} of {count} jump", wrong)
    return passed(f"{count} packets") if count else not_seen(checks.NOTHING)


@requires(301, "the system's serial driver")
def unplugging_is_reported(decoded: BallTraffic) -> Verdict:
    """Its port unplugged, the system says that it is gone, and nothing more comes."""
    return checks.unplugged(decoded)
