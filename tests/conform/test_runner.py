"""A scenario, driven by times and events."""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace

import pytest

from cardan.conform import (
    Exchange,
    Kind,
    Pause,
    Scenario,
    ask,
    close,
    mark,
    open_,
    send,
)
from cardan.conform.requirements import (
    NOTHING,
    Over,
    Requirements,
    Words,
    failed,
    met,
    must,
    not_applicable,
    not_seen,
    passed,
    some,
)


class Echo(Scenario):
    """Scenario that waits for a message for at most 1 s, and answers each one twice."""

    heard = False

    def script(self):
        yield open_("wire")
        yield mark("wait")
        yield Pause(1.0, lambda: self.heard)
        yield mark("more")
        yield ask("hand", "Wave.")
        yield Pause(0.5)
        yield send(b"end", "wire")
        yield close("wire")

    def answer(self, event):
        if event.kind is Kind.DATA:
            self.heard = True
            yield send(event.data * 2, "wire")


def conducted():
    exchange = Exchange(Echo())
    assert [act.kind for act in exchange.due(0.0)] == [Kind.OPENED]
    assert exchange.heard(0.0, "wire", kind=Kind.OPENED)[0].note == "wait"
    return exchange


def test_a_wait_ends_with_what_it_waits_for():
    exchange = conducted()
    acts = exchange.heard(0.25, "wire", b"x", note="them")
    assert [(act.kind, act.data, act.note) for act in acts] == [
        (Kind.DATA, b"xx", ""),
        (Kind.MARK, b"", "more"),
        (Kind.ASKED, b"", "Wave."),
    ]
    assert exchange.next_s == 0.75
    assert exchange.due(0.7) == []
    assert [act.kind for act in exchange.due(0.75)] == [Kind.DATA, Kind.CLOSED]
    assert exchange.over
    assert exchange.next_s == math.inf


def test_a_wait_ends_with_its_time():
    exchange = conducted()
    assert exchange.due(0.99) == []
    assert 0.99 < exchange.next_s <= 1.0
    assert [act.kind for act in exchange.due(1.0)] == [Kind.MARK, Kind.ASKED]


def test_the_timeline_has_both_ways_and_the_phases():
    exchange = conducted()
    exchange.heard(0.25, "wire", b"x", note="them")
    exchange.due(1.0)
    timeline = exchange.timeline
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
    exchange = conducted()
    exchange.due(1.0)
    exchange.due(2.0)
    assert exchange.over
    assert exchange.heard(3.0, "wire", b"late") == []
    assert exchange.timeline.events[-1].data == b"late"


def test_a_number_of_a_requirement_is_given_once():
    requires = Requirements("X")
    requires(101, "a page")(lambda decoded: passed("good"))
    with pytest.raises(ValueError, match="X-101 is there already"):
        requires(101, "another page")(lambda decoded: passed("good"))


def judged(wrong, count, **options):
    """Return the verdict on `count` numbered items, of which the first `wrong` are wrong."""
    requires = Requirements("X")
    things = [SimpleNamespace(number=n, why="odd" if n < wrong else "") for n in range(count)]
    requires.each(101, "", Over(lambda decoded: decoded, "{} things, {} odd", "things", **options))(
        lambda each: each.why
    )
    return requires.all()[0].verdict(things, 0.0)


@pytest.mark.parametrize(("wrong", "said"), [(0, "10 things, 0 odd"), (2, "10 things, 2 odd")])
def test_few_may_be_wrong_where_that_is_allowed(wrong, said):
    assert judged(wrong, 10, few=0.2) == passed(said)


def test_more_may_not():
    assert judged(3, 10, few=0.2) == failed("3 of 10 things: odd", (0, 1, 2))
    assert judged(1, 10) == failed("1 of 10 things: odd", (0,))


def test_of_none_it_is_said_why():
    assert judged(0, 0).said == NOTHING
    assert judged(0, 0, nothing="none was sent") == not_seen("none was sent")
    assert judged(0, 0, nothing=not_applicable("it has none")) == not_applicable("it has none")
    assert judged(1, 9, unless=lambda decoded: not_seen("too late")) == not_seen("too late")


def test_a_judge_of_several_requirements_has_a_text_for_each():
    requires = Requirements("X")
    for number, what in ((101, "one"), (102, "other")):
        requires(number, "", text=f"It is {what}.")(partial(met, said=what))
    assert [each.text for each in requires.all()] == ["It is one.", "It is other."]


@pytest.mark.parametrize("found", [None, [], False])
def test_a_judge_ends_where_there_is_nothing_to_judge(found):
    requires = Requirements("X")
    requires(101, "")(lambda decoded: passed(f"{some(decoded, 'none was sent')}"))
    (requirement,) = requires.all()
    assert requirement.verdict(found, 0.0) == not_seen("none was sent")
    assert requirement.check([7]) == passed("[7]")


def test_a_judge_ends_where_what_must_be_is_not():
    requires = Requirements("X")
    requires(101, "")(lambda decoded: passed(f"{must(decoded, 'it never was', [3])}"))
    (requirement,) = requires.all()
    assert requirement.check(None) == failed("it never was", (3,))
    assert requirement.check([7]) == passed("[7]")


def test_events_that_show_what_is_wrong_can_be_others_than_the_thing_s_own():
    requires = Requirements("X")

    @requires(101, "")
    def check(decoded):
        for n, why in enumerate(decoded):
            yield 40 + n, why
        return Words("{} things")

    (requirement,) = requires.all()
    assert requirement.check(["odd", "odd"]) == failed("2 of 2: odd", (40, 41))
    assert requirement.check(["", ""]) == passed("2 things")
