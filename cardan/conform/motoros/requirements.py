"""Requirements of a controller with MotoROS on its three ports."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

from cardan.conform.motoros.decoded import MotorosExchange, MotorosTraffic, ReceivedMessage
from cardan.conform.motoros.scenario import STEP_RAD, STEP_S, UNKNOWN_TYPE
from cardan.conform.requirements import (
    Findings,
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
    not_seen,
    passed,
    some,
)
from cardan.conform.second_reading import differing, read_twice, refused
from cardan.conform.timing import mostly_within, not_torn
from cardan.protocols.simple_message import codes, framing, messages as m
from cardan.protocols.simple_message.codes import (
    MessageType as T,
    MotionCommand as C,
    MotionResult as R,
    NotReadySubcode as N,
)

STATES = "motoman_driver 1.9.12, MotoPlus/StateServer.c"
SERVER = "motoman_driver 1.9.12, MotoPlus/MotionServer.c"
MESSAGES = "motoman_driver 1.9.12, MotoPlus/SimpleMessage.h"
CONTROLLER = "motoman_driver 1.9.12, MotoPlus/Controller.c"
GROUP = "motoman_driver 1.9.12, MotoPlus/CtrlGroup.c"
IO = "motoman_driver 1.9.12, MotoPlus/IoServer.c"
VELOCITY = "docs/protocols/simple-message.md, velocity mode"

PERIOD_S, PERIOD_TOLERANCE_S = 0.025, 0.0005
MISSED_S = 0.075
"""Three state cycles."""
REPLY_WITHIN_S = 0.02
"""Half a second is a client's time-out; 0.2 to 1.1 ms were measured on a controller."""
STILL_RAD = 2e-3
PLAYED_LATE_S = 0.06
REACHED_SHARE = 0.2

requires: Requirements[MotorosTraffic] = Requirements("MOTO")
_UNANSWERED = "nothing was answered"
_OTHERWISE = "it was not answered by a motion reply"
_NO_STATUS, _NO_FEEDBACK = "no status came", "no feedback came"
Echoed = tuple[MotorosExchange, m.MotionReply]
"""A command, and the reply that names it."""


# -- level 0: the state port ----------------------------------------------------------------------


@requires(1, f"{STATES}: nothing is ever read there")
def states_come_unasked(decoded: MotorosTraffic) -> Verdict:
    """The state port sends feedback and status to every client."""
    count, states = len(decoded.feedback("listen")), len(decoded.statuses("listen"))
    return met(count > 0 and states > 0, f"{count} feedbacks, {states} statuses")


@requires(2, f"{MESSAGES}: prefix, header, body")
def bytes_are_messages(decoded: MotorosTraffic) -> Verdict:
    """All that comes on any port is whole messages with the right prefix, one after the other."""
    count = len(decoded.heard) + len(decoded.unread)
    return none_wrong(decoded.unread, count, f"{count} messages")


@requires(3, f"{STATES}: a cycle every 25 ms")
def the_state_cycle_is_25_ms(decoded: MotorosTraffic) -> Verdict:
    """The mean period of ROBOT_STATUS is 25 ms, to half a millisecond."""
    times = [each.time_s for each, _ in decoded.statuses("listen")]
    some(len(times) >= 10, "fewer than 10 statuses")
    period_s = (times[-1] - times[0]) / (len(times) - 1)
    return met(abs(period_s - PERIOD_S) < PERIOD_TOLERANCE_S, f"{period_s * 1e3:.2f} ms")


@requires(4, f"{STATES}; a client stops its stream after three missed cycles")
def no_three_cycles_are_missed(decoded: MotorosTraffic) -> Verdict:
    """From one ROBOT_STATUS to the next it is never more than 75 ms, whatever else is done."""
    found = some(decoded.statuses(), _NO_STATUS)
    gaps = [(b.time_s - a.time_s, b.number) for (a, _), (b, _) in pairwise(found)]
    last_phase = max(decoded.phases.values(), key=lambda each: each.end)
    gaps.append((last_phase.end_s - found[-1][0].time_s, found[-1][0].number))
    longest, index = max(gaps)
    return at_most(MISSED_S * 1e3, longest * 1e3, "ms", f"longest {longest * 1e3:.0f} ms", [index])


@requires(5, f"{STATES}: JOINT_FEEDBACK of each group, then ROBOT_STATUS")
def a_cycle_has_its_order(decoded: MotorosTraffic) -> Findings:
    """In each cycle feedback of the groups comes in their order, and the status last."""
    groups: list[int] = []
    for each in decoded.heard:
        body = each.message.body
        if each.channel == "state" and isinstance(body, m.JointFeedback):
            groups.append(body.group)
        elif each.channel == "state" and isinstance(body, m.RobotStatus):
            right = groups and groups == list(range(len(groups)))
            yield each.number, "" if right else f"groups {groups} before the status"
            groups = []
    return Words("{} cycles", _NO_STATUS)


@requires(6, f"{MESSAGES}: TOPIC is 1, the reply code of topics 0")
def states_are_topics(decoded: MotorosTraffic) -> Findings:
    """Messages of the state port are topics with the reply code 0."""
    for each in decoded.heard:
        if each.channel == "state":
            kind, code = each.message.comm_type, each.message.reply_code
            topic = kind == codes.CommType.TOPIC and not code
            yield each.number, "" if topic else f"communication type {kind}"
    return Words("{} messages")


@requires(7, f"{STATES}: POSITION, and VELOCITY where speed feedback is available")
def feedback_says_what_is_valid(decoded: MotorosTraffic) -> Findings:
    """valid_fields of feedback are POSITION, or POSITION and VELOCITY; all values are finite."""
    position, had = codes.ValidFields.POSITION, set()
    for each, body in decoded.feedback():
        had.add(fields := body.valid_fields)
        if fields not in (position, position | codes.ValidFields.VELOCITY):
            yield each.number, f"valid_fields {fields}"
        else:
            finite = all(map(math.isfinite, (*body.pos, *body.vel)))
            yield each.number, "" if finite else "a value that is not finite"
    return Words(f"valid_fields {' and '.join(map(str, sorted(had)))}", _NO_FEEDBACK)


@requires(8, f"{STATES}: speed feedback since the API has it")
def feedback_has_speeds(decoded: MotorosTraffic) -> Verdict:
    """Feedback has speeds, as of firmware that is not old."""
    found = some(decoded.feedback(), _NO_FEEDBACK)
    without = [
        each.number for each, body in found if not body.valid_fields & codes.ValidFields.VELOCITY
    ]
    must(not without, "positions alone", without)
    return passed(f"{len(found)} feedbacks")


@requires(9, f"{MESSAGES}, ROBOT_STATUS: MotoROS sends no unknowns")
def statuses_are_plausible(decoded: MotorosTraffic) -> Findings:
    """Switches of a status are 0 or 1, and the mode is 1 (teach) or 2 (play)."""
    for each, s in decoded.statuses():
        switches = (s.drives_powered, s.e_stopped, s.in_error, s.motion_possible)
        if not set(switches) <= {0, 1} or s.in_motion not in (-1, 0, 1):
            yield each.number, f"switches {switches}"
        else:
            known = s.mode in (codes.ControllerMode.MANUAL, codes.ControllerMode.AUTO)
            yield each.number, "" if known else f"mode {s.mode}"
    return Words("{} statuses", _NO_STATUS)


@requires(10, f"{STATES}: each message in one send()")
def messages_are_not_torn(decoded: MotorosTraffic) -> Findings:
    """Of a message whose first bytes have come the rest is there within half a millisecond."""
    return not_torn(decoded.heard, "{} messages, {} in pieces")


@requires(11, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: MotorosTraffic) -> Verdict:
    """A second reader, the scapy layers, sees the same types, groups and positions."""

    def differs(each: ReceivedMessage, layers: Any) -> str:
        layer = layers.SimpleMessage(each.raw)
        if wrong := refused(layers, layer):
            return wrong
        head = (layer.msg_type, layer.comm_type, layer.reply_code)
        if head != each.message[:3]:
            return "another header"
        return differing(each.message.body, layer, _LAYERS_HAVE)

    return read_twice(decoded.heard, "simple_message", differs, "messages")


_LAYERS_HAVE = {"command": "command_code", "pos": "positions", "time": "time_s"}
"""Fields of the codec, and the layers' names for them."""


# -- level 1: requests, and hold ------------------------------------------------------------------


def _control(decoded: MotorosTraffic, command: C, phase: str = "") -> list[MotorosExchange]:
    return decoded.requests(m.MotionCtrl, phase, command=command)


@requires(101, f"{SERVER}: every request is answered, one at a time")
def every_request_is_answered(decoded: MotorosTraffic) -> Findings:
    """Each request is answered on its connection before a client's time is out."""
    ends = [event.time_s for _, event in decoded.gone]
    for each in decoded.asked:
        if each.request and each.request.comm_type == codes.CommType.SERVICE_REQUEST:
            ended = any(each.time_s - 1.0 < end < each.time_s for end in ends)
            yield each.number, "" if each.reply or ended else "no answer"
    return Words("{} requests", "nothing was asked")


@requires(102, "0.2 to 1.1 ms in a capture of a controller (2015)")
def answers_are_quick(decoded: MotorosTraffic) -> Verdict:
    """Nine of ten requests that start nothing are answered within 20 ms."""
    times = (
        (each.reply.time_s - each.time_s, each.number)
        for each in _control(decoded, C.CHECK_QUEUE_CNT) + _control(decoded, C.CHECK_MOTION_READY)
        if each.reply is not None
    )
    return mostly_within(times, 0.9, REPLY_WITHIN_S, "nine of ten within {:.1f} ms", _UNANSWERED)


@requires(103, f"{SERVER}: group, sequence and command are echoed")
def answers_are_to_what_was_asked(decoded: MotorosTraffic) -> Findings:
    """The reply to an order has its command and its sequence."""
    for each in decoded.asked:
        body, found = each.body, each.motion
        if each.reply is not None and isinstance(body, m.MotionCtrl):
            echoed = found and (found.command, found.sequence) == (body.command, body.sequence)
            words = "" if echoed else f"not of {body.command}, {body.sequence}"
            yield each.reply.number, words
    return Words("{} replies", _UNANSWERED)


@requires(104, f"{MESSAGES}: SERVICE_REPLY is 3, the reply code SUCCESS even of errors")
def replies_are_replies(decoded: MotorosTraffic) -> Findings:
    """A motion reply has the communication type 3 and the reply code 1."""
    for each in decoded.asked:
        if each.motion and each.reply:
            head = each.reply.message.comm_type, each.reply.message.reply_code
            good = head == (codes.CommType.SERVICE_REPLY, codes.ReplyCode.SUCCESS)
            yield each.reply.number, "" if good else f"type {head[0]}, code {head[1]}"
    return Words("{} replies", _UNANSWERED)


@requires(105, f"{SERVER}: PING is answered with PING")
def ping_is_answered(decoded: MotorosTraffic) -> Verdict:
    """PING on the motion port is answered with a PING of 16 bytes."""
    found = [e for e in decoded.exchanges("ask") if e.request and e.request.msg_type == T.PING]
    reply = some(found[0].reply if found else None, "no PING was answered")
    good = reply.message.msg_type == T.PING and len(reply.raw) == 16
    return passed("16 B") if good else failed(f"type {reply.message.msg_type}", [reply.number])


def _refused(decoded: MotorosTraffic, msg_type: int, subcode: int) -> Verdict:
    big = decoded.order is framing.ByteOrder.BIG
    found = [
        each
        for each in decoded.exchanges("ask")
        if int.from_bytes(each.raw[4:8], "big" if big else "little") == msg_type
        and not isinstance(each.body, m.MotionCtrl)
    ]
    reply = _motion(found, _OTHERWISE)
    said = f"{_words(reply)}, command {reply.command}"
    return met((reply.result, reply.subcode) == (R.INVALID, subcode), said, [found[0].number])


@requires(106, f"{SERVER}: INVALID, MSGTYPE, and the connection is kept")
def unknown_types_are_refused(decoded: MotorosTraffic) -> Verdict:
    """An unknown type is answered INVALID with 3003."""
    return _refused(decoded, UNKNOWN_TYPE, codes.InvalidSubcode.MSGTYPE)


@requires(107, f"{SERVER}: INVALID, MSGSIZE")
def short_messages_are_refused(decoded: MotorosTraffic) -> Verdict:
    """An order with too short a body is answered INVALID with 3001."""
    return _refused(decoded, T.MOTO_MOTION_CTRL, codes.InvalidSubcode.MSGSIZE)


@requires(108, f"{SERVER}: NOT_READY before GROUPNO")
def points_are_refused_before_the_start(decoded: MotorosTraffic) -> Verdict:
    """A point before START_TRAJ_MODE, of a group that is not there, is refused and does nothing."""
    found = decoded.requests(m.JointTrajPtFull, "ask")
    reply = _motion(found, _OTHERWISE)
    return met(reply.result in (R.NOT_READY, R.INVALID), _words(reply), [found[0].number])


def _echoed(decoded: MotorosTraffic, command: C, phase: str = "") -> list[Echoed]:
    """Return the requests with `command` with the replies that name it."""
    pairs = [(each, each.motion) for each in _control(decoded, command, phase)]
    return [(each, reply) for each, reply in pairs if reply and reply.command == command]


@requires(109, f"{CONTROLLER}: the first NOT_READY reason that applies")
def not_ready_has_a_reason(decoded: MotorosTraffic) -> Findings:
    """CHECK_MOTION_READY that is not TRUE is FALSE with a subcode of 5000 to 5099."""
    for each, reply in _echoed(decoded, C.CHECK_MOTION_READY):
        if reply.result != R.SUCCESS:
            reason = reply.result == R.FAILURE and 0 <= reply.subcode - N.UNSPECIFIED < 100
            yield each.number, "" if reason else _words(reply)
    return Words("{} reasons", "it was ready all the time")


@requires(110, f"{IO}: results 0 and 1001")
def inputs_and_outputs_are_read(decoded: MotorosTraffic) -> Verdict:
    """The I/O port gives the bit 10010, and refuses the address 9 with 1001."""
    found = [each for each in decoded.exchanges("ask") if each.channel == "io"]
    bodies = [e.reply.message.body for e in found if e.reply is not None]
    replies = [each for each in bodies if isinstance(each, m.ReadIoReply)]
    some(bodies, "the I/O port did not answer")
    must(len(replies) >= 2, "no such reply")
    good, bad = replies[:2]
    said = f"results {good.result} and {bad.result}"
    right = (good.result, bad.result) == (codes.IoResult.OK, codes.IoResult.READ_ADDRESS_INVALID)
    return met(right and good.value in (0, 1), said, [found[-1].number])


@requires(111, "RFC 9293: TCP keeps no message boundaries; MotionServer.c loses split ones")
def torn_messages_are_understood(decoded: MotorosTraffic) -> Verdict:
    """A PING that arrives in two pieces is answered as one that arrives whole."""
    found = decoded.exchanges("pieces")
    some(len(found) >= 2, "none was sent")
    replies = [each.reply for each in found if each.reply is not None]
    must(replies, "no answer", [found[-1].number])
    msg_type = replies[0].message.msg_type
    return met(msg_type == T.PING, f"answered with type {msg_type}", [replies[0].number])


@requires(112, f"{CONTROLLER}, START_TRAJ_MODE")
def trajectory_mode_starts(decoded: MotorosTraffic) -> Verdict:
    """START_TRAJ_MODE succeeds, or says with a subcode why not; then motion is possible."""
    found = _control(decoded, C.START_TRAJ_MODE, "start")
    reply = _motion(found)
    must(reply.result == R.SUCCESS, _words(reply), [found[0].number])
    after = decoded.statuses("hold")
    if after and after[0][1].motion_possible != 1:
        return failed("motion is not possible after it", [after[0][0].number])
    took_s = found[0].reply.time_s - found[0].time_s if found[0].reply else 0.0
    return passed(f"after {took_s:.2f} s", took_s, "s")


def _held(decoded: MotorosTraffic) -> Verdict | None:
    possible = any(s.motion_possible for _, s in decoded.statuses("hold"))
    return None if possible else not_seen("motion was never possible")


@requires(113, f"{STATES}, ROBOT_STATUS; {CONTROLLER}: what ends motion", unless=_held)
def holding_is_undisturbed(decoded: MotorosTraffic) -> Findings:
    """Held in trajectory mode, the drives have power, play is on, no stop or alarm, motion is
    possible."""
    for each, s in decoded.statuses("hold"):
        causes = (
            (s.e_stopped, "emergency stop"),
            (s.in_error, f"alarm {s.error_code}"),
            (s.mode != codes.ControllerMode.AUTO, "not in play"),
            (not s.drives_powered, "drives without power"),
            (not s.motion_possible, "motion is not possible"),
        )
        yield each.number, next((words for bad, words in causes if bad), "")
    return Words("{} statuses")


@requires(114, f"{SERVER}: one client is served until it leaves")
def connections_last(decoded: MotorosTraffic) -> Verdict:
    """No connection is closed or refused by the controller while it is used."""
    count = sum(1 for each in decoded.phases if each != "listen")
    wrong = ((n, f"{event.channel} {event.kind.value}") for n, event in decoded.gone)
    return none_wrong(wrong, max(count, len(decoded.gone)), "none was", "")


@requires(115, f"{GROUP}: 30 pulses around the command")
def the_first_point_is_taken(decoded: MotorosTraffic) -> Verdict:
    """Point 0 at the measured position is taken, and nothing moves."""
    found = decoded.requests(m.JointTrajPtFull, "hold")
    reply = _motion(found, "no point was answered")
    some(reply.command == T.JOINT_TRAJ_PT_FULL, "no point was answered")
    must(reply.result == R.SUCCESS, _words(reply), [found[0].number])
    feedback = [body.pos for _, body in decoded.feedback("hold")]
    far = max(distance(pos, feedback[0]) for pos in feedback)
    return met(far < STILL_RAD, f"{math.degrees(far):.4f} degrees at most", [found[0].number])


@requires(116, f"{GROUP}: the number of increments")
def an_empty_queue_is_said_to_be(decoded: MotorosTraffic) -> Findings:
    """While nothing was commanded CHECK_QUEUE_CNT counts 0."""
    for each, reply in _echoed(decoded, C.CHECK_QUEUE_CNT, "hold"):
        empty = (reply.result, reply.subcode) == (R.SUCCESS, 0)
        yield each.number, "" if empty else f"result {reply.result}, {reply.subcode} increments"
    return Words("{} times", "it was not answered")


def _velocities(decoded: MotorosTraffic, phase: str) -> list[MotorosExchange]:
    found = decoded.requests(m.JointVelocity, phase)
    return [e for e in found if e.request and e.request.comm_type == codes.CommType.SERVICE_REQUEST]


def _info(decoded: MotorosTraffic) -> m.VelocityInfo | None:
    for each in decoded.exchanges("ask"):
        if each.reply is not None and isinstance(each.reply.message.body, m.VelocityInfo):
            return each.reply.message.body
    return None


@requires(121, f"{VELOCITY}, finding out")
def the_velocity_mode_says_what_it_is(decoded: MotorosTraffic) -> Verdict:
    """MOTO_VELOCITY_INFO gives version 1, a period, and limits of each axis above 0; or, without
    the mode, INVALID with 3003."""
    info = _info(decoded)
    if info is not None:
        axes = range(min(info.axes, 10))
        good = info.version == 1 and 500 <= info.ipc_us <= 20_000 and info.axes >= 1
        good = good and all(info.v_max[n] > 0.0 and info.a_max[n] > 0.0 for n in axes)
        good = good and all(info.pos_min[n] < info.pos_max[n] for n in axes)
        return met(good, f"version {info.version}, {info.ipc_us} us, {info.axes} axes")
    return _refused(decoded, T.MOTO_VELOCITY_INFO, codes.InvalidSubcode.MSGTYPE)


def _in_velocity_mode(phase: str) -> Callable[[MotorosTraffic], Verdict | None]:
    """Return an `unless`: its verdict if a phase has no velocities to check; None: it has."""

    def why(decoded: MotorosTraffic) -> Verdict | None:
        if decoded.phase(phase) is None:
            return not_seen("it was not tried")
        if _info(decoded) is None:
            return not_applicable("the controller has no velocity mode")
        found = _control(decoded, C.START_VEL_MODE, phase)
        reply = found[0].motion if found else None
        if reply is None or reply.result != R.SUCCESS:
            return not_seen("START_VEL_MODE did not succeed")
        return None

    return why


def _motion(found: list[MotorosExchange], nothing: str = "it was not answered") -> m.MotionReply:
    """Return the motion reply to the first of these requests."""
    return some(found[0].motion if found else None, nothing)


def _words(reply: m.MotionReply) -> str:
    return f"result {reply.result}, subcode {reply.subcode}"


def _answered(found: list[MotorosExchange], *wanted: tuple[int, int]) -> Verdict:
    """Check if the first of these was answered by one of these results and subcodes."""
    reply = _motion(found)
    return met((reply.result, reply.subcode) in wanted, _words(reply), [found[0].number])


@requires(122, f"{VELOCITY}, the watchdog", unless=_in_velocity_mode("velocity"))
def the_watchdog_latches(decoded: MotorosTraffic) -> Verdict:
    """After a silence longer than the watchdog waits a velocity is answered NOT_READY with 5041."""
    return _answered(_velocities(decoded, "velocity")[1:], (R.NOT_READY, N.VEL_WATCHDOG))


@requires(123, f"{VELOCITY}, starting and stopping", unless=_in_velocity_mode("velocity"))
def modes_exclude_each_other(decoded: MotorosTraffic) -> Verdict:
    """In velocity mode a point is answered NOT_READY with 5042."""
    found = decoded.requests(m.JointTrajPtFull, "velocity")
    return _answered(found, (R.NOT_READY, N.OTHER_MODE_ACTIVE))


@requires(124, f"{VELOCITY}, sequence", unless=_in_velocity_mode("velocity"))
def old_velocities_are_refused(decoded: MotorosTraffic) -> Verdict:
    """A sequence that is not newer than the last is answered INVALID with 3040."""
    found = _velocities(decoded, "velocity")[4:]
    return _answered(found[-1:], (R.INVALID, codes.InvalidSubcode.VEL_SEQUENCE))


# -- level 2: micro-motion ------------------------------------------------------------------------


def _point(decoded: MotorosTraffic, phase: str, sequence: int) -> list[MotorosExchange]:
    return decoded.requests(m.JointTrajPtFull, phase, sequence=sequence)


_NO_POINT = "no point was taken"


def _taken(
    decoded: MotorosTraffic, phase: str = "out", nothing: str = _NO_POINT
) -> MotorosExchange:
    """Return the accepted point that moves an axis in a phase."""
    found = _point(decoded, phase, 1)
    some(_motion(found, nothing).result == R.SUCCESS, nothing)
    return found[0]


@requires(201, f"{GROUP}, {SERVER}: SUCCESS at acceptance")
def a_point_is_taken(decoded: MotorosTraffic) -> Verdict:
    """A point that turns one axis by 0.2 degrees in 0.1 s is taken."""
    some(decoded.phase("out"), "it was not tried")
    found, begun = _point(decoded, "out", 1), _point(decoded, "out", 0)
    if not found:
        why = f": {_words(begun[0].motion)}" if begun and begun[0].motion else ""
        return failed(f"not even point 0 was{why}")
    reply = _motion(found)
    return met(reply.result == R.SUCCESS, _words(reply), [found[0].number])


@requires(202, f"{GROUP}: one increment in each interpolation period")
def a_trajectory_takes_its_time(decoded: MotorosTraffic) -> Verdict:
    """The queue is empty 0.1 s after the point was taken, or no more than 60 ms later."""
    point = _taken(decoded)
    counts = [
        (each.time_s, reply.subcode)
        for each, reply in _echoed(decoded, C.CHECK_QUEUE_CNT, "out")
        if reply.result == R.SUCCESS
    ]
    filled = [time_s for time_s, count in counts if count > 0]
    some(filled, "the queue was never seen to hold anything")
    empty = [time_s for time_s, count in counts if not count and time_s > filled[-1]]
    must(empty, "it never was", [point.number])
    took_s = empty[0] - point.time_s
    return at_most(STEP_S + PLAYED_LATE_S, took_s, "s", f"after {took_s:.3f} s", [point.number])


def _reached(decoded: MotorosTraffic, phase: str, nothing: str) -> Verdict:
    """Check if an axis turned in a phase as far as commanded, if its point was answered."""
    asked, found = _point(decoded, phase, 1), [body.pos for _, body in decoded.feedback(phase)]
    _motion(asked, nothing)
    some(len(found) >= 2, nothing)
    far = distance(found[0], found[-1])
    said = f"{math.degrees(far):.3f} degrees"
    return met(abs(far / STEP_RAD - 1.0) < REACHED_SHARE, said, [asked[0].number])


@requires(203, f"{GROUP}: the last sample is the point itself")
def a_point_is_reached(decoded: MotorosTraffic) -> Verdict:
    """Half a second later the axis has turned by 0.2 degrees, to a fifth of it; and no error is
    latched."""
    return _reached(decoded, "out", _NO_POINT)


@requires(204, f"{CONTROLLER}: motion stays possible after motion")
def motion_stays_possible(decoded: MotorosTraffic) -> Findings:
    """While it moves and after, motion is possible and no alarm comes."""
    some(_point(decoded, "out", 1), _NO_POINT)
    for each, s in decoded.statuses("out") + decoded.statuses("back"):
        stays = s.motion_possible == 1 and not s.in_error
        words = f"motion_possible {s.motion_possible}, alarm {s.error_code}"
        yield each.number, "" if stays else words
    return Words("{} statuses", _NO_POINT)


@requires(205, f"{STATES}, in_motion")
def it_says_that_it_moves(decoded: MotorosTraffic) -> Verdict:
    """in_motion is 1 while the queue is played, and 0 again afterwards."""
    taken, found = _taken(decoded), [s.in_motion for _, s in decoded.statuses("out")]
    some(found, _NO_POINT)
    must(1 in found, "it never was", [taken.number])
    return passed("1, then 0") if found[-1] == 0 else failed("it still is", [taken.number])


@requires(206, f"{GROUP}: a new point 0 at standstill")
def it_comes_back(decoded: MotorosTraffic) -> Verdict:
    """A second trajectory, from where the first ended, turns the axis back."""
    return _reached(decoded, "back", "no second point was taken")


@requires(211, f"{VELOCITY}, law of one interpolation period", unless=_in_velocity_mode("stream"))
def velocities_move_it(decoded: MotorosTraffic) -> Verdict:
    """0.1 s of velocities turn the axis, and by no more than 0.2 degrees."""
    before, after = decoded.feedback("stream"), decoded.feedback("deserted")
    some(before and after, _NO_FEEDBACK)
    far = distance(before[0][1].pos, after[-1][1].pos)
    return met(0.2 * STEP_RAD < far < 1.2 * STEP_RAD, f"{math.degrees(far):.3f} degrees")


@requires(212, f"{VELOCITY}, the watchdog", unless=_in_velocity_mode("stream"))
def silence_stops_it(decoded: MotorosTraffic) -> Verdict:
    """Without further velocities the axis stands within 0.3 s, and the watchdog is latched."""
    phase = some(decoded.phase("deserted"), "it was not tried")
    found, asked = decoded.feedback("deserted"), _velocities(decoded, "deserted")
    some(found and asked, "it was not tried")
    late = [body.pos for each, body in found if each.time_s > phase.start_s + 0.3]
    some(late, _NO_FEEDBACK)
    far, reply = max(distance(late[0], pos) for pos in late), asked[0].motion
    latched = reply is not None and reply.subcode == N.VEL_WATCHDOG
    said = f"{math.degrees(far):.4f} degrees more, {'' if latched else 'not '}latched"
    return met(far < STEP_RAD / 50 and latched, said, [asked[0].number])


# -- level 3: by hand -----------------------------------------------------------------------------


@requires(301, f"{STATES}, ROBOT_STATUS; {CONTROLLER}")
def an_emergency_stop_is_reported(decoded: MotorosTraffic) -> Verdict:
    """After an emergency stop e_stopped is 1 and motion is not possible."""
    found = [(each, s) for each, s in decoded.statuses("estop") if s.e_stopped == 1]
    some(found, "no status reported one")
    wrong = [each.number for each, s in found[2:] if s.motion_possible]
    return failed("motion is still possible", wrong) if wrong else passed("reported")


@requires(302, f"{CONTROLLER}: the order of the reasons")
def an_emergency_stop_is_the_reason(decoded: MotorosTraffic) -> Verdict:
    """CHECK_MOTION_READY then is FALSE with 5003, or with an alarm or an error, which come before
    it."""
    reasons = ((R.FAILURE, each) for each in (N.ALARM, N.ERROR, N.ESTOP))
    return _answered(_control(decoded, C.CHECK_MOTION_READY, "estop"), *reasons)


@requires(303, f"{CONTROLLER}: START_TRAJ_MODE is needed again")
def release_starts_nothing(decoded: MotorosTraffic) -> Verdict:
    """When the emergency stop is released motion is not possible by itself."""
    found = [(each, s) for each, s in decoded.statuses("released") if s.e_stopped == 0]
    some(found, "it was not released")
    wrong = [each.number for each, s in found if s.motion_possible]
    return failed("motion is possible", wrong) if wrong else passed(f"{len(found)} statuses")
