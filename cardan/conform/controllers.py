"""Scenarios that are the controller, and end of a driver; shared by the suites of drivers."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

from cardan.conform.requirements import Verdict, not_seen
from cardan.conform.runner import Pause, Scenario, Script, send
from cardan.conform.timeline import NumberedItem, Traffic

COME = 6.0
"""Time for a driver to connect, or to answer for the first time, in lengths of a phase."""
MAX_SENT = 3
"""Datagrams that a cyclic controller remembers."""

UNANSWERED = 10
"""A driver has ended if it leaves as many last datagrams of a phase, and all later, unanswered."""


def had_ended(
    decoded: Traffic,
    phase: str,
    asked: Iterable[NumberedItem],
    answers: Sequence[NumberedItem],
    asks: Mapping[str, str],
) -> Verdict | None:
    """Return the verdict not seen if the driver had ended before a phase began; None: it had not.

    `asks` has the phases in which the driver must answer the datagrams `asked`, and the
    requirement's id of each: the first unanswered phase is named as the reason.
    """
    began = decoded.phase(phase)
    if began is None or not answers:
        return None
    last = max(each.number for each in answers)
    numbers = [each.number for each in decoded.within(asked, *asks)]
    missed = [number for number in numbers if last < number < began.first]
    if last > began.first or len(missed) < UNANSWERED:
        return None
    why = next(asks[name] for name in asks if decoded.inside(missed[0], name))
    return not_seen(f"not judged: it had ended ({why})")


class CyclicController(Scenario):
    """A controller that sends datagrams in each of its cycles, run by a script."""

    period_s: float

    def __init__(self) -> None:
        self._next_s = 0.0
        self._channel = ""
        """Channel that it sends to."""
        self._sent: deque[bytes] = deque(maxlen=MAX_SENT)
        """Last datagrams sent."""

    @abstractmethod
    def _cycle(self, now_s: float) -> Iterable[bytes]:
        """Run the cycle at `now_s`; return the datagrams to send."""

    def _cycles(self, seconds: float) -> Script:
        """Run control cycles on an absolute schedule for `seconds`."""
        end_s = self.now_s + seconds
        self._next_s = max(self._next_s, self.now_s)
        while self._next_s < end_s:
            yield Pause(max(0.0, self._next_s - self.now_s))
            found = self._cycle(self._next_s)
            self._next_s += self.period_s
            for data in found:
                self._sent.append(data)
                yield send(data, self._channel)
        yield Pause(max(0.0, end_s - self.now_s))

    def _cycles_until(self, done: Callable[[], bool], seconds: float, step_s: float) -> Script:
        """Run control cycles until `done`, checked every `step_s`, but at most for `seconds`."""
        end_s = self.now_s + seconds
        while not done() and self.now_s < end_s:
            yield from self._cycles(step_s)
