"""Requirements for a JR3 sensor behind uc3m's board."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_seen,
    passed,
)
from cardan.conform.second_reading import second_description
from cardan_jr3.conform.decoded import Asked, Jr3Traffic, Said
from cardan_jr3.conform.scenario import PERIOD_US, SYNCS
from cardan_jr3.protocol import (
    Ack,
    Bootup,
    Forces,
    GetFsForces,
    GetFsMoments,
    Moments,
    StartAsync,
    State,
    Sync,
    samples_between,
)
from cardan_jr3.protocol.scaling import FULL_SCALE_COUNTS, SAMPLE_PERIOD_S

FIRMWARE = "roboticslab-uc3m/jr3-mbed-firmware-can"
SENSOR = "roboticslab-uc3m/jr3-mbed-firmware"
YARP = "roboticslab-uc3m/yarp-devices, Jr3Mbed"

ACK_WITHIN_S = 0.1
GAP_PERIODS = 6
PERIOD_SHARE = 0.02
RATE_SHARE = 0.02
DRIFT_N = 0.5
LOADED_N = 1.0
FIRST_COUNTER = 2000
"""A quarter of a second of samples."""

requires: Requirements[Jr3Traffic] = Requirements("JR3")
_NOT_RUN = "acquisition was not started"


def _bad(found: Iterable[tuple[int, str]], of: int, good: str, nothing: str = _NOT_RUN) -> Verdict:
    wrong = list(found)
    if wrong:
        return failed(f"{len(wrong)} of {of}: {wrong[0][1]}", (n for n, _ in wrong))
    return passed(good) if of else not_seen(nothing)


@requires(1, f"{FIRMWARE}: BOOTUP once the sensor is read")
def it_says_that_it_started(decoded: Jr3Traffic) -> Verdict:
    """Powered, the board sends BOOTUP once, and samples only on request."""
    found = decoded.during("listen")
    boots = [each for each in found if isinstance(each.value, Bootup)]
    others = [each.number for each in found if not isinstance(each.value, Bootup)]
    if others:
        return failed("something else came", others)
    return passed("BOOTUP") if len(boots) == 1 else failed(f"{len(boots)} times")


@requires(2, FIRMWARE)
def frames_are_whole(decoded: Jr3Traffic) -> Verdict:
    """Every frame of the node has the length of its operation code."""
    count = len(decoded.frames)
    return _bad(decoded.malformed, count, f"{count} frames", "no frames came")


@requires(3, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: Jr3Traffic) -> Verdict:
    """A second reader, the scapy layers, finds the same frames wrong."""
    malformed = second_description("jr3").malformed
    if not decoded.frames:
        return not_seen("no frames came")
    wrong = {number for number, _ in decoded.malformed}
    chosen = {*wrong, *list(decoded.frames)[:: max(1, len(decoded.frames) // 50)]}
    alone = sorted(n for n in chosen if (malformed(*decoded.frames[n]) is not None) != (n in wrong))
    if alone:
        return failed(f"they differ on {len(alone)} frames", alone)
    return passed(f"{len(chosen)} frames read twice")


def _acked(decoded: Jr3Traffic) -> list[Asked]:
    return [each for each in decoded.asked if not isinstance(each.value, Sync)]


@requires(101, f"{FIRMWARE}: every request but SYNC and the gripper's is acknowledged")
def requests_are_acknowledged(decoded: Jr3Traffic) -> Verdict:
    """Every request is acknowledged within 0.1 s."""
    wrong = []
    for each in _acked(decoded):
        if each.ack is None:
            wrong.append((each.number, f"no ACK of {type(each.value).__name__}"))
        elif each.ack.time_s - each.time_s > ACK_WITHIN_S:
            wrong.append((each.ack.number, f"after {each.ack.time_s - each.time_s:.2f} s"))
    return _bad(
        wrong, len(_acked(decoded)), f"{len(_acked(decoded))} requests", "nothing was asked"
    )


@requires(102, f"{FIRMWARE}: 0 is ready")
def it_is_ready(decoded: Jr3Traffic) -> Verdict:
    """Every acknowledgment says that the board is ready."""
    found = [each for each in decoded.said if isinstance(each.value, Ack)]
    wrong = [
        (each.number, f"state {each.value.state}")
        for each in found
        if isinstance(each.value, Ack) and each.value.state != State.READY
    ]
    return _bad(wrong, len(found), f"{len(found)} times", "nothing was acknowledged")


@requires(103, f"{FIRMWARE}; JR3's full scales are hundreds of N and tens of N·m")
def full_scales_are_reported(decoded: Jr3Traffic) -> Verdict:
    """Asked for, the full scales come with the acknowledgment, all above 0."""
    asked = [e for e in decoded.asked if isinstance(e.value, (GetFsForces, GetFsMoments))]
    if not asked:
        return not_seen("they were not asked for")
    scales = decoded.scales()
    if scales is None:
        return failed("they did not come", [each.number for each in asked])
    forces, moments = scales
    good = all(each > 0 for each in (*forces, *moments))
    said = f"{forces} N, {moments} x 0.1 N·m"
    return passed(said) if good else failed(said)


@requires(104, f"{FIRMWARE}: FORCES, then MOMENTS of the same sample")
def samples_come_in_pairs(decoded: Jr3Traffic) -> Verdict:
    """After each FORCES comes its MOMENTS, with the same counter."""
    found = decoded.samples("run")
    wrong, count = [], 0
    for one, other in pairwise(found):
        if isinstance(one.value, Forces):
            count += 1
            if not isinstance(other.value, Moments):
                wrong.append((other.number, "FORCES without MOMENTS"))
            elif other.value.counter != one.value.counter:
                wrong.append((other.number, f"{other.value.counter} with {one.value.counter}"))
        elif not isinstance(other.value, Forces):
            wrong.append((other.number, "MOMENTS without FORCES"))
    return _bad(wrong, count, f"{count} pairs")


def _forces(decoded: Jr3Traffic, *phases: str) -> list[tuple[Said, Forces]]:
    return [(e, e.value) for e in decoded.samples(*phases) if isinstance(e.value, Forces)]


@requires(105, f"{SENSOR}: the counter counts samples, 7782 a second")
def the_counter_counts_samples(decoded: Jr3Traffic) -> Verdict:
    """From pair to pair the counter goes up, and over the whole as samples do, to 2 %."""
    found = _forces(decoded, "run")
    if len(found) < 10:
        return not_seen("fewer than 10 samples")
    still = [
        (b.number, f"{other.counter} again")
        for (_, one), (b, other) in pairwise(found)
        if samples_between(other.counter, one.counter) == 0
    ]
    if still:
        return _bad(still, len(found), "")
    passed_s = found[-1][0].time_s - found[0][0].time_s
    steps = sum(
        samples_between(other.counter, one.counter) for (_, one), (_, other) in pairwise(found)
    )
    share = steps * SAMPLE_PERIOD_S / passed_s
    said = f"{steps} in {passed_s:.2f} s"
    return passed(said) if abs(share - 1.0) < RATE_SHARE else failed(said, [found[-1][0].number])


@requires(106, f"{FIRMWARE}, START_ASYNC")
def samples_come_in_their_period(decoded: Jr3Traffic) -> Verdict:
    """Told to send every 5 ms, it does, to 2 % in the mean, and is never silent for 30 ms."""
    phase, found = decoded.phase("run"), _forces(decoded, "run")
    started = any(isinstance(e.value, StartAsync) and e.ack is not None for e in decoded.asked)
    if phase is None or not started:
        return not_seen(_NOT_RUN)
    if len(found) < 10:
        return failed(f"{len(found)} samples")
    period_s = PERIOD_US * 1e-6
    times = [phase.start_s, *(each.time_s for each, _ in found), phase.end_s]
    longest = max(b - a for a, b in pairwise(times))
    mean_s = (found[-1][0].time_s - found[0][0].time_s) / (len(found) - 1)
    said = f"{mean_s * 1e3:.3f} ms, longest {longest * 1e3:.0f} ms"
    good = abs(mean_s / period_s - 1.0) < PERIOD_SHARE and longest < GAP_PERIODS * period_s
    return passed(said, longest * 1e3, "ms") if good else failed(said, [found[-1][0].number])


@requires(107, f"{FIRMWARE}: its settings are lost after BOOTUP")
def it_does_not_start_anew(decoded: Jr3Traffic) -> Verdict:
    """No BOOTUP comes while it is used."""
    listen = decoded.phase("listen")
    end = 0 if listen is None else listen.end
    later = [e.number for e in decoded.said if isinstance(e.value, Bootup) and e.number >= end]
    if not decoded.asked:
        return not_seen("nothing was asked")
    return failed("it did", later) if later else passed("none came")


@requires(108, f"{FIRMWARE}, STOP: the counter begins at 0")
def the_counter_begins_at_0(decoded: Jr3Traffic) -> Verdict:
    """After the start, and after a stop, the counter begins within a quarter of a second of 0."""
    found = [_forces(decoded, "start"), _forces(decoded, "syncs")]
    firsts = [each[0] for each in found if each]
    wrong = (
        (each.number, f"it begins at {value.counter}")
        for each, value in firsts
        if value.counter > FIRST_COUNTER
    )
    return _bad(wrong, len(firsts), f"{len(firsts)} times")


def _mean_n(decoded: Jr3Traffic, found: list[tuple[Said, Forces]]) -> list[float] | None:
    scales = decoded.scales()
    if scales is None or not found:
        return None
    units = scales.per_count
    rows = [(value.x, value.y, value.z) for _, value in found]
    return [
        sum(axis) / len(rows) * unit
        for axis, unit in zip(zip(*rows, strict=True), units[:3], strict=True)
    ]


@requires(109, f"{FIRMWARE}, ZERO_OFFS")
def zero_is_where_it_was_set(decoded: Jr3Traffic) -> Verdict:
    """Left alone after ZERO_OFFS, the forces stay within 0.5 N of zero."""
    found = _forces(decoded, "run")
    if len(found) < 50:
        return not_seen("too few samples")
    tenth = len(found) // 10
    means = [_mean_n(decoded, found[:tenth]), _mean_n(decoded, found[-tenth:])]
    values = [abs(axis) for mean in means if mean is not None for axis in mean]
    if not values:
        return not_seen("the full scales are not known")
    said = f"{max(values):.2f} N at most"
    if max(values) > DRIFT_N:
        return failed(said, [found[-1][0].number], max(values), "N")
    return passed(said, max(values), "N")


@requires(110, f"{FIRMWARE}: 16384 is the full scale, and overloads are more")
def samples_are_in_range(decoded: Jr3Traffic) -> Verdict:
    """Left alone, no component is beyond the full scale."""
    found = [
        (each.number, max(abs(each.value.x), abs(each.value.y), abs(each.value.z)))
        for each in decoded.samples("run")
        if isinstance(each.value, (Forces, Moments))
    ]
    wrong = [(number, f"{most} counts") for number, most in found if most > FULL_SCALE_COUNTS]
    return _bad(wrong, len(found), f"{len(found)} frames")


@requires(111, f"{FIRMWARE}, STOP")
def it_stops(decoded: Jr3Traffic) -> Verdict:
    """Told to stop, it sends no more samples."""
    if decoded.phase("stopped") is None or not decoded.samples("run"):
        return not_seen(_NOT_RUN)
    found = [each.number for each in decoded.samples("stopped")]
    return failed(f"{len(found)} frames", found) if found else passed("nothing came")


@requires(112, f"{FIRMWARE}, START_SYNC and SYNC")
def sync_is_answered_by_a_pair(decoded: Jr3Traffic) -> Verdict:
    """In synchronous mode each SYNC is answered by one pair."""
    if decoded.phase("syncs") is None:
        return not_seen("it was not tried")
    count = len(_forces(decoded, "syncs"))
    said = f"{count} pairs for {SYNCS} SYNCs"
    return passed(said) if count == SYNCS else failed(said)


@requires(301, f"{YARP}: raw value times full scale by 16384")
def a_load_is_felt(decoded: Jr3Traffic) -> Verdict:
    """Pressed upon, it shows a force of 1 N and more."""
    found = _forces(decoded, "load")
    scales = decoded.scales()
    if not found or scales is None:
        return not_seen("nothing came")
    units = scales.per_count
    most = max(
        abs(count) * unit
        for _, value in found
        for count, unit in zip((value.x, value.y, value.z), units[:3], strict=True)
    )
    return passed(f"{most:.1f} N") if most > LOADED_N else failed(f"{most:.2f} N")
