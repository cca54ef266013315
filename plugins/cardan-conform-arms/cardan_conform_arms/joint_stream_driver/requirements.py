"""Requirements for a client of the joint stream that moves an arm."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

from cardan.conform.controllers import had_ended
from cardan.conform.requirements import (
    Over,
    Requirements,
    Verdict,
    at_most,
    failed,
    met,
    none_wrong,
    not_applicable,
    not_seen,
    passed,
)
from cardan.conform.second_reading import read_twice, refused
from cardan.protocols.joint_stream.codec import ArmCommand, ControlMode, is_newer
from cardan.robots import load_arm
from cardan_conform_arms.joint_stream.decoded import Command, JointStreamTraffic, State

PAGE = "docs/simulated-peers.md"
RULES = f"{PAGE}, rules"
HEADER = f"{PAGE}, header"

ROBOT, PERIOD_S = "ur5", 0.008
"""Simulated arm, and its cycle."""
ARM = load_arm(ROBOT)
JOINTS = len(ARM.joints)
JOINTS_AT = 7
"""Offset of the number of joints in a datagram."""
ANSWERED_SHARE = 0.95
NEAR_RAD = math.radians(0.5)
STILL_RAD_S = 0.02
STOP_TOLERANCE_RAD = 0.02
"""Tolerance beyond a stop for measured, and thus commanded, positions of a joint that rests on
it."""
SPEED_SHARE = 1.1
CLOCK_SHARE = 0.02
UNLIKE_RAD_S, UNLIKE_SHARE = 0.05, 0.3
"""Largest difference of a command's speed from that of its positions, absolute and relative."""
ON_THEIR_WAY_S = 0.05
GREETS_WITHIN_S = 1.0
STOPPED_STATES = 10

_NOTHING = "no commands came"
requires: Requirements[JointStreamTraffic] = Requirements("JSPC", _NOTHING)

ASKS = {"run": "JSPC-106", "junk": "JSPC-115", "again": "JSPC-120"}
"""Phases in which the client must answer, and the requirement of each."""


def _ended_before(phase: str) -> Callable[[JointStreamTraffic], Verdict | None]:
    return lambda decoded: had_ended(decoded, phase, decoded.states, decoded.commands, ASKS)


class Said(NamedTuple):
    """Command of the client, and the newest state before it."""

    number: int
    time_s: float
    value: ArmCommand
    state: State | None


def _said(decoded: JointStreamTraffic, *phases: str) -> list[Said]:
    """Return the commands of the phases; without phases: all."""
    found: list[Said] = []
    states = iter(decoded.states)
    newest: State | None = None
    coming = next(states, None)
    commands: list[Command] = decoded.sent_during(*phases) if phases else decoded.commands
    for each in commands:
        while coming is not None and coming.number < each.number:
            # A repeated state is not the newest.
            later = newest is None or _later(coming, newest)
            newest, coming = (coming if later else newest), next(states, None)
        if each.value is not None:
            found.append(Said(each.number, each.time_s, each.value, newest))
    return found


def _later(one: State, than: State) -> bool:
    if one.value.session == than.value.session:
        return is_newer(one.value.sequence, than.value.sequence)
    return is_newer(one.value.session, than.value.session)


def _greets(command: ArmCommand) -> bool:
    return command.mode is ControlMode.HOLD and command.session == 0


def _speed(said: Said) -> float:
    """Return the largest commanded speed, rad/s; for torques it is unknown."""
    value = said.value
    if value.mode is ControlMode.VELOCITY:
        return max(map(abs, value.values))
    return max(map(abs, value.feed_forward), default=0.0)


def _away(said: Said) -> float:
    """Return the distance of commanded positions from the measured ones, rad."""
    if said.value.mode is not ControlMode.POSITION or said.state is None:
        return 0.0
    there = said.state.value.positions
    return max(abs(a - b) for a, b in zip(said.value.values, there, strict=False))


@requires(101, f"{RULES} 1: the client begins")
def it_greets(decoded: JointStreamTraffic) -> Verdict:
    """It begins with a hold that has session 0, and states come of that."""
    first = next((e for e in decoded.commands if e.value is not None), None)
    if first is None or first.value is None:
        return failed("nothing came")
    if not _greets(first.value):
        mode = first.value.mode.name.lower()
        return failed(f"{mode} with session {first.value.session}", [first.number])
    return passed("greeted") if decoded.states else failed("no state came of it", [first.number])


@requires(102, f"{RULES} 6")
def datagrams_are_commands(decoded: JointStreamTraffic) -> Verdict:
    """Every datagram is one whole command: no other length, mode or number of joints, all
    finite."""
    return none_wrong(decoded.unread, len(decoded.raw), f"{len(decoded.raw)} datagrams", _NOTHING)


@requires(103, f"{HEADER}: number of joints of the arm, in a hold too")
def the_joints_are_the_arms(decoded: JointStreamTraffic) -> Verdict:
    """Once states came, every command says how many joints the arm has."""
    found = [e for e in _said(decoded) if e.state is not None]
    wrong = [
        (e.number, f"{decoded.raw[e.number][JOINTS_AT]} joints")
        for e in found
        if decoded.raw[e.number][JOINTS_AT] != JOINTS
    ]
    return none_wrong(wrong, len(found), f"{len(found)} commands", _NOTHING)


COMMANDS: Over[JointStreamTraffic, Said] = Over(_said, "{} commands")


@requires.each(
    104,
    f"{HEADER}: sequence, from 1; {RULES} 2: from a greeting it may count anew",
    Over(lambda decoded: pairwise(_said(decoded)), "{} commands"),
)
def commands_count_up_by_one(each: tuple[Said, Said]) -> str | None:
    """The sequence goes up by one from command to command."""
    a, b = (said.value for said in each)
    if _greets(b):
        return None
    return "" if (b.sequence - a.sequence) & 0xFFFFFFFF == 1 else f"{b.sequence} after {a.sequence}"


@requires.each(105, f"{RULES} 2: the session of the newest state", COMMANDS)
def the_session_is_the_newest(each: Said) -> str | None:
    """Commands have the session of the newest state, greetings 0."""
    if each.state is None or _greets(each.value):
        return None
    reported, newest = each.value.session, each.state.value.session
    return "" if reported == newest else f"session {reported}, not {newest}"


class Pair(NamedTuple):
    """State, and the commands before the next one."""

    state: State
    commands: list[Said]


def _pairs(decoded: JointStreamTraffic, *phases: str) -> list[Pair]:
    """Return the states of the phases."""
    found = []
    commands = iter(_said(decoded, *phases))
    command = next(commands, None)
    states = decoded.during(*phases)
    ends = [*(each.number for each in states[1:]), math.inf]
    for state, end in zip(states, ends, strict=False):
        own = []
        while command is not None and command.number < end:
            if command.number > state.number:
                own.append(command)
            command = next(commands, None)
        found.append(Pair(state, own))
    return found


def _answered(decoded: JointStreamTraffic, phase: str, least: float) -> Verdict:
    found = _pairs(decoded, phase)[:-1]
    began = next((n for n, each in enumerate(found) if each.commands), None)
    if began is None:
        return failed("none came") if found else not_seen("there were no states")
    share = sum(bool(each.commands) for each in found[began:]) / len(found[began:])
    said = f"{100 * share:.1f} %"
    return met(share >= least, said, [found[-1].state.number])


@requires(106, f"{RULES} 4: in a cycle without a command the arm continues by itself")
def states_are_answered(decoded: JointStreamTraffic) -> Verdict:
    """95 % of the states of a run are answered by a command."""
    return _answered(decoded, "run", ANSWERED_SHARE)


@requires(107, f"{RULES} 3 and 4: one command in a cycle")
def one_command_is_enough(decoded: JointStreamTraffic) -> Verdict:
    """To a state there is one command; 1 % may be late, and stand beside the next."""
    found = _pairs(decoded, "run", "anew")
    wrong = [
        (each.commands[1].number, f"{len(each.commands)} commands")
        for each in found
        if len(each.commands) > 1
    ]
    if len(wrong) <= 0.01 * len(found):
        wrong = []
    return none_wrong(wrong, sum(bool(e.commands) for e in found), f"{len(found)} states", _NOTHING)


@requires(108, f"{RULES} 4: a command acts in the cycle that it comes in")
def commands_are_in_time(decoded: JointStreamTraffic) -> Verdict:
    """A command comes within the cycle of its state: none comes later than that after the last
    state before a silence."""
    times = []
    for name in ("silence", "restarted"):
        phase = decoded.phase(name)
        states = [] if phase is None else [e for e in decoded.states if e.number < phase.first]
        if phase is None or not states or not _ever_answers(decoded, "run"):
            continue
        last = states[-1]
        end = next((e.number for e in decoded.states if e.number > phase.first), phase.end)
        inside = [
            e for e in _said(decoded) if last.number < e.number < end and not _greets(e.value)
        ]
        if inside:
            times.append((inside[-1].time_s - last.time_s, inside[-1].number))
    if not times:
        return not_seen("it was never silent, or it never answered")
    late_s, number = max(times)
    said = f"{late_s * 1e3:.2f} ms"
    return at_most(PERIOD_S * 1e3, late_s * 1e3, "ms", said, [number])


@requires(109, f"{HEADER}: stamp, the sender's clock, s")
def stamps_advance_as_time_does(decoded: JointStreamTraffic) -> Verdict:
    """The stamp never goes back, and advances as time does, to 2 %."""
    found = _said(decoded)
    if len(found) < 10:
        return not_seen("fewer than ten commands")
    wrong = [b.number for a, b in pairwise(found) if b.value.stamp_s < a.value.stamp_s]
    if wrong:
        return failed(f"it goes back {len(wrong)} times", wrong)
    passes_s = found[-1].time_s - found[0].time_s
    reported_s = found[-1].value.stamp_s - found[0].value.stamp_s
    said = f"{reported_s:.3f} s in {passes_s:.3f} s"
    return met(abs(reported_s - passes_s) <= CLOCK_SHARE * passes_s, said, [found[-1].number])


def _begins(decoded: JointStreamTraffic) -> Iterator[Said]:
    """Yield the first commands other than holds: of all, of a session, and after a stop or a
    silence."""
    for phases in (("greet", "run"), ("acknowledged",), ("again",), ("restarted", "anew")):
        found = [e for e in _said(decoded, *phases) if e.value.mode is not ControlMode.HOLD]
        if phases[0] == "restarted":
            before = {e.value.session for e in decoded.during("run")}
            found = [e for e in found if e.state and e.state.value.session not in before]
        yield from found[:1]


@requires(110, f"{RULES} 2 and 4: what was commanded before is void")
def motion_begins_where_the_arm_is(decoded: JointStreamTraffic) -> Verdict:
    """The first command of a session, and after a stop and a silence, is the measured position to
    half a degree, or no speed."""
    found = list(_begins(decoded))
    wrong = []
    for each in found:
        if _away(each) > NEAR_RAD:
            wrong.append((each.number, f"{math.degrees(_away(each)):.2f} degrees away"))
        elif _speed(each) > STILL_RAD_S:
            wrong.append((each.number, f"at {_speed(each):.3g} rad/s"))
    if _said(decoded) and not found:
        return not_applicable("it only holds")
    return none_wrong(wrong, len(found), f"{len(found)} beginnings", _NOTHING)


def _outside(value: ArmCommand) -> str:
    """Return the first joint out of its range, or too fast; empty: none."""
    if value.mode is ControlMode.TORQUE:
        return ""
    for joint, q in enumerate(value.values):
        model = ARM.joints[joint] if joint < JOINTS else None
        if model is None:
            return f"there is no joint {joint + 1}"
        if value.mode is ControlMode.VELOCITY:
            if abs(q) > model.velocity * (1.0 + 1e-9):
                return f"joint {joint + 1} at {q:.3g} rad/s"
        elif not model.lower - STOP_TOLERANCE_RAD <= q <= model.upper + STOP_TOLERANCE_RAD:
            return f"joint {joint + 1} at {q:.3g} rad"
    return ""


@requires.each(111, f"{RULES} 5: what is beyond is refused, and the arm holds", COMMANDS)
def commands_are_within_the_arm(each: Said) -> str:
    """Positions are within the joints' ranges, and speeds within what the joints can do."""
    return _outside(each.value)


def _steps(decoded: JointStreamTraffic) -> Iterator[tuple[Said, Said, float]]:
    """Yield neighboring position commands in one session, and the arm's time between them."""
    for a, b in pairwise(_said(decoded, "run", "acknowledged", "junk", "anew")):
        both = a.value.mode is b.value.mode is ControlMode.POSITION
        if not both or a.state is None or b.state is None:
            continue
        passed_s = b.state.value.stamp_s - a.state.value.stamp_s
        if a.value.session == b.value.session and 0.0 < passed_s < 3.0 * PERIOD_S:
            yield a, b, passed_s


def _unpositioned(decoded: JointStreamTraffic) -> Verdict | None:
    none = bool(_said(decoded)) and not any(_steps(decoded))
    return not_applicable("it commands no positions") if none else None


STEPS: Over[JointStreamTraffic, tuple[Said, Said, float]] = Over(
    _steps, "{} steps", unless=_unpositioned
)


@requires.each(112, f"{RULES} 4: what comes is followed at once", STEPS)
def positions_do_not_jump(each: tuple[Said, Said, float]) -> str:
    """From command to command no joint goes further than its highest speed takes it, and a tenth
    more."""
    a, b, passed_s = each
    for joint, (p, q) in enumerate(zip(a.value.values, b.value.values, strict=True)):
        if abs(q - p) > SPEED_SHARE * ARM.joints[joint].velocity * passed_s:
            return f"joint {joint + 1} by {q - p:.3f} rad"
    return ""


@requires.each(
    113,
    f"{PAGE}, command: speeds at the positions, 0 for none; {RULES} 4",
    # The positions may be limited in one step.
    replace(STEPS, few=0.02),
)
def speeds_are_those_of_the_positions(each: tuple[Said, Said, float]) -> str:
    """The speeds beside positions are those at which the positions move, or 0: where a command is
    missing the arm continues at them."""
    a, b, passed_s = each
    for joint, (p, q) in enumerate(zip(a.value.values, b.value.values, strict=True)):
        reported = 0.5 * (a.value.feed_forward[joint] + b.value.feed_forward[joint])
        speed = (q - p) / passed_s
        if reported and abs(reported - speed) > UNLIKE_RAD_S + UNLIKE_SHARE * abs(speed):
            return f"joint {joint + 1}: {reported:.3f} rad/s told"
    return ""


def _while_stopped(decoded: JointStreamTraffic) -> list[Said]:
    numbers = {e.number for e in decoded.during("estop")[STOPPED_STATES:]}
    return [e for e in _said(decoded, "estop") if e.state is not None and e.state.number in numbers]


@requires.each(
    114,
    f"{RULES} 5: every command is ignored, and the next acts when that is over",
    Over(_while_stopped, "{} commands", nothing="it did not answer then"),
    unless=_ended_before("estop"),
)
def a_stopped_arm_is_followed(each: Said) -> str:
    """While states say why commands do not act, it holds, or commands the measured position without
    speed."""
    still = _away(each) <= NEAR_RAD and _speed(each) <= STILL_RAD_S
    held = each.value.mode is ControlMode.HOLD
    return "" if held or still else f"{math.degrees(_away(each)):.2f} degrees away"


@requires(
    115, f"{RULES} 6: malformed as a whole, and changes nothing", unless=_ended_before("junk")
)
def junk_does_not_end_it(decoded: JointStreamTraffic) -> Verdict:
    """Datagrams that are no states have no effect: 90 % of the states are answered."""
    return _answered_if_ever(decoded, "junk")


def _answered_if_ever(decoded: JointStreamTraffic, phase: str) -> Verdict:
    if not any(each.commands for each in _pairs(decoded, "run")):
        return not_seen("it never answered")
    return _answered(decoded, phase, 0.9)


def _ever_answers(decoded: JointStreamTraffic, phase: str) -> bool:
    return any(not _greets(e.value) for e in _said(decoded, phase))


@requires(116, f"{RULES} 3: what is not newer is dropped", unless=_ended_before("old"))
def old_states_are_not_answered(decoded: JointStreamTraffic) -> Verdict:
    """A state that is old, or comes again, is not answered."""
    if not _ever_answers(decoded, "old"):
        return not_seen("none were sent, or it did not answer")
    fresh = len({each.value.sequence for each in _fresh(decoded, "old")})
    found = _said(decoded, "old")
    said = f"{len(found)} commands to {fresh} new states"
    # The last answer before may have been late.
    return met(len(found) <= fresh + 1, said, [found[-1].number])


def _fresh(decoded: JointStreamTraffic, phase: str) -> list[State]:
    """Return the states of a phase that are newer than all before them."""
    inside = {each.number for each in decoded.during(phase)}
    found: list[State] = []
    newest: State | None = None
    for each in decoded.states:
        if newest is None or _later(each, newest):
            newest = each
            if each.number in inside:
                found.append(each)
    return found


@requires(
    117, f"{RULES} 2: sessions count up; what was before is void", unless=_ended_before("earlier")
)
def earlier_sessions_are_not_answered(decoded: JointStreamTraffic) -> Verdict:
    """A state of an earlier session, on its way for long, is not answered."""
    if not _ever_answers(decoded, "earlier"):
        return not_seen("none were sent, or it did not answer")
    fresh, found = len(_fresh(decoded, "earlier")), _said(decoded, "earlier")
    said = f"{len(found)} commands to {fresh} new states"
    return met(len(found) <= fresh + 1, said, [found[-1].number])


@requires(
    118, f"{RULES} 4: an arm that hears nothing brakes and holds", unless=_ended_before("silence")
)
def silence_is_not_commanded(decoded: JointStreamTraffic) -> Verdict:
    """While the arm is silent it is sent holds only, which keep it from forgetting its client."""
    phase = decoded.phase("silence")
    if phase is None or not _ever_answers(decoded, "run"):
        return not_seen("there was no silence, or it never answered")
    found = [e for e in _said(decoded, "silence") if e.time_s > phase.start_s + ON_THEIR_WAY_S]
    wrong = [
        (e.number, e.value.mode.name.lower()) for e in found if e.value.mode is not ControlMode.HOLD
    ]
    return none_wrong(wrong, max(1, len(found)), f"{len(found)} holds", _NOTHING)


@requires(
    119, f"{RULES} 1: a client that is silent for 1 s is forgotten", unless=_ended_before("silence")
)
def a_silent_arm_is_greeted(decoded: JointStreamTraffic) -> Verdict:
    """A silent arm is greeted again, once a second at least: it may have forgotten its client, or
    restarted."""
    found = []
    for name in ("silence", "restarted"):
        phase = decoded.phase(name)
        if phase is not None:
            greets = [e for e in _said(decoded, name) if _greets(e.value)]
            first_s = greets[0].time_s if greets else math.inf
            found.append((first_s - phase.start_s, phase.first))
    if not found or not _ever_answers(decoded, "run"):
        return not_seen("it was never silent, or it never answered")
    longest_s, number = max(found)
    if longest_s > GREETS_WITHIN_S:
        late = f"{longest_s:.2f} s" if longest_s < math.inf else "never"
        return failed(f"greeted after: {late}", [number])
    return passed(f"after {longest_s:.2f} s")


@requires(120, f"{RULES} 4: the next command acts again", unless=_ended_before("again"))
def it_goes_on_after_silence(decoded: JointStreamTraffic) -> Verdict:
    """The arm heard again, 90 % of its states are answered."""
    return _answered_if_ever(decoded, "again")


@requires(
    121, f"{RULES} 2: a restart of the controller is a new session", unless=_ended_before("anew")
)
def a_restart_is_followed(decoded: JointStreamTraffic) -> Verdict:
    """After a restart of the arm 90 % of the states of its new session are answered."""
    if decoded.phase("anew") is None or not _ever_answers(decoded, "run"):
        return not_seen("there was no restart, or it never answered")
    if not decoded.during("anew"):
        return failed("it did not greet the arm again")
    return _answered(decoded, "anew", 0.9)


@requires(122, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: JointStreamTraffic) -> Verdict:
    """A second reader, the scapy layers, sees the same commands."""

    def differs(each: Said, layers: Any) -> str:
        layer = layers.JointStream(decoded.raw[each.number])
        if wrong := refused(layers, layer):
            return wrong
        same = (layer.session, layer.sequence) == (each.value.session, each.value.sequence)
        return "" if same else "another session or sequence"

    return read_twice(_said(decoded), "joint_stream", differs, "commands", _NOTHING, 30)


@requires(
    301, f"{RULES} 4: the arm continues at the last speeds for 0.1 s", unless=_ended_before("ended")
)
def it_leaves_at_rest(decoded: JointStreamTraffic) -> Verdict:
    """When the client's program ends, its last command is a hold, or one without speed."""
    phase, found = decoded.phase("ended"), _said(decoded)
    if phase is None or not found:
        return not_seen("it was not ended")
    last = found[-1]
    if phase.end_s - last.time_s < 3.0 * PERIOD_S:
        return not_seen("it still answers")
    said = f"{last.value.mode.name.lower()}, {_speed(last):.3g} rad/s"
    return met(
        last.value.mode is ControlMode.HOLD or _speed(last) <= STILL_RAD_S, said, [last.number]
    )
