"""Requirements for an arm that speaks the joint stream."""

from __future__ import annotations

import math
import statistics
from itertools import pairwise
from typing import Any

from cardan.conform.requirements import (
    Over,
    Requirements,
    Verdict,
    at_most,
    failed,
    met,
    none_wrong,
    not_seen,
    passed,
)
from cardan.conform.second_reading import read_twice, refused
from cardan.conform.timing import steady
from cardan.protocols.joint_stream.codec import ControlMode
from cardan_conform_arms.joint_stream.decoded import JointStreamTraffic, State
from cardan_conform_arms.joint_stream.scenario import SPEED_RAD_S, STEP_RAD

PAGE = "docs/simulated-peers.md"
RULES = f"{PAGE}, rules"
STATE = f"{PAGE}, state"

PERIOD_SHARE = 0.02
JITTER_SHARE_OF_PERIOD = 0.4
GAP_PERIODS = 12
ACK_PERIODS, ACK_S = 3.0, 0.01
HELD_RAD = math.radians(0.6)
"""Tolerance: a servo without integral action sags under gravity when it takes over."""
STANDING_RAD = math.radians(0.003)
REACHED = 0.3
FORGOTTEN_S = 1.2
STOPPED_S = 0.3
COMMANDED = (
    "idle",
    "settle",
    "hold",
    "junk",
    "foreign",
    "beyond",
    "before",
    "out",
    "back",
    "speed",
)

_NOTHING = "no states came"
requires: Requirements[JointStreamTraffic] = Requirements("JS", _NOTHING)


def _in(*phases: str, nothing: str = "") -> Over[JointStreamTraffic, State]:
    """Return the states of these phases."""
    return Over(lambda decoded: decoded.during(*phases), "{} states", nothing=nothing)


@requires(1, f"{RULES} 1: the client begins")
def nothing_comes_unasked(decoded: JointStreamTraffic) -> Verdict:
    """The arm sends nothing before it is greeted."""
    found = [each.number for each in decoded.during("listen")]
    return failed(f"{len(found)} states", found) if found else passed("nothing came")


@requires(101, f"{RULES} 1")
def a_greeting_is_answered(decoded: JointStreamTraffic) -> Verdict:
    """A hold with session 0 is answered with states."""
    if decoded.phase("greet") is None:
        return not_seen("it was not greeted")
    count = len(decoded.during("greet", "idle"))
    return passed(f"{count} states") if count else failed("none came")


@requires(102, f"{RULES} 6")
def datagrams_are_states(decoded: JointStreamTraffic) -> Verdict:
    """Every datagram is one whole state: no other length, mode or number of joints, all finite."""
    return none_wrong(
        decoded.unread,
        len(decoded.states) + len(decoded.unread),
        f"{len(decoded.states)} states",
        _NOTHING,
    )


def _gaps(decoded: JointStreamTraffic) -> list[tuple[State, State]]:
    """Return the neighbors in a session in phases in which the arm is commanded."""
    found = []
    for session in decoded.sessions:
        numbers = {each.number for each in decoded.during(*COMMANDED)}
        found += [
            (a, b) for a, b in pairwise(session) if a.number in numbers and b.number in numbers
        ]
    return found


@requires(103, f"{PAGE}, header: sequence")
def none_is_missing(decoded: JointStreamTraffic) -> Verdict:
    """Within a session no sequence number is left out."""
    wrong, count = [], 0
    for session in decoded.sessions:
        numbers = {each.value.sequence for each in session}
        count += len(session)
        missing = max(numbers) - min(numbers) + 1 - len(numbers)
        if missing:
            wrong.append((session[-1].number, f"{missing} of a session"))
    return none_wrong(wrong, count, "every one", _NOTHING)


@requires(104, f"{PAGE}, header: sequence")
def they_come_once_and_in_order(decoded: JointStreamTraffic) -> Verdict:
    """Sequence numbers go up: none comes twice, none is overtaken."""
    wrong = [
        (b.number, f"{b.value.sequence} after {a.value.sequence}")
        for session in decoded.sessions
        for a, b in pairwise(session)
        if b.value.sequence <= a.value.sequence
    ]
    return none_wrong(wrong, len(decoded.states), "every one", _NOTHING)


@requires(105, f"{STATE}: the controller's cycle")
def the_period_is_the_one_reported(decoded: JointStreamTraffic) -> Verdict:
    """States come in the period that they tell, to 2 % in the mean."""
    found = decoded.during("hold")
    if len(found) < 50:
        return not_seen("too few states")
    cycles = found[-1].value.sequence - found[0].value.sequence
    period_s = (found[-1].time_s - found[0].time_s) / max(1, cycles)
    reported_s = found[0].value.period_s
    said = f"{period_s * 1e3:.3f} ms, told {reported_s * 1e3:.3f}"
    return met(abs(period_s / reported_s - 1.0) < PERIOD_SHARE, said)


@requires(106, f"{STATE}: one state in each cycle")
def arrival_is_steady(decoded: JointStreamTraffic) -> Verdict:
    """95 % of the states arrive within 0.4 periods of when they are due."""
    found = _gaps(decoded)
    if len(found) < 50:
        return not_seen("too few states")
    periods = ((a.value.period_s, a, b) for a, b in found)
    off = [(abs(b.time_s - a.time_s - s) / s, b.number) for s, a, b in periods]
    return steady(off, JITTER_SHARE_OF_PERIOD, "periods", _NOTHING)


@requires(107, f"{RULES} 1: a state in each of its cycles")
def there_are_no_pauses(decoded: JointStreamTraffic) -> Verdict:
    """While it is commanded there is no silence of more than 12 periods."""
    wrong, longest = [], 0.0
    for one, other in _gaps(decoded):
        gap = (other.time_s - one.time_s) / one.value.period_s
        longest = max(longest, gap)
        if gap > GAP_PERIODS:
            wrong.append((other.number, f"{gap:.0f} periods"))
    hold = decoded.phase("hold")
    found = decoded.during("hold")
    if hold is not None and found and hold.end_s - found[-1].time_s > 0.1:
        wrong.append((found[-1].number, f"{hold.end_s - found[-1].time_s:.2f} s at the end"))
    return none_wrong(wrong, len(decoded.states), f"longest {longest:.1f} periods", _NOTHING)


@requires(108, f"{RULES} 2: a restart is a new session")
def the_session_lasts(decoded: JointStreamTraffic) -> Verdict:
    """While it is commanded, the session stays the same."""
    if not decoded.states:
        return not_seen(_NOTHING)
    later = [session[0].number for session in decoded.sessions[1:]]
    return failed(f"{len(later)} more sessions", later) if later else passed("one session")


@requires(109, f"{STATE}: sequence of the newest command taken")
def commands_are_acknowledged_soon(decoded: JointStreamTraffic) -> Verdict:
    """A command is acknowledged within three periods and 10 ms."""
    found = decoded.during("hold")
    sent = {
        each.value.sequence: each.time_s
        for each in decoded.sent_during("settle", "hold")
        if each.value is not None
    }
    if len(found) < 50 or not sent:
        return not_seen("too few states")
    delays, before = [], -1
    for each in found:
        acknowledged = each.value.acknowledged
        if acknowledged != before and acknowledged in sent:
            delays.append((each.time_s - sent[acknowledged], each.number))
        before = acknowledged
    if not delays:
        return failed("none was", [found[-1].number])
    delays.sort()
    late_s, number = delays[len(delays) // 2]
    said = f"{late_s * 1e3:.1f} ms in the median"
    return at_most(
        (ACK_PERIODS * found[0].value.period_s + ACK_S) * 1e3, late_s * 1e3, "ms", said, [number]
    )


@requires.each(
    110,
    f"{STATE}: why commands do not act; empty when they do",
    _in("hold", nothing="it was not held"),
)
def holding_is_undisturbed(each: State) -> str:
    """Held by commands of positions, it says so, and no reason why it would not."""
    held = each.value.mode is ControlMode.POSITION
    return each.value.reason or ("" if held else f"mode {each.value.mode.name}")


@requires(111, f"{RULES} 4")
def an_arm_that_is_held_stays(decoded: JointStreamTraffic) -> Verdict:
    """Told the position that it had, every joint stays within 0.6 degrees of it."""
    idle, found = decoded.during("idle"), decoded.during("hold")
    if not idle or not found:
        return not_seen("it was not held")
    was = idle[-1].value.positions
    far, number = max(
        (max(abs(a - b) for a, b in zip(was, each.value.positions, strict=True)), each.number)
        for each in found
    )
    said = f"{math.degrees(far):.3f} degrees"
    return at_most(math.degrees(HELD_RAD), math.degrees(far), "degrees", said, [number])


@requires(112, f"{STATE}: positions")
def an_arm_that_is_held_stands(decoded: JointStreamTraffic) -> Verdict:
    """Held, what is measured of a joint varies by less than 0.003 degrees (standard deviation)."""
    found = decoded.during("hold")[-100:]
    if len(found) < 50:
        return not_seen("it was not held for long enough")
    rows = zip(*(each.value.positions for each in found), strict=True)
    most = max(statistics.pstdev(joint) for joint in rows)
    said = f"{math.degrees(most):.5f} degrees"
    return at_most(
        math.degrees(STANDING_RAD), math.degrees(most), "degrees", said, [found[-1].number]
    )


@requires.each(
    113,
    f"{RULES} 6: malformed as a whole, and changes nothing",
    _in("junk", nothing="none was sent"),
)
def junk_changes_nothing(each: State) -> str:
    """Datagrams that are no command change nothing."""
    return each.value.reason


@requires(114, f"{RULES} 2: the arm ignores other sessions")
def another_session_is_ignored(decoded: JointStreamTraffic) -> Verdict:
    """Commands of another session are not acknowledged and move nothing."""
    phase = decoded.phase("foreign")
    if phase is None or not decoded.during("foreign"):
        return not_seen("none was sent")
    own = {each.value.session for each in decoded.states}
    foreign = {
        each.value.sequence
        for each in decoded.sent_during("foreign")
        if each.value is not None and each.value.session not in own
    }
    wrong = [
        (each.number, f"{each.value.acknowledged} is acknowledged")
        for each in decoded.during("foreign", "beyond")
        if each.value.acknowledged in foreign or each.value.mode is ControlMode.VELOCITY
    ]
    return none_wrong(wrong, len(decoded.during("foreign")), f"{len(foreign)} commands", _NOTHING)


@requires(115, f"{RULES} 5: refused, the arm holds, and the reason is in the states")
def what_is_out_of_range_is_refused(decoded: JointStreamTraffic) -> Verdict:
    """Positions outside of the joints' ranges are refused with a reason, and nothing moves."""
    found = decoded.during("beyond")
    if not found:
        return not_seen("none was sent")
    reasons = [each.value.reason for each in found if each.value.reason]
    if not reasons:
        return failed("there is no reason", [found[-1].number])
    was = found[0].value.positions
    far = max(abs(a - b) for each in found for a, b in zip(was, each.value.positions, strict=True))
    return passed(reasons[0]) if far < HELD_RAD else failed(f"it moved by {far:.3f} rad")


@requires(116, f"{RULES} 1: a client that is silent for 1 s is forgotten")
def a_silent_client_is_forgotten(decoded: JointStreamTraffic) -> Verdict:
    """A second after the last command nothing comes any more."""
    phase = decoded.phase("quiet")
    if phase is None or not decoded.during("hold"):
        return not_seen("it was not left alone")
    found = [each.number for each in decoded.during("quiet")]
    return failed(f"{len(found)} states", found) if found else passed("nothing came")


@requires(117, f"{RULES} 4: without a command for 0.1 s the arm brakes and holds")
def silence_makes_it_hold(decoded: JointStreamTraffic) -> Verdict:
    """Without commands its mode is hold after a tenth of a second and a few cycles."""
    phase = decoded.phase("silence")
    if phase is None:
        return not_seen("it was not left alone")
    late = [each for each in decoded.during("silence") if each.time_s > phase.start_s + STOPPED_S]
    wrong = [
        (each.number, f"mode {each.value.mode.name}")
        for each in late
        if each.value.mode is not ControlMode.HOLD
    ]
    return none_wrong(wrong, len(late), f"{len(late)} states", _NOTHING)


@requires.each(
    118,
    f"{STATE}: unit quaternion, norm within 0.001 of 1",
    Over(
        lambda decoded: (p for session in decoded.sessions for p in pairwise(session)), "{} states"
    ),
)
def figures_are_plausible(each: tuple[State, State]) -> str | None:
    """The stamp goes up with the sequence, by the announced period."""
    a, b = each
    cycles = b.value.sequence - a.value.sequence
    if cycles <= 0:
        return None
    off = b.value.stamp_s - a.value.stamp_s - cycles * a.value.period_s
    # A dropped client gets no states, and no sequence number is used up.
    return f"{off * 1e3:.2f} ms off" if off < -0.5 * a.value.period_s else ""


@requires(119, "cardan.dissect: a second description of the protocol")
def both_descriptions_agree(decoded: JointStreamTraffic) -> Verdict:
    """A second reader, the scapy layers, sees the same states."""

    def differs(each: State, layers: Any) -> str:
        layer = layers.JointStream(decoded.raw[each.number])
        if wrong := refused(layers, layer):
            return wrong
        if (layer.session, layer.sequence) != (each.value.session, each.value.sequence):
            return "another session or sequence"
        return "" if tuple(layer.positions) == each.value.positions else "other positions"

    return read_twice(decoded.states, "joint_stream", differs, "states", _NOTHING, 30)


def _moved(decoded: JointStreamTraffic, before: str, after: str) -> tuple[list[float], int] | None:
    """Return the displacement of each joint from the end of one phase to that of another, rad."""
    one, other = decoded.during(before), decoded.during(after)
    if not one or not other:
        return None
    a, b = one[-1].value.positions, other[-1].value.positions
    return [y - x for x, y in zip(a, b, strict=True)], other[-1].number


_NOT_MOVED = "it was not moved"


@requires(201, f"{RULES} 4")
def a_step_is_made_by_every_joint(decoded: JointStreamTraffic) -> Verdict:
    """Told to, every joint turns by 0.02 degrees, to 30 %, within half a second."""
    found = _moved(decoded, "before", "out")
    if found is None:
        return not_seen(_NOT_MOVED)
    shares = [each / STEP_RAD for each in found[0]]
    worst = max(range(len(shares)), key=lambda n: abs(shares[n] - 1.0))
    said = f"joint {worst + 1} by {100 * shares[worst]:.0f} % of it"
    return met(abs(shares[worst] - 1.0) < REACHED, said, [found[1]])


@requires(202, f"{RULES} 4")
def it_comes_back(decoded: JointStreamTraffic) -> Verdict:
    """Told its old position, every joint comes back to it, to 30 % of the step."""
    found = _moved(decoded, "before", "back")
    if found is None:
        return not_seen(_NOT_MOVED)
    left = max(map(abs, found[0])) / STEP_RAD
    said = f"{100 * left:.0f} % of the step is left"
    return met(left < REACHED, said, [found[1]])


@requires(203, f"{PAGE}, command: velocity")
def a_speed_is_reached(decoded: JointStreamTraffic) -> Verdict:
    """Told a speed of 0.002 rad/s, every joint reaches it, to 30 %."""
    found = decoded.during("speed")
    if len(found) < 10:
        return not_seen(_NOT_MOVED)
    last = found[-1].value.velocities
    worst = max(last, key=lambda v: abs(v / SPEED_RAD_S - 1.0))
    said = f"{100 * worst / SPEED_RAD_S:.0f} % of it at worst"
    return met(abs(worst / SPEED_RAD_S - 1.0) < REACHED, said, [found[-1].number])


@requires(204, f"{RULES} 4: without a command for 0.1 s the arm brakes and holds")
def a_deserted_motion_ends(decoded: JointStreamTraffic) -> Verdict:
    """Moved by speeds that cease to come, it stands after 0.3 s."""
    phase, found = decoded.phase("deserted"), decoded.during("deserted")
    if phase is None or not found:
        return not_seen(_NOT_MOVED)
    late = [each for each in found if each.time_s > phase.start_s + 0.05 + STOPPED_S]
    if not late:
        return not_seen("no states came")
    wrong = [
        (each.number, f"{max(map(abs, each.value.velocities)):.2g} rad/s")
        for each in late
        if max(map(abs, each.value.velocities)) > 0.2 * SPEED_RAD_S
    ]
    return none_wrong(wrong, len(late), f"{len(late)} states", _NOTHING)


@requires(301, f"{RULES} 5: in an emergency stop the reason says so")
def an_emergency_stop_is_reported(decoded: JointStreamTraffic) -> Verdict:
    """In an emergency stop states say why commands do not act, and the mode is hold."""
    found = [each for each in decoded.during("estop") if each.value.reason]
    if not found:
        return not_seen("no state reported one")
    wrong = [e.number for e in found[3:] if e.value.mode is not ControlMode.HOLD]
    said = found[0].value.reason
    return failed("the mode is not hold", wrong) if wrong else passed(said)
