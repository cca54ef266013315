"""Energy given in a contact is independent of earlier events: free motion, or a passive wall."""

from __future__ import annotations

import functools

import pytest

from studies.haptics import earlier
from studies.haptics.earlier import CONTACTS, SURPLUS_J, Before
from studies.haptics.stability import HELD, LIGHTLY, OURS, PLAIN, RESTLESS_M_S

pytestmark = pytest.mark.matrix

STIRS = Before("stirs for 10 s", 10.0)
NOISE = Before("stirs for 10 s, noise 0.05 N", 10.0, 0.05)
STRONG_NOISE = Before("stirs for 10 s, noise 0.35 N", 10.0, 0.35)
LEAVES = Before("leans on an undelayed wall, leaves it", leans=True)
KEEPS = Before("leans on a wall that becomes delayed", leans=True, keeps=True)
ALLOWED_J = 0.0005
"""Tolerance for the energy hidden by the sensors."""

each_contact = pytest.mark.parametrize("contact", CONTACTS, ids=lambda one: one.hand.name)


@functools.cache
def find(before, contact):
    return earlier.find(OURS, before, contact)


@each_contact
@pytest.mark.parametrize("before", [STIRS, NOISE], ids=lambda one: one.name)
def test_free_motion_buys_nothing(before, contact):
    found = find(before, contact)
    assert found.given_j <= OURS.energy_budget_j + ALLOWED_J
    assert found.surplus_j < 0.001
    assert found.margin_j >= 0.0
    assert found.restless_m_s <= RESTLESS_M_S


@each_contact
@pytest.mark.parametrize("before", [LEAVES, KEEPS, STRONG_NOISE], ids=lambda one: one.name)
def test_what_was_taken_in_may_be_given_back_but_has_an_end(before, contact):
    found = find(before, contact)
    assert found.surplus_j <= SURPLUS_J + ALLOWED_J
    assert found.given_j <= OURS.energy_budget_j + SURPLUS_J + ALLOWED_J
    assert found.margin_j >= 0.0
    assert found.restless_m_s <= RESTLESS_M_S


def test_a_wall_that_stores_is_credited_with_what_it_stores():
    """A spring with less than 18 mJ of stored energy could not push back."""
    assert find(KEEPS, CONTACTS[1]).surplus_j > 0.015


def test_the_plain_loop_throws_the_stylus_in_the_same_contacts():
    plain = earlier.find(PLAIN, STIRS, CONTACTS[0])
    assert plain.given_j > 1.0
    assert plain.margin_j < 0.0
    rows = earlier.table([(plain, find(STIRS, CONTACTS[0]))]).splitlines()
    assert rows[2].count("**") == 2
    assert [row.count("|") for row in rows] == [9] * 3


def test_what_is_watched_are_the_contacts_of_two_hands():
    assert {contact.hand for contact in CONTACTS} == {HELD, LIGHTLY}
