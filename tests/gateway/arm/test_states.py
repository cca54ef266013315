"""The machines of an arm's states: see :mod:`tests.gateway.arm.explorer` for what they lead to."""

import ast
import inspect
import itertools

import pytest

from cardan.gateway.arm import controller
from cardan.gateway.arm.states import (
    RESTING,
    Event,
    Facts,
    Inhibit,
    Link,
    Motion,
    Readings,
    Separation,
    States,
    inhibits_after,
    separation_after,
)
from cardan.gateway.operator.arming import Arming

ALL = [
    States(*each) for each in itertools.product(Link, Readings, Motion, Separation, (Arming.ARMED,))
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
        if node.attr in ("state", "_activity")
    }
    assert places == {"__init__", "_enter"}


@pytest.mark.parametrize("event", Event)
def test_every_event_changes_something(event):
    assert any(each.after(event, facts) != each for each in ALL for facts in FACTS)


@pytest.mark.parametrize("event", Event)
def test_an_event_that_comes_again_changes_nothing_more(event):
    for each, facts in itertools.product(ALL, FACTS):
        once = each.after(event, facts)
        assert once.after(event, facts) == once


def test_an_event_that_forgets_or_places_leaves_no_motion_of_a_source():
    for each, facts in itertools.product(ALL, FACTS):
        assert each.after(Event.FORGOTTEN, facts).motion is Motion.UNCOMMANDED
        assert each.after(Event.PLACED, facts).motion in (*RESTING, Motion.BRAKING)
        assert each.after(Event.DISARMED, facts).arming is Arming.DISARMED


@pytest.mark.parametrize(
    ("event", "after"),
    [
        (Event.HELD, Separation.TO_RESYNCHRONIZE),
        (Event.NOT_BACK, Separation.APART),
        (Event.ASKED, Separation.NONE),
        (Event.PLACED, Separation.LEFT),
        (Event.UNREADY, Separation.LEFT),
        (Event.ACKNOWLEDGED, Separation.LEFT),
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
