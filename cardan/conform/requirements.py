"""A numbered requirement, and the verdict on it."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from cardan.errors import ExtraMissingError

T = TypeVar("T")
V = TypeVar("V")
"""What a suite makes of a timeline for its judges to look at."""
W = TypeVar("W", "str", "str | None")
J = TypeVar("J", "Verdict", "Findings")
"""What a judge gives."""
Item = TypeVar("Item")
"""One of what a requirement says something of."""
Wrongs = Iterable[tuple[int, str]]
"""Numbers of events that show something wrong, and what."""


class Level(enum.IntEnum):
    """How much is asked of what is judged; each level includes those below it."""

    LISTEN = 0
    """Nothing is sent that could change anything."""
    HOLD = 1
    """The session is up, and nothing moves."""
    MOVE = 2
    """Motions of at most 1 mm or 0.2 degrees; somebody is at the enable switch."""
    BY_HAND = 3
    """Somebody makes faults by hand, from a list."""


class Outcome(enum.Enum):
    """What became of a requirement."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"
    """It does not concern what is judged."""
    NOT_SEEN = "not seen"
    """What it is about did not happen, or not on this level; or this computer was too late to tell
    whose fault it was."""


class Verdict(NamedTuple):
    """What a judge says of a timeline."""

    outcome: Outcome
    said: str
    """What was seen, in a few words, with its numbers."""
    evidence: tuple[int, ...] = ()
    """Numbers of the timeline's events that show it, at most a few."""
    figure: float | None = None
    """What was measured, where that is one number; the lower, the easier for the other side."""
    unit: str = ""


EVIDENCE_AT_MOST = 5
NOTHING = "nothing came"
"""Why nothing was seen, where a suite or a requirement does not say it otherwise."""


def passed(said: str, figure: float | None = None, unit: str = "") -> Verdict:
    """It is met; `figure` where something was measured."""
    return Verdict(Outcome.PASSED, said, (), figure, unit)


def failed(
    said: str, evidence: Iterable[int] = (), figure: float | None = None, unit: str = ""
) -> Verdict:
    """It is not met; the first few of `evidence` are kept."""
    return Verdict(Outcome.FAILED, said, tuple(evidence)[:EVIDENCE_AT_MOST], figure, unit)


def met(good: bool, said: str, evidence: Iterable[int] = ()) -> Verdict:
    """Passed where it is `good`; else failed with the first few of `evidence`."""
    return passed(said) if good else failed(said, evidence)


def at_most(
    limit: float, figure: float, unit: str, said: str, evidence: Iterable[int] = ()
) -> Verdict:
    """Passed where what was measured is no more than `limit`; the first few of `evidence` are kept
    where it is."""
    if figure > limit:
        return failed(said, evidence, figure, unit)
    return passed(said, figure, unit)


def none_wrong(
    wrong: Iterable[tuple[int, str]], of: int, good: str, nothing: str = NOTHING, what: str = ""
) -> Verdict:
    """Failed by the first of what is `wrong`, each an event's number and why, of so many that could
    have been and are called `what`; else `good`, or not seen where there was `nothing`."""
    found = list(wrong)
    if found:
        return failed(
            f"{len(found)} of {of}{what and ' ' + what}: {found[0][1]}", (n for n, _ in found)
        )
    return passed(good) if of else not_seen(nothing)


class Words(NamedTuple):
    """What is said of all that a requirement says something of."""

    good: str
    """Where none is wrong; ``{}`` is how many there were."""
    nothing: str | Verdict = ""
    """Where there was none, or the verdict then; empty: the suite's words."""
    what: str = ""
    """What the wrong ones are called."""
    few: float = 0.0
    """The share of them that may be wrong; a second ``{}`` of `good` is how many are."""


Findings = Generator[tuple[int, str], None, "Words | Verdict"]
"""Of each thing that a requirement says something of its event's number, and why it is wrong, empty
where it is right; in the end the words for all of them, or a verdict that needs none of them."""


def tallied(found: Verdict | Findings, nothing: str = NOTHING) -> Verdict:
    """The verdict, by what was found one by one where that is not it itself."""
    if isinstance(found, Verdict):
        return found
    wrong, count = [], 0
    while True:
        try:
            number, why = next(found)
        except StopIteration as end:
            words = end.value
            break
        count += 1
        if why:
            wrong.append((number, why))
    if isinstance(words, Verdict):
        return words
    if not count:
        return (
            not_seen(words.nothing or nothing) if isinstance(words.nothing, str) else words.nothing
        )
    good = words.good.format(count, len(wrong))
    return none_wrong(wrong if len(wrong) > words.few * count else (), count, good, what=words.what)


def not_seen(said: str) -> Verdict:
    """What it is about did not happen."""
    return Verdict(Outcome.NOT_SEEN, said)


def not_applicable(said: str) -> Verdict:
    """It does not concern what is judged."""
    return Verdict(Outcome.NOT_APPLICABLE, said)


class SettledError(Exception):
    """Ends a judge: what it has to say is known before it is through."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(verdict.said)
        self.verdict = verdict


def some(found: T | None, nothing: str) -> T:
    """`found`, in a judge; where it is none, empty or false, the verdict is not seen: `nothing`."""
    if not found:
        raise SettledError(not_seen(nothing))
    return found


def must(found: T | None, said: str, evidence: Iterable[int] = ()) -> T:
    """`found`, in a judge; where it is none, empty or false, the verdict is failed."""
    if not found:
        raise SettledError(failed(said, evidence))
    return found


def apart(one: Iterable[float], other: Iterable[float]) -> float:
    """How far two postures, or places, are apart in the part in which they are farthest."""
    return max((abs(a - b) for a, b in zip(one, other, strict=False)), default=0.0)


def number_of(item: Any) -> int:
    """The number of the event by which `item` came; of a tuple of several, of the last of them."""
    number = getattr(item, "number", None)
    if number is None:
        number = next(each.number for each in reversed(item) if hasattr(each, "number"))
    return int(number)


@dataclass(frozen=True)
class Over(Generic[V, Item]):
    """What several requirements say something of one by one, and in which words: as in `Words`."""

    of: Callable[[V], Iterable[Item]]
    good: str
    what: str = ""
    nothing: str | Verdict = ""
    unless: Callable[[V], Verdict | None] | None = None
    """Where it gives a verdict, that is the verdict."""
    few: float = 0.0


@dataclass(frozen=True)
class Requirement(Generic[V]):
    """One thing that the other side must do."""

    id: str
    """As EGM-104: never given anew to another one. The hundreds are the level."""
    level: Level
    source: str
    text: str
    judged: Callable[[V], Verdict]
    unless: Callable[[V], Verdict | None] | None
    """Why it cannot be judged, where it cannot."""
    late_s: float
    """Where this computer was later than this, what seems a failure may be its own."""

    def judge(self, seen: V) -> Verdict:
        """Verdict of its judge on `seen`; a judge that needs a package that is missing has none."""
        try:
            return self.judged(seen)
        except SettledError as settled:
            return settled.verdict
        except ExtraMissingError as missing:
            return not_applicable(str(missing))

    def verdict(self, seen: V, late_s: float) -> Verdict:
        """On `seen`, taken by a computer that was late by up to `late_s`."""
        found = (self.unless and self.unless(seen)) or self.judge(seen)
        if found.outcome is Outcome.FAILED and late_s > self.late_s:
            late_ms = late_s * 1e3
            return not_seen(f"not judged: this computer was late by {late_ms:.0f} ms; {found.said}")
        return found


class Requirements(Generic[V]):
    """The requirements of a suite, in order. A judge's docstring is the requirement's text."""

    def __init__(self, prefix: str, nothing: str = NOTHING) -> None:
        self._prefix, self._nothing = prefix, nothing
        self._found: dict[int, Requirement[V]] = {}

    def __call__(
        self,
        number: int,
        source: str,
        *,
        unless: Callable[[V], Verdict | None] | None = None,
        late_s: float = math.inf,
        text: str = "",
    ) -> Callable[[Callable[[V], J]], Callable[[V], J]]:
        """Decorates the judge of requirement `number`, whose hundreds are its level: it gives its
        verdict, or yields what it finds of each thing in turn. Where `unless`
        gives a verdict, that is the verdict. `late_s` is what this computer may be late by for a
        failure to be the other side's. `text` is the requirement's, where one judge has several."""

        def enter(judge: Callable[[V], J]) -> Callable[[V], J]:
            def judged(seen: V) -> Verdict:
                return tallied(judge(seen), self._nothing)

            name = f"{self._prefix}-{number:03}"
            if number in self._found:
                raise ValueError(f"{name} is there already")
            said = " ".join((text or judge.__doc__ or "").split())
            level = Level(number // 100)
            self._found[number] = Requirement(name, level, source, said, judged, unless, late_s)
            return judge

        return enter

    def each(
        self,
        number: int,
        source: str,
        over: Over[V, Item],
        unless: Callable[[V], Verdict | None] | None = None,
    ) -> Callable[[Callable[[Item], W]], Callable[[Item], W]]:
        """Decorates what says of one of `over` why it is wrong, empty where it is right; None where
        it is none of those that the requirement is about. `unless` goes before that of `over`."""

        def enter(wrong: Callable[[Item], W]) -> Callable[[Item], W]:
            def judge(seen: V) -> Findings:
                for item in over.of(seen):
                    why = wrong(item)
                    if why is not None:
                        yield number_of(item), why
                return Words(over.good, over.nothing, over.what, over.few)

            judge.__doc__ = wrong.__doc__
            self(number, source, unless=unless or over.unless)(judge)
            return wrong

        return enter

    def all(self) -> tuple[Requirement[V], ...]:
        """In the order of their numbers."""
        return tuple(self._found[number] for number in sorted(self._found))
