"""Requirements of a Universal Robots controller for a client that only reads: level 0."""

from __future__ import annotations

import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from operator import attrgetter
from typing import Any

from cardan.conform.requirements import (
    Findings,
    Over,
    Requirements,
    Verdict,
    Words,
    Wrongs,
    at_most,
    distance,
    failed,
    met,
    must,
    none_wrong,
    passed,
    some,
)
from cardan.conform.second_reading import COMPARED, differing, read_twice
from cardan.conform.timing import mostly_within, not_torn
from cardan.conform.ur_rtde import scenario
from cardan.conform.ur_rtde.decoded import (
    OLD,
    PRIMARY,
    REVERSE,
    RTDE,
    SECOND,
    DataPackage,
    OutputStream,
    ReceivedPackage,
    ReceivedPacket,
    RtdeExchange,
    UrTraffic,
)
from cardan.protocols.ur import dashboard, rtde
from cardan.protocols.ur.primary import ROBOT_STATE, MessageKind, RobotMessage, read_mode
from cardan.protocols.ur.realtime import RealtimeForm
from cardan.protocols.ur.robot_state import PARTS, sub_packages
from cardan.protocols.ur.rtde import Data, SetupReply
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyBit, SafetyMode, StatusBit
from cardan.protocols.ur.variables import OUTPUTS as OUTPUT_TYPES

GUIDE = "UR's RTDE guide"
CLIENT = "UR's client interface tables"
BOARD = "UR's dashboard server pages"
DRIVER = "docs/universal-robots.md"

FEWEST = 30
"""Fewest states whose times are checked."""
PERIOD_SHARE = 0.02
JITTER_S, JITTER_SHARE = 0.0015, 0.05
LEFT_OUT_SHARE = 0.01
CLOCK_SHARE, CLOCK_S = 0.01, 0.02
STATE_PERIOD_S, STATE_PERIOD_SHARE = 0.1, 0.1
MODE_FOLLOWS_S = 0.3
"""Tolerance, because the interfaces report one moment at different times."""

requires: Requirements[UrTraffic] = Requirements("UR")
NO_STATES = "no states came"
_NOT_OPENED = "it was not opened"


def cycle_s(decoded: UrTraffic) -> float:
    """Return the period of its control loop, by the version that it reports."""
    return 1.0 / rtde.control_rate_hz(version_of(decoded))


def version_of(decoded: UrTraffic) -> rtde.ControllerVersion | None:
    """Return the reported version of its software, if any."""
    found = (each.reply for each in decoded.heard if isinstance(each.reply, rtde.ControllerVersion))
    return next(found, None)


def accepted(exchange: RtdeExchange) -> bool | None:
    """Return True if the request was accepted; None: no answer."""
    reply = None if exchange.reply is None else exchange.reply.reply
    return reply.accepted if isinstance(reply, rtde.Accepted) else None


def versions(decoded: UrTraffic, version: int) -> list[RtdeExchange]:
    """Return the requests for a version of the protocol."""
    return [
        each
        for each in decoded.exchanges(rtde.PacketType.PROTOCOL_VERSION)
        if isinstance(each.asked, rtde.ControlRequest) and each.asked.version == version
    ]


def streams(decoded: UrTraffic, channel: str = RTDE) -> list[OutputStream]:
    """Return the output streams of a connection."""
    return [each for each in decoded.streams if each.channel == channel]


# -- level 0: RTDE outputs ------------------------------------------------------------------------


@requires(1, f"{GUIDE}: protocol version 2")
def version_2_is_spoken(decoded: UrTraffic) -> Verdict:
    """The protocol version 2 is accepted."""
    found = versions(decoded, rtde.VERSION)
    wrong = [(each.number, "refused") for each in found if accepted(each) is False]
    if found and all(accepted(each) is None for each in found):
        return failed("no answer", [found[0].number])
    return none_wrong(wrong, len(found), f"{len(found)} times", "it was not asked")


@requires(2, f"{GUIDE}: header, and a payload for each type")
def bytes_are_packets(decoded: UrTraffic) -> Verdict:
    """All that comes is whole: packets of a known type and form, packages, and lines of text."""
    count = len(decoded.heard) + len(decoded.primary) + len(decoded.lines)
    said = (
        f"{len(decoded.heard)} packets, {len(decoded.primary)} packages, {len(decoded.lines)} lines"
    )
    return none_wrong(decoded.unread, count + len(decoded.unread), said, "nothing came")


@requires(3, f"{GUIDE}: accepted or not")
def other_versions_arerefused(decoded: UrTraffic) -> Verdict:
    """A protocol version that there is not is refused."""
    found = versions(decoded, scenario.FUTURE_VERSION)
    some(found and accepted(found[0]) is not None, "it was not answered")
    return failed("accepted", [found[0].number]) if accepted(found[0]) else passed("refused")


@requires(4, f"{GUIDE}: URControl version")
def it_says_its_version(decoded: UrTraffic) -> Verdict:
    """It reports its software's version, which is 3 or newer."""
    found = version_of(decoded)
    some(found or decoded.exchanges(rtde.PacketType.CONTROLLER_VERSION), "it was not asked")
    found = must(found, "it was not reported")
    return met(found.major >= 3, ".".join(map(str, found)))


@requires(5, f"{GUIDE}: each request has its return")
def every_request_is_answered(decoded: UrTraffic) -> Verdict:
    """Each RTDE request is answered within 1 s by a packet of its own type."""
    took = [(e.reply.time_s - e.time_s if e.reply else math.inf, e) for e in decoded.asked]
    wrong = [
        (each.number, f"after {s:.2f} s" if each.reply else f"no answer to {each.asked.kind.name}")
        for s, each in took
        if s > scenario.REPLY_S
    ]
    latest_ms = 1e3 * max((s for s, each in took if each.reply), default=0.0)
    said = f"{len(took)}, within {latest_ms:.1f} ms"
    return none_wrong(wrong, len(took), said, "nothing was asked")


@requires(6, f"{GUIDE}: field names and associated types")
def outputs_are_as_documented(decoded: UrTraffic) -> Verdict:
    """All states that the driver asks for are there, with the documented types."""
    setups = decoded.setups(rtde.PacketType.OUTPUTS)
    found = [each for each in setups if each[1].names == scenario.OUTPUTS]
    exchange, asked, reply = some(found, "it was not answered")[0]
    words = f"{len(reply.types)} types for {len(asked.names)}"
    must(len(reply.types) == len(asked.names), words, [exchange.number])
    wrong = [
        (exchange.number, f"{name} {kind}")
        for name, kind in zip(asked.names, reply.types, strict=True)
        if kind != OUTPUT_TYPES[name]
    ]
    must(wrong or reply.recipe, "no recipe", [exchange.number])
    return none_wrong(wrong, len(asked.names), f"{len(asked.names)} states", "")


def refused(
    decoded: UrTraffic, kind: rtde.PacketType, name: str, word: str, *phases: str
) -> Verdict:
    """Check if a recipe with a name was refused with `word`."""
    found = [each for each in decoded.setups(kind, *phases) if name in each[1].names]
    exchange, asked, reply = some(found, "it was not answered")[-1]
    types = dict(zip(asked.names, reply.types, strict=False))
    said = f"recipe {reply.recipe}, {types.get(name, 'no type')}"
    return met(not reply.recipe and types.get(name) == word, said, [exchange.number])


@requires(7, f"{GUIDE}: NOT_FOUND")
def unknown_outputs_arerefused(decoded: UrTraffic) -> Verdict:
    """A name that there is not is NOT_FOUND, and the recipe 0: none."""
    return refused(decoded, rtde.PacketType.OUTPUTS, scenario.UNKNOWN, rtde.NOT_FOUND)


@requires(8, f"{GUIDE}: start and pause")
def states_come_from_start_to_pause(decoded: UrTraffic) -> Verdict:
    """Data packages come between START and PAUSE, and at no other time."""
    period_s = cycle_s(decoded)
    ends = [each.end_s for each in decoded.streams]
    wrong = [
        (number, "a package outside")
        for number, time_s, _ in decoded.strays
        # A package in flight may arrive after the answer.
        if not any(end_s <= time_s < end_s + 2.0 * period_s for end_s in ends)
    ]
    empty = [each for each in decoded.streams if not each.states]
    must(wrong or not empty, f"none in {len(empty)} of {len(decoded.streams)} streams")
    count = len(decoded.states)
    return none_wrong(wrong, count + len(wrong), f"{len(decoded.streams)} streams", NO_STATES)


def _steps(decoded: UrTraffic) -> list[tuple[DataPackage, DataPackage]]:
    """Return the neighbors in the streams of the tested connection."""
    return [pair for each in streams(decoded) for pair in pairwise(each.states)]


@requires(9, f"{GUIDE}: 500 Hz on e-Series, 125 Hz on CB3")
def the_period_is_the_control_loop_s(decoded: UrTraffic) -> Verdict:
    """Asked for all, it sends a state in each control cycle: 2 ms, CB3 8 ms, to 2 % in the mean."""
    found = decoded.during("listen")
    some(len(found) >= FEWEST, "too few states")
    period_s = (found[-1].time_s - found[0].time_s) / (len(found) - 1)
    said = f"{period_s * 1e3:.3f} ms"
    return met(abs(period_s / cycle_s(decoded) - 1.0) < PERIOD_SHARE, said, [found[-1].number])


def _advance_s(pair: tuple[DataPackage, DataPackage]) -> float:
    """Return the advance of its clock from one state to the other."""
    return float(pair[1].values["timestamp"] - pair[0].values["timestamp"])


@requires(10, f"{GUIDE}: a controller that is busy leaves packages out")
def none_is_left_out(decoded: UrTraffic) -> Verdict:
    """At most 1 % of the states are left out, as their timestamps say."""
    period_s, found = cycle_s(decoded), _steps(decoded)
    some(len(found) >= FEWEST, "too few states")
    left_out = [(round(_advance_s(pair) / period_s) - 1, pair[1].number) for pair in found]
    count = sum(max(each, 0) for each, _ in left_out)
    said, most = f"{count} of {len(found) + count}", LEFT_OUT_SHARE * (len(found) + count)
    return at_most(most, count, "", said, (number for each, number in left_out if each > 0))


@requires(11, f"{GUIDE}: timestamp, seconds since the controller was started")
def its_clock_goes_as_ours(decoded: UrTraffic) -> Verdict:
    """timestamp never goes back, and advances as time does, to 1 % and 20 ms."""
    found = _steps(decoded)
    wrong = [(b.number, "it does not advance") for a, b in found if _advance_s((a, b)) <= 0.0]
    for each in streams(decoded):
        if len(each.states) > 1:
            first, last = each.states[0], each.states[-1]
            theirs_s, ours_s = _advance_s((first, last)), last.time_s - first.time_s
            if abs(theirs_s - ours_s) > CLOCK_SHARE * ours_s + CLOCK_S:
                wrong.append((last.number, f"{theirs_s:.3f} s in {ours_s:.3f} s"))
    return none_wrong(wrong, len(found), f"{len(found)} states", NO_STATES)


@requires(12, f"{DRIVER}: state_timeout_s")
def it_is_never_silent(decoded: UrTraffic) -> Verdict:
    """From START to PAUSE it is never 0.1 s without a state, whatever else is done."""
    gaps = []
    for each in streams(decoded):
        number = each.states[-1].number if each.states else 0
        times = [each.start_s, *(state.time_s for state in each.states), each.end_s]
        gaps.append((max(b - a for a, b in pairwise(times)), number))
    some(gaps, "nothing was started")
    longest_s, number = max(gaps)
    said = f"longest {longest_s * 1e3:.1f} ms"
    return at_most(1e3 * scenario.STATE_TIMEOUT_S, 1e3 * longest_s, "ms", said, [number])


@requires(13, f"{GUIDE}: a package in each control cycle")
def arrival_is_steady(decoded: UrTraffic) -> Verdict:
    """95 % of the states arrive within 1.5 ms of their period after the one before."""
    found = _steps(decoded)
    some(len(found) >= FEWEST, "too few states")
    off = ((abs(b.time_s - a.time_s - _advance_s((a, b))), b.number) for a, b in found)
    return mostly_within(off, 1.0 - JITTER_SHARE, JITTER_S, "95 % within {:.2f} ms", NO_STATES)


@requires(14, "a controller writes a packet at once; half of one says nothing yet")
def packets_are_not_torn(decoded: UrTraffic) -> Findings:
    """Of an RTDE packet whose first bytes have come the rest is there within half a millisecond."""
    return not_torn(decoded.heard, "{} packets, {} in pieces")


def _uneven(
    pairs: list[tuple[DataPackage, DataPackage]], off: Callable[[float], bool], few: float
) -> Wrongs:
    """Yield states that are `off` by their clock, if more than `few` are."""
    wrong = [(p[1].number, f"{_advance_s(p) * 1e3:.1f} ms") for p in pairs if off(_advance_s(p))]
    return wrong if len(wrong) > few else []


@requires(15, f"{GUIDE}: each client has its recipes and its frequency")
def another_client_has_its_own_rate(decoded: UrTraffic) -> Verdict:
    """Another client beside it gets a tenth of the states, evenly, when it asks for a tenth."""
    found = [pair for each in streams(decoded, SECOND) for pair in pairwise(each.states)]
    some(len(found) >= 3, "it got no states")
    want_s = scenario.SLOWER * cycle_s(decoded)
    few = LEFT_OUT_SHARE * len(found)
    wrong = _uneven(found, lambda each_s: abs(each_s - want_s) > 0.1 * want_s, few)
    said = f"{len(found) + 1} states, {want_s * 1e3:g} ms apart"
    return none_wrong(wrong, len(found), said, "")


STATES: Over[UrTraffic, DataPackage] = Over(
    lambda decoded: decoded.states, "{} states", nothing=NO_STATES
)


@requires.each(16, f"{GUIDE}: field names, units and modes", STATES)
def states_are_plausible(each: DataPackage) -> str:
    """Values are finite, joints inside their ranges, modes known, and the speed slider 0 to 1."""
    values = each.values
    for name, value in values.items():
        if not all(map(math.isfinite, value if isinstance(value, tuple) else (value,))):
            return f"{name} is not finite"
    for name in ("actual_q", "target_q"):
        if max(map(abs, values[name])) > 2.1 * math.pi:
            return f"{name} beyond 378 degrees"
    for name, known in _MODES.items():
        if values[name] not in known._value2member_map_:
            return f"{name} {values[name]}"
    slider = values["target_speed_fraction"]
    return "" if 0.0 <= slider <= 1.0 else f"target_speed_fraction {slider:g}"


_MODES = {"robot_mode": RobotMode, "safety_mode": SafetyMode, "runtime_state": RuntimeState}


@requires(17, f"{GUIDE}: robot_status_bits, safety_status_bits")
def bits_say_what_modes_say(decoded: UrTraffic) -> Verdict:
    """The bits for power, for normal mode and for a protective stop say what the modes say."""
    wrong = (each for state in decoded.states for each in _contradictions(state))
    return none_wrong(wrong, len(decoded.states), f"{len(decoded.states)} states", NO_STATES)


def _contradictions(each: DataPackage) -> Wrongs:
    """Yield contradictions between a state's bits and its modes."""
    v = each.values
    mode, safety, bits = v["robot_mode"], v["safety_mode"], v["safety_status_bits"]
    power = bool(v["robot_status_bits"] & StatusBit.POWER_ON)
    if mode in (RobotMode.IDLE, RobotMode.RUNNING) and not power:
        yield each.number, f"no power in mode {mode}"
    if mode == RobotMode.POWER_OFF and power:
        yield each.number, "power in the mode POWER_OFF"
    for known, bit in (
        (SafetyMode.NORMAL, SafetyBit.NORMAL),
        (SafetyMode.PROTECTIVE_STOP, SafetyBit.PROTECTIVE_STOP),
    ):
        if (safety == known) != bool(bits & bit):
            yield each.number, f"safety mode {safety}, bits {bits:#x}"


@requires(18, "a client's connection is its own to end")
def connections_last(decoded: UrTraffic) -> Verdict:
    """No connection is refused, or closed by the controller while it is used."""
    gone = [each for each in decoded.gone if not each[1].channel.startswith(REVERSE)]
    wrong = [(number, f"{event.channel} {event.kind.value}") for number, event in gone]
    count = len(decoded.opened) + len(wrong)
    return none_wrong(wrong, count, f"{len(decoded.opened)} connections", "none was")


def _version_first(found: Sequence[ReceivedPackage]) -> RobotMessage:
    """Return the version message, which must come first on a client interface."""
    first = must(found, "nothing came")[0]
    version = first.message and first.message.kind == MessageKind.VERSION and first.message
    return must(version or None, f"first a package of type {first.package.kind}", [first.number])


def _ten_times_a_second(times: Sequence[float]) -> Verdict:
    """Check if robot states came ten times a second."""
    period_s = (times[-1] - times[0]) / (len(times) - 1)
    said = f"{period_s * 1e3:.1f} ms"
    return met(abs(period_s / STATE_PERIOD_S - 1.0) < STATE_PERIOD_SHARE, said)


@requires(21, f"{CLIENT}: version message, robot state")
def the_primary_interface_begins_with_a_version(decoded: UrTraffic) -> Verdict:
    """The primary interface sends its version first, and then robot states."""
    some(decoded.phase(PRIMARY), _NOT_OPENED)
    version = _version_first(decoded.primary)
    count = sum(each.package.kind == ROBOT_STATE for each in decoded.primary)
    return met(count > 0, f"{version.text}, {count} states")


@requires(22, f"{CLIENT}: 10 Hz")
def robot_states_come_ten_times_a_second(decoded: UrTraffic) -> Verdict:
    """Robot states of the primary interface come ten times a second, to a tenth."""
    times = [each.time_s for each in decoded.primary if each.package.kind == ROBOT_STATE]
    some(len(times) >= 4, "too few robot states")
    return _ten_times_a_second(times)


def near(decoded: UrTraffic, time_s: float) -> list[DataPackage]:
    """Return the states of about that time."""
    time_of = attrgetter("time_s")
    first = bisect_right(decoded.states, time_s - MODE_FOLLOWS_S, key=time_of)
    return decoded.states[first : bisect_left(decoded.states, time_s + MODE_FOLLOWS_S, key=time_of)]


@requires(23, f"{CLIENT}: robot mode data; {GUIDE}: robot_mode")
def both_interfaces_tell_one_mode(decoded: UrTraffic) -> Findings:
    """The robot mode of the primary interface is one that RTDE reports within 0.3 s of it."""
    for each in decoded.primary:
        mode = read_mode(each.package)
        around = {s.values["robot_mode"] for s in near(decoded, each.time_s)} if mode else set()
        if mode and around:
            words = f"{mode.robot_mode.name}, RTDE {sorted(around)}"
            yield each.number, "" if mode.robot_mode in around else words
    return Words("{} states", "no robot state could be compared")


@requires(24, f"{BOARD}: a line a request, a line a reply")
def the_dashboard_greets_and_answers(decoded: UrTraffic) -> Verdict:
    """The dashboard server greets, and answers each request by one line."""
    some(decoded.phase("dashboard"), _NOT_OPENED)
    greeting = [each.said for each in decoded.said("")]
    greets = greeting and (greeting[0] or "").startswith(dashboard.GREETING)
    must(greets, f"greeted with {greeting[0] if greeting else 'nothing'!r}")
    asked = [each for each in decoded.lines if each.asked]
    wrong = [(each.number, f"{each.asked}: no answer") for each in asked if each.said is None]
    wrong += [
        (after.number, f"{after.asked}: two lines")
        for before, after in pairwise(asked)
        if before.request == after.request
    ]
    return none_wrong(wrong, len(asked), f"{len(asked)} requests", "nothing was asked")


_BOARD_MODES = {
    dashboard.ROBOT_MODE: ("robot_mode", "Robotmode: ", RobotMode),
    dashboard.SAFETY_STATUS: ("safety_mode", "Safetystatus: ", SafetyMode),
}


@requires(25, f"{BOARD}; {GUIDE}: robot_mode, safety_mode")
def the_dashboard_tells_the_same_modes(decoded: UrTraffic) -> Findings:
    """robotmode and safetystatus of the dashboard are those that RTDE reports within 0.3 s."""
    for words, (name, begins, modes) in _BOARD_MODES.items():
        for each in decoded.said(words):
            around = {state.values[name] for state in near(decoded, each.time_s)}
            if each.said is not None and around:
                names = {modes(value).name for value in around if value in modes._value2member_map_}
                same = each.said.removeprefix(begins) in names
                others = ", ".join(sorted(names))
                yield each.number, "" if same else f"{each.said!r}, RTDE {others}"
    return Words("{} answers", "none could be compared")


@requires(26, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: UrTraffic) -> Verdict:
    """A second reader, the scapy layers, sees the same replies, recipes and values."""

    def differs(each: ReceivedPacket, layers: Any) -> str:
        layer = layers.RtdeReply(each.raw)
        return layers.malformed(layer) or _difference(decoded, each, layer, layers)

    # The layers are of version 2; packets other than data are few.
    heard = [each for each in decoded.heard if each.channel not in decoded.old]
    data = [each for each in heard if isinstance(each.reply, Data)]
    chosen = [each for each in heard if not isinstance(each.reply, Data)]
    chosen += data[:: max(1, len(data) // COMPARED)]
    return read_twice(chosen, "rtde", differs, "packets", compared=max(1, len(chosen)))


# -- level 0: the other interfaces, for what users run beside a driver ---------------------------


REALTIME = "UR's guide to the real-time interface"
SAME_RAD = 0.01
"""Tolerance, because two interfaces report one moment at different times."""


def _documented(names: Sequence[str], found: Mapping[str, tuple[int, str]], asked: int) -> Wrongs:
    """Yield those of `names` whose types are not the documented ones; `asked`: the number of the
    event that requested them."""
    for name in names:
        number, kind = found.get(name, (asked, ""))
        if kind != OUTPUT_TYPES[name]:
            yield number, f"{name} {kind}" if kind else f"{name}: no answer"


@requires(27, f"{GUIDE}: protocol version 1")
def version_1_is_spoken(decoded: UrTraffic) -> Verdict:
    """The protocol version 1 is accepted: outputs are asked for without a frequency, and come in
    each control cycle without a recipe's number."""
    asked = some(versions(decoded, 1), "it was not asked")
    must(accepted(asked[0]), "not accepted", [asked[0].number])
    setups = decoded.setups(rtde.PacketType.OUTPUTS)
    setups = [each for each in setups if each[1].names == scenario.OLD_OUTPUTS]
    if not setups or not setups[0][2].recipe:
        types = ", ".join(setups[0][2].types) if setups else "no answer"
        return failed(f"outputs: {types}", [asked[0].number])
    states = [state for each in streams(decoded, OLD) for state in each.states]
    must(len(states) >= FEWEST, f"{len(states)} states")
    period_s, few = cycle_s(decoded), 0.1 * len(states)
    wrong = _uneven([*pairwise(states)], lambda each_s: not 0.5 < each_s / period_s < 1.5, few)
    return none_wrong(wrong, len(states), f"{len(states)} states", "")


@requires(28, f"{GUIDE}: controller output, and since which version")
def all_published_outputs_are_there(decoded: UrTraffic) -> Verdict:
    """Every output variable that is published for its version is there, with its type."""
    names = scenario.published(version_of(decoded))
    found = {
        name: (exchange.number, kind)
        for exchange, asked, reply in decoded.setups(rtde.PacketType.OUTPUTS, "published")
        for name, kind in zip(asked.names, reply.types, strict=False)
    }
    some(names and found, "they were not asked for")
    wrong = _documented(names, found, decoded.phases["published"].first)
    return none_wrong(wrong, len(names), f"{len(names)} variables", "")


@requires(29, f"{CLIENT}: the secondary interface has no messages but that of the version")
def the_secondary_interface_tells_states(decoded: UrTraffic) -> Verdict:
    """The secondary interface sends its version first, and then robot states ten times a second,
    and no other messages."""
    some(decoded.phase(PRIMARY), _NOT_OPENED)
    found = decoded.within(decoded.secondary, PRIMARY)
    _version_first(found)
    wrong = [each.number for each in found[1:] if each.message is not None]
    must(not wrong, "another message", wrong)
    times = [each.time_s for each in found if each.package.kind == ROBOT_STATE]
    must(len(times) >= 3, f"{len(times)} robot states")
    return _ten_times_a_second(times)


@requires(30, f"{CLIENT}: sub-packages of a robot state")
def robot_states_are_whole(decoded: UrTraffic) -> Verdict:
    """Robot states of the primary and the secondary interface have all documented sub-packages,
    none shorter than documented, and nothing between them."""
    version = version_of(decoded)
    wanted = [each for each in PARTS if not each.e_series or (version and version.major > 3)]
    wrong, count = [], 0
    for received in (*decoded.primary, *decoded.secondary):
        if received.package.kind != ROBOT_STATE:
            continue
        count += 1
        found = sub_packages(received.package)
        if found is None:
            wrong.append((received.number, "sub-packages do not fill it"))
            continue
        for part in wanted:
            if len(found.get(part.kind, b"")) < part.size:
                had = f"{len(found[part.kind])} bytes" if part.kind in found else "missing"
                wrong.append((received.number, f"sub-package {part.kind}: {had}, not {part.size}"))
                break
    return none_wrong(wrong, count, f"{count} robot states", "none came")


@requires(31, f"{REALTIME}: 500 Hz on e-Series, 125 Hz on CB3; the length of each version")
def the_real_time_interface_keeps_time(decoded: UrTraffic) -> Verdict:
    """The real-time interface sends a packet in each control cycle, to 2 % in the mean, all of one
    length, which is no less than what is documented for the version."""
    version = some(decoded.phase(PRIMARY) and version_of(decoded), _NOT_OPENED)
    found = decoded.within(decoded.samples, PRIMARY)
    must(len(found) >= FEWEST, f"{len(found)} packets")
    size = len(found[0].packet)
    wrong = [each.number for each in found if len(each.packet) != size]
    must(not wrong, f"{size} bytes, and others", wrong)
    least = RealtimeForm(version[:2]).size
    must(size >= least, f"{size} bytes, not {least}", [found[0].number])
    period_s = (found[-1].time_s - found[0].time_s) / (len(found) - 1)
    said = f"{size} bytes, {period_s * 1e3:.3f} ms"
    return met(abs(period_s / cycle_s(decoded) - 1.0) < PERIOD_SHARE, said)


@requires(32, f"{REALTIME}: actual joint positions; {GUIDE}: actual_q")
def the_real_time_interface_tells_the_same_joints(decoded: UrTraffic) -> Findings:
    """Joints of the real-time interface are those that RTDE reports within 0.3 s, to 0.01 rad."""
    version = some(version_of(decoded) if decoded.samples else None, "no packet came")
    form = RealtimeForm(version[:2])
    for each in decoded.samples:
        values, around = form.read(each.packet), near(decoded, each.time_s)
        if values is not None and around:
            joints = values["actual_q"]
            far = min(distance(joints, state.values["actual_q"]) for state in around)
            words = f"joints at {', '.join(f'{angle:g}' for angle in joints)} rad"
            yield each.number, words if far > SAME_RAD else ""
    return Words("{} packets", "none could be compared")


_WORDS = {
    "safetymode": r"Safetymode: [A-Z_]+",
    "running": r"Program running: (true|false)",
    "programState": r"(STOPPED|PLAYING|PAUSED)\b.*",
    "get loaded program": r"Loaded program: .+|No program loaded",
    "isProgramSaved": r"(true|false)\b.*",
    "PolyscopeVersion": r"(URSoftware|Polyscope:? ?)? ?\d+\.\d+.*",
}


@requires(33, f"{BOARD}: safetymode, running, programState, get loaded program, ...")
def the_dashboard_answers_in_its_words(decoded: UrTraffic) -> Findings:
    """The dashboard's answers on safety, program and version begin with the documented words."""
    for each in (line for words in scenario.WORDED for line in decoded.said(words)):
        known = each.said and re.fullmatch(_WORDS[each.asked], each.said, re.IGNORECASE)
        yield each.number, "" if known else f"{each.asked}: {each.said!r}"
    return Words("{} answers", "nothing was asked")


def _difference(decoded: UrTraffic, heard: ReceivedPacket, layer: object, layers: Any) -> str:
    """Return the layer's difference from the codec in words; empty: none."""
    reply = heard.reply
    if isinstance(reply, SetupReply):
        read = getattr(layer, "recipe", None), layers.listed(getattr(layer, "types", b""))
        return "" if read == (reply.recipe, reply.types) else f"another recipe: {read}"
    if isinstance(reply, Data):
        recipe = decoded.recipes.get(heard.number)
        if recipe is None:
            return ""
        values = layers.values_of(recipe.types, getattr(layer, "values", b""))
        same = recipe.unpack(reply.values)
        return "" if same is not None and values == [*same.values()] else "other values"
    return differing(reply, layer, _SAME)


_SAME = {"text": "message", "build": "build_number"}
"""Fields of the codec, and the layers' names for them."""
