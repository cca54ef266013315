"""Requirements of a controller in Externally Guided Motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import dropwhile, pairwise
from typing import Any

from cardan.conform.egm.decoded import EgmTraffic, Robot, joints_of, not_normal, place_of, step
from cardan.conform.egm.scenario import STEP_M, STEP_RAD
from cardan.conform.requirements import (
    Findings,
    Over,
    Requirements,
    Verdict,
    Words,
    at_most,
    distance,
    failed,
    met,
    must,
    none_wrong,
    not_applicable,
    passed,
    some,
)
from cardan.conform.second_reading import read_twice, refused
from cardan.conform.timing import steady
from cardan.protocols.egm.messages import EgmMessageType, EgmMotion, RapidState
from cardan.spatial import from_euler_zyx

MANUAL = "ABB application manual 3HAC073318-001 (RobotWare 7.16)"
SCHEMA = "ABB's egm.proto, RobotWare 6.08 to 7.16"
LIBEGM = "ros-industrial/abb_libegm, src/egm_common_auxiliary.cpp"
LAW = f"{MANUAL}, control law and latency"

PERIODS_S = (0.004032, 0.004)
"""Periods of a real and of a virtual controller."""
PERIOD_TOLERANCE = 0.003
JITTER_MS = 1.5
GAP_PERIODS = 12
"""Longest time without a datagram, in periods; abb_libegm times out sooner or later."""
CLOCK_STEP_S = 0.05
ACTS_WITHIN_S = 0.06
"""The manual's 20 ms from writing a reference until it affects the robot, 20 ms of the servo's lag,
and the time in which half a millimeter begun at the default gain is more than noise."""
IN_TIME_S = 0.1
"""The first answers may meet a run that is timing out without earlier ones."""
LATE_ANSWERS_S = 0.1
"""A run that ends while answers are later than this may have timed out."""
FULL_S = 0.25
"""Time in which a controller's datagrams fill the buffer of an unread socket."""
LARGEST_BYTES = 1113
HELD_WITHIN_M, HELD_WITHIN_RAD = 5e-4, math.radians(0.1)
MOVED_M, MOVED_RAD = 2e-5, math.radians(4e-3)
"""Smallest displacement that counts as motion, above an encoder's noise."""
ENOUGH = 50
"""Fewest datagrams for which a rate is checked."""

_NOTHING = "no datagrams of the controller"
_NEVER_RAN = "the MCI never ran"
requires: Requirements[EgmTraffic] = Requirements("EGM", _NOTHING)


@requires(1, f"{MANUAL}, UdpUc: the controller is the client")
def datagrams_come(decoded: EgmTraffic) -> Verdict:
    """The controller sends datagrams without having been sent any."""
    first = next((a.time_s for a in decoded.answers), math.inf)
    before = [each for each in decoded.robots if each.time_s < first]
    return passed(f"{len(before)} datagrams") if before else failed("none came")


@requires(2, SCHEMA)
def datagrams_are_messages(decoded: EgmTraffic) -> Verdict:
    """Every datagram is one whole EgmRobot, with nothing before, after or between."""
    count = len(decoded.robots) + len(decoded.unread)
    return none_wrong(decoded.unread, count, f"{count} datagrams", _NOTHING, "datagrams are none")


ROBOTS: Over[EgmTraffic, Robot] = Over(lambda decoded: decoded.robots, "{} datagrams", "datagrams")


@requires.each(3, f"{SCHEMA}; {LIBEGM}", replace(ROBOTS, good="{} headers", what="headers"))
def headers_are_whole(each: Robot) -> str:
    """Every header has seqno, tm and the mtype DATA."""
    header = each.message.header
    if header is None or header.seqno is None or header.tm_ms is None:
        return "seqno or tm is missing"
    return f"mtype {header.mtype:d}" if header.mtype != EgmMessageType.DATA else ""


def _sequence(decoded: EgmTraffic, wrong: Iterable[tuple[int, str]], what: str) -> Verdict:
    return none_wrong(wrong, sum(map(len, decoded.sessions)), "every one", _NOTHING, what)


@requires(4, f"{SCHEMA}, EgmHeader.seqno", late_s=FULL_S)
def none_is_missing(decoded: EgmTraffic) -> Verdict:
    """No sequence number is left out within a session."""
    wrong = []
    for session in decoded.sessions:
        numbers = [each.seqno for each in session if each.seqno is not None]
        come = {step(numbers[0], number) for number in numbers}
        missing = sorted({*range(min(come), max(come) + 1)} - come)
        end = session[-1].number
        wrong += [(end, f"number {numbers[0] + n} never came") for n in missing]
    return _sequence(decoded, wrong, "are missing")


@requires(5, f"{SCHEMA}, EgmHeader.seqno")
def none_comes_twice(decoded: EgmTraffic) -> Verdict:
    """No sequence number comes twice within a session."""
    wrong = []
    for session in decoded.sessions:
        had: set[int | None] = set()
        for each in session:
            if each.seqno in had:
                wrong.append((each.number, f"number {each.seqno} again"))
            had.add(each.seqno)
    return _sequence(decoded, wrong, "come twice")


@requires(6, f"{SCHEMA}, EgmHeader.seqno")
def they_come_in_order(decoded: EgmTraffic) -> Verdict:
    """Datagrams arrive in the order of their sequence numbers."""
    wrong = [
        (other.number, f"{other.seqno} after {one.seqno}")
        for one, other, n in decoded.steps()
        if n < 0
    ]
    return _sequence(decoded, wrong, "were overtaken")


def _long(decoded: EgmTraffic) -> Iterator[list[Robot]]:
    return (each for each in decoded.sessions if len(each) > ENOUGH)


@requires(7, f"{MANUAL}: 4.032 ms, virtual about 4 ms; SampleRate its multiples")
def the_period_is_a_controllers(decoded: EgmTraffic) -> Verdict:
    """The mean period is 4.032 ms, or 4 ms of a virtual controller, times a whole number."""
    found = [(_period_s(session), session[-1].number) for session in _long(decoded)]
    some(found, f"no session of more than {ENOUGH} datagrams")
    for period_s, index in found:
        ratios = [period_s / each for each in PERIODS_S]
        off = min(abs(r / max(1, round(r)) - 1.0) if r == r else 1.0 for r in ratios)
        if off > PERIOD_TOLERANCE:
            return failed(f"{period_s * 1e3:.3f} ms", [index], period_s * 1e3, "ms")
    return passed(f"{found[0][0] * 1e3:.3f} ms in {len(found)} sessions")


@requires(8, f"{MANUAL}: one datagram in each cycle of the motion task")
def arrival_is_steady(decoded: EgmTraffic) -> Verdict:
    """95 % of the datagrams arrive within 1.5 ms of their period after the one before."""
    off = []
    for session in _long(decoded):
        gaps = [(b.time_s - a.time_s, b.number) for a, b in pairwise(session)]
        usual = sorted(gap for gap, _ in gaps)[len(gaps) // 2]
        off += [(abs(gap - usual) * 1e3, index) for gap, index in gaps]
    return steady(off, JITTER_MS, "ms", f"no session of more than {ENOUGH} datagrams")


@requires(9, f"{MANUAL}: one datagram in each cycle of the motion task")
def there_are_no_pauses(decoded: EgmTraffic) -> Verdict:
    """While a session lasts there is no silence of more than 12 periods."""
    some(decoded.sessions, _NOTHING)
    longest, wrong = 0.0, []
    for one, other, n in decoded.steps():
        gap_s = other.time_s - one.time_s
        longest = max(longest, gap_s)
        if n > 0 and gap_s > GAP_PERIODS * PERIODS_S[0]:
            wrong.append((other.number, f"{gap_s * 1e3:.0f} ms of silence"))
    if wrong:
        words = f"{len(wrong)} pauses: {wrong[0][1]}"
        return failed(words, (n for n, _ in wrong), longest * 1e3, "ms")
    return passed(f"longest {longest * 1e3:.1f} ms", longest * 1e3, "ms")


@requires(10, f"{MANUAL}, Local Port Number; the PC answers to the source of the datagram")
def a_session_has_one_source(decoded: EgmTraffic) -> Verdict:
    """All datagrams of a session come from one address and port."""
    wrong = [
        (other.number, f"{other.source} after {one.source}")
        for one, other, _ in decoded.steps()
        if one.source != other.source
    ]
    return _sequence(decoded, wrong, "come from elsewhere")


def _period_s(found: list[Robot]) -> float:
    """Return the mean period by sequence numbers; NaN if these do not advance."""
    first, last = found[0], found[-1]
    cycles = step(first.seqno or 0, last.seqno or 0)
    return (last.time_s - first.time_s) / cycles if cycles > 0 else math.nan


@requires(11, f"{SCHEMA}, EgmHeader.tm")
def the_ms_clock_runs(decoded: EgmTraffic) -> Verdict:
    """tm counts milliseconds: within a session it advances as time does, to 1 % and 10 ms."""
    worst, wrong = 0.0, []
    for session in _long(decoded):
        first, last = session[0], session[-1]
        one, other = (each.message.header and each.message.header.tm_ms for each in (first, last))
        if one is None or other is None:
            return failed("there is no tm", [first.number])
        passed_s = last.time_s - first.time_s
        off = abs(step(one, other) * 1e-3 - passed_s)
        worst = max(worst, off)
        if off > 0.01 * passed_s + 0.01:
            wrong.append((last.number, f"{step(one, other)} ms in {passed_s:.3f} s"))
    count, said = len(decoded.sessions), f"off by {worst * 1e3:.1f} ms at most"
    return none_wrong(wrong, count, said, _NOTHING, "sessions")


@requires(12, f"{SCHEMA}, EgmFeedBack.time (since RobotWare 6.07)")
def the_wall_clock_runs(decoded: EgmTraffic) -> Verdict:
    """The wall clock in feedBack.time advances as tm does; it never jumps."""
    times = [
        (header.tm_ms, back.time_us, each.number)
        for each in decoded.robots
        if (header := each.message.header) and (back := each.message.feed_back)
        if header.tm_ms is not None and back.time_us is not None
    ]
    wrong = []
    for (tm_ms, time_us, _), (later_ms, later_us, number) in pairwise(times):
        passed_ms = step(tm_ms, later_ms)
        jump_s = (later_us - time_us) * 1e-6 - passed_ms * 1e-3
        if 0 <= passed_ms < 60_000 and abs(jump_s) > CLOCK_STEP_S:
            wrong.append((number, f"by {jump_s:.3f} s"))
    said, nothing = f"{len(times)} times", "no datagram has feedBack.time"
    return none_wrong(wrong, len(times), said, nothing, "clocks jump")


def _complete(motion: EgmMotion | None, name: str) -> str:
    """Return the first field that clients need and `motion` lacks, in words; empty: none."""
    if motion is None:
        return f"no {name}"
    if motion.joints is None or len(motion.joints) != 6:
        return f"{name} without six joints"
    pose = motion.cartesian
    if pose is None or pose.pos is None or pose.orient is None:
        return f"{name} without a pose of pos and orient"
    return "" if motion.time_us is not None else f"{name} without time"


@requires.each(13, LIBEGM, ROBOTS)
def both_motions_are_whole(each: Robot) -> str:
    """feedBack and planned each have six joints, a pose of pos and orient, and a time."""
    m = each.message
    return _complete(m.feed_back, "feedBack") or _complete(m.planned, "planned")


@requires.each(14, LIBEGM, ROBOTS)
def the_states_are_there(each: Robot) -> str:
    """Every datagram has motorState, mciState, rapidExecState and mciConvergenceMet."""
    m = each.message
    found = (m.motor_state, m.mci_state, m.rapid_exec_state, m.mci_convergence_met)
    return "one of them is missing" if None in found else ""


def _poses(decoded: EgmTraffic) -> Iterator[tuple[Robot, EgmMotion]]:
    for each in decoded.robots:
        for motion in (each.message.feed_back, each.message.planned):
            if motion is not None and motion.cartesian is not None:
                yield each, motion


QUATERNIONS = Over(_poses, "{} quaternions", "quaternions", "no quaternion came")


@requires.each(15, f"{SCHEMA}, EgmQuaternion", QUATERNIONS)
def quaternions_are_normal(each: tuple[Robot, EgmMotion]) -> str | None:
    """Every quaternion has the length 1, to 1e-3."""
    return not_normal(each[1])


@requires(16, f"{SCHEMA}, EgmEuler; {LIBEGM}")
def euler_agrees(decoded: EgmTraffic) -> Findings:
    """Euler angles, where they are sent, are the quaternion's: R = Rz Ry Rx."""
    for each, motion in _poses(decoded):
        pose = motion.cartesian
        if pose is not None and pose.euler is not None and pose.orient is not None:
            same = from_euler_zyx(*pose.euler)
            dot = abs(sum(a * b for a, b in zip(same, pose.orient, strict=True)))
            far = math.degrees(2.0 * math.acos(min(1.0, dot)))
            yield each.number, f"{far:.2f} degrees apart" if dot < 1.0 - 1e-6 else ""
    return Words("{} poses", not_applicable("no Euler angles are sent"), "poses")


@requires(17, f"{SCHEMA}, EgmMeasuredForce in both layouts")
def forces_have_six_values(decoded: EgmTraffic) -> Findings:
    """measuredForce, where it is sent, has six values."""
    layouts = set()
    for each in decoded.robots:
        force = each.message.measured_force
        if force is not None:
            layouts.add("RobotWare 6" if force.fc_active is None else "RobotWare 7")
            count = len(force.force)
            yield each.number, "" if count == 6 else f"{count} values"
    good = f"{{}} forces in the layout of {' and '.join(sorted(layouts, reverse=True))}"
    return Words(good, not_applicable("no force is sent"), "forces")


@requires(18, f"{SCHEMA}: fields since 6.10, 7.6, 7.7, 7.16")
def fields_are_of_one_release(decoded: EgmTraffic) -> Findings:
    """A field of a later RobotWare comes only with those of the releases before it."""
    release = ""
    for each in decoded.robots:
        m = each.message
        fields = (m.utilization_rate, m.move_index, m.rapid_from_robot, m.torque_ref)
        has = [field is not None for field in fields]
        known = sum(has)
        # RAPID data are sent only where the program asks for them.
        right = has == sorted(has, reverse=True) or (has[:2] == [True, True] and known == 3)
        yield each.number, "" if right else "a later field without an earlier one"
        release = ("6.08", "6.10", "7.6", "7.7", "7.16")[max(known, 4 if has[3] else 0)]
    return Words(f"as RobotWare {release} or later sends", what="datagrams")


@requires(19, f"{SCHEMA}: the longest message with every field")
def datagrams_are_short(decoded: EgmTraffic) -> Verdict:
    """No datagram is longer than 1113 bytes."""
    lengths = [(len(decoded.events[each.number].data), each.number) for each in decoded.robots]
    longest, index = max(some(lengths, _NOTHING))
    return met(longest <= LARGEST_BYTES, f"{longest} B", [index])


@requires(20, "cardan.dissect: a second description of the protocol, written from the schema")
def both_descriptions_agree(decoded: EgmTraffic) -> Verdict:
    """A second reader, the scapy layers, sees the same sequence numbers, clocks and joints."""

    def differs(each: Robot, layers: Any) -> str:
        layer = layers.EgmRobot(decoded.events[each.number].data)
        if wrong := refused(layers, layer):
            return wrong
        header = each.message.header
        if header is not None and (layer.header.seqno, layer.header.tm) != header[:2]:
            return "another seqno or tm"
        joints = [math.radians(q) for q in layer.feedBack.joints.joints]
        same = not each.joints or all(
            math.isclose(a, b, abs_tol=1e-12) for a, b in zip(joints, each.joints, strict=True)
        )
        return "" if same else "other joints"

    return read_twice(decoded.robots, "egm", differs, "datagrams", _NOTHING, 40)


def _hold(decoded: EgmTraffic) -> list[Robot]:
    """Return the datagrams of the hold from the first with running and answered guidance on."""
    found = decoded.during("hold")
    first = next(
        (a.time_s for a in decoded.answers if found and a.number > found[0].number), math.inf
    )
    began = (n for n, each in enumerate(found) if each.running and each.time_s > first + IN_TIME_S)
    return found[next(began, len(found)) :]


@requires(
    101,
    f"{MANUAL}: a run ends by convergence, EGMStop, a stop or an error, not by itself",
    late_s=LATE_ANSWERS_S,
)
def an_answered_session_lasts(decoded: EgmTraffic) -> Verdict:
    """While every datagram is answered, no session ends and no other begins."""
    phase = some(decoded.phase("hold"), "there was no hold")
    found = some(_hold(decoded) or decoded.during("hold"), "there was no hold")
    begun = [session[0].number for session in decoded.sessions]
    anew = [number for number in begun if found[0].number < number < phase.end]
    must(not anew, "a session began anew", anew[:1])
    silent_s = phase.end_s - found[-1].time_s
    must(silent_s <= 0.25, f"it ended {silent_s:.2f} s before the answers did", [found[-1].number])
    return passed(f"{phase.end_s - found[0].time_s:.1f} s, {len(found)} datagrams")


@requires(102, f"{MANUAL}, egmstate; {SCHEMA}, EgmMotorState, EgmMCIState", late_s=LATE_ANSWERS_S)
def holding_is_undisturbed(decoded: EgmTraffic) -> Findings:
    """Once guidance runs and is answered, the motors stay on and the MCI stays RUNNING."""
    for each in _hold(decoded):
        words = "" if each.running else f"the MCI's state is {each.message.mci_state}"
        yield each.number, words if each.motors_on else "the motors went off"
    return Words("{} datagrams", _NEVER_RAN, "datagrams")


@requires(103, f"{SCHEMA}, EgmRapidCtrlExecState; {LIBEGM}: UNDEFINED is a known defect")
def the_program_is_said_to_run(decoded: EgmTraffic) -> Findings:
    """While the MCI is RUNNING, so is RAPID's execution state."""
    for each in decoded.robots:
        if each.running:
            state = each.message.rapid_exec_state
            yield each.number, "" if state == RapidState.RUNNING else f"the state is {state}"
    return Words("{} datagrams", _NEVER_RAN, "datagrams")


@requires(104, LAW)
def an_arm_that_is_held_stands(decoded: EgmTraffic) -> Verdict:
    """Told its own position, the arm stays within 0.5 mm and 0.1 degrees of it."""
    found = [each for each in _hold(decoded) if each.running]
    some(len(found) >= ENOUGH, "the MCI ran too briefly")
    first = found[0]
    far_m = max(distance(first.position, each.position) for each in found)
    far_rad = max(distance(first.joints, each.joints) for each in found)
    worst = max(found, key=lambda each: distance(first.position, each.position))
    held = not (far_m > HELD_WITHIN_M or far_rad > HELD_WITHIN_RAD)
    said = f"{far_m * 1e3:.3f} mm, {math.degrees(far_rad):.3f} degrees"
    return met(held, said, [worst.number], far_m * 1e3, "mm")


@requires(105, f"{MANUAL}, CommTimeout: event 41822")
def silence_ends_the_run(decoded: EgmTraffic) -> Verdict:
    """Without messages of the PC the run ends, after CommTimeout."""
    phase = some(decoded.phase("silence"), "no run was left alone")
    found = decoded.during("silence")
    last = max(some([each.time_s for each in found if each.running], "no run was left alone"))
    after_s = last - phase.start_s
    if phase.end_s - last < 0.25 and found[-1].running:
        return failed(f"it still runs after {after_s:.1f} s", [found[-1].number], after_s, "s")
    return passed(f"after {after_s:.2f} s", after_s, "s")


@requires(106, f"{MANUAL}: both directions are independent")
def silence_does_not_slow_it(decoded: EgmTraffic) -> Verdict:
    """Until then the controller sends on in its period, whether it is answered or not."""
    found = [each for each in decoded.during("silence") if each.running]
    some(len(found) >= ENOUGH, "no run was left alone for long enough")
    cycles = max(1, step(found[0].seqno or 0, found[-1].seqno or 0))
    period_s = (found[-1].time_s - found[0].time_s) / cycles
    off = min(abs(period_s / (n * p) - 1.0) for p in PERIODS_S for n in range(1, 25))
    return met(off <= 0.01, f"{period_s * 1e3:.3f} ms", [found[-1].number])


@requires(107, "ros-industrial/abb_libegm: sequence number 0 is the start of a session")
def a_new_run_counts_from_0(decoded: EgmTraffic) -> Verdict:
    """A run after an earlier one counts its datagrams from 0 again."""
    later = some([session[0] for session in decoded.sessions[1:]], "there was one session only")
    wrong = ((each.number, f"the first is {each.seqno}") for each in later if each.seqno)
    return none_wrong(wrong, len(later), f"{len(later)} sessions", _NOTHING, "sessions")


@requires(
    108,
    "not documented by ABB: a controller is tried, docs/simulated-peers.md says ignored",
    late_s=LATE_ANSWERS_S,
)
def junk_changes_nothing(decoded: EgmTraffic) -> Verdict:
    """Datagrams that are not EGM neither stop nor move the arm."""
    found = decoded.during("junk")
    some(decoded.junk and found and decoded.during("hold"), "none were sent")
    before = some([each for each in decoded.during("hold") if each.running], _NEVER_RAN)
    stopped = [each.number for each in found if not each.running]
    must(not stopped, "the run ended", stopped)
    far_m = max(distance(before[-1].position, each.position) for each in found)
    said = f"{len(decoded.junk)} datagrams, moved {far_m * 1e3:.3f} mm"
    return met(far_m <= HELD_WITHIN_M, said, [found[-1].number])


def _progress(found: list[Robot], still: Robot) -> Iterator[tuple[Robot, float]]:
    """Yield each with its distance from `still`, of the TCP or the last joint, in steps."""
    for each in found:
        by_position = distance(still.position, each.position) / STEP_M
        by_joints = distance(still.joints[5:6], each.joints[5:6]) / STEP_RAD
        yield each, max(by_position, by_joints)


def _stepped(decoded: EgmTraffic) -> tuple[Robot, list[Robot]] | None:
    """Return the last datagram before the step, and those after it."""
    found = [each for each in decoded.during("step") if each.running]
    before = [each for each in decoded.robots if found and each.number < found[0].number]
    return (before[-1], found) if before and len(found) > ENOUGH else None


_NO_STEP = "no step was made"


def _moved(one: Robot, other: Robot) -> bool:
    """True if the measured or planned position of TCP or joints differs."""
    m, n = one.message.planned, other.message.planned
    far_m = max(distance(one.position, other.position), distance(place_of(m), place_of(n)))
    far_rad = max(distance(one.joints, other.joints), distance(joints_of(m), joints_of(n)))
    return far_m > MOVED_M or far_rad > MOVED_RAD


@requires(201, LAW, late_s=ACTS_WITHIN_S / 4.0)
def a_reference_acts_soon(decoded: EgmTraffic) -> Verdict:
    """A reference moves the arm within 60 ms of being sent, what it plans or what it measures."""
    still, found = some(_stepped(decoded), _NO_STEP)
    phase = some(decoded.phase("step"), _NO_STEP)
    sent = next((a.time_s for a in decoded.answers if a.number > phase.first), phase.start_s)
    moved = next((each for each in found if _moved(still, each)), None)
    moved = must(moved, "it never moved", [found[-1].number])
    after_ms = (moved.time_s - sent) * 1e3
    said = f"after {after_ms:.1f} ms"
    return at_most(ACTS_WITHIN_S * 1e3, after_ms, "ms", said, [moved.number])


@requires(202, LAW)
def a_reference_is_reached(decoded: EgmTraffic) -> Verdict:
    """The arm comes to within 15 % of a small step's end, in the time of five time constants."""
    still, found = some(_stepped(decoded), _NO_STEP)
    *_, (last, share) = _progress(found, still)
    return met(abs(share - 1.0) < 0.15, f"{100 * share:.0f} % of the step", [last.number])


@requires(203, LAW)
def a_step_does_not_overshoot(decoded: EgmTraffic) -> Verdict:
    """On its way it goes no more than 20 % beyond the step's end."""
    still, found = some(_stepped(decoded), _NO_STEP)
    far, most = max(_progress(found, still), key=lambda each: each[1])
    return met(most < 1.2, f"{100 * most:.0f} % at most", [far.number])


@requires(204, LAW)
def it_comes_back(decoded: EgmTraffic) -> Verdict:
    """Told its old position, the arm comes back to within 15 % of the step."""
    still, _ = some(_stepped(decoded), _NO_STEP)
    back = some([each for each in decoded.during("back") if each.running], _NO_STEP)
    *_, (last, share) = _progress(back, still)
    return met(share < 0.15, f"{100 * share:.0f} % of the step is left", [last.number])


@requires(301, f"{SCHEMA}, EgmMotorState, EgmMCIState")
def an_emergency_stop_is_reported(decoded: EgmTraffic) -> Verdict:
    """After an emergency stop no datagram says that motors are on and guidance runs."""
    off = dropwhile(lambda each: each.motors_on, decoded.during("estop"))
    found = some(list(off), "no datagram said that the motors went off")
    wrong = [each.number for each in found if each.motors_on or each.running]
    return failed("it says on or RUNNING again", wrong) if wrong else passed("off, not RUNNING")


@requires(302, LAW)
def it_goes_on_where_it_stood(decoded: EgmTraffic) -> Verdict:
    """Guided again after an emergency stop, the arm is within 1 mm of where it stopped."""
    before = decoded.during("estop")
    after = [each for each in decoded.during("released") if each.running]
    some(before and after, "it was not started again")
    far_m = max(distance(before[-1].position, each.position) for each in after)
    return met(far_m < 1e-3, f"{far_m * 1e3:.3f} mm away", [after[-1].number])
