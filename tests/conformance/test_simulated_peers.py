"""Each simulated peer meets the requirements of its protocol, and a requirement catches each
fault."""

from __future__ import annotations

import re

import pytest

from cardan.conform import Level, VerdictOutcome, registry
from cardan.conform.run import simulated
from cardan_omni.peer import available
from tests import conformance_tables as tables, site_tables
from tests.result_tables import of_suite

pytestmark = pytest.mark.matrix
COMPILED = pytest.mark.skipif(not available(), reason="the simulated libHD was not compiled")
SUITES = [
    pytest.param(name, marks=COMPILED) if name == "hdapi" else name for name in registry.names()
]


@pytest.mark.parametrize("suite", SUITES)
def test_a_peer_without_faults_meets_every_requirement(suite):
    report = tables.sound(suite)
    assert report.failed == ()
    unseen = [each.id for each in report.results if each.outcome is VerdictOutcome.NOT_SEEN]
    assert unseen == [], "requirements without a positive example"
    ids = [each.id for each in report.results]
    assert ids == [each.id for each in registry.load(suite).requirements]
    not_met = {each.id for each in report.results if each.outcome is not VerdictOutcome.PASSED}
    assert not_met == tables.DO_NOT_APPLY & {*ids}


@pytest.mark.parametrize("suite", SUITES)
def test_every_fault_is_caught_by_a_requirement_or_is_undetectable(suite):
    """The committed table is compared in the same test, because its computation takes seconds."""
    for each in tables.tried(suite):
        assert bool(each.caught) != bool(each.why_not), each
    written = of_suite(suite).read()
    assert tables.faults_table(suite) == written, "`python -m tests.conformance_tables` rewrites it"


@pytest.mark.parametrize("suite", SUITES)
def test_what_is_said_of_faults_is_said_of_faults_that_there_are(suite):
    found = registry.load(suite)
    switches = {each.name for each in found.switches()}
    assert {*found.fault_test_values, *found.undetectable_faults} <= switches


def test_the_site_lists_every_protocol_and_the_page_has_its_section():
    listed = site_tables.read(tables.PAGE)
    for name in registry.names():
        assert f"| [`{name}`]({tables.section_of(name)}) |" in listed
        heading = rf"^(## {name}|### `cardan conform {name}`)$"
        assert re.search(heading, site_tables.read(of_suite(name).page), re.MULTILINE)


def test_ids_are_of_one_form_and_belong_to_one_requirement():
    ids = [each.id for name in registry.names() for each in registry.load(name).requirements]
    assert all(re.fullmatch(r"[A-Z0-9]+-[0-3]\d\d", each) for each in ids)
    assert len(set(ids)) == len(ids)
    for name in registry.names():
        for each in registry.load(name).requirements:
            assert each.text.endswith(".")
            assert each.source
            assert each.level == int(each.id[-3])


@pytest.mark.parametrize("suite", SUITES)
def test_level_0_sends_nothing_that_could_change_anything(suite):
    found = registry.load(suite)
    report, timeline = simulated(found, Level.LISTEN)
    assert report.failed == ()
    assert not [each for each in timeline if each.sent and each.data and not found.only_asks(each)]


@pytest.mark.parametrize("suite", SUITES)
def test_the_same_run_gives_the_same_events(suite):
    found = registry.load(suite)
    first, again = (simulated(found, Level.HOLD, seconds=1.0)[1] for _ in range(2))
    assert list(first) == list(again)
