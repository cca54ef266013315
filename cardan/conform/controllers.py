"""Controllers as scenarios, and how a driver ends: shared by the suites of drivers."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

from cardan.conform.requirements import Verdict, not_seen
from cardan.conform.runner import Scenario, Script, Wait, send
from cardan.conform.timeline import Numbered, Traffic

COME = 6.0
"""A driver has so many times the length of a phase to come, or to answer for the first time."""
KEPT = 3
"""Datagrams that a cyclic controller remembers."""

UNANSWERED = 10
"""A driver that leaves the last so many datagrams of a phase unanswered, and all that come later,
has ended."""


def had_ended(
    seen: Traffic,
    phase: str,
    asked: Iterable[Numbered],
    answers: Sequence[Numbered],
    asks: Mapping[str, str],
) -> Verdict | None:
    """That a driver which had ended before a phase began is not judged by it; None: it had not.

    `asks` has the phases in which it is to answer what is `asked`, and the requirement's id of
    each: the first that was left unanswered is said to be why.
    """
    began = seen.phase(phase)
    if began is None or not answers:
        return None
    last = max(each.number for each in answers)
    missed = [each.number for each in seen.within(asked, *asks) if last < each.number < began.first]
    if last > began.first or len(missed) < UNANSWERED:
        return None
    why = next(asks[name] for name in asks if seen.inside(missed[0], name))
    return not_seen(f"not judged: it had ended ({why})")


class CyclicController(Scenario):
    """A controller that sends datagrams in each of its cycles, in the hands of a script."""

    period_s: float

    def __init__(self) -> None:
        self._next_s = 0.0
        self._channel = ""
        """Where it sends."""
        self._sent: deque[bytes] = deque(maxlen=KEPT)
        """What it sent last."""

    @abstractmethod
    def _cycle(self, now_s: float) -> Iterable[bytes]:
        """One cycle at `now_s`: what to send."""

    def _cycles(self, seconds: float) -> Script:
        """Control cycles on an absolute schedule, until `seconds` are over."""
        end_s = self.now_s + seconds
        self._next_s = max(self._next_s, self.now_s)
        while self._next_s < end_s:
            yield Wait(max(0.0, self._next_s - self.now_s))
            found = self._cycle(self._next_s)
            self._next_s += self.period_s
            for data in found:
                self._sent.append(data)
                yield send(data, self._channel)
        yield Wait(max(0.0, end_s - self.now_s))

    def _cycles_until(self, done: Callable[[], bool], seconds: float, step_s: float) -> Script:
        """Control cycles until `done`, which is asked every `step_s`, or `seconds` are over."""
        end_s = self.now_s + seconds
        while not done() and self.now_s < end_s:
            yield from self._cycles(step_s)
