"""What the suites of drivers share: the controller that a pilot is, and the driver's core beside it
in virtual time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

from cardan.conform.requirements import Verdict, not_seen
from cardan.conform.runner import Act, Exchange, Scenario, Script, Wait, send
from cardan.conform.timeline import Kind, Numbered, Seen
from cardan.sim_peers.base import FaultSwitch, check_faults

LONGEST_S = 300.0
"""Of a simulated run; a script that waits for what never comes ends before."""
STEP_S = 1e-6
LOOK_S = 0.01
"""How often a driver's core is looked at, at least."""
COME = 6.0
"""A driver has so many times the length of a phase to come, or to answer for the first time."""
KEPT = 3
"""Datagrams that a cyclic controller remembers."""

UNANSWERED = 10
"""A driver that leaves the last so many datagrams of a phase unanswered, and all that come later,
has ended."""


def had_ended(
    seen: Seen,
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


class DriverRig(ABC):
    """A driver's core and a pilot in virtual time; what one of them sends takes its time."""

    def __init__(
        self, conduct: Exchange, faults: Mapping[str, float], switches: Iterable[FaultSwitch]
    ) -> None:
        check_faults(faults, switches)
        self._conduct, self._faults = conduct, faults
        self._now_s = 0.0
        self._flight: deque[tuple[float, Callable[[], None]]] = deque()

    def run(self) -> None:
        """Until the pilot's script is over."""
        conduct, flight = self._conduct, self._flight
        while not conduct.over and self._now_s < LONGEST_S:
            self._do(conduct.due(self._now_s))
            while flight and flight[0][0] <= self._now_s:
                flight.popleft()[1]()
            self._turn()
            if conduct.over:
                break
            times = [conduct.next_s, self._now_s + LOOK_S, self._driver_next_s()]
            if flight:
                times.append(flight[0][0])
            self._now_s = max(self._now_s + STEP_S, min(times))

    def _later(self, seconds: float, act: Callable[[], None]) -> None:
        """Do `act` so much later; what came before it is done before it."""
        self._flight.append((self._now_s + seconds, act))

    def _hear(
        self, channel: str, data: bytes = b"", kind: Kind = Kind.DATA, note: str = ""
    ) -> None:
        """Something of the driver reaches the controller."""
        self._do(self._conduct.heard(self._now_s, channel, data, kind=kind, note=note))

    def _do(self, acts: list[Act]) -> None:
        for act in acts:
            if act.kind is Kind.DATA:
                self._take(act.data, act.channel)
            elif act.kind is Kind.OPENED:
                self._hear(act.channel, kind=Kind.OPENED)
                self._opened(act.channel)
            elif act.kind is Kind.CLOSED:
                self._closed(act.channel)
            elif act.kind is Kind.ASKED:
                self._by_hand(act.channel)

    def _every(self, fault: str, count: int, most: bool = False) -> bool:
        """Whether a fault of every VALUE-th acts; `most`: on all but those."""
        if fault not in self._faults:
            return False
        strikes = count % int(self._faults[fault]) == 0
        return not strikes if most else strikes

    @abstractmethod
    def _take(self, data: bytes, channel: str) -> None:
        """The controller sends `data`."""

    @abstractmethod
    def _by_hand(self, what: str) -> None:
        """Somebody is to do `what` with the driver's program."""

    def _opened(self, channel: str) -> None:  # noqa: B027 - datagrams need none
        """The controller listens on `channel`."""

    def _closed(self, channel: str) -> None:  # noqa: B027
        """The controller closes `channel`."""

    def _turn(self) -> None:  # noqa: B027 - a core that only answers has no time of its own
        """Whatever the driver does of itself."""

    def _driver_next_s(self) -> float:
        """When `_turn` has something to do."""
        return self._now_s + LOOK_S
