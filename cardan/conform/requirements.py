"""Numbered requirements, and verdicts on them."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from cardan.errors import ExtraMissingError

T = TypeVar("T")
V = TypeVar("V")
"""Decoded traffic of a suite: the argument of its checks."""
W = TypeVar("W", "str", "str | None")
J = TypeVar("J", "Verdict", "Findings")
"""Return type of a check."""
Item = TypeVar("Item")
"""Type of the things that a requirement checks one by one."""
Wrongs = Iterable[tuple[int, str]]
"""Numbers of events that show a violation, and the violation in words."""


class Level(enum.IntEnum):
    """Intrusiveness of a run; each level includes those below it."""

    LISTEN = 0
    """Nothing is sent that could change anything."""
    HOLD = 1
    """The session is up, and nothing moves."""
    MOVE = 2
    """Motions of at most 1 mm or 0.2 degrees; an operator is at the enable switch."""
    BY_HAND = 3
    """An operator makes faults by hand, from a list."""


class VerdictOutcome(enum.Enum):
    """Result of checking a requirement."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"
    """The requirement does not concern the tested side."""
    NOT_SEEN = "not seen"
    """Its subject did not happen, not on this level, or this computer was too late to tell."""


class Verdict(NamedTuple):
    """Result of a check on a timeline."""

    outcome: VerdictOutcome
    said: str
    """The observation in a few words, with its numbers."""
    evidence: tuple[int, ...] = ()
    """Numbers of the timeline's events that show it, at most a few."""
    figure: float | None = None
    """Measured value, if it is a single number; the lower, the easier for the other side."""
    unit: str = ""


EVIDENCE_AT_MOST = 5
NOTHING = "nothing came"
"""Default reason of `VerdictOutcome.NOT_SEEN`, if neither suite nor requirement gives its own."""


def passed(said: str, figure: float | None = None, unit: str = "") -> Verdict:
    """Return the verdict of a met requirement; `figure` if a value was measured."""
    return Verdict(VerdictOutcome.PASSED, said, (), figure, unit)


def failed(
    said: str, evidence: Iterable[int] = (), figure: float | None = None, unit: str = ""
) -> Verdict:
    """Return the verdict of a violated requirement; the first few of `evidence` are kept."""
    return Verdict(VerdictOutcome.FAILED, said, tuple(evidence)[:EVIDENCE_AT_MOST], figure, unit)


def met(
    good: bool, said: str, evidence: Iterable[int] = (), figure: float | None = None, unit: str = ""
) -> Verdict:
    """Return passed if `good`; else failed with the first few of `evidence`."""
    return passed(said, figure, unit) if good else failed(said, evidence, figure, unit)


def at_most(
    limit: float, figure: float, unit: str, said: str, evidence: Iterable[int] = ()
) -> Verdict:
    """Return passed if `figure` is at most `limit`; else failed with the first of `evidence`."""
    return met(not figure > limit, said, evidence, figure, unit)


def none_wrong(
    wrong: Iterable[tuple[int, str]], of: int, good: str, nothing: str = NOTHING, what: str = ""
) -> Verdict:
    """Return failed with the first of `wrong`, event numbers and reasons; else passed: `good`, or
    not seen: `nothing` if `of`, the number of checked things, is 0. `what` is their plural noun."""
    found = list(wrong)
    if found:
        return failed(
            f"{len(found)} of {of}{what and ' ' + what}: {found[0][1]}", (n for n, _ in found)
        )
    return passed(good) if of else not_seen(nothing)


class Words(NamedTuple):
    """Texts of the verdict on the things that a requirement checks one by one."""

    good: str
    """If none is wrong; ``{}`` is their number."""
    nothing: str | Verdict = ""
    """If there was none, or the verdict then; empty: the suite's words."""
    what: str = ""
    """Plural noun for the wrong things."""
    few: float = 0.0
    """The share of them that may be wrong; a second ``{}`` of `good` is their number."""


Findings = Generator[tuple[int, str], None, "Words | Verdict"]
"""For each checked thing its event's number and the reason why it is wrong (empty: it is right); at
the end the texts for all of them, or a verdict that needs none of them."""


def tallied(found: Verdict | Findings, nothing: str = NOTHING) -> Verdict:
    """Return `found` if it is a verdict; else the verdict on the findings, counted."""
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
        absent = words.nothing or nothing
        return not_seen(absent) if isinstance(absent, str) else absent
    good = words.good.format(count, len(wrong))
    return none_wrong(wrong if len(wrong) > words.few * count else (), count, good, what=words.what)


def not_seen(said: str) -> Verdict:
    """Return the verdict on a requirement whose subject did not happen."""
    return Verdict(VerdictOutcome.NOT_SEEN, said)


def not_applicable(said: str) -> Verdict:
    """Return the verdict on a requirement that does not concern the tested side."""
    return Verdict(VerdictOutcome.NOT_APPLICABLE, said)


class SettledError(Exception):
    """Ends a check early with its verdict."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(verdict.said)
        self.verdict = verdict


def some(found: T | None, nothing: str) -> T:
    """Return `found`; if it is None, empty or false, end the check: not seen, `nothing`."""
    if not found:
        raise SettledError(not_seen(nothing))
    return found


def must(found: T | None, said: str, evidence: Iterable[int] = ()) -> T:
    """Return `found`; if it is None, empty or false, end the check: failed."""
    if not found:
        raise SettledError(failed(said, evidence))
    return found


def distance(one: Iterable[float], other: Iterable[float]) -> float:
    """Return the largest difference between two postures or positions in one component."""
    return max((abs(a - b) for a, b in zip(one, other, strict=False)), default=0.0)


def number_of(item: Any) -> int:
    """Return the number of the event of `item`; of a tuple of several, of the last of them."""
    number = getattr(item, "number", None)
    if number is None:
        number = next(each.number for each in reversed(item) if hasattr(each, "number"))
    return int(number)


@dataclass(frozen=True)
class Over(Generic[V, Item]):
    """Things that several requirements check one by one, and their texts as in `Words`."""

    of: Callable[[V], Iterable[Item]]
    good: str
    what: str = ""
    nothing: str | Verdict = ""
    unless: Callable[[V], Verdict | None] | None = None
    """If it returns a verdict, that is the verdict."""
    few: float = 0.0


@dataclass(frozen=True)
class Requirement(Generic[V]):
    """A numbered obligation of the tested side."""

    id: str
    """As EGM-104: never reused for another requirement. The hundreds are the level."""
    level: Level
    source: str
    text: str
    check: Callable[[V], Verdict]
    unless: Callable[[V], Verdict | None] | None
    """Verdict that replaces the check, if the requirement cannot be checked; else None."""
    late_s: float
    """If this computer was later than this, an apparent failure may be its own."""

    def verdict(self, decoded: V, late_s: float) -> Verdict:
        """Return the verdict on traffic recorded by a computer that was late by up to `late_s`."""
        found = (self.unless and self.unless(decoded)) or self.check(decoded)
        if found.outcome is VerdictOutcome.FAILED and late_s > self.late_s:
            late_ms = late_s * 1e3
            return not_seen(f"not judged: this computer was late by {late_ms:.0f} ms; {found.said}")
        return found


class Requirements(Generic[V]):
    """The requirements of a suite, in order. A check's docstring is the requirement's text."""

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
        """Decorate the check of requirement `number`, whose hundreds are its level. The check
        returns its verdict, or yields its finding on each thing in turn. If `unless` returns a
        verdict, that is the verdict. Beyond a lateness of `late_s` of this computer a failure is
        not counted. `text` is the requirement's, if one check has several. If the
        check needs a package that is missing, the verdict is not applicable."""

        def enter(check: Callable[[V], J]) -> Callable[[V], J]:
            def checked(decoded: V) -> Verdict:
                try:
                    return tallied(check(decoded), self._nothing)
                except SettledError as settled:
                    return settled.verdict
                except ExtraMissingError as missing:
                    return not_applicable(str(missing))

            name = f"{self._prefix}-{number:03}"
            if number in self._found:
                raise ValueError(f"{name} is there already")
            said = " ".join((text or check.__doc__ or "").split())
            level = Level(number // 100)
            self._found[number] = Requirement(name, level, source, said, checked, unless, late_s)
            return check

        return enter

    def each(
        self,
        number: int,
        source: str,
        over: Over[V, Item],
        unless: Callable[[V], Verdict | None] | None = None,
    ) -> Callable[[Callable[[Item], W]], Callable[[Item], W]]:
        """Decorate the check of an item of `over`: it returns why the item is wrong; empty: right;
        None: not concerned by the requirement. `unless` overrides that of `over`."""

        def enter(wrong: Callable[[Item], W]) -> Callable[[Item], W]:
            def check(decoded: V) -> Findings:
                for item in over.of(decoded):
                    why = wrong(item)
                    if why is not None:
                        yield number_of(item), why
                return Words(over.good, over.nothing, over.what, over.few)

            check.__doc__ = wrong.__doc__
            self(number, source, unless=unless or over.unless)(check)
            return wrong

        return enter

    def all(self) -> tuple[Requirement[V], ...]:
        """Return the requirements in the order of their numbers."""
        return tuple(self._found[number] for number in sorted(self._found))
