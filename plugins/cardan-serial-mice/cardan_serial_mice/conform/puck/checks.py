"""Checks that suit any serial six-axis device."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from cardan.conform.requirements import Verdict, failed, not_seen, passed
from cardan.conform.timing import never_silent
from cardan_serial_mice.conform.puck.decoded import Asked, PuckTraffic

HELD = ("push-held", "twist-held")
NOTHING = "no packets came"
Traffic = PuckTraffic[Any]


def opened(decoded: Traffic) -> Verdict:
    """Check that the port can be opened."""
    return failed("it was refused", decoded.refused) if decoded.refused else passed("opened")


def reported(decoded: Traffic) -> Verdict:
    """Check that it sends motion while deflected."""
    if decoded.refused or decoded.phase("push-held") is None:
        return not_seen("it was never deflected")
    found = [each for each in decoded.motions("push", "push-held") if any(each.counts)]
    return passed(f"{len(found)} packets") if found else failed("none came")


def reported_again(decoded: Traffic) -> Verdict:
    """Check that it reports motion after requests as before."""
    if decoded.phase("push-again") is None or decoded.refused:
        return not_seen("it was not asked")
    found = [each for each in decoded.motions("push-again") if any(each.counts)]
    return passed(f"{len(found)} packets") if found else failed("none came")


def whole(decoded: Traffic) -> Verdict:
    """Check that no packet is malformed."""
    if not decoded.packets:
        return not_seen(NOTHING)
    wrong = [
        (each.number, f"{chr(each.value.letter)!r} {each.value.reason}")
        for each in decoded.packets
        if each.is_malformed
    ]
    if wrong:
        words = f"{len(wrong)} of {len(decoded.packets)}: {wrong[0][1]}"
        return failed(words, (n for n, _ in wrong))
    return passed(f"{len(decoded.packets)} packets")


def rate(decoded: Traffic, fastest_s: float, slowest_s: float) -> Verdict:
    """Check that its mean period lies between these while it is held deflected."""
    periods = []
    for name in HELD:
        found = decoded.motions(name)
        if len(found) > 3:
            periods.append((found[-1].time_s - found[0].time_s) / (len(found) - 1))
    if not periods:
        return not_seen(NOTHING)
    worst = max(periods)
    said = f"{worst * 1e3:.0f} ms"
    good = min(periods) >= fastest_s and worst <= slowest_s
    return passed(said, worst * 1e3, "ms") if good else failed(said)


def silent(decoded: Traffic, most_s: float) -> Verdict:
    """Check that it is never silent for longer than `most_s` while it is held deflected."""
    return never_silent(((decoded.phase(name), decoded.motions(name)) for name in HELD), most_s)


def ends_with_zero(decoded: Traffic) -> Verdict:
    """Check that the last packet of each motion is zero on all axes."""
    wrong, count = [], 0
    for name in ("push", "twist"):
        found = decoded.motions(f"{name}-held", f"{name}-over")
        if not any(any(each.counts) for each in found):
            continue
        count += 1
        if any(found[-1].counts):
            wrong.append(found[-1].number)
    if wrong:
        return failed("the last one is not zero", wrong)
    return passed(f"{count} motions") if count else not_seen("it was never deflected")


def silent_at_rest(decoded: Traffic) -> Verdict:
    """Check that it sends no motion after the release of the cap."""
    if decoded.phase("push-rest") is None or not decoded.packets:
        return not_seen("it was never released")
    talks = [each.number for each in decoded.motions("rest", "push-rest", "twist-rest")]
    return failed(f"{len(talks)} packets at rest", talks) if talks else passed("silent")


def in_range(decoded: Traffic, most: int, most_rotation: int) -> Verdict:
    """Check that no axis goes beyond these counts."""
    found = [each for each in decoded.packets if each.counts]
    if not found:
        return not_seen(NOTHING)
    moved = max(abs(count) for each in found for count in each.counts[:3])
    turned = max(abs(count) for each in found for count in each.counts[3:])
    wrong = [
        each.number
        for each in found
        if max(map(abs, each.counts[:3])) > most or max(map(abs, each.counts[3:])) > most_rotation
    ]
    said = f"{moved} and {turned} counts at most"
    return failed(said, wrong) if wrong else passed(said)


def signs(decoded: Traffic) -> Verdict:
    """Check signs: pushed to the right X is positive and the largest; twisted clockwise B is
    negative and the largest of the rotations."""
    push, twist = (
        [each.counts for each in decoded.motions(name)] for name in ("push-held", "twist-held")
    )
    if not push or not twist:
        return not_seen("it was not pushed and twisted")
    one, other = _mean(push), _mean(twist)
    said = f"X {one[0]:.0f}, B {other[4]:.0f} counts"
    # Translations and rotations may have different scales.
    good = one[0] == max(one[:3], key=abs) > 0 and other[4] == max(other[3:], key=abs) < 0
    return passed(said) if good else failed(said)


def _mean(rows: Sequence[tuple[int, ...]]) -> list[float]:
    return [sum(axis) / len(rows) for axis in zip(*rows, strict=True)]


def buttons(decoded: Traffic) -> Verdict:
    """Check that every press and release of a button is reported."""
    if decoded.phase("release") is None or decoded.refused:
        return not_seen("none was pressed")
    down, up = decoded.keys("press"), decoded.keys("release")
    if not down or not down[-1]:
        return failed("pressing was not reported")
    if down[-1] & (down[-1] - 1):
        return failed("two are reported")
    if not up:
        return failed("the release was not reported")
    return passed("pressed and let go") if not up[-1] else failed("it stays down")


def stays(decoded: Traffic) -> Verdict:
    """Check that the port remains while it is used."""
    phase = decoded.phase("unplug")
    wrong = [index for index in decoded.lost if phase is None or index < phase.first]
    if decoded.refused:
        return not_seen("it was never opened")
    return failed("it disconnected", wrong) if wrong else passed("connected all the time")


def unplugged(decoded: Traffic) -> Verdict:
    """Check that unplugging the port is reported by the system and ends the data."""
    phase = decoded.phase("unplug")
    gone = [] if phase is None else [index for index in decoded.lost if index >= phase.first]
    if not gone:
        return not_seen("it was not unplugged, or its port stays without it")
    after = [each.number for each in decoded.packets if each.number > gone[0]]
    return failed("packets come from the unplugged device", after) if after else passed("reported")


def answered(asked: Asked[Any] | None, within_s: float) -> Verdict:
    """Check that a command is answered within that time."""
    if asked is None:
        return not_seen("it was not asked")
    if asked.answer is None:
        return failed("no answer", [asked.number])
    after_ms = (asked.answer.time_s - asked.time_s) * 1e3
    said = f"after {after_ms:.0f} ms"
    if after_ms > within_s * 1e3:
        return failed(said, [asked.answer.number], after_ms, "ms")
    return passed(said, after_ms, "ms")


def lines(stream: bytes) -> list[bytes]:
    """Return whole packets of a stream, each ended by CR."""
    return [each + b"\r" for each in stream.split(b"\r")[:-1] if each]


def read_twice(
    decoded: Traffic, cut: Callable[[bytes], list[bytes]], is_broken: Callable[[bytes], bool]
) -> Verdict:
    """Check that a second reader, which splits the stream and detects broken packets, agrees."""
    pieces = cut(decoded.stream)
    if not pieces:
        return not_seen(NOTHING)
    broken = sum(map(is_broken, pieces))
    known = [each.number for each in decoded.packets if each.is_malformed]
    if broken != len(known):
        return failed(f"{broken} are broken to one, {len(known)} to the other", known)
    return passed(f"{len(pieces)} packets read twice")
