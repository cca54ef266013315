"""Requirements of a MotoROS client that moves an arm."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

from cardan.conform.motoros.requirements import CONTROLLER, MESSAGES, SERVER, STATES, VELOCITY
from cardan.conform.motoros_driver.decoded import (
    VELOCITY_TYPES,
    DriverTraffic,
    Neighbors,
    Said,
    SaidPoint,
    SaidSpeeds,
    newest,
)
from cardan.conform.motoros_driver.scenario import (
    ANSWERED_WITHIN_S,
    ROBOT,
    STOPS,
)
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
    passed,
    some,
)
from cardan.conform.second_reading import read_twice, refused
from cardan.protocols.simple_message import codes, messages as m
from cardan.protocols.simple_message.codes import (
    MessageType as T,
    MotionCommand as C,
    MotionResult as R,
    NotReadySubcode as N,
)
from cardan.robots import load_arm
from cardan.sim_peers.motoros_controller.io_image import BIT_AND_GROUP_TYPES, REGISTER_TYPES

MANUAL = "docs/protocols/simple-message.md"
CLIENT = "motoman_driver 1.9.12, src/joint_trajectory_streamer.cpp"
ENDS = f"{CONTROLLER}: queues are emptied, START_TRAJ_MODE is needed"
AGAIN = "ISO 13850: resetting an emergency stop only permits a restart"

PIECES_SHARE = 0.01
"""Tolerated share of merged or split messages, as TCP may merge and split."""
ARM = load_arm(ROBOT)
NEAR_RAD = 1e-3
"""Corresponds to 30 pulses of the GP8's coarsest axis."""
STILL_RAD_S = 1e-6
EDGE_RAD = 0.02
"""Tolerance beyond a joint's range: an arm at its stop may be measured beyond it."""
TOO_FAST = 1.1
"""Factor on an axis's speed: the controller executes no faster increments."""
SAMPLES = 8
STOPPED_WITHIN_S = 0.15
"""Ten polls of the inputs take 0.1 s, the next status comes 25 ms later."""
BLIND_WITHIN_S = 0.3
UNDISTURBED = ("before-run", "run", "before-pieces", "pieces")
STARTS = frozenset((C.START_TRAJ_MODE, C.START_VEL_MODE))
POWER = frozenset((*STARTS, C.RESET_ALARM, C.START_SERVOS))
MOVING = frozenset((*STARTS, C.START_SERVOS))
POINT_FIELDS = codes.ValidFields.TIME | codes.ValidFields.POSITION | codes.ValidFields.VELOCITY
KNOWN_TYPES = {
    T.PING,
    T.JOINT_TRAJ_PT_FULL,
    T.MOTO_JOINT_TRAJ_PT_FULL_EX,
    T.MOTO_MOTION_CTRL,
    T.MOTO_SELECT_TOOL,
    T.MOTO_GET_DH_PARAMETERS,
    T.MOTO_VELOCITY_INFO,
    *BIT_AND_GROUP_TYPES,
    *REGISTER_TYPES,
}
VELOCITY_COMMANDS = frozenset((C.START_VEL_MODE, C.STOP_VEL_MODE))
LEAVES = frozenset((C.STOP_TRAJ_MODE, C.STOP_VEL_MODE, C.STOP_SERVOS, C.DISCONNECT))

requires: Requirements[DriverTraffic] = Requirements("MOTOPC")
_NO_POINTS = "no points were sent"
_NO_SPEEDS = "no speeds were sent"
_NEVER_STARTED = "motion was never started"


def _unused(decoded: DriverTraffic) -> Verdict | None:
    """Return not applicable if the client moves the arm without the velocity mode; else None."""
    unused = bool(decoded.points) and not decoded.velocities
    return not_applicable("it does not use the velocity mode") if unused else None


# -- the wire --------------------------------------------------------------------------------------


def _not_to(found: Iterable[str]) -> str:
    """Return the required ports without a connection in words; empty: none."""
    missing = sorted({"motion", "state"} - set(found))
    return f"not to {' and '.join(missing)}" if missing else ""


@requires(101, f"{MANUAL}: the controller listens at 50240 and 50241")
def it_connects(decoded: DriverTraffic) -> Verdict:
    """It connects to the state port and to the motion port."""
    missing = _not_to(each.port for each in decoded.links)
    return failed(missing) if missing else passed("to both")


@requires(102, f"{MESSAGES}: prefix, header, body")
def bytes_are_messages(decoded: DriverTraffic) -> Verdict:
    """All that it sends is whole messages: right prefixes, each of the length of its type."""
    count = len(decoded.said) + len(decoded.unread)
    return none_wrong(decoded.unread, count, f"{len(decoded.said)} messages")


@requires(103, f"{SERVER}: the bytes of one recv are taken for one message")
def a_message_is_one_piece(decoded: DriverTraffic) -> Verdict:
    """Each message comes by itself and in one piece; speeds sent as topics may come together."""
    count = len(decoded.said)
    few = len(decoded.pieces) <= PIECES_SHARE * count
    return none_wrong([] if few else decoded.pieces, count, f"{count} messages")


@requires(104, f"{SERVER}: a second message in the buffer can be lost; {MANUAL}")
def one_request_at_a_time(decoded: DriverTraffic) -> Findings:
    """No request is sent before the one before is answered; speeds sent as topics are none."""
    for said in decoded.said:
        if not said.is_topic:
            yield said.number, f"{said.owed} were open" if said.owed else ""
    return Words("{} requests")


@requires(105, f"{MANUAL}: the byte order is that of the controller's CPU")
def the_byte_order_is_the_controllers(decoded: DriverTraffic) -> Verdict:
    """Its messages have the byte order that the states have, of an FS100 too."""
    return none_wrong(decoded.disordered, len(decoded.said), f"{len(decoded.said)} messages")


@requires(106, f"{MESSAGES}, comm_type and reply_code: 2 and 0 of a request")
def requests_are_requests(decoded: DriverTraffic) -> Findings:
    """Everything is a service request with reply code 0; speeds may be topics."""
    for said in decoded.said:
        head = said.message.comm_type, said.message.reply_code
        good = said.is_topic or head == (codes.CommType.SERVICE_REQUEST, codes.ReplyCode.INVALID)
        yield said.number, "" if good else f"comm_type {head[0]}, reply_code {head[1]}"
    return Words("{} messages")


@requires(107, f"{STATES}: nothing is ever read there")
def the_state_port_is_left_alone(decoded: DriverTraffic) -> Verdict:
    """Nothing is sent to the state port: it would fill the controller's buffers."""
    some(any(each.port == "state" for each in decoded.links), "it did not connect there")
    count = len(decoded.strays)
    return failed(f"{count} pieces", decoded.strays) if count else passed("nothing came")


@requires(108, f"{SERVER}: an unknown command is answered with the reply before")
def commands_are_known(decoded: DriverTraffic) -> Findings:
    """Types and commands are such as MotoROS has; the velocity mode's are used where it is."""
    stock = decoded.named("connect")
    for said in decoded.said:
        kind, command = said.message.msg_type, said.command
        controller = next((p.name for p in reversed(stock) if p.first <= said.number), "velocity")
        of_velocity = kind in VELOCITY_TYPES or command in VELOCITY_COMMANDS
        if kind not in KNOWN_TYPES | VELOCITY_TYPES:
            yield said.number, f"type {kind}"
        elif isinstance(said.message.body, m.MotionCtrl) and command not in set(C):
            yield said.number, f"command {command}"
        else:
            there = not of_velocity or controller.startswith("velocity")
            yield said.number, "" if there else "there is no velocity mode"
    return Words("{} messages")


@requires(109, f"{SERVER}: the queue left by a connection continues with the next one")
def stop_motion_comes_first(decoded: DriverTraffic) -> Findings:
    """On every motion connection STOP_MOTION is answered before motion is started."""
    for messages in decoded.motion.values():
        stopped = False
        for each in messages:
            if each.command == C.STOP_MOTION and each.answered is not None:
                stopped = True
            elif each.command in STARTS or each.point is not None or each.velocity is not None:
                yield each.number, "" if stopped else "motion begins without one"
                break
    return Words("{} connections", _NEVER_STARTED)


def _started(messages: list[Said]) -> Iterator[tuple[Said, str]]:
    """Yield points and speeds of a connection with the mode that the answers had confirmed:
    "points", "speeds" or ""."""
    mode = ""
    for each in messages:
        reply = each.reply
        if each.point is not None or each.velocity is not None:
            yield each, mode
        if reply is None:
            continue
        good = reply.result == R.SUCCESS
        if each.command in (C.START_TRAJ_MODE, C.START_VEL_MODE) and good:
            mode = "points" if each.command == C.START_TRAJ_MODE else "speeds"
        elif each.command == C.CHECK_MOTION_READY:
            mode = (mode or "points") if good else ""
        elif (each.command == C.STOP_TRAJ_MODE and good) or reply.result == R.NOT_READY:
            mode = ""
        elif each.command == C.STOP_VEL_MODE and good:
            mode = "points"


@requires(110, f"{CONTROLLER}: the motion-ready predicate")
def motion_is_started_first(decoded: DriverTraffic) -> Findings:
    """Points and speeds are only sent after a start of their mode that was answered SUCCESS, and
    not after an answer NOT_READY, until the next one."""
    for messages in decoded.motion.values():
        for each, mode in _started(messages):
            wanted = "points" if each.point is not None else "speeds"
            # A topic may have been in flight at the same time as the answer.
            good = mode == wanted or (each.is_topic and _answered_lately(each, messages))
            yield each.number, "" if good else f"{wanted} in mode {mode or 'none'}"
    return Words("{} points and speeds", _NEVER_STARTED)


def _answered_lately(said: Said, messages: list[Said]) -> bool:
    before = [e.answered.time_s for e in messages if e.answered and e.answered.number < said.number]
    return bool(before) and said.time_s - before[-1] < STOPPED_WITHIN_S


@requires(111, f"{CONTROLLER}: HOLD, for example, prevents the start of a job")
def a_refused_start_is_taken_for_one(decoded: DriverTraffic) -> Verdict:
    """Neither points nor speeds follow a start of motion that is answered NOT_READY."""
    found = decoded.during("refused")
    refused = [e for e in found if e.command in STARTS and e.reply and e.reply.result]
    some(refused, "none was refused")
    wrong = [e.number for e in found if e.point or e.velocity]
    must(not wrong, f"{len(wrong)} after it", wrong)
    return passed(f"{len(refused)} refused")


# -- trajectories ----------------------------------------------------------------------------------


POINTS: Over[DriverTraffic, SaidPoint] = Over(
    lambda decoded: decoded.points, "{} points", nothing=_NO_POINTS
)
NEIGHBORS = Over(DriverTraffic.neighbors, "{} points", nothing=_NO_POINTS)


@requires.each(120, f"{SERVER}: else DATA_INSUFFICIENT", POINTS)
def points_are_complete(each: SaidPoint) -> str:
    """Every point has a time, positions and velocities, and says so; all are finite."""
    point = each[1]
    if point.valid_fields & POINT_FIELDS != POINT_FIELDS:
        return f"valid_fields {point.valid_fields}"
    return _finite(point.time, *point.pos, *point.vel)


def _finite(*values: float) -> str:
    """Return words if one of them is not finite; else empty."""
    return "" if all(map(math.isfinite, values)) else "a number that is not finite"


@requires(121, f"{SERVER}: within 30 pulses of the commanded position, else DATA_START_POS")
def a_trajectory_begins_where_the_arm_is(decoded: DriverTraffic) -> Findings:
    """The first point (sequence 0) is the measured position, to 0.001 rad, with no speed."""
    for said, point in decoded.points:
        measured = newest(decoded.feedback, said.number)
        if not point.sequence and measured is not None:
            far, speed = distance(point.pos, measured.pos), max(map(abs, point.vel))
            words = f"at {speed:.3g} rad/s" if speed > STILL_RAD_S else ""
            yield said.number, f"{far:.4f} rad away" if far > NEAR_RAD else words
    return Words("{} trajectories", _NO_POINTS)


@requires.each(
    122, f"{CLIENT}: the index of the point; {SERVER}: 0 begins, below 0 is refused", NEIGHBORS
)
def points_count_up(each: Neighbors) -> str:
    """The sequence goes up by one from point to point of a trajectory."""
    _, one, _, point = each
    up = point.sequence == one.sequence + 1
    return "" if up else f"{point.sequence} after {one.sequence}"


@requires.each(
    123, f"{SERVER}: of a point that is not later nothing is queued, and it is SUCCESS", NEIGHBORS
)
def time_goes_on(each: Neighbors) -> str:
    """From point to point of a trajectory the time rises by a whole millisecond at least."""
    _, one, _, point = each
    later = int(point.time * 1e3) > int(one.time * 1e3)
    return "" if later else f"{point.time:.4f} s after {one.time:.4f}"


def _outside(positions: m.Joints) -> str:
    """Return the first joint out of its range in words; empty: none."""
    for joint, (q, each) in enumerate(zip(positions, ARM.joints, strict=False), 1):
        if not each.lower - EDGE_RAD <= q <= each.upper + EDGE_RAD:
            return f"joint {joint} at {q:.3f} rad"
    return ""


def _too_fast(speeds: Iterable[float], share: float = 1.0) -> str:
    """Return the first joint beyond its maximum speed in words; empty: none."""
    for joint, (v, most) in enumerate(zip(speeds, ARM.velocity, strict=False), 1):
        if abs(v) > share * most + 1e-3:
            return f"joint {joint} at {v:.2f} rad/s"
    return ""


@requires.each(124, f"{SERVER}: DATA_SPEED of a speed; positions are not checked there", POINTS)
def points_are_within_the_arm(each: SaidPoint) -> str:
    """Positions are within the joints' ranges, and speeds within what the joints can do."""
    return _outside(each[1].pos) or _too_fast(each[1].vel)


def _steepest(one: m.JointTrajPtFull, other: m.JointTrajPtFull) -> list[float]:
    """Return the peak speed of each joint on MotoROS's cubic from point to point, rad/s."""
    span = other.time - one.time
    if span <= 0.0:
        return []
    found = []
    for p0, p1, v0, v1 in zip(one.pos, other.pos, one.vel, other.vel, strict=True):
        a1 = 6.0 * (p1 - p0) / span**2 - 2.0 * (v1 + 2.0 * v0) / span
        a2 = -12.0 * (p1 - p0) / span**3 + 6.0 * (v1 + v0) / span**2
        times = (span * n / SAMPLES for n in range(SAMPLES + 1))
        found.append(max((v0 + a1 * t + a2 * t * t / 2.0 for t in times), key=abs))
    return found


@requires.each(
    125, f"{SERVER}: increments beyond an axis's speed are refused, INC_MOVE_ERROR", NEIGHBORS
)
def the_way_between_is_within_the_arm(each: Neighbors) -> str:
    """On the cubic from point to point no joint is more than a tenth faster than it can be."""
    return _too_fast(_steepest(each[1], each[3]), TOO_FAST)


def _with_next(decoded: DriverTraffic, result: R) -> list[tuple[Said, Said | None]]:
    """Return the points with this answer, each with the next one on its connection."""
    return [
        (each, next((e for e in messages[n + 1 :] if e.point is not None), None))
        for messages in decoded.motion.values()
        for n, each in enumerate(messages)
        if each.point is not None and each.reply is not None and each.reply.result == result
    ]


@requires(126, f"{SERVER}: BUSY, the point is not taken; {CLIENT}: the same is sent again")
def a_busy_point_is_sent_again(decoded: DriverTraffic) -> Findings:
    """A point that is answered BUSY is the next one that is sent, unless motion is restarted."""
    busy = _with_next(decoded, R.BUSY)
    some(busy or not decoded.points, "no point was answered BUSY")
    for each, after in busy:
        other = after and after.point and after.point.sequence and after.point != each.point
        yield (after or each).number, "another point follows" if other else ""
    return Words("{} busy answers", _NO_POINTS)


@requires(127, f"{SERVER}: a refused first point is kept, and the next point continues from it")
def a_refused_first_point_is_not_gone_on_from(decoded: DriverTraffic) -> Findings:
    """After a first point that is answered INVALID comes another first point, or none."""
    found = [e for e in _with_next(decoded, R.INVALID) if e[0].point and not e[0].point.sequence]
    some(found or not decoded.points, "no first point was refused")
    for each, after in found:
        sequence = after.point.sequence if after and after.point else 0
        yield (after or each).number, f"point {sequence} follows" if sequence else ""
    return Words("{} of them", _NO_POINTS)


@requires(128, f"{SERVER}: an empty queue stops the command dead, without a ramp")
def the_queue_does_not_run_empty(decoded: DriverTraffic) -> Findings:
    """In motion every point is accepted before the ones before it have been played."""
    inside = {each.place for each in decoded.during("run")}
    ends_s = 0.0
    for before, one, said, point in decoded.neighbors():
        assert before.answered is not None
        assert said.answered is not None
        if one.sequence == 0:
            ends_s = before.answered.time_s
        moving = max(map(abs, one.vel)) > STILL_RAD_S
        if moving and one.sequence and said.place in inside:
            late_s = said.answered.time_s - ends_s
            yield said.number, f"{late_s * 1e3:.0f} ms too late" if late_s > 0.0 else ""
        ends_s = max(ends_s, said.answered.time_s) + point.time - one.time
    return Words("{} points", "no points were sent in motion")


@requires.each(129, f"{SERVER}: InvalidSubcode; {MANUAL}", POINTS)
def points_are_taken(each: SaidPoint) -> str:
    """No point is answered INVALID, but a first one where the arm sags."""
    reply, first = each[0].reply, each[1].sequence == 0
    if reply is None or reply.result != R.INVALID:
        return ""
    sags = first and reply.subcode == codes.InvalidSubcode.DATA_START_POS
    return "" if sags else f"subcode {reply.subcode}"


@requires(130, f"{SERVER}: a new point 0 splices nothing; in_motion of ROBOT_STATUS")
def a_trajectory_begins_at_rest(decoded: DriverTraffic) -> Findings:
    """No first point is sent while the newest status says that the arm is in motion."""
    for said, point in decoded.points:
        status = newest(decoded.statuses, said.number)
        if not point.sequence and status is not None:
            yield said.number, "it is in motion" if status.in_motion == 1 else ""
    return Words("{} trajectories", _NO_POINTS)


# -- the velocity mode -----------------------------------------------------------------------------


@requires(140, f"{VELOCITY}, finding out", unless=_unused)
def the_velocity_mode_is_asked_for(decoded: DriverTraffic) -> Findings:
    """START_VEL_MODE is only sent after MOTO_VELOCITY_INFO was answered on that connection."""
    for messages in decoded.motion.values():
        known = False
        for each in messages:
            known = known or isinstance(each.answer, m.VelocityInfo)
            if each.command == C.START_VEL_MODE:
                yield each.number, "" if known else "without having asked"
    return Words("{} starts", _NO_SPEEDS)


@requires(
    141,
    f"{VELOCITY}, starting and stopping: 0, or 20 to 500 ms; 0, or 0.01 to 1",
    unless=_unused,
)
def the_watchdog_can_be_had(decoded: DriverTraffic) -> Findings:
    """START_VEL_MODE asks for a watchdog and for a scale of acceleration that there are."""
    for said in decoded.said:
        body = said.message.body
        if isinstance(body, m.MotionCtrl) and said.command == C.START_VEL_MODE:
            watchdog_ms, scale = body.data[:2]
            words = "" if scale == 0.0 or 0.01 <= scale <= 1.0 else f"a scale of {scale:g}"
            there = watchdog_ms == 0.0 or 20.0 <= watchdog_ms <= 500.0
            yield said.number, words if there else f"a watchdog of {watchdog_ms:g} ms"
    return Words("{} starts", _NO_SPEEDS)


def _streams(decoded: DriverTraffic) -> Iterator[tuple[Said, int, int | None]]:
    """Yield speeds, their sequence and the one before since START_VEL_MODE or a 0, if any."""
    for messages in decoded.motion.values():
        before = None
        for each in messages:
            body = each.velocity
            if each.command == C.START_VEL_MODE or (body is not None and not body.sequence):
                before = None
            if body is not None:
                yield each, body.sequence, before
                before = body.sequence


@requires(142, f"{VELOCITY}, sequence: 0 arms, then strictly rising, modulo 2^31", unless=_unused)
def speeds_count_up(decoded: DriverTraffic) -> Findings:
    """The first speeds after a start have sequence 0, and from there on it rises."""
    for said, sequence, before in _streams(decoded):
        if before is None:
            yield said.number, f"{sequence} is the first" if sequence else ""
        else:
            rises = 0 < (sequence - before) % 2**31 < 2**30
            yield said.number, "" if rises else f"{sequence} after {before}"
    return Words("{} messages", _NO_SPEEDS)


SPEEDS = Over(lambda decoded: decoded.velocities, "{} messages", nothing=_NO_SPEEDS, unless=_unused)


@requires.each(143, f"{VELOCITY}, valid_fields: VELOCITY, and not POSITION", SPEEDS)
def speeds_are_complete(each: SaidSpeeds) -> str:
    """Speeds say that they are, and no positions; all are finite."""
    fields = each[1].valid_fields
    if not fields & codes.ValidFields.VELOCITY or fields & codes.ValidFields.POSITION:
        return f"valid_fields {fields}"
    return _finite(*each[1].vel)


@requires.each(144, f"{VELOCITY}, MOTO_VELOCITY_INFO: v_max", SPEEDS)
def speeds_are_within_the_arm(each: SaidSpeeds) -> str:
    """No speed is higher than the controller said that it can be."""
    return _too_fast(each[1].vel)


@requires.each(
    145,
    f"{VELOCITY}: the newest command wins; there is no queue",
    replace(SPEEDS, good="{} streams"),
)
def a_stream_begins_at_rest(each: SaidSpeeds) -> str | None:
    """The first speeds, of sequence 0, are zero."""
    return None if each[1].sequence else _moving(each[1])


@requires(146, f"{VELOCITY}, safety: the watchdog", unless=_unused)
def the_watchdog_is_fed(decoded: DriverTraffic) -> Verdict:
    """While nothing disturbs it, it is never silent for as long as the watchdog waits."""
    inside = {each.place for each in decoded.during(*UNDISTURBED)}
    gaps = [
        (b.time_s - a.time_s, b.number)
        for messages in decoded.motion.values()
        for a, b in pairwise(messages)
        if a.velocity is not None and a.place in inside and b.place in inside
    ]
    longest_s, number = max(some(gaps, _NO_SPEEDS))
    starts = (e.reply for e in decoded.said if e.command == C.START_VEL_MODE and e.reply)
    watchdog_s = [0.1, *(reply.data[2] * 1e-3 for reply in starts if not reply.result)][-1]
    said = f"longest {longest_s * 1e3:.0f} of {watchdog_s * 1e3:.0f} ms"
    return met(longest_s < watchdog_s, said, [number], longest_s * 1e3, "ms")


def _moving(body: m.JointTrajPtFull | m.JointVelocity) -> str:
    """Return the speed of a point or of speeds in words; empty: at rest."""
    speed = max(map(abs, body.vel))
    return f"{speed:.3g} rad/s" if speed > STILL_RAD_S else ""


@requires(
    147,
    f"{VELOCITY}, MOTO_JOINT_VELOCITY: INVALID and NOT_READY; it is never BUSY",
    unless=_unused,
)
def speeds_are_taken(decoded: DriverTraffic) -> Findings:
    """Speeds that are asked about are not answered INVALID, nor VEL_WATCHDOG."""
    found = [(said, said.reply) for said, _ in decoded.velocities if said.reply is not None]
    if decoded.velocities and not found:
        return not_applicable("it never asks what became of its speeds")
    for said, reply in found:
        bad = reply.result == R.INVALID or reply.subcode == N.VEL_WATCHDOG
        yield said.number, f"subcode {reply.subcode}" if bad else ""
    return Words("{} answers", _NO_SPEEDS)


# -- disturbances ----------------------------------------------------------------------------------


def _moves(found: Iterable[Said]) -> Iterator[tuple[int, str]]:
    """Yield points that move the arm, and nonzero speeds."""
    before = None
    for each in found:
        point, body = each.point, each.velocity
        if body is not None and (speed := _moving(body)):
            yield each.number, f"speeds of {speed}"
        elif point is not None:
            same = before is not None and before.pos == point.pos
            if _moving(point) or not (same or point.sequence == 0):
                yield each.number, f"point {point.sequence}"
            before = point


NOT_MOVED = "it did not move the arm"


def _stopped(decoded: DriverTraffic, what: str) -> Verdict:
    phases = decoded.named(what)
    wrong = [each for phase in phases for each in _moves(decoded.after(phase, STOPPED_WITHIN_S))]
    wrong += [
        (each.number, f"command {each.command}")
        for phase in phases
        for each in decoded.after(phase, 0.0)
        if each.command in POWER
    ]
    return none_wrong(wrong, len(phases), f"{len(phases)} of them", NOT_MOVED)


for number, field, what, when, starts in (
    (150, "e_stopped", "estop", "In an emergency stop", "starts and resets nothing"),
    (151, "in_error", "alarm", "After an alarm", "starts and resets nothing by itself"),
    (152, "mode", "teach", "With the key in teach", "starts nothing"),
    (153, "motion_possible", "hold", "In hold", "starts nothing"),
    (
        154,
        "drives_powered",
        "servo-off",
        "With the drives off",
        "does not switch them on by itself",
    ),
    (155, "motion_possible", "pfl", "After a collaborative stop", "starts nothing by itself"),
):
    text = f"{when} it sends no motion any more, and {starts}."
    requires(number, f"{ENDS}; {field} of ROBOT_STATUS", text=text)(partial(_stopped, what=what))


@requires(156, f"{ENDS}; {AGAIN}")
def it_does_not_start_by_itself(decoded: DriverTraffic) -> Verdict:
    """When the cause of a stop is over, it starts nothing unless it is told to."""
    names = [f"{name} over" for name in STOPS]
    phases = decoded.named(*names)
    found = decoded.during(*names)
    wrong = [(e.number, f"command {e.command}") for e in found if e.command in POWER]
    wrong += _moves(found)
    return none_wrong(wrong, len(phases), f"{len(phases)} of them", NOT_MOVED)


@requires(157, f"{STATES}: a cycle every 25 ms; without states the arm's motion is unobserved")
def without_states_it_stops(decoded: DriverTraffic) -> Verdict:
    """When the state port falls silent, no motion is commanded from 0.3 s on."""
    phases = decoded.named("silence")
    wrong = [each for phase in phases for each in _moves(decoded.after(phase, BLIND_WITHIN_S))]
    return none_wrong(wrong, len(phases), f"{len(phases)} of them", NOT_MOVED)


@requires(158, f"{SERVER}: a request is answered within its 5 s at most, or never")
def an_unanswered_request_ends_the_connection(decoded: DriverTraffic) -> Verdict:
    """A request that is not answered is not sent again on that connection, which is closed within
    5 s."""
    phases = decoded.named("unanswered")
    wrong = []
    for phase in phases:
        links = [e for e in decoded.links if e.port == "motion" and e.number < phase.first]
        if not links or links[-1].closed_s < phase.start_s:
            continue
        link = links[-1]
        if link.by_us or link.closed_s > phase.end_s + 1e-9:
            wrong.append((phase.first, f"it is open after {ANSWERED_WITHIN_S:g} s"))
        wrong += [
            (e.number, "another request")
            for e in decoded.after(phase, 0.0)
            if e.owed and not e.is_topic and e.channel == link.channel
        ]
    return none_wrong(wrong, len(phases), f"{len(phases)} of them", NOT_MOVED)


@requires(159, f"{MANUAL}: compare command and sequence of every reply with the request")
def the_reply_before_is_not_the_answer(decoded: DriverTraffic) -> Verdict:
    """After a reply that names another command or sequence it sends no motion any more on that
    connection."""
    wrong, count = [], 0
    for messages in decoded.motion.values():
        wrong_s = math.inf
        for each in messages:
            if each.time_s > wrong_s + STOPPED_WITHIN_S:
                wrong += list(_moves([each]))
            elif each.time_s > wrong_s and each.point is not None:
                wrong.append((each.number, "a point after it"))
            reply = each.reply
            if reply is None or reply.result == R.INVALID or each.answered is None:
                continue
            body = each.message.body
            asked = getattr(body, "sequence", reply.sequence)
            named = each.command or each.message.msg_type
            if (reply.sequence, reply.command) != (asked, named):
                count += 1
                wrong_s = min(wrong_s, each.answered.time_s)
    return none_wrong(wrong, count, f"{count} of them", "no request was answered so")


def _came_again(decoded: DriverTraffic, what: str, port: str) -> Verdict:
    """Check if a connection that ended in a phase was restored."""
    phases = some(decoded.named(what, f"{what} over"), NOT_MOVED)
    firsts = [phase for phase in phases if not phase.name.endswith("over")]
    wrong = []
    for phase in firsts:
        end = max(p.end for p in phases if p.name.startswith(phase.name))
        if not any(e.port == port and phase.first < e.number < end for e in decoded.links):
            wrong.append((phase.first, "it did not reconnect"))
    inside = decoded.during(what, f"{what} over")
    wrong += [(e.number, f"command {e.command}") for e in inside if e.command in MOVING]
    return none_wrong(wrong, len(firsts), f"{len(firsts)} of them")


@requires(160, f"{SERVER}: the place is free at once; {ENDS}")
def it_comes_again(decoded: DriverTraffic) -> Verdict:
    """The motion connection cut, it connects again, and does not start motion by itself."""
    return _came_again(decoded, "cut", "motion")


@requires(161, f"{MANUAL}: a stream that has lost its framing must be closed")
def junk_ends_the_connection_only(decoded: DriverTraffic) -> Verdict:
    """Bytes on the state port that are no message end that connection, not the client: it connects
    again, and does not start motion by itself."""
    return _came_again(decoded, "junk", "state")


@requires(162, f"{MANUAL}: TCP splits and merges")
def messages_in_pieces_are_read(decoded: DriverTraffic) -> Verdict:
    """Messages of the controller that come in pieces, or several at once, disturb nothing."""
    phases = some(decoded.named("pieces"), NOT_MOVED)
    wrong = []
    for phase in phases:
        last_s = phase.end_s - 0.5 * (phase.end_s - phase.start_s)
        found = [s for s in decoded.after(phase, last_s - phase.start_s) if s.point or s.velocity]
        if not found:
            wrong.append((phase.first, "it ceased to command"))
        ended = [e for e in decoded.links if phase.first < e.ended < phase.end]
        wrong += [(e.ended, f"{e.channel} was closed") for e in ended if not e.by_us]
    return none_wrong(wrong, len(phases), f"{len(phases)} of them")


@requires(163, f"{STATES}, {SERVER}: after power-up the ports are open again")
def a_restart_is_followed(decoded: DriverTraffic) -> Findings:
    """After a restart of the controller it connects again, to both ports."""
    phases = decoded.named("connect")[1:]
    some(phases and decoded.links, "there was no restart, or it never connected")
    for phase in phases:
        yield phase.first, _not_to(each.port for each in decoded.within(decoded.links, phase.name))
    return Words("{} of them")


@requires(164, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: DriverTraffic) -> Verdict:
    """A second reader, the scapy layers, finds nothing wrong in the messages either."""

    def differs(each: Said, layers: Any) -> str:
        layer = layers.SimpleMessage(each.raw)
        if wrong := refused(layers, layer):
            return wrong
        return "" if layer.msg_type == each.message.msg_type else "another type"

    return read_twice(decoded.said, "simple_message", differs, "messages", compared=40)


# -- its end ---------------------------------------------------------------------------------------

_NOT_ENDED = "it was not ended while the arm moved"


@requires(301, f"{SERVER}: a connection that ends stops the command dead, without a ramp")
def it_leaves_at_rest(decoded: DriverTraffic) -> Findings:
    """When the program ends, its last point or speeds are at rest."""
    for phase in decoded.named("end"):
        last = [s for s in decoded.said if s.number < phase.end and (s.point or s.velocity)][-1]
        body = last.point or last.velocity
        yield last.number, _moving(body) if body is not None else ""
    return Words("{} of them", _NOT_ENDED)


@requires(302, f"{SERVER}: INIT_ROS keeps waiting for increments after a connection")
def it_leaves_the_mode(decoded: DriverTraffic) -> Findings:
    """When the program ends, it leaves the mode: STOP_TRAJ_MODE, STOP_VEL_MODE or DISCONNECT is
    sent and not refused."""
    for phase in decoded.named("end"):
        found = [s for s in decoded.after(phase, 0.0) if s.command in LEAVES]
        good = [s for s in found if s.reply is None or s.reply.result == R.SUCCESS]
        yield phase.first, "" if good else f"{len(found)} were sent and refused"
    return Words("{} of them", _NOT_ENDED)


@requires(303, f"{SERVER}: one client at a time, and only TCP shows that it has gone")
def it_closes_its_connections(decoded: DriverTraffic) -> Verdict:
    """When the program ends, its connections are closed."""
    phases, wrong = decoded.named("end"), []
    for phase in phases:
        links = [each for each in decoded.links if each.number < phase.end]
        left = [each for each in links if each.closed_s > phase.end_s + 1e-9]
        wrong += [(each.number, f"{each.channel} is open") for each in left]
    return none_wrong(wrong, len(phases), f"{len(phases)} of them", _NOT_ENDED)
