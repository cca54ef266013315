"""State machines of an arm: see :mod:`tests.gateway.arm.explorer` for their combinations."""

import ast
import inspect
import itertools

import pytest

from cardan.gateway.arm import controller
from cardan.gateway.arm.states import (
    RESTING,
    ArmEvent,
    ArmingAction,
    Facts,
    Inhibit,
    MotionState,
    Readings,
    RobotReadiness,
    Separation,
    States,
    arming_after,
    inhibits_after,
    link_after,
    motion_after,
    phase_of,
    readings_after,
    separation_after,
)
from cardan.gateway.arm.status import Phase
from cardan.gateway.operator.deadman import Arming, armed_by_deadman, armed_by_rest
from cardan.gateway.operator.input import NO_REQUEST

ALL = [
    States(*each)
    for each in itertools.product(
        RobotReadiness, Readings, MotionState, Separation, (Arming.ARMED,)
    )
]
FACTS = [Facts(*each) for each in itertools.product((False, True), repeat=4)]


def test_one_place_assigns_states_and_what_moves_the_arm():
    (whole,) = (
        each
        for each in ast.parse(inspect.getsource(controller)).body
        if isinstance(each, ast.ClassDef) and each.name == "ArmController"
    )
    places = {
        method.name
        for method in whole.body
        if isinstance(method, ast.FunctionDef)
        for node in ast.walk(method)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
        if node.attr in ("state", "_motion")
    }
    assert places == {"__init__", "_enter"}


@pytest.mark.parametrize("event", ArmEvent)
def test_every_event_changes_something(event):
    assert any(each.after(event, facts) != each for each in ALL for facts in FACTS)


@pytest.mark.parametrize("event", ArmEvent)
def test_an_event_that_comes_again_changes_nothing_more(event):
    for each, facts in itertools.product(ALL, FACTS):
        once = each.after(event, facts)
        assert once.after(event, facts) == once


def test_an_event_that_forgets_or_places_leaves_no_motion_of_a_source():
    for each, facts in itertools.product(ALL, FACTS):
        assert each.after(ArmEvent.FORGOTTEN, facts).motion is MotionState.UNCOMMANDED
        assert each.after(ArmEvent.PLACED, facts).motion in (*RESTING, MotionState.BRAKING)
        assert each.after(ArmEvent.DISARMED, facts).arming is Arming.DISARMED


@pytest.mark.parametrize(
    ("event", "after"),
    [
        (ArmEvent.HELD, Separation.TO_RESYNCHRONIZE),
        (ArmEvent.NOT_BACK, Separation.UNTIL_REARMED),
        (ArmEvent.ASKED, Separation.NONE),
        (ArmEvent.PLACED, Separation.LEFT),
        (ArmEvent.UNREADY, Separation.LEFT),
        (ArmEvent.ACKNOWLEDGED, Separation.LEFT),
    ],
)
def test_a_resynchronization_that_a_button_ended_is_left_until_it_has_to_be_again(event, after):
    facts = Facts(device=True, resynchronizes=True)
    assert separation_after(Separation.LEFT, event, facts) is after


def test_what_inhibits_for_one_tick_keeps_its_first_reason_and_what_is_said_its_last():
    inhibits = {}
    for reason, kind in (
        ("first", Inhibit.ONCE),
        ("second", Inhibit.ONCE),
        ("silent", Inhibit.WHILE_SAID),
        ("lost", Inhibit.WHILE_SAID),
    ):
        inhibits = inhibits_after(inhibits, reason, kind)
    assert inhibits == {Inhibit.ONCE: "first", Inhibit.WHILE_SAID: "lost"}
    assert inhibits_after(inhibits, "", Inhibit.WHILE_SAID) == {Inhibit.ONCE: "first"}


# -- exact transitions of each machine -------------------------------------------------------------


def facts_where(**known):
    return [facts for facts in FACTS if known.items() <= facts._asdict().items()]


def others(members, *but):
    return [each for each in members if each not in but]


def changes_of(after, members):
    """{(state, event, facts): next state} of all transitions that change the state."""
    return {
        (state, event, facts): after(state, event, facts)
        for state, event, facts in itertools.product(members, ArmEvent, FACTS)
        if after(state, event, facts) is not state
    }


def changes(*rules):
    """The same mapping, from rules (states, event, facts, next state)."""
    return {
        (state, event, each): after
        for states, event, facts, after in rules
        for state in states
        for each in facts
        if state is not after
    }


def test_what_changes_the_link():
    moving, at_rest = facts_where(moving=True), facts_where(moving=False)
    assert changes_of(link_after, RobotReadiness) == changes(
        (RobotReadiness, ArmEvent.READY, FACTS, RobotReadiness.READY),
        (RobotReadiness, ArmEvent.UNREADY, moving, RobotReadiness.BRAKING_BLIND),
        (RobotReadiness, ArmEvent.UNREADY, at_rest, RobotReadiness.ABSENT),
        ([RobotReadiness.BRAKING_BLIND], ArmEvent.FORGOTTEN, FACTS, RobotReadiness.ABSENT),
    )


@pytest.mark.parametrize("link", RobotReadiness)
@pytest.mark.parametrize("motion", MotionState)
def test_what_changes_whether_readings_are_believed(link, motion):
    states = States(link=link, motion=motion)
    rejected = [Readings.REJECTED, Readings.REJECTED_ELSEWHERE]
    absent, uncommanded = link is RobotReadiness.ABSENT, motion is MotionState.UNCOMMANDED
    elsewhere = Readings.REJECTED_ELSEWHERE

    def after(readings, event, facts):
        return readings_after(readings, event, states)

    assert changes_of(after, Readings) == changes(
        (Readings, ArmEvent.PLACED, FACTS, Readings.ACCEPTED),
        (Readings, ArmEvent.PLAUSIBLE, FACTS, Readings.ACCEPTED),
        (Readings if absent else [], ArmEvent.JUMPED, FACTS, elsewhere),
        ([] if absent else [Readings.ACCEPTED], ArmEvent.JUMPED, FACTS, Readings.REJECTED),
        (rejected if uncommanded else [], ArmEvent.RETURNED, FACTS, elsewhere),
        (rejected, ArmEvent.INVALID, FACTS, elsewhere),
    )


def test_what_changes_what_moves_the_arm():
    device, none = facts_where(device=True), facts_where(device=False)
    commanded = others(MotionState, MotionState.UNCOMMANDED)
    assert changes_of(motion_after, MotionState) == changes(
        (MotionState, ArmEvent.FORGOTTEN, FACTS, MotionState.UNCOMMANDED),
        (MotionState, ArmEvent.PLACED, facts_where(moving=True), MotionState.BRAKING),
        (MotionState, ArmEvent.PLACED, facts_where(moving=False, device=True), MotionState.HOLDING),
        (
            MotionState,
            ArmEvent.PLACED,
            facts_where(moving=False, device=False),
            MotionState.UNCOMMANDED,
        ),
        ([MotionState.UNCOMMANDED], ArmEvent.ENGAGED, FACTS, MotionState.HOLDING),
        (MotionState, ArmEvent.FOLLOWS, FACTS, MotionState.FOLLOWING),
        (MotionState, ArmEvent.EXECUTES, FACTS, MotionState.EXECUTING),
        (MotionState, ArmEvent.RESYNCHRONIZES, FACTS, MotionState.RESYNCHRONIZING),
        (others(MotionState, *RESTING), ArmEvent.BRAKES, FACTS, MotionState.BRAKING),
        (MotionState, ArmEvent.COASTED, none, MotionState.UNCOMMANDED),
        (commanded, ArmEvent.COASTED, device, MotionState.HOLDING),
        (commanded, ArmEvent.OVER, FACTS, MotionState.HOLDING),
    )


def test_what_changes_whether_command_and_robot_are_apart():
    resynchronizes, stay = facts_where(resynchronizes=True), facts_where(resynchronizes=False)
    again = facts_where(resynchronizes=True, near=False)
    done = [facts for facts in FACTS if facts not in again]
    waits, separated = Separation.TO_RESYNCHRONIZE, Separation.UNTIL_REARMED
    assert changes_of(separation_after, Separation) == changes(
        (others(Separation, Separation.LEFT), ArmEvent.UNREADY, FACTS, Separation.NONE),
        (others(Separation, Separation.LEFT), ArmEvent.PLACED, FACTS, Separation.NONE),
        ([waits], ArmEvent.JUMPED, FACTS, Separation.NONE),
        ([waits], ArmEvent.RESYNCHRONIZES, FACTS, Separation.NONE),
        (Separation, ArmEvent.HELD, resynchronizes, waits),
        (Separation, ArmEvent.HELD, stay, separated),
        (Separation, ArmEvent.NOT_BACK, FACTS, separated),
        (Separation, ArmEvent.LEFT, FACTS, Separation.LEFT),
        ([Separation.LEFT], ArmEvent.ASKED, FACTS, Separation.NONE),
        ([separated], ArmEvent.ACKNOWLEDGED, again, waits),
        ([separated], ArmEvent.ACKNOWLEDGED, done, Separation.NONE),
    )


def test_an_event_acts_on_each_machine_and_only_being_disarmed_on_the_arming():
    for each, event, facts in itertools.product(ALL, ArmEvent, FACTS):
        assert each.after(event, facts) == States(
            link_after(each.link, event, facts),
            readings_after(each.readings, event, each),
            motion_after(each.motion, event, facts),
            separation_after(each.separation, event, facts),
            Arming.DISARMED if event is ArmEvent.DISARMED else Arming.ARMED,
        )


def test_what_a_state_is_asked():
    assert {each for each in RobotReadiness if each.ready} == {RobotReadiness.READY}
    assert {each for each in Readings if each.rejected} == set(Readings) - {Readings.ACCEPTED}
    assert {each for each in Readings if each.elsewhere} == {Readings.REJECTED_ELSEWHERE}
    assert {each for each in MotionState if each.commanded} == set(MotionState) - {
        MotionState.UNCOMMANDED
    }
    assert {each for each in MotionState if each.braking} == {MotionState.BRAKING}
    assert {each for each in Separation if each.waits} == {Separation.TO_RESYNCHRONIZE}
    assert {each for each in Separation if each.until_rearmed} == {Separation.UNTIL_REARMED}
    assert {each for each in Separation if each.together} == {Separation.NONE}
    assert {each for each in Separation if each.left} == {Separation.LEFT}
    assert {each for each in Arming if each.armed} == {Arming.ARMED, Arming.CLAIMING}
    assert {each for each in Arming if each.claims} == {Arming.CLAIMING}
    assert Facts() == (False, False, False, False)


# -- the operator's request ------------------------------------------------------------------------

BOTH = (False, True)


def all_requests():
    """All (arming, request, acknowledges, owns, refused) without faults."""
    for before, asked, requested, *rest in itertools.product(
        Arming, Arming, BOTH, BOTH, BOTH, BOTH
    ):
        yield before, NO_REQUEST._replace(arming=asked, arming_requested=requested), *rest


def test_a_fault_of_the_device_trips_and_one_of_a_filter_only_a_device_that_is_or_gets_armed():
    for before, request, *rest in all_requests():
        fault = request._replace(fault="lost")
        assert arming_after(before, fault, *rest) == (Arming.DISARMED, ArmingAction.TRIP)
        fault = request._replace(filter_fault="broken")
        trips = before.armed or request.armed
        after = (Arming.DISARMED, ArmingAction.TRIP) if trips else (request.arming, None)
        assert arming_after(before, fault, *rest) == after


def test_what_follows_from_a_request_without_a_fault():
    for before, request, acknowledges, owns, refused in all_requests():
        asked = request.arming
        wants = before.armed and asked.claims and not owns
        if before.armed and not asked.armed:
            action = ArmingAction.LET_GO
        elif asked.armed and not before.armed:
            action = ArmingAction.TAKE if asked.claims else ArmingAction.ARM
        elif request.arming_requested and acknowledges:
            action = ArmingAction.ACKNOWLEDGE
        elif wants:
            action = ArmingAction.TRIP if refused else ArmingAction.TAKE
        else:
            action = None
        after = Arming.DISARMED if action is ArmingAction.TRIP else asked
        assert arming_after(before, request, acknowledges, owns, refused) == (after, action)


def test_the_act_by_a_dead_man_is_its_release_with_the_device_at_rest_and_its_press():
    for before, at_rest, inhibited in itertools.product(Arming, BOTH, BOTH):
        released = before is Arming.RELEASED
        after = armed_by_deadman(before, False, at_rest, inhibited)
        assert after == (Arming.RELEASED if released or at_rest else Arming.DISARMED, False)
        after = armed_by_deadman(before, True, at_rest, inhibited)
        assert after == (Arming.ARMED if released and not inhibited else Arming.DISARMED, released)


@pytest.mark.parametrize("before", Arming)
def test_rearming_without_a_button_is_rest_and_where_it_is_inhibited_to_let_go(before):
    assert armed_by_rest(before, True, False) == (Arming.ARMED, True)
    assert armed_by_rest(before, False, False) == (Arming.DISARMED, False)
    assert armed_by_rest(before, False, True) == (Arming.DEFLECTED, False)
    assert armed_by_rest(before, True, True) == (Arming.DISARMED, before is Arming.DEFLECTED)


# -- messages to operators -------------------------------------------------------------------------


@pytest.mark.parametrize("moving", BOTH)
@pytest.mark.parametrize("asks", BOTH)
@pytest.mark.parametrize("recovers", BOTH)
def test_a_robot_that_is_not_ready_is_reported_first(moving, asks, recovers):
    for motion, arming in itertools.product(MotionState, Arming):
        absent = States(RobotReadiness.ABSENT, motion=motion, arming=arming)
        assert phase_of(absent, moving, asks, recovers) is Phase.NO_ROBOT
        blind = absent._replace(link=RobotReadiness.BRAKING_BLIND)
        assert phase_of(blind, moving, asks, recovers) is Phase.BRAKING
        ready = absent._replace(link=RobotReadiness.READY)
        assert (phase_of(ready, moving, asks, recovers) is Phase.RECOVERING) == recovers


def test_a_robot_that_is_ready_moves_as_somebody_wants_or_brakes_or_rests():
    for motion, arming, asks in itertools.product(MotionState, Arming, BOTH):
        states = States(RobotReadiness.READY, motion=motion, arming=arming)
        wanted = motion is MotionState.EXECUTING or (motion is MotionState.FOLLOWING and asks)
        phase = Phase.MOVING if wanted else Phase.BRAKING
        assert phase_of(states, True, asks, False) is phase
        driven = motion in (MotionState.FOLLOWING, MotionState.EXECUTING)
        phase = Phase.HOLDING if driven or arming.armed else Phase.DISARMED
        assert phase_of(states, False, asks, False) is phase
