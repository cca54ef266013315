"""Requirements for an arm's action server: how it treats goals."""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    VerdictOutcome,
    at_most,
    failed,
    met,
    none_wrong,
    not_applicable,
    not_seen,
    passed,
)
from cardan.protocols.ros2.actions import GoalStatus
from cardan_conform_arms.joint_trajectory.decoded import Goal, TrajectoryTraffic
from cardan_conform_arms.joint_trajectory.scenario import LATE_S, NEAR, REST_S, STEP, TOLERANCE_S
from cardan_conform_arms.ros2_arm.decoded import State

ACTION = "control_msgs/action/FollowJointTrajectory"
DESIGN = "design.ros2.org, Actions"
CONTROLLER = "ros2_controllers, joint_trajectory_controller"

INVALID = {"INVALID_GOAL": -1, "INVALID_JOINTS": -2}
ALLOWED_S = TOLERANCE_S + 0.5 * LATE_S
HELD = NEAR * STEP
RESTS = 0.05 * STEP

requires: Requirements[TrajectoryTraffic] = Requirements("JOINTTRAJ")
_NOTHING = "no goal was sent"


@requires(1, "sensor_msgs/msg/JointState; REP 103: rad or m")
def joints_are_where_they_are(decoded: TrajectoryTraffic) -> Verdict:
    """Joint states come unasked, with finite positions, and have every joint that moves in the
    description."""
    if not decoded.states:
        return failed("no joint states came")
    if not decoded.described:
        return not_seen("no description came")
    wrong = [s.number for s in decoded.states if not all(map(math.isfinite, s.positions.values()))]
    if wrong:
        return failed("a position is not a number", wrong)
    named = {name for each in decoded.states for name in each.positions}
    odd = [name for name in decoded.described if name not in named]
    return failed(f"they lack {', '.join(odd)}") if odd else passed(f"{len(named)} joints")


@requires(101, f"{DESIGN}: Send Goal Service")
def a_goal_is_accepted(decoded: TrajectoryTraffic) -> Verdict:
    """A goal to stay where the arm is is accepted."""
    found = decoded.sent_in("hold")
    if not found:
        return not_seen(_NOTHING)
    said = "it was accepted" if found[0].accepted else found[0].became
    return met(found[0].accepted is True, said, [found[0].number])


def _succeeded(goals: list[Goal]) -> Verdict:
    """Check if all of them succeeded in time."""
    wrong = []
    for goal in goals:
        late_s = goal.result_s - goal.sent_s - goal.seconds
        if goal.status != GoalStatus.SUCCEEDED or goal.code:
            wrong.append((goal.result or goal.number, f"{goal.became} {goal.words}".rstrip()))
        elif late_s > ALLOWED_S:
            wrong.append((goal.result, f"{late_s:.1f} s late"))
    return none_wrong(wrong, len(goals), "SUCCEEDED in its time", _NOTHING)


@requires(102, f"{ACTION}: error_code, goal_time_tolerance; {DESIGN}: Get Result Service")
def staying_succeeds(decoded: TrajectoryTraffic) -> Verdict:
    """It ends as SUCCEEDED with error_code 0, within its time, its tolerance and 0.5 s."""
    return _succeeded(decoded.sent_in("hold"))


def _still(decoded: TrajectoryTraffic, states: list[State], limit: float) -> Verdict:
    if len(states) < 2:
        return not_seen("too few joint states came")
    moved, name, number = decoded.farthest(states)
    return at_most(limit, moved, "rad", f"{name} by {moved:.5f} rad", [number])


@requires(103, f"{ACTION}: trajectory")
def staying_is_staying(decoded: TrajectoryTraffic) -> Verdict:
    """Meanwhile no joint moves by more than 0.0009 rad."""
    return _still(decoded, decoded.during("hold"), HELD)


@requires(104, f"{DESIGN}: Goal States, Goal Status Topic")
def the_status_goes_forward(decoded: TrajectoryTraffic) -> Verdict:
    """The status of a goal is published, goes forward only, and ends as its result has it."""
    ended = [goal for goal in decoded.goals if goal.status is not None]
    wrong = []
    for goal in ended:
        states = [status for _, status in goal.states]
        number = goal.states[-1][0] if goal.states else goal.number
        back = [b for a, b in pairwise(states) if b < a or (b != a >= GoalStatus.SUCCEEDED)]
        if not states:
            wrong.append((number, "it was not published"))
        elif back:
            wrong.append((number, f"it was {max(states)}, and then {back[0]}"))
        elif states[-1] != goal.status:
            wrong.append(
                (number, f"it is {states[-1]} in the end, and {goal.status} in the result")
            )
    return none_wrong(wrong, len(ended), f"{len(ended)} goals", "no goal ended")


@requires(105, f"{ACTION}: feedback; {DESIGN}: Goal Feedback Topic")
def feedback_is_of_a_goal(decoded: TrajectoryTraffic) -> Verdict:
    """Feedback is of a goal that was sent, and has a position for each of its joints."""
    if decoded.goals and not decoded.feedback:
        return not_applicable("it gives none")
    known = {goal.id for goal in decoded.goals}
    wrong = []
    for number, message in decoded.feedback:
        reported = message["feedback"]
        if bytes(message["goal_id"]["uuid"]) not in known:
            wrong.append((number, "it is of no goal that was sent"))
        elif len(reported["joint_names"]) != len(reported["actual"]["positions"]):
            wrong.append((number, "joints and positions do not fit"))
    return none_wrong(wrong, len(decoded.feedback), f"{len(decoded.feedback)} of them", _NOTHING)


@requires(106, f"{DESIGN}: Send Goal Service, Get Result Service")
def each_goal_has_an_end(decoded: TrajectoryTraffic) -> Verdict:
    """Every goal is answered, and every one that is accepted has a result."""
    wrong = [
        (goal.number, goal.became)
        for goal in decoded.goals
        if goal.accepted is None or (goal.accepted and goal.status is None)
    ]
    return none_wrong(wrong, len(decoded.goals), f"{len(decoded.goals)} goals", _NOTHING)


_MOVES = ("out", "back")


@requires(201, f"{ACTION}: error_code, goal_time_tolerance; {DESIGN}: Get Result Service")
def moving_succeeds(decoded: TrajectoryTraffic) -> Verdict:
    """A goal that turns the last joint by 0.17 degrees, and one back, end as SUCCEEDED with
    error_code 0, within their time, their tolerance and 0.5 s."""
    return _succeeded([goal for phase in _MOVES for goal in decoded.sent_in(phase)])


def _missed(decoded: TrajectoryTraffic, goal: Goal) -> tuple[float, str, int] | None:
    """Return the joint farthest from the goal in the state after its result."""
    for state in decoded.states:
        # Other publishers may send other joints.
        if state.number > goal.result and (off := decoded.off(state, goal.target)):
            return max((abs(value), name, state.number) for name, value in off.items())
    return None


@requires(202, f"{ACTION}: goal_tolerance")
def it_is_where_it_says(decoded: TrajectoryTraffic) -> Verdict:
    """When these have succeeded, every measured joint is within 0.0009 rad of its goal."""
    goals = [goal for phase in _MOVES for goal in decoded.sent_in(phase)]
    found = [m for g in goals if g.status == GoalStatus.SUCCEEDED and (m := _missed(decoded, g))]
    if not found:
        return not_seen("none succeeded")
    away, name, number = max(found)
    return at_most(HELD, away, "rad", f"{name} is {away:.5f} rad away", [number])


def _refused(decoded: TrajectoryTraffic, phase: str) -> Verdict:
    found = decoded.sent_in(phase)
    if not found:
        return not_seen(_NOTHING)
    goal = found[0]
    invalid = goal.status == GoalStatus.ABORTED and goal.code in INVALID.values()
    if goal.accepted is not False and not invalid:
        return failed(goal.became, [goal.result or goal.number])
    still = _still(decoded, decoded.during(phase), HELD)
    return still._replace(said=f"{goal.became}; {still.said}")


CHECKED = f"{ACTION}: error_code; {CONTROLLER}: goals are checked before they are accepted"


for number, bad, how in (
    (203, "unknown", "for joints that the arm does not have"),
    (204, "too-few", "that lacks a joint"),
    (205, "unequal", "whose last point lacks a position"),
    (206, "same-time", "with two points at the same time"),
    (207, "nan", "with a position that is not a number"),
):
    refusal = "is rejected, or ends as ABORTED with INVALID_GOAL or INVALID_JOINTS; nothing moves."
    requires(number, CHECKED, text=f"A goal {how} {refusal}")(partial(_refused, phase=bad))


def _canceled(goal: Goal) -> Verdict:
    if goal.status == GoalStatus.CANCELED:
        return passed(goal.became)
    return failed(goal.became, [goal.result or goal.number])


@requires(208, f"{DESIGN}: Cancel Goal Service; action_msgs/msg/GoalStatus")
def a_canceled_goal_is_canceled(decoded: TrajectoryTraffic) -> Verdict:
    """A goal that is canceled while it moves the arm ends as CANCELED."""
    found = decoded.sent_in("cancel")
    return _canceled(found[0]) if found else not_seen(_NOTHING)


@requires(209, f"{CONTROLLER}: a goal that is canceled holds the arm where it is")
def a_canceled_arm_rests(decoded: TrajectoryTraffic) -> Verdict:
    """From 0.5 s after its cancellation on no joint moves by more than 0.00015 rad."""
    found = decoded.sent_in("cancel")
    canceled_s = decoded.canceled.get(found[0].id) if found else None
    if canceled_s is None:
        return not_seen("none was canceled")
    later = [each for each in decoded.during("cancel") if each.time_s > canceled_s + REST_S]
    return _still(decoded, later, RESTS)


@requires(210, f"{DESIGN}: Cancel Goal Service: by the goal's id, which its client chooses")
def a_goal_canceled_at_once_is_canceled(decoded: TrajectoryTraffic) -> Verdict:
    """A goal whose cancellation is sent with it, before it is accepted, ends as CANCELED, or is
    rejected; nothing moves."""
    found = decoded.sent_in("at-once")
    if not found:
        return not_seen(_NOTHING)
    if (
        found[0].accepted is not False
        and (end := _canceled(found[0])).outcome is VerdictOutcome.FAILED
    ):
        return end
    return _still(decoded, decoded.during("at-once"), HELD)


@requires(211, f"{CONTROLLER}: a new goal replaces the one before; {DESIGN}: Goal States")
def one_of_two_goals_is_reached(decoded: TrajectoryTraffic) -> Verdict:
    """Of two goals, the second sent while the first moves the arm, one is reached and ends as
    SUCCEEDED; the other is rejected, CANCELED or ABORTED."""
    found = decoded.sent_in("two")
    if len(found) < 2:
        return not_seen(_NOTHING)
    said = ", ".join(goal.became for goal in found)
    reached = [goal for goal in found if goal.status == GoalStatus.SUCCEEDED]
    ended = {GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED}
    open_ = [g for g in found if g.accepted is not False and g.status not in ended]
    if len(reached) != 1 or open_:
        return failed(said, [goal.result or goal.number for goal in found])
    missed = _missed(decoded, reached[0])
    if missed is None:
        return not_seen("no joint states came after it")
    away, name, number = missed
    return at_most(HELD, away, "rad", f"{said}; {name} is {away:.5f} rad away", [number])


@requires(212, f"{CONTROLLER}: angle wraparound from the current state to the first point")
def a_whole_turn_is_none(decoded: TrajectoryTraffic) -> Verdict:
    """A plan that differs by whole turns from where a continuous joint is, as planners leave them
    out, is carried out by the short way: no joint moves by more than twice what is asked."""
    if decoded.described and "continuous" not in decoded.described.values():
        return not_applicable("no joint is continuous")
    found = decoded.sent_in("wrap")
    if not found:
        return not_seen(_NOTHING)
    short = _still(decoded, decoded.during("wrap"), 2.0 * STEP)
    return short if short.outcome is not VerdictOutcome.PASSED else _succeeded(found)
