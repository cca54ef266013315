"""Requirements of a driver that guides a controller over EGM."""

from __future__ import annotations

import math
from bisect import bisect
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import dropwhile, pairwise
from typing import Any, NamedTuple

from cardan.conform.controllers import had_ended
from cardan.conform.egm.decoded import (
    EgmTraffic,
    Robot,
    SensorDatagram,
    joints_of,
    not_normal,
    place_of,
    step,
)
from cardan.conform.egm.requirements import MANUAL, SCHEMA
from cardan.conform.requirements import (
    Findings,
    Over,
    Requirements,
    Verdict,
    Words,
    distance,
    failed,
    met,
    must,
    none_wrong,
    not_applicable,
    number_of,
    some,
)
from cardan.conform.second_reading import read_twice, refused
from cardan.conform.timing import mostly_within
from cardan.protocols.egm.messages import EgmMessageType, EgmMotion, EgmSensor, EgmSensorPathCorr

LIBEGM = "ros-industrial/abb_libegm, src/egm_base_interface.cpp"
LAW = f"{MANUAL}: every reference acts at once; there is no path planner"

ANSWERED_SHARE = 0.95
ANSWER_WITHIN_S = 0.004
NEAR_M, NEAR_RAD = 5e-4, math.radians(0.05)
JUMP_M, JUMP_RAD = 0.004, math.radians(1.0)
"""Largest step in one cycle: 1 m/s and 250 degrees a second."""
SPEED_M_S, SPEED_RAD_S = 1e-6, 1e-6
FAREWELLS = 3
SILENT_AFTER_S = 0.1

_NOTHING = "no answers came"
requires: Requirements[EgmTraffic] = Requirements("EGMPC", _NOTHING)

ASKS = {"run": "EGMPC-101", "junk": "EGMPC-112"}
"""Phases in which the driver must answer, and the requirement of each."""


def _ended_before(phase: str) -> Callable[[EgmTraffic], Verdict | None]:
    return lambda decoded: had_ended(decoded, phase, decoded.robots, decoded.answers, ASKS)


ANSWERS: Over[EgmTraffic, SensorDatagram] = Over(lambda decoded: decoded.answers, "{} answers")


class Pair(NamedTuple):
    """A datagram of the suite, and the answers before the next one."""

    robot: Robot
    answers: list[SensorDatagram]


def _pairs(decoded: EgmTraffic, *phases: str) -> list[Pair]:
    """Return the pairs of the phases, without junk and old datagrams."""
    found = [Pair(robot, []) for robot in decoded.robots]
    for answer in decoded.answers:
        before = bisect(decoded.robots, answer.number, key=number_of)
        if before:
            found[before - 1].answers.append(answer)
    if not phases:
        return found
    inside = {each.number for each in decoded.within(decoded.robots, *phases)}
    return [each for each in found if each.robot.number in inside]


def _answered(found: Sequence[Pair]) -> float:
    """Return the share of answered datagrams."""
    return sum(bool(each.answers) for each in found) / max(1, len(found))


def _planned(answer: SensorDatagram) -> EgmMotion | None:
    message = answer.message
    return message.planned if isinstance(message, EgmSensor) else None


def _speed(answer: SensorDatagram) -> float:
    """Return the largest component of its speed reference, m/s or rad/s."""
    speed = answer.message.speed_ref if isinstance(answer.message, EgmSensor) else None
    if speed is None:
        return 0.0
    return max(map(abs, (*(speed.cartesians or ()), *(speed.joints or ()), 0.0)))


@requires(101, f"{MANUAL}: the PC answers to the source of the datagram")
def the_run_is_answered(decoded: EgmTraffic) -> Verdict:
    """Once it has begun to answer, it answers 95 % of the datagrams of a run."""
    found = some(_pairs(decoded, "run"), "nothing was sent")
    began = must(list(dropwhile(lambda each: not each.answers, found)), "none came")
    share = _answered(began[:-1])
    return met(share >= ANSWERED_SHARE, f"{100 * share:.1f} %")


@requires(102, SCHEMA)
def answers_are_messages(decoded: EgmTraffic) -> Verdict:
    """Every answer is one whole EgmSensor or EgmSensorPathCorr, all of whose numbers are finite."""
    count = len(decoded.answers) + len(decoded.unread)
    return none_wrong(decoded.unread, count, f"{count} answers", _NOTHING)


@requires.each(103, f"{SCHEMA}, EgmHeader.mtype", ANSWERS)
def answers_have_their_type(answer: SensorDatagram) -> str:
    """mtype is CORRECTION, or PATH_CORRECTION of a path correction."""
    path = isinstance(answer.message, EgmSensorPathCorr)
    wanted = EgmMessageType.PATH_CORRECTION if path else EgmMessageType.CORRECTION
    mtype = None if answer.message.header is None else answer.message.header.mtype
    return "" if mtype == wanted else f"mtype {mtype}"


@requires(104, f"{SCHEMA}, EgmHeader.seqno")
def answers_count_up_by_one(decoded: EgmTraffic) -> Findings:
    """seqno goes up by one from message to message; it may restart with a run."""
    for one, other in _neighbors(decoded):
        a, b = one.message.header, other.message.header
        if a is None or b is None or a.seqno is None or b.seqno is None:
            return failed("there is no seqno", [other.number])
        yield other.number, "" if step(a.seqno, b.seqno) == 1 else f"{b.seqno} after {a.seqno}"
    return Words("{} messages")


@requires(105, f"{MANUAL}: the controller takes one message in a cycle, oldest first")
def one_answer_is_enough(decoded: EgmTraffic) -> Verdict:
    """To a datagram there is one answer: more would wait in the controller and make it lag."""
    found = _pairs(decoded, "run", "started")
    several = [each.answers for each in found if len(each.answers) > 1]
    wrong = [(answers[1].number, f"{len(answers)} answers") for answers in several]
    # A slightly late answer stands beside the next one.
    if len(wrong) <= 0.01 * len(found):
        wrong = []
    return none_wrong(
        wrong, sum(bool(e.answers) for e in found), f"{len(found)} datagrams", _NOTHING
    )


@requires(106, f"{MANUAL}: the controller reads what is there in its next cycle")
def answers_are_in_time(decoded: EgmTraffic) -> Verdict:
    """99 of 100 answers come within the cycle of 4 ms."""
    by_tm = {each.message.header.tm_ms: each for each in decoded.robots if each.message.header}
    times = []
    before = {answer.number: robot for robot, answers in _pairs(decoded) for answer in answers}
    for answer in decoded.within(decoded.answers, "run"):
        asked, header = before.get(answer.number), answer.message.header
        echoed = by_tm.get(header.tm_ms) if header is not None and header.tm_ms else None
        if asked is not None and echoed is not None and echoed.number < answer.number:
            asked = echoed
        if asked is not None:
            times.append((answer.time_s - asked.time_s, answer.number))
    return mostly_within(times, 0.99, ANSWER_WITHIN_S, "99 of 100 within {:.2f} ms", _NOTHING)


@requires.each(
    107, f"{SCHEMA}; {MANUAL}: planned or speedRef of the mode, else the last one counts", ANSWERS
)
def every_answer_has_a_reference(answer: SensorDatagram) -> str:
    """Every answer has a position or a speed, in joints or of the TCP, or a path correction."""
    m = answer.message
    if isinstance(m, EgmSensorPathCorr):
        return ""
    position = m.planned is not None and (m.planned.joints or m.planned.cartesian)
    speed = m.speed_ref is not None and (m.speed_ref.joints or m.speed_ref.cartesians)
    return "" if position or speed else "neither position nor speed"


def _none_sent(decoded: EgmTraffic) -> Verdict | None:
    sent = any(not_normal(_planned(each)) is not None for each in decoded.answers)
    return not_applicable("no quaternion is sent") if decoded.answers and not sent else None


QUATERNIONS = replace(ANSWERS, good="{} quaternions", unless=_none_sent)


@requires.each(108, f"{SCHEMA}, EgmQuaternion", QUATERNIONS)
def quaternions_are_normal(answer: SensorDatagram) -> str | None:
    """Every quaternion has the length 1, to 1e-3."""
    return not_normal(_planned(answer))


def _beyond(far_m: float, far_rad: float, most_m: float, most_rad: float) -> str:
    """Return the distances beyond their limits in words; empty: none."""
    found = []
    if far_m > most_m:
        found.append(f"{far_m * 1e3:.2f} of at most {most_m * 1e3:g} mm")
    if far_rad > most_rad:
        far, most = math.degrees(far_rad), math.degrees(most_rad)
        found.append(f"{far:.2f} of at most {most:.3g} degrees")
    return " and ".join(found)


def _strays(robot: Robot, answer: SensorDatagram) -> str:
    """Return the difference of an answer from the measured position at rest; empty: none."""
    motion = _planned(answer)
    far_m = distance(place_of(motion), robot.position)
    far_rad = distance(joints_of(motion)[:6], robot.joints)
    if far := _beyond(far_m, far_rad, NEAR_M, NEAR_RAD):
        return f"away by {far}"
    speed = _speed(answer)
    return f"with a speed of {speed:.3g} m/s or rad/s" if speed > SPEED_M_S else ""


@requires(109, f"{LAW}; a stale target after a restart is a jump")
def a_session_begins_where_the_arm_is(decoded: EgmTraffic) -> Findings:
    """The first answer of every session is the measured position, with no speed."""
    pairs = _pairs(decoded)
    for session in decoded.sessions:
        numbers = {each.number for each in session}
        for robot, answers in pairs:
            if robot.number in numbers and answers:
                yield answers[0].number, _strays(robot, answers[0])
                break
    return Words("{} sessions")


def _neighbors(decoded: EgmTraffic) -> Iterator[tuple[SensorDatagram, SensorDatagram]]:
    """Yield consecutive answers without a new session between them."""
    starts = [session[0].number for session in decoded.sessions]
    for one, other in pairwise(decoded.answers):
        if not any(one.number < start < other.number for start in starts):
            yield one, other


@requires.each(110, LAW, Over(_neighbors, "{} steps"))
def references_do_not_jump(each: tuple[SensorDatagram, SensorDatagram]) -> str | None:
    """From answer to answer the reference goes no further than 4 mm and 1 degree."""
    a, b = map(_planned, each)
    if a is None or b is None:
        return None
    far_m, far_rad = distance(place_of(a), place_of(b)), distance(joints_of(a), joints_of(b))
    return _beyond(far_m, far_rad, JUMP_M, JUMP_RAD)


@requires(
    111,
    f"{LAW}; {LIBEGM} repeats its last reference there",
    unless=_ended_before("stopped"),
)
def it_follows_while_commands_do_not_act(decoded: EgmTraffic) -> Findings:
    """While the MCI is not RUNNING, answers are the measured position without speed, so that
    going on is no jump."""
    # The first answers may have been in flight.
    for robot, answers in _pairs(decoded, "stopped")[25:]:
        if not robot.running:
            for answer in answers:
                yield answer.number, _strays(robot, answer)
    return Words("{} answers", "it did not answer while commands do not act")


@requires(
    112,
    f"{SCHEMA}: any datagram may come to a UDP port; ABBRobotEGM ended at one",
    unless=_ended_before("junk"),
)
def junk_does_not_end_it(decoded: EgmTraffic) -> Verdict:
    """Datagrams that are not EGM have no effect: the driver continues to answer."""
    found, ran = _pairs(decoded, "junk"), _answered(_pairs(decoded, "run"))
    some(found and decoded.junk and ran, "none were sent, or it never answered")
    said = f"{len(decoded.junk)} of them; {100 * _answered(found):.1f} % answered"
    return met(_answered(found) > 0.9, said, [decoded.junk[0][0]])


@requires(
    113,
    f"{SCHEMA}, EgmHeader.seqno: old datagrams must have no effect",
    unless=_ended_before("old"),
)
def old_datagrams_are_not_answered(decoded: EgmTraffic) -> Verdict:
    """A datagram that is old, or comes again, is not answered."""
    some(_answered(_pairs(decoded, "old")), "none were sent, or it did not answer")
    sent = Counter(each.message.header for each in decoded.robots)
    again = {header.tm_ms for header, count in sent.items() if count > 1 and header is not None}
    echoed = Counter(each.message.header.tm_ms for each in decoded.answers if each.message.header)
    twice = {tm_ms for tm_ms in again if echoed[tm_ms] > 1}
    inside = decoded.within(decoded.answers, "old")
    # The echoed tm identifies the answered datagram, however late.
    wrong = [e.number for e in inside if e.message.header and e.message.header.tm_ms in twice]
    must(not wrong, f"{len(wrong)} answers to duplicates", wrong)
    fresh = len({each.seqno for each in decoded.during("old")})
    said = f"{len(inside)} answers to {fresh} new datagrams"
    # The last answer before may have been late.
    return met(len(inside) <= fresh + 1, said, [each.number for each in inside[-1:]])


@requires(
    114,
    f"{MANUAL}: what is sent waits in the controller for its next run",
    unless=_ended_before("silence"),
)
def silence_is_not_answered(decoded: EgmTraffic) -> Verdict:
    """While the controller is silent it is sent no more than three messages."""
    phase = some(decoded.phase("silence"), _NEVER)
    some(_answered(_pairs(decoded, "run")), _NEVER)
    since_s = phase.start_s + SILENT_AFTER_S
    found = [e.number for e in decoded.within(decoded.answers, "silence") if e.time_s > since_s]
    return met(len(found) <= FAREWELLS, f"{len(found)} messages", found)


_NEVER = "there was no silence, or it never answered"


@requires(
    115,
    f"{MANUAL}, Local Port Number: 0 is any, and another one after a restart",
    unless=_ended_before("restarted"),
)
def a_new_port_is_followed(decoded: EgmTraffic) -> Verdict:
    """After a restart of the controller, which has another port then, that one is answered."""
    found, ran = _pairs(decoded, "restarted"), _answered(_pairs(decoded, "run"))
    some(len(found) >= 25 and ran, "there was no restart, or it never answered")
    share = _answered(found[10:-1])
    said = f"{100 * share:.1f} % of its datagrams are answered"
    return met(share > 0.9, said, [found[-1].robot.number])


@requires(116, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: EgmTraffic) -> Verdict:
    """A second reader, the scapy layers, finds nothing wrong in the answers either."""

    def differs(each: SensorDatagram, layers: Any) -> str:
        return refused(layers, layers.EgmFromPc(decoded.events[each.number].data))

    return read_twice(decoded.answers, "egm", differs, "answers", _NOTHING, 30)


@requires(
    301,
    f"{MANUAL}: the controller continues at the last speed until CommTimeout",
    unless=_ended_before("ended"),
)
def it_leaves_without_speed(decoded: EgmTraffic) -> Verdict:
    """When the driver's program ends, the last message says no speed."""
    phase = some(decoded.phase("ended"), "it was not ended")
    last = some(decoded.answers, "it was not ended")[-1]
    some(phase.end_s - last.time_s >= 0.5, "it still answers")
    return met(_speed(last) <= SPEED_M_S, f"{_speed(last):.3g} m/s or rad/s", [last.number])
