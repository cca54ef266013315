"""What a client of MotoROS must do that moves an arm."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise

from cardan.conform.motoros_driver.pilot import (
    ANSWERED_WITHIN_S,
    ROBOT,
    STOPS,
)
from cardan.conform.motoros_driver.seen import DriverSeen, Link, Said
from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_applicable,
    not_seen,
    passed,
)
from cardan.conform.timeline import Phase
from cardan.errors import ExtraMissingError
from cardan.protocols.simple_message import (
    CommType,
    InvalidSubcode,
    Joints,
    JointTrajPtFull,
    MessageType as T,
    MotionCommand as C,
    MotionCtrl,
    MotionResult as R,
    NotReadySubcode as N,
    ReplyCode,
    ValidFields,
    VelocityInfo,
)
from cardan.robots import load_arm

MANUAL = "docs/protocols/simple-message.md"
SERVER = "motoman_driver 1.9.12, MotoPlus/MotionServer.c"
STATES = "motoman_driver 1.9.12, MotoPlus/StateServer.c"
CONTROLLER = "motoman_driver 1.9.12, MotoPlus/Controller.c"
MESSAGES = "motoman_driver 1.9.12, MotoPlus/SimpleMessage.h"
CLIENT = "motoman_driver 1.9.12, src/joint_trajectory_streamer.cpp"
VELOCITY = "docs/protocols/motoros-velocity-mode.md"
ENDS = f"{CONTROLLER}: queues are emptied, START_TRAJ_MODE is needed"
AGAIN = "ISO 13850: resetting an emergency stop only permits a restart"

PIECES_SHARE = 0.01
"""TCP may merge and cut on the way to us."""
ARM = load_arm(ROBOT)
NEAR_RAD = 1e-3
"""30 pulses of the GP8's coarsest axis."""
STILL_RAD_S = 1e-6
EDGE_RAD = 0.02
"""An arm at its stop may be measured beyond it."""
TOO_FAST = 1.1
"""Of an axis's speed: the controller executes no faster increments."""
SAMPLES = 8
STOPPED_WITHIN_S = 0.15
"""Ten polls of the inputs take 0.1 s, the next status comes 25 ms later."""
BLIND_WITHIN_S = 0.3
UNDISTURBED = ("before-run", "run", "before-pieces", "pieces")
STARTS = frozenset((C.START_TRAJ_MODE, C.START_VEL_MODE))
POWER = frozenset((*STARTS, C.RESET_ALARM, C.START_SERVOS))
MOVING = frozenset((*STARTS, C.START_SERVOS))
POINT_FIELDS = ValidFields.TIME | ValidFields.POSITION | ValidFields.VELOCITY
KNOWN_TYPES = frozenset(
    (
        T.PING,
        T.JOINT_TRAJ_PT_FULL,
        T.MOTO_MOTION_CTRL,
        T.MOTO_JOINT_TRAJ_PT_FULL_EX,
        T.MOTO_SELECT_TOOL,
        T.MOTO_GET_DH_PARAMETERS,
        T.MOTO_READ_IO_BIT,
        T.MOTO_WRITE_IO_BIT,
        T.MOTO_READ_IO_GROUP,
        T.MOTO_WRITE_IO_GROUP,
        T.MOTO_READ_MREGISTER,
        T.MOTO_WRITE_MREGISTER,
        T.MOTO_VELOCITY_INFO,
    )
)
VELOCITY_TYPES = frozenset((T.MOTO_JOINT_VELOCITY, T.MOTO_JOINT_VELOCITY_EX))
VELOCITY_COMMANDS = frozenset((C.START_VEL_MODE, C.STOP_VEL_MODE))
LEAVES = frozenset((C.STOP_TRAJ_MODE, C.STOP_VEL_MODE, C.STOP_SERVOS, C.DISCONNECT))

requires: Requirements[DriverSeen] = Requirements("MOTOPC")
_NOTHING = "nothing came"
_NO_POINTS = "no points were sent"
_NO_SPEEDS = "no speeds were sent"


def _bad(found: Iterable[tuple[int, str]], of: int, good: str, nothing: str = _NOTHING) -> Verdict:
    wrong = list(found)
    if wrong:
        return failed(f"{len(wrong)} of {of}: {wrong[0][1]}", (n for n, _ in wrong))
    return passed(good) if of else not_seen(nothing)


# -- the wire --------------------------------------------------------------------------------------


@requires(101, f"{MANUAL}: the controller listens at 50240 and 50241")
def it_connects(seen: DriverSeen) -> Verdict:
    """It connects to the state port and to the motion port."""
    found = {each.port for each in seen.links}
    missing = sorted({"motion", "state"} - found)
    return failed(f"not to {' and '.join(missing)}") if missing else passed("to both")


@requires(102, f"{MESSAGES}: prefix, header, body")
def bytes_are_messages(seen: DriverSeen) -> Verdict:
    """All that it sends is whole messages: right prefixes, each of the length of its type."""
    count = len(seen.said) + len(seen.malformed)
    return _bad(seen.malformed, count, f"{len(seen.said)} messages")


@requires(103, f"{SERVER}: the bytes of one recv are taken for one message")
def a_message_is_one_piece(seen: DriverSeen) -> Verdict:
    """Each message comes by itself and in one piece; speeds sent as topics may come together."""
    count = len(seen.said)
    few = len(seen.pieces) <= PIECES_SHARE * count
    return _bad([] if few else seen.pieces, count, f"{count} messages")


@requires(104, f"{SERVER}: a second message in the buffer can be lost; {MANUAL}")
def one_request_at_a_time(seen: DriverSeen) -> Verdict:
    """No request is sent before the one before is answered; speeds sent as topics are none."""
    found = [each for each in seen.said if not each.is_topic]
    wrong = ((each.number, f"{each.owed} were open") for each in found if each.owed)
    return _bad(wrong, len(found), f"{len(found)} requests")


@requires(105, f"{MANUAL}: the byte order is that of the controller's CPU")
def the_byte_order_is_the_controllers(seen: DriverSeen) -> Verdict:
    """What it sends has the byte order that the states have, of an FS100 too."""
    return _bad(seen.disordered, len(seen.said), f"{len(seen.said)} messages")


@requires(106, f"{MESSAGES}, comm_type and reply_code: 2 and 0 of a request")
def requests_are_requests(seen: DriverSeen) -> Verdict:
    """Everything is a service request with reply code 0; speeds may be topics."""
    wrong = []
    for each in seen.said:
        message = each.message
        head = (message.comm_type, message.reply_code)
        if head != (CommType.SERVICE_REQUEST, ReplyCode.INVALID) and not each.is_topic:
            wrong.append((each.number, f"comm_type {head[0]}, reply_code {head[1]}"))
    return _bad(wrong, len(seen.said), f"{len(seen.said)} messages")


@requires(107, f"{STATES}: nothing is ever read there")
def the_state_port_is_left_alone(seen: DriverSeen) -> Verdict:
    """Nothing is sent to the state port: it would fill the controller's buffers."""
    if not any(each.port == "state" for each in seen.links):
        return not_seen("it did not connect there")
    count = len(seen.strays)
    return failed(f"{count} pieces", seen.strays) if count else passed("nothing came")


@requires(108, f"{SERVER}: an unknown command is answered with the reply before")
def commands_are_known(seen: DriverSeen) -> Verdict:
    """Types and commands are such as MotoROS has; the velocity mode's are used where it is."""
    wrong = []
    stock = seen.named("connect")
    for each in seen.said:
        kind, command = each.message.msg_type, each.command
        known = kind in KNOWN_TYPES | VELOCITY_TYPES
        if not known:
            wrong.append((each.number, f"type {kind}"))
        elif isinstance(each.message.body, MotionCtrl) and command not in set(C):
            wrong.append((each.number, f"command {command}"))
        elif kind in VELOCITY_TYPES or command in VELOCITY_COMMANDS:
            of = [phase for phase in stock if phase.first <= each.number]
            if of and not of[-1].name.startswith("velocity"):
                wrong.append((each.number, "there is no velocity mode"))
    return _bad(wrong, len(seen.said), f"{len(seen.said)} messages")


@requires(109, f"{SERVER}: what a connection before left in the queue goes on with the next one")
def stop_motion_comes_first(seen: DriverSeen) -> Verdict:
    """On every motion connection STOP_MOTION is answered before motion is started."""
    wrong, count = [], 0
    for messages in seen.motion.values():
        stopped = False
        for each in messages:
            if each.command == C.STOP_MOTION and each.answered is not None:
                stopped = True
            elif each.command in STARTS or each.point is not None or each.velocity is not None:
                count += 1
                if not stopped:
                    wrong.append((each.number, "motion begins without one"))
                break
    return _bad(wrong, count, f"{count} connections", "motion was never started")


def _started(messages: list[Said]) -> Iterator[tuple[Said, str]]:
    """Points and speeds of a connection with the mode that was on by what was answered: "points",
    "speeds" or ""."""
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
def motion_is_started_first(seen: DriverSeen) -> Verdict:
    """Points and speeds are only sent after a start of their mode that was answered SUCCESS, and
    not after an answer NOT_READY, until the next one."""
    wrong, count = [], 0
    for messages in seen.motion.values():
        for each, mode in _started(messages):
            count += 1
            wanted = "points" if each.point is not None else "speeds"
            # A topic may have been on its way while the answer was.
            if mode != wanted and not (each.is_topic and _answered_lately(each, messages)):
                wrong.append((each.number, f"{wanted} in mode {mode or 'none'}"))
    return _bad(wrong, count, f"{count} points and speeds", "motion was never started")


def _answered_lately(said: Said, messages: list[Said]) -> bool:
    before = [m.answered.time_s for m in messages if m.answered and m.answered.number < said.number]
    return bool(before) and said.time_s - before[-1] < STOPPED_WITHIN_S


@requires(111, f"{CONTROLLER}: hold, for one, does not let a job be started")
def a_refused_start_is_taken_for_one(seen: DriverSeen) -> Verdict:
    """Where the start of motion is answered NOT_READY, neither points nor speeds follow."""
    refused = [
        e for e in seen.during("refused") if e.command in STARTS and e.reply and e.reply.result
    ]
    if not refused:
        return not_seen("none was refused")
    wrong = [e.number for e in seen.during("refused") if e.point or e.velocity]
    said = f"{len(wrong)} after it"
    return failed(said, wrong) if wrong else passed(f"{len(refused)} refused")


# -- trajectories ----------------------------------------------------------------------------------


@requires(120, f"{SERVER}: else DATA_INSUFFICIENT")
def points_are_complete(seen: DriverSeen) -> Verdict:
    """Every point has a time, positions and velocities, and says so; all are finite."""
    wrong = []
    for said, point in seen.points:
        if point.valid_fields & POINT_FIELDS != POINT_FIELDS:
            wrong.append((said.number, f"valid_fields {point.valid_fields}"))
        elif not all(map(math.isfinite, (point.time, *point.pos, *point.vel))):
            wrong.append((said.number, "a number that is not finite"))
    return _bad(wrong, len(seen.points), f"{len(seen.points)} points", _NO_POINTS)


@requires(121, f"{SERVER}: within 30 pulses of the commanded position, else DATA_START_POS")
def a_trajectory_begins_where_the_arm_is(seen: DriverSeen) -> Verdict:
    """The first point (sequence 0) is the measured position, to 0.001 rad, with no speed."""
    wrong, count = [], 0
    for said, point in seen.points:
        measured = seen.feedback_before(said.number)
        if point.sequence or measured is None:
            continue
        count += 1
        far = max(abs(a - b) for a, b in zip(point.pos, measured.pos, strict=True))
        if far > NEAR_RAD:
            wrong.append((said.number, f"{far:.4f} rad away"))
        elif max(map(abs, point.vel)) > STILL_RAD_S:
            wrong.append((said.number, f"at {max(map(abs, point.vel)):.3g} rad/s"))
    return _bad(wrong, count, f"{count} trajectories", _NO_POINTS)


@requires(122, f"{CLIENT}: the index of the point; {SERVER}: 0 begins, below 0 is refused")
def points_count_up(seen: DriverSeen) -> Verdict:
    """The sequence goes up by one from point to point of a trajectory."""
    wrong, count = [], 0
    for _, one, said, point in seen.neighbours():
        count += 1
        if point.sequence != one.sequence + 1:
            wrong.append((said.number, f"{point.sequence} after {one.sequence}"))
    return _bad(wrong, count, f"{count} points", _NO_POINTS)


@requires(123, f"{SERVER}: of a point that is not later nothing is queued, and it is SUCCESS")
def time_goes_on(seen: DriverSeen) -> Verdict:
    """From point to point of a trajectory the time rises by a whole millisecond at least."""
    wrong, count = [], 0
    for _, one, said, point in seen.neighbours():
        count += 1
        if int(point.time * 1e3) <= int(one.time * 1e3):
            wrong.append((said.number, f"{point.time:.4f} s after {one.time:.4f}"))
    return _bad(wrong, count, f"{count} points", _NO_POINTS)


def _outside(positions: Joints) -> str:
    """Which joint is out of its range; empty: none."""
    for joint, (q, each) in enumerate(zip(positions, ARM.joints, strict=False), 1):
        if not each.lower - EDGE_RAD <= q <= each.upper + EDGE_RAD:
            return f"joint {joint} at {q:.3f} rad"
    return ""


def _too_fast(speeds: Iterable[float], share: float = 1.0) -> str:
    """Which joint is faster than it can be; empty: none."""
    for joint, (v, most) in enumerate(zip(speeds, ARM.velocity, strict=False), 1):
        if abs(v) > share * most + 1e-3:
            return f"joint {joint} at {v:.2f} rad/s"
    return ""


@requires(124, f"{SERVER}: DATA_SPEED of a speed; positions are not checked there")
def points_are_within_the_arm(seen: DriverSeen) -> Verdict:
    """Positions are within the joints' ranges, and speeds within what the joints can do."""
    wrong = [
        (said.number, why)
        for said, point in seen.points
        for why in [_outside(point.pos) or _too_fast(point.vel)]
        if why
    ]
    return _bad(wrong, len(seen.points), f"{len(seen.points)} points", _NO_POINTS)


def _steepest(one: JointTrajPtFull, other: JointTrajPtFull) -> list[float]:
    """The highest speed of each joint on MotoROS's cubic from point to point, rad/s."""
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


@requires(125, f"{SERVER}: increments beyond an axis's speed are refused, INC_MOVE_ERROR")
def the_way_between_is_within_the_arm(seen: DriverSeen) -> Verdict:
    """On the cubic from point to point no joint is more than a tenth faster than it can be."""
    wrong, count = [], 0
    for _, one, said, point in seen.neighbours():
        count += 1
        why = _too_fast(_steepest(one, point), TOO_FAST)
        if why:
            wrong.append((said.number, why))
    return _bad(wrong, count, f"{count} points", _NO_POINTS)


def _next_point(said: Said, messages: list[Said]) -> Said | None:
    """The point after one on its connection."""
    return next((m for m in messages if m.place > said.place and m.point is not None), None)


@requires(126, f"{SERVER}: BUSY, the point is not taken; {CLIENT}: the same is sent again")
def a_busy_point_is_sent_again(seen: DriverSeen) -> Verdict:
    """A point that is answered BUSY is the next one that is sent, unless motion begins anew."""
    wrong, count = [], 0
    for messages in seen.motion.values():
        for each in messages:
            if each.point is None or each.reply is None or each.reply.result != R.BUSY:
                continue
            count += 1
            after = _next_point(each, messages)
            anew = after is None or after.point is None or after.point.sequence == 0
            if after is not None and not anew and after.point != each.point:
                wrong.append((after.number, "another point follows"))
    if seen.points and not count:
        return not_seen("no point was answered BUSY")
    return _bad(wrong, count, f"{count} busy answers", _NO_POINTS)


@requires(127, f"{SERVER}: a first point that is refused is kept, and the next goes on from it")
def a_refused_first_point_is_not_gone_on_from(seen: DriverSeen) -> Verdict:
    """After a first point that is answered INVALID comes another first point, or none."""
    wrong, count = [], 0
    for messages in seen.motion.values():
        for each in messages:
            first = each.point is not None and each.point.sequence == 0
            if not first or each.reply is None or each.reply.result != R.INVALID:
                continue
            count += 1
            after = _next_point(each, messages)
            if after is not None and after.point is not None and after.point.sequence != 0:
                wrong.append((after.number, f"point {after.point.sequence} follows"))
    if seen.points and not count:
        return not_seen("no first point was refused")
    return _bad(wrong, count, f"{count} of them", _NO_POINTS)


@requires(128, f"{SERVER}: an empty queue stops the command dead, without a ramp")
def the_queue_does_not_run_empty(seen: DriverSeen) -> Verdict:
    """In motion every point is accepted before the ones before it have been played."""
    wrong, count = [], 0
    inside = {each.place for each in seen.during("run")}
    ends_s = 0.0
    for before, one, said, point in seen.neighbours():
        assert before.answered is not None
        assert said.answered is not None
        if one.sequence == 0:
            ends_s = before.answered.time_s
        moving = max(map(abs, one.vel)) > STILL_RAD_S
        if moving and one.sequence and said.place in inside:
            count += 1
            late_s = said.answered.time_s - ends_s
            if late_s > 0.0:
                wrong.append((said.number, f"{late_s * 1e3:.0f} ms too late"))
        ends_s = max(ends_s, said.answered.time_s) + point.time - one.time
    return _bad(wrong, count, f"{count} points", "no points were sent in motion")


@requires(129, f"{SERVER}: InvalidSubcode; {MANUAL}")
def points_are_taken(seen: DriverSeen) -> Verdict:
    """No point is answered INVALID, but a first one where the arm sags."""
    wrong = [
        (said.number, f"subcode {said.reply.subcode}")
        for said, point in seen.points
        if said.reply is not None
        and said.reply.result == R.INVALID
        and not (point.sequence == 0 and said.reply.subcode == InvalidSubcode.DATA_START_POS)
    ]
    return _bad(wrong, len(seen.points), f"{len(seen.points)} points", _NO_POINTS)


@requires(130, f"{SERVER}: a new point 0 splices nothing; in_motion of ROBOT_STATUS")
def a_trajectory_begins_at_rest(seen: DriverSeen) -> Verdict:
    """No first point is sent while the newest status says that the arm is in motion."""
    wrong, count = [], 0
    for said, point in seen.points:
        status = seen.status_before(said.number)
        if point.sequence or status is None:
            continue
        count += 1
        if status.in_motion == 1:
            wrong.append((said.number, "it is in motion"))
    return _bad(wrong, count, f"{count} trajectories", _NO_POINTS)


# -- the velocity mode -----------------------------------------------------------------------------


def _unused(seen: DriverSeen) -> bool:
    """The client moves the arm, and does not by the velocity mode."""
    return bool(seen.points) and not seen.velocities


_OTHER_MODE = "it does not use the velocity mode"


@requires(140, f"{VELOCITY}, finding out")
def the_velocity_mode_is_asked_for(seen: DriverSeen) -> Verdict:
    """START_VEL_MODE is only sent after MOTO_VELOCITY_INFO was answered on that connection."""
    wrong, count = [], 0
    for messages in seen.motion.values():
        known = False
        for each in messages:
            if each.answered and isinstance(each.answered.message.body, VelocityInfo):
                known = True
            if each.command == C.START_VEL_MODE:
                count += 1
                if not known:
                    wrong.append((each.number, "without having asked"))
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    return _bad(wrong, count, f"{count} starts", _NO_SPEEDS)


@requires(141, f"{VELOCITY}, starting and stopping: 0, or 20 to 500 ms; 0, or 0.01 to 1")
def the_watchdog_can_be_had(seen: DriverSeen) -> Verdict:
    """START_VEL_MODE asks for a watchdog and for a scale of acceleration that there are."""
    wrong, count = [], 0
    for each in seen.said:
        body = each.message.body
        if not isinstance(body, MotionCtrl) or each.command != C.START_VEL_MODE:
            continue
        count += 1
        watchdog_ms, scale = body.data[:2]
        if not (watchdog_ms == 0.0 or 20.0 <= watchdog_ms <= 500.0):
            wrong.append((each.number, f"a watchdog of {watchdog_ms:g} ms"))
        elif not (scale == 0.0 or 0.01 <= scale <= 1.0):
            wrong.append((each.number, f"a scale of {scale:g}"))
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    return _bad(wrong, count, f"{count} starts", _NO_SPEEDS)


def _streams(seen: DriverSeen) -> Iterator[list[Said]]:
    """Speeds from one START_VEL_MODE, or sequence 0, to the next."""
    for messages in seen.motion.values():
        found: list[Said] = []
        for each in messages:
            body = each.velocity
            begins = each.command == C.START_VEL_MODE or (body is not None and not body.sequence)
            if begins and found:
                yield found
                found = []
            if body is not None:
                found.append(each)
        if found:
            yield found


@requires(142, f"{VELOCITY}, sequence: 0 arms, then strictly rising, modulo 2^31")
def speeds_count_up(seen: DriverSeen) -> Verdict:
    """The first speeds after a start have sequence 0, and from there on it rises."""
    wrong = []
    for stream in _streams(seen):
        before = None
        for each in stream:
            body = each.velocity
            assert body is not None
            if before is None and body.sequence:
                wrong.append((each.number, f"{body.sequence} is the first"))
            elif before is not None and not 0 < (body.sequence - before) % 2**31 < 2**30:
                wrong.append((each.number, f"{body.sequence} after {before}"))
            before = body.sequence
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    return _bad(wrong, len(seen.velocities), f"{len(seen.velocities)} messages", _NO_SPEEDS)


@requires(143, f"{VELOCITY}, valid_fields: VELOCITY, and not POSITION")
def speeds_are_complete(seen: DriverSeen) -> Verdict:
    """Speeds say that they are, and no positions; all are finite."""
    wrong = []
    for said, body in seen.velocities:
        fields = body.valid_fields
        if not fields & ValidFields.VELOCITY or fields & ValidFields.POSITION:
            wrong.append((said.number, f"valid_fields {fields}"))
        elif not all(map(math.isfinite, body.vel)):
            wrong.append((said.number, "a number that is not finite"))
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    return _bad(wrong, len(seen.velocities), f"{len(seen.velocities)} messages", _NO_SPEEDS)


@requires(144, f"{VELOCITY}, MOTO_VELOCITY_INFO: v_max")
def speeds_are_within_the_arm(seen: DriverSeen) -> Verdict:
    """No speed is higher than the controller said that it can be."""
    wrong = [
        (said.number, why) for said, body in seen.velocities for why in [_too_fast(body.vel)] if why
    ]
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    return _bad(wrong, len(seen.velocities), f"{len(seen.velocities)} messages", _NO_SPEEDS)


@requires(145, f"{VELOCITY}: the newest command wins; nobody stands still at another one")
def a_stream_begins_at_rest(seen: DriverSeen) -> Verdict:
    """The first speeds, of sequence 0, are zero."""
    wrong, count = [], 0
    for said, body in seen.velocities:
        if body.sequence:
            continue
        count += 1
        if max(map(abs, body.vel)) > STILL_RAD_S:
            wrong.append((said.number, f"{max(map(abs, body.vel)):.3g} rad/s"))
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    return _bad(wrong, count, f"{count} streams", _NO_SPEEDS)


@requires(146, f"{VELOCITY}, safety: the watchdog")
def the_watchdog_is_fed(seen: DriverSeen) -> Verdict:
    """While nothing disturbs it, it is never silent for as long as the watchdog waits."""
    inside = {each.place for each in seen.during(*UNDISTURBED)}
    gaps = [
        (b.time_s - a.time_s, b.number)
        for messages in seen.motion.values()
        for a, b in pairwise(messages)
        if a.velocity is not None and a.place in inside and b.place in inside
    ]
    watchdog_s = 0.1
    for each in seen.said:
        if each.command == C.START_VEL_MODE and each.reply and not each.reply.result:
            watchdog_s = each.reply.data[2] * 1e-3
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    if not gaps:
        return not_seen(_NO_SPEEDS)
    longest_s, number = max(gaps)
    said = f"longest {longest_s * 1e3:.0f} of {watchdog_s * 1e3:.0f} ms"
    if longest_s >= watchdog_s:
        return failed(said, [number], longest_s * 1e3, "ms")
    return passed(said, longest_s * 1e3, "ms")


@requires(147, f"{VELOCITY}, MOTO_JOINT_VELOCITY: INVALID and NOT_READY; it is never BUSY")
def speeds_are_taken(seen: DriverSeen) -> Verdict:
    """Speeds that are asked about are not answered INVALID, nor VEL_WATCHDOG."""
    found = [(said, said.reply) for said, _ in seen.velocities if said.reply is not None]
    wrong = [
        (said.number, f"subcode {reply.subcode}")
        for said, reply in found
        if reply.result == R.INVALID or reply.subcode == N.VEL_WATCHDOG
    ]
    if _unused(seen):
        return not_applicable(_OTHER_MODE)
    if seen.velocities and not found:
        return not_applicable("it never asks what became of its speeds")
    return _bad(wrong, len(found), f"{len(found)} answers", _NO_SPEEDS)


# -- what befalls it -------------------------------------------------------------------------------


def _moves(found: Iterable[Said], since: Said | None = None) -> Iterator[tuple[int, str]]:
    """Points that go somewhere, and speeds that are not zero."""
    before = None if since is None else since.point
    for each in found:
        point, body = each.point, each.velocity
        if body is not None and max(map(abs, body.vel)) > STILL_RAD_S:
            yield each.number, f"speeds of {max(map(abs, body.vel)):.3g} rad/s"
        elif point is not None:
            same = before is not None and before.pos == point.pos
            if max(map(abs, point.vel)) > STILL_RAD_S or not (same or point.sequence == 0):
                yield each.number, f"point {point.sequence}"
            before = point


def _stopped(seen: DriverSeen, what: str) -> Verdict:
    phases = seen.named(what)
    wrong = [each for phase in phases for each in _moves(seen.after(phase, STOPPED_WITHIN_S))]
    wrong += [
        (each.number, f"command {each.command}")
        for phase in phases
        for each in seen.after(phase, 0.0)
        if each.command in POWER
    ]
    return _bad(wrong, len(phases), f"{len(phases)} of them", "it did not move the arm")


@requires(150, f"{ENDS}; e_stopped of ROBOT_STATUS")
def an_emergency_stop_ends_motion(seen: DriverSeen) -> Verdict:
    """In an emergency stop it sends no motion any more, and starts and resets nothing."""
    return _stopped(seen, "estop")


@requires(151, f"{ENDS}; in_error of ROBOT_STATUS")
def an_alarm_ends_motion(seen: DriverSeen) -> Verdict:
    """After an alarm it sends no motion any more, and starts and resets nothing by itself."""
    return _stopped(seen, "alarm")


@requires(152, f"{ENDS}; mode of ROBOT_STATUS")
def teach_mode_ends_motion(seen: DriverSeen) -> Verdict:
    """With the key in teach it sends no motion any more, and starts nothing."""
    return _stopped(seen, "teach")


@requires(153, f"{ENDS}; motion_possible of ROBOT_STATUS")
def hold_ends_motion(seen: DriverSeen) -> Verdict:
    """In hold it sends no motion any more, and starts nothing."""
    return _stopped(seen, "hold")


@requires(154, f"{ENDS}; drives_powered of ROBOT_STATUS")
def drives_off_end_motion(seen: DriverSeen) -> Verdict:
    """With the drives off it sends no motion any more, and does not switch them on by itself."""
    return _stopped(seen, "servo-off")


@requires(155, f"{ENDS}; motion_possible of ROBOT_STATUS")
def a_collaborative_stop_ends_motion(seen: DriverSeen) -> Verdict:
    """After a collaborative stop it sends no motion any more, and starts nothing by itself."""
    return _stopped(seen, "pfl")


@requires(156, f"{ENDS}; {AGAIN}")
def it_does_not_start_by_itself(seen: DriverSeen) -> Verdict:
    """What ended motion being over, it starts nothing unless it is told to."""
    names = [f"{name} over" for name in STOPS]
    phases = seen.named(*names)
    found = [(e.number, f"command {e.command}") for e in seen.during(*names) if e.command in POWER]
    found += _moves(seen.during(*names))
    return _bad(found, len(phases), f"{len(phases)} of them", "it did not move the arm")


@requires(157, f"{STATES}: a cycle every 25 ms; without states nobody sees what the arm does")
def without_states_it_stops(seen: DriverSeen) -> Verdict:
    """When the state port falls silent, no motion is commanded from 0.3 s on."""
    phases = seen.named("silence")
    wrong = [each for phase in phases for each in _moves(seen.after(phase, BLIND_WITHIN_S))]
    return _bad(wrong, len(phases), f"{len(phases)} of them", "it did not move the arm")


@requires(158, f"{SERVER}: a request is answered within its 5 s at most, or never")
def an_unanswered_request_ends_the_connection(seen: DriverSeen) -> Verdict:
    """A request that is not answered is not sent again on that connection, which is closed within
    5 s."""
    phases = seen.named("unanswered")
    wrong = []
    for phase in phases:
        link = _link_in(seen, phase)
        if link is None:
            continue
        if link.by_us or link.closed_s > phase.end_s + 1e-9:
            wrong.append((phase.first, f"it is open after {ANSWERED_WITHIN_S:g} s"))
        wrong += [
            (e.number, "another request")
            for e in seen.after(phase, 0.0)
            if e.owed and not e.is_topic and e.channel == link.channel
        ]
    return _bad(wrong, len(phases), f"{len(phases)} of them", "it did not move the arm")


def _link_in(seen: DriverSeen, phase: Phase) -> Link | None:
    """The motion connection that was open when a phase began."""
    found = [e for e in seen.links if e.port == "motion" and e.number < phase.first]
    return found[-1] if found and found[-1].closed_s >= phase.start_s else None


@requires(159, f"{MANUAL}: compare command and sequence of every reply with the request")
def the_reply_before_is_not_the_answer(seen: DriverSeen) -> Verdict:
    """After a reply that names another command or sequence it sends no motion any more on that
    connection."""
    wrong, count = [], 0
    for messages in seen.motion.values():
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
    return _bad(wrong, count, f"{count} of them", "no request was answered so")


def _came_again(seen: DriverSeen, what: str, port: str) -> Verdict:
    """Whether a connection that ended in a phase was made again."""
    phases = seen.named(what, f"{what} over")
    if not phases:
        return not_seen("it did not move the arm")
    wrong, count = [], 0
    firsts = [phase for phase in phases if not phase.name.endswith("over")]
    for phase in firsts:
        count += 1
        end = max(p.end for p in phases if p.name.startswith(phase.name))
        again = [e for e in seen.links if e.port == port and phase.first < e.number < end]
        if not again:
            wrong.append((phase.first, "it did not come again"))
    inside = seen.during(what, f"{what} over")
    wrong += [(e.number, f"command {e.command}") for e in inside if e.command in MOVING]
    return _bad(wrong, count, f"{count} of them")


@requires(160, f"{SERVER}: the place is free at once; {ENDS}")
def it_comes_again(seen: DriverSeen) -> Verdict:
    """The motion connection cut, it connects again, and does not start motion by itself."""
    return _came_again(seen, "cut", "motion")


@requires(161, f"{MANUAL}: a stream that cannot be cut any more must be closed")
def junk_ends_the_connection_only(seen: DriverSeen) -> Verdict:
    """Bytes on the state port that are no message end that connection, not the client: it connects
    again, and does not start motion by itself."""
    return _came_again(seen, "junk", "state")


@requires(162, f"{MANUAL}: TCP splits and merges")
def messages_in_pieces_are_read(seen: DriverSeen) -> Verdict:
    """Messages of the controller that come in pieces, or several at once, disturb nothing."""
    phases = seen.named("pieces")
    if not phases:
        return not_seen("it did not move the arm")
    wrong = []
    for phase in phases:
        last_s = phase.end_s - 0.5 * (phase.end_s - phase.start_s)
        found = [s for s in seen.after(phase, last_s - phase.start_s) if s.point or s.velocity]
        if not found:
            wrong.append((phase.first, "it ceased to command"))
        ended = [e for e in seen.links if phase.first < e.ended < phase.end]
        wrong += [(e.ended, f"{e.channel} was closed") for e in ended if not e.by_us]
    return _bad(wrong, len(phases), f"{len(phases)} of them")


@requires(163, f"{STATES}, {SERVER}: after power-up the ports are there anew")
def a_restart_is_followed(seen: DriverSeen) -> Verdict:
    """After a restart of the controller it connects again, to both ports."""
    phases = seen.named("connect")[1:]
    if not phases or not seen.links:
        return not_seen("there was no restart, or it never connected")
    wrong = []
    for phase in phases:
        found = {e.port for e in seen.links if phase.first < e.number < phase.end}
        missing = sorted({"motion", "state"} - found)
        if missing:
            wrong.append((phase.first, f"not to {' and '.join(missing)}"))
    return _bad(wrong, len(phases), f"{len(phases)} of them")


@requires(164, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(seen: DriverSeen) -> Verdict:
    """A second reader, the scapy layers, finds nothing wrong in the messages either."""
    try:
        from cardan.dissect.simple_message import SimpleMessage, malformed
    except ExtraMissingError as missing:
        return not_applicable(str(missing))
    if not seen.said:
        return not_seen(_NOTHING)
    chosen = seen.said[:: max(1, len(seen.said) // 40)]
    for each in chosen:
        layer = SimpleMessage(each.raw)
        wrong = malformed(layer)
        if wrong is not None:
            return failed(f"the layers refuse it: {wrong}", [each.number])
        if layer.msg_type != each.message.msg_type:
            return failed("another type", [each.number])
    return passed(f"{len(chosen)} messages read twice")


# -- its end ---------------------------------------------------------------------------------------

_NOT_ENDED = "it was not ended while the arm moved"


@requires(301, f"{SERVER}: a connection that ends stops the command dead, without a ramp")
def it_leaves_at_rest(seen: DriverSeen) -> Verdict:
    """When the program ends, its last point or speeds are at rest."""
    phases, wrong = seen.named("end"), []
    for phase in phases:
        found = [s for s in seen.said if s.number < phase.end and (s.point or s.velocity)]
        last = found[-1]
        body = last.point or last.velocity
        assert body is not None
        vel = body.vel
        if max(map(abs, vel)) > STILL_RAD_S:
            wrong.append((last.number, f"{max(map(abs, vel)):.3g} rad/s"))
    return _bad(wrong, len(phases), f"{len(phases)} of them", _NOT_ENDED)


@requires(302, f"{SERVER}: INIT_ROS keeps waiting for increments after a connection")
def it_leaves_the_mode(seen: DriverSeen) -> Verdict:
    """When the program ends, it leaves the mode: STOP_TRAJ_MODE, STOP_VEL_MODE or DISCONNECT is
    sent and not refused."""
    phases, wrong = seen.named("end"), []
    for phase in phases:
        found = [s for s in seen.after(phase, 0.0) if s.command in LEAVES]
        good = [s for s in found if s.reply is None or s.reply.result == R.SUCCESS]
        if not good:
            wrong.append((phase.first, f"{len(found)} were sent and refused"))
    return _bad(wrong, len(phases), f"{len(phases)} of them", _NOT_ENDED)


@requires(303, f"{SERVER}: one client at a time, and nothing but TCP tells that it has gone")
def it_closes_its_connections(seen: DriverSeen) -> Verdict:
    """When the program ends, its connections are closed."""
    phases, wrong = seen.named("end"), []
    for phase in phases:
        left = [e for e in seen.links if e.number < phase.end and e.closed_s > phase.end_s + 1e-9]
        wrong += [(e.number, f"{e.channel} is open") for e in left]
    return _bad(wrong, len(phases), f"{len(phases)} of them", _NOT_ENDED)
