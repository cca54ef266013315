"""What a Universal Robots controller must tell by the other interfaces, for what users run beside a
driver: level 0."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

from cardan.conform.requirements import Verdict, failed, met, must, none_wrong, not_seen, some
from cardan.conform.ur_rtde.decoded import OLD, PRIMARY, UrSeen
from cardan.conform.ur_rtde.requirements import (
    BOARD,
    CLIENT,
    FEWEST,
    GUIDE,
    PERIOD_SHARE,
    STATE_PERIOD_S,
    STATE_PERIOD_SHARE,
    accepted,
    cycle_s,
    near,
    requires,
    streams,
    version_of,
    versions,
)
from cardan.conform.ur_rtde.scenario import OLD_OUTPUTS, WORDED, published
from cardan.protocols.ur.primary import ROBOT_STATE, MessageKind
from cardan.protocols.ur.realtime import RealtimeForm
from cardan.protocols.ur.robot_state import PARTS, sub_packages
from cardan.protocols.ur.rtde import PacketType
from cardan.protocols.ur.variables import OUTPUTS as OUTPUT_TYPES

REALTIME = "UR's guide to the real-time interface"
SAME_RAD = 0.01
"""Two interfaces tell of one moment at different times."""

_NOT_OPENED = "it was not opened"


@requires(27, f"{GUIDE}: protocol version 1")
def version_1_is_spoken(seen: UrSeen) -> Verdict:
    """The protocol version 1 is accepted: outputs are asked for without a frequency, and come in
    each control cycle without a recipe's number."""
    asked = some(versions(seen, 1), "it was not asked")
    must(accepted(asked[0]), "not accepted", [asked[0].number])
    setups = [each for each in seen.setups(PacketType.OUTPUTS) if each[1].names == OLD_OUTPUTS]
    if not setups or not setups[0][2].recipe:
        types = ", ".join(setups[0][2].types) if setups else "no answer"
        return failed(f"outputs: {types}", [asked[0].number])
    states = [state for each in streams(seen, OLD) for state in each.states]
    must(len(states) >= FEWEST, f"{len(states)} states")
    wrong = [
        (b.number, f"{(b.values['timestamp'] - a.values['timestamp']) * 1e3:.1f} ms")
        for a, b in pairwise(states)
        if not 0.5 < (b.values["timestamp"] - a.values["timestamp"]) / cycle_s(seen) < 1.5
    ]
    allowed = len(wrong) <= 0.1 * len(states)
    return none_wrong([] if allowed else wrong, len(states), f"{len(states)} states", "")


@requires(28, f"{GUIDE}: controller output, and since which version")
def all_published_outputs_are_there(seen: UrSeen) -> Verdict:
    """Every output variable that is published for its version is there, with its type."""
    names = published(version_of(seen))
    found: dict[str, tuple[int, str]] = {}
    for exchange, asked, reply in seen.setups(PacketType.OUTPUTS, "published"):
        for name, kind in zip(asked.names, reply.types, strict=False):
            found[name] = exchange.number, kind
    some(names and found, "they were not asked for")
    wrong = [
        (found[name][0], f"{name} {found[name][1]}")
        if name in found
        else (seen.phases["published"].first, f"{name}: no answer")
        for name in names
        if name not in found or found[name][1] != OUTPUT_TYPES[name]
    ]
    return none_wrong(wrong, len(names), f"{len(names)} variables", "")


@requires(29, f"{CLIENT}: the secondary interface has no messages but that of the version")
def the_secondary_interface_tells_states(seen: UrSeen) -> Verdict:
    """The secondary interface sends its version first, and then robot states ten times a second,
    and no other messages."""
    if seen.phase(PRIMARY) is None:
        return not_seen(_NOT_OPENED)
    found = [each for each in seen.secondary if seen.inside(each.number, PRIMARY)]
    must(found, "nothing came")
    first, *others = found
    if first.message is None or first.message.kind != MessageKind.VERSION:
        return failed(f"first a package of type {first.package.kind}", [first.number])
    wrong = [each.number for each in others if each.message is not None]
    must(not wrong, "another message", wrong)
    times = [each.time_s for each in others if each.package.kind == ROBOT_STATE]
    must(len(times) >= 3, f"{len(times)} robot states")
    period_s = (times[-1] - times[0]) / (len(times) - 1)
    said = f"{period_s * 1e3:.1f} ms"
    return met(abs(period_s / STATE_PERIOD_S - 1.0) < STATE_PERIOD_SHARE, said)


@requires(30, f"{CLIENT}: sub-packages of a robot state")
def robot_states_are_whole(seen: UrSeen) -> Verdict:
    """Robot states of the primary and the secondary interface have all documented sub-packages,
    none shorter than documented, and nothing between them."""
    version = version_of(seen)
    wanted = [each for each in PARTS if not each.e_series or (version and version.major > 3)]
    wrong, count = [], 0
    for told in (*seen.told, *seen.secondary):
        if told.package.kind != ROBOT_STATE:
            continue
        count += 1
        found = sub_packages(told.package)
        if found is None:
            wrong.append((told.number, "sub-packages do not fill it"))
            continue
        for part in wanted:
            if len(found.get(part.kind, b"")) < part.size:
                had = f"{len(found[part.kind])} bytes" if part.kind in found else "missing"
                wrong.append((told.number, f"sub-package {part.kind}: {had}, not {part.size}"))
                break
    return none_wrong(wrong, count, f"{count} robot states", "none came")


@requires(31, f"{REALTIME}: 500 Hz on e-Series, 125 Hz on CB3; the length of each version")
def the_real_time_interface_keeps_time(seen: UrSeen) -> Verdict:
    """The real-time interface sends a packet in each control cycle, to 2 % in the mean, all of one
    length, which is no less than what is documented for the version."""
    version = version_of(seen)
    if seen.phase(PRIMARY) is None or version is None:
        return not_seen(_NOT_OPENED)
    found = [each for each in seen.samples if seen.inside(each.number, PRIMARY)]
    must(len(found) >= FEWEST, f"{len(found)} packets")
    size = len(found[0].packet)
    wrong = [each.number for each in found if len(each.packet) != size]
    must(not wrong, f"{size} bytes, and others", wrong)
    least = RealtimeForm(version[:2]).size
    must(size >= least, f"{size} bytes, not {least}", [found[0].number])
    period_s = (found[-1].time_s - found[0].time_s) / (len(found) - 1)
    said = f"{size} bytes, {period_s * 1e3:.3f} ms"
    return met(abs(period_s / cycle_s(seen) - 1.0) < PERIOD_SHARE, said)


def _same(told: Sequence[float], other: Sequence[float]) -> bool:
    return all(abs(a - b) <= SAME_RAD for a, b in zip(told, other, strict=True))


@requires(32, f"{REALTIME}: actual joint positions; {GUIDE}: actual_q")
def the_real_time_interface_tells_the_same_joints(seen: UrSeen) -> Verdict:
    """Joints of the real-time interface are those that RTDE tells within 0.3 s, to 0.01 rad."""
    version = version_of(seen)
    if version is None or not seen.samples:
        return not_seen("no packet came")
    form, wrong, count = RealtimeForm(version[:2]), [], 0
    for each in seen.samples:
        values, around = form.read(each.packet), near(seen, each.time_s)
        if values is None or not around:
            continue
        count += 1
        told = values["actual_q"]
        if not any(_same(told, state.values["actual_q"]) for state in around):
            words = ", ".join(f"{angle:g}" for angle in told)
            wrong.append((each.number, f"joints at {words} rad"))
    return none_wrong(wrong, count, f"{count} packets", "none could be compared")


_WORDS = {
    "safetymode": r"Safetymode: [A-Z_]+",
    "running": r"Program running: (true|false)",
    "programState": r"(STOPPED|PLAYING|PAUSED)\b.*",
    "get loaded program": r"Loaded program: .+|No program loaded",
    "isProgramSaved": r"(true|false)\b.*",
    "PolyscopeVersion": r"(URSoftware|Polyscope:? ?)? ?\d+\.\d+.*",
}


@requires(33, f"{BOARD}: safetymode, running, programState, get loaded program, ...")
def the_dashboard_answers_in_its_words(seen: UrSeen) -> Verdict:
    """What the dashboard says of safety, program and version begins with the documented words."""
    found = [each for words in WORDED for each in seen.said(words)]
    wrong = [
        (each.number, f"{each.asked}: {each.said!r}")
        for each in found
        if each.said is None or not re.fullmatch(_WORDS[each.asked], each.said, re.IGNORECASE)
    ]
    return none_wrong(wrong, len(found), f"{len(found)} answers", "nothing was asked")
