"""Requirements for the network traffic of an arm under ros2_control."""

from __future__ import annotations

import math
from itertools import pairwise

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
from cardan.conform.timing import steady
from cardan_conform_arms.ros2_arm.decoded import RosArmTraffic, State
from cardan_conform_arms.ros2_arm.scenario import STEP_RAD

BROADCASTER = "ros2_controllers, joint_state_broadcaster"
JOINT_STATE = "sensor_msgs/msg/JointState"
FORWARD = "ros2_controllers, forward_command_controller"
DESCRIPTION = "robot_state_publisher, robot_description"
ZENOH = "rmw_zenoh, attachment of every message"

RATE_HZ = (10.0, 1100.0)
SILENT_PERIODS = 10
JITTER = 0.4
FAR_RAD = 100.0
STAMP_JUMP_S = 1.0
HELD_RAD = math.radians(0.6)
REACHED = 0.3
ACTS_PERIODS = 3.0

_NOTHING = "no joint states came"
requires: Requirements[RosArmTraffic] = Requirements("ROS2ARM", _NOTHING)


@requires(1, f"{BROADCASTER}: /joint_states")
def states_come(decoded: RosArmTraffic) -> Verdict:
    """Joint states come unasked, 10 to 1100 a second."""
    found = decoded.during("listen")
    if len(found) < 5:
        return failed(f"{len(found)} of them")
    rate = (len(found) - 1) / (found[-1].time_s - found[0].time_s)
    said = f"{rate:.1f} a second"
    return met(RATE_HZ[0] <= rate <= RATE_HZ[1], said)


STATES: Over[RosArmTraffic, State] = Over(lambda decoded: decoded.states, "{} states")


@requires(2, JOINT_STATE)
def messages_are_whole(decoded: RosArmTraffic) -> Verdict:
    """Every message is one of its type, with a position for each name, and no name twice."""
    wrong = [*decoded.unread]
    wrong += [(e.number, "names and positions do not fit") for e in decoded.states if not e.whole]
    return none_wrong(
        wrong, len(decoded.states) + len(decoded.unread), f"{len(decoded.states)} states", _NOTHING
    )


@requires(3, JOINT_STATE)
def positions_are_numbers(decoded: RosArmTraffic) -> Verdict:
    """Every position is a finite number."""
    wrong = [
        (each.number, f"{name} is {value}")
        for each in decoded.states
        for name, value in each.positions.items()
        if not math.isfinite(value)
    ]
    return none_wrong(wrong, len(decoded.states), f"{len(decoded.states)} states", _NOTHING)


@requires(4, f"{JOINT_STATE}: rad or m")
def positions_are_plausible(decoded: RosArmTraffic) -> Verdict:
    """No position is beyond 100 rad or m."""
    wrong = [
        (each.number, f"{name} at {value:.3g}")
        for each in decoded.states
        for name, value in each.positions.items()
        if math.isfinite(value) and abs(value) > FAR_RAD
    ]
    return none_wrong(wrong, len(decoded.states), f"{len(decoded.states)} states", _NOTHING)


@requires(5, f"{BROADCASTER}: the joints of its parameters, in one order")
def names_stay(decoded: RosArmTraffic) -> Verdict:
    """Each publisher names the same joints in every message."""
    wrong = []
    for found in decoded.publishers().values():
        first = set(found[0].positions)
        wrong += [
            (each.number, f"{', '.join(sorted(first ^ set(each.positions)))}")
            for each in found
            if set(each.positions) != first
        ]
    return none_wrong(sorted(wrong), len(decoded.states), f"{len(decoded.states)} states", _NOTHING)


@requires(6, f"{DESCRIPTION}; {BROADCASTER}")
def names_are_those_of_the_description(decoded: RosArmTraffic) -> Verdict:
    """Every joint that moves in the description is named, and no other."""
    if decoded.described is None:
        return not_seen("no description came")
    if not decoded.states:
        return not_seen(_NOTHING)
    named = {name for each in decoded.states for name in each.positions}
    odd = sorted(named ^ set(decoded.described))
    said = f"{len(named)} joints"
    return (
        failed(f"not in both: {', '.join(odd)}", [decoded.states[0].number])
        if odd
        else passed(said)
    )


@requires(7, f"{BROADCASTER}: one of them publishes an arm's states")
def there_is_one_publisher(decoded: RosArmTraffic) -> Verdict:
    """All joint states come from one publisher, from the beginning to the end."""
    found = decoded.publishers()
    if not found:
        return not_seen(_NOTHING)
    others = [states[0].number for states in found.values()][1:]
    said = f"{len(found)} publishers"
    return failed(said, others) if others else passed("one")


def _sequences(decoded: RosArmTraffic) -> list[tuple[State, State, int]]:
    return [
        (a, b, b.sequence - a.sequence)
        for found in decoded.publishers().values()
        for a, b in pairwise(found)
        if a.sequence is not None and b.sequence is not None
    ]


def _uncounted(decoded: RosArmTraffic) -> Verdict | None:
    none = bool(decoded.states) and not _sequences(decoded)
    return not_applicable("the transport does not count") if none else None


COUNTED: Over[RosArmTraffic, tuple[State, State, int]] = Over(
    _sequences, "{} messages", unless=_uncounted
)


@requires.each(8, f"{ZENOH}: sequence number", COUNTED)
def none_is_missing(each: tuple[State, State, int]) -> str:
    """No message of a publisher is missing."""
    return f"{each[2] - 1} are missing" if each[2] > 1 else ""


@requires.each(9, f"{ZENOH}: sequence number", COUNTED)
def they_come_once_and_in_order(each: tuple[State, State, int]) -> str:
    """No message comes twice, or after a later one."""
    a, b, n = each
    return f"{b.sequence} after {a.sequence}" if n <= 0 else ""


def _usual(found: list[State]) -> float:
    gaps = sorted(b.time_s - a.time_s for a, b in pairwise(found))
    return gaps[len(gaps) // 2] if gaps else math.nan


@requires(10, f"{BROADCASTER}: one message in each cycle of the controller manager")
def arrival_is_steady(decoded: RosArmTraffic) -> Verdict:
    """95 % of the messages arrive within 0.4 periods of when they are due."""
    found = decoded.during("listen")
    if len(found) < 50:
        return not_seen("too few states")
    usual = _usual(found)
    if not usual:
        return failed("several come at once", [found[1].number])
    off = [(abs(b.time_s - a.time_s - usual) / usual, b.number) for a, b in pairwise(found)]
    return steady(off, JITTER, "periods", _NOTHING)


@requires(11, f"{BROADCASTER}: one message in each cycle of the controller manager")
def there_are_no_pauses(decoded: RosArmTraffic) -> Verdict:
    """It is never silent for more than 10 periods."""
    phase = decoded.phase("gone")
    found = [e for e in decoded.states if phase is None or e.number < phase.first]
    if len(found) < 10:
        return not_seen(_NOTHING)
    usual = _usual(found)
    gaps = [(b.time_s - a.time_s, b.number) for a, b in pairwise(found)]
    last = max(decoded.phases.values(), key=lambda each: each.end_s)
    gaps.append(((phase or last).start_s - found[-1].time_s, found[-1].number))
    longest, number = max(gaps)
    said = f"longest {longest * 1e3:.0f} ms"
    return at_most(SILENT_PERIODS * usual * 1e3, longest * 1e3, "ms", said, [number])


@requires.each(12, f"{JOINT_STATE}, header.stamp: when it was recorded", STATES)
def states_are_stamped(each: State) -> str:
    """Every message has a stamp."""
    # A gripper's node may omit it: that is another publisher.
    return "" if each.stamp_s else "it is zero"


def _stamped(decoded: RosArmTraffic) -> list[tuple[State, State]]:
    pairs = [p for found in decoded.publishers().values() for p in pairwise(found)]
    return [(a, b) for a, b in pairs if a.stamp_s and b.stamp_s]


STAMPED: Over[RosArmTraffic, tuple[State, State]] = Over(
    _stamped, "{} states", nothing="no stamps came"
)


@requires.each(13, f"{JOINT_STATE}, header.stamp", STAMPED)
def stamps_go_up(each: tuple[State, State]) -> str:
    """From message to message of a publisher the stamp goes up."""
    by_s = each[1].stamp_s - each[0].stamp_s
    return f"by {by_s:.3f} s" if each[1].stamp_s <= each[0].stamp_s else ""


@requires.each(14, f"{JOINT_STATE}, header.stamp; REP 103: ROS time", STAMPED)
def stamps_do_not_jump(each: tuple[State, State]) -> str:
    """Stamps advance as time does, to a second from message to message."""
    a, b = each
    jump_s = (b.stamp_s - a.stamp_s) - (b.time_s - a.time_s)
    return f"by {jump_s:.0f} s" if abs(jump_s) > STAMP_JUMP_S else ""


@requires(15, f"{JOINT_STATE}: the state of a joint, which is in one place")
def a_joint_has_one_publisher_at_a_time(decoded: RosArmTraffic) -> Verdict:
    """No joint is published by two publishers at the same time."""
    wrong: list[tuple[int, str]] = []
    spans: dict[str, list[tuple[State, State]]] = {}
    for found in decoded.publishers().values():
        names = {name for each in found for name in each.positions}
        for name in names:
            having = [each for each in found if name in each.positions]
            spans.setdefault(name, []).append((having[0], having[-1]))
    for name, there in sorted(spans.items()):
        there.sort(key=lambda span: span[0].number)
        for (_, last), (first, _) in pairwise(there):
            if first.number < last.number:
                wrong.append((first.number, f"{name} has two"))
    return none_wrong(wrong, len(spans), f"{len(spans)} joints", _NOTHING)


_NOT_HELD = "it was not held"


def _far(one: State, other: State) -> float:
    names = one.positions.keys() & other.positions.keys()
    values = [abs(other.positions[n] - one.positions[n]) for n in names]
    return max((v for v in values if math.isfinite(v)), default=0.0)


@requires(101, f"{FORWARD}: each command is passed on at once")
def an_arm_that_is_held_stays(decoded: RosArmTraffic) -> Verdict:
    """Commanded to be where it is, every joint stays within 0.6 degrees."""
    before, found = decoded.during("listen"), decoded.during("hold")
    if not before or not found or not decoded.commands:
        return not_seen(_NOT_HELD)
    far, number = max((_far(before[-1], each), each.number) for each in found)
    said = f"{math.degrees(far):.3f} degrees"
    return at_most(math.degrees(HELD_RAD), math.degrees(far), "degrees", said, [number])


def _last(decoded: RosArmTraffic, phase: str) -> dict[str, float] | None:
    """Return the last position of each joint of the description in a phase."""
    found: dict[str, float] = {}
    for each in decoded.during(phase):
        found.update(each.positions)
    wanted = [name for name in decoded.described or () if name in found]
    return {name: found[name] for name in wanted} if wanted else None


@requires(201, f"{FORWARD}: positions in the order of its joints")
def a_step_is_made_by_every_joint(decoded: RosArmTraffic) -> Verdict:
    """Commanded to, every joint turns by 0.02 degrees, to 30 %, within 0.6 s."""
    before, after = _last(decoded, "hold"), _last(decoded, "out")
    if before is None or after is None:
        return not_seen("it was not moved")
    shares = {n: (after[n] - before[n]) / STEP_RAD for n in before if n in after}
    worst = max(shares, key=lambda name: abs(shares[name] - 1.0))
    said = f"{worst} by {100 * shares[worst]:.0f} % of it"
    return met(abs(shares[worst] - 1.0) < REACHED, said, [decoded.during("out")[-1].number])


@requires(202, FORWARD)
def it_comes_back(decoded: RosArmTraffic) -> Verdict:
    """Commanded back, every joint is where it was, to 30 % of the step."""
    before, after = _last(decoded, "hold"), _last(decoded, "back")
    if before is None or after is None:
        return not_seen("it was not moved")
    left = max(abs(after[n] - before[n]) for n in before if n in after) / STEP_RAD
    said = f"{100 * left:.0f} % of the step is left"
    return met(left < REACHED, said, [decoded.during("back")[-1].number])


@requires(203, f"{FORWARD}: in the next cycle of the controller manager")
def a_command_acts_soon(decoded: RosArmTraffic) -> Verdict:
    """A step shows in the joint states within three periods of its being sent."""
    phase, found, held = decoded.phase("out"), decoded.during("out"), decoded.during("hold")
    if phase is None or not found or not held:
        return not_seen("it was not moved")
    sent = next(
        (time_s for number, time_s in decoded.commands if number >= phase.first), phase.start_s
    )
    moved = [each for each in found if _far(held[-1], each) > 0.05 * STEP_RAD]
    if not moved:
        return failed("it never did", [found[-1].number])
    after_s = moved[0].time_s - sent
    said = f"after {after_s * 1e3:.0f} ms"
    return at_most(ACTS_PERIODS * _usual(held) * 1e3, after_s * 1e3, "ms", said, [moved[0].number])


@requires(301, f"{BROADCASTER}: states end with their node")
def what_has_ended_is_silent(decoded: RosArmTraffic) -> Verdict:
    """Its nodes ended, no more joint states come."""
    phase = decoded.phase("gone")
    if phase is None:
        return not_seen("they were not ended")
    found = decoded.during("gone")
    quiet_s = phase.end_s - (found[-1].time_s if found else phase.start_s)
    said = f"silent for the last {quiet_s:.1f} s"
    return met(quiet_s > 0.3, said, [each.number for each in found[-1:]])
