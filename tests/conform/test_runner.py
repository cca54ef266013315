"""A pilot's script, run by times and events."""

from __future__ import annotations

import math

import pytest

from cardan.conform import (
    Exchange,
    Kind,
    Scenario,
    Wait,
    ask,
    close,
    mark,
    open_,
    send,
)


class Echo(Scenario):
    """Opens a wire, waits for what comes, at most a second, and answers everything twice."""

    heard = False

    def script(self):
        yield open_("wire")
        yield mark("wait")
        yield Wait(1.0, lambda: self.heard)
        yield mark("more")
        yield ask("hand", "Wave.")
        yield Wait(0.5)
        yield send(b"end", "wire")
        yield close("wire")

    def answer(self, event):
        if event.kind is Kind.DATA:
            self.heard = True
            yield send(event.data * 2, "wire")


def conducted():
    conduct = Exchange(Echo())
    assert [act.kind for act in conduct.due(0.0)] == [Kind.OPENED]
    assert conduct.heard(0.0, "wire", kind=Kind.OPENED)[0].note == "wait"
    return conduct


def test_a_wait_ends_with_what_it_waits_for():
    conduct = conducted()
    acts = conduct.heard(0.25, "wire", b"x", note="them")
    assert [(act.kind, act.data, act.note) for act in acts] == [
        (Kind.DATA, b"xx", ""),
        (Kind.MARK, b"", "more"),
        (Kind.ASKED, b"", "Wave."),
    ]
    assert conduct.next_s == 0.75
    assert conduct.due(0.7) == []
    assert [act.kind for act in conduct.due(0.75)] == [Kind.DATA, Kind.CLOSED]
    assert conduct.over
    assert conduct.next_s == math.inf


def test_a_wait_ends_with_its_time():
    conduct = conducted()
    assert conduct.due(0.99) == []
    assert 0.99 < conduct.next_s <= 1.0
    assert [act.kind for act in conduct.due(1.0)] == [Kind.MARK, Kind.ASKED]


def test_the_timeline_has_both_ways_and_the_phases():
    conduct = conducted()
    conduct.heard(0.25, "wire", b"x", note="them")
    conduct.due(1.0)
    timeline = conduct.timeline
    assert [(each.kind, each.sent, each.data) for each in timeline] == [
        (Kind.OPENED, False, b""),
        (Kind.MARK, True, b""),
        (Kind.DATA, False, b"x"),
        (Kind.DATA, True, b"xx"),
        (Kind.MARK, True, b""),
        (Kind.ASKED, True, b""),
        (Kind.DATA, True, b"end"),
        (Kind.CLOSED, True, b""),
        (Kind.MARK, True, b""),
    ]
    phases = timeline.phases()
    assert (phases["wait"].first, phases["wait"].end) == (1, 4)
    assert (phases["wait"].start_s, phases["wait"].end_s) == (0.0, 0.25)
    assert (phases["more"].end, phases["more"].end_s) == (len(timeline) - 1, 1.0)
    assert timeline.end_s == 1.0


def test_nothing_is_answered_after_the_end():
    conduct = conducted()
    conduct.due(1.0)
    conduct.due(2.0)
    assert conduct.over
    assert conduct.heard(3.0, "wire", b"late") == []
    assert conduct.timeline.events[-1].data == b"late"


def test_a_number_of_a_requirement_is_given_once():
    from cardan.conform import Requirements, passed

    requires = Requirements("X")
    requires(101, "a page")(lambda seen: passed("good"))
    with pytest.raises(ValueError, match="X-101 is there already"):
        requires(101, "another page")(lambda seen: passed("good"))
