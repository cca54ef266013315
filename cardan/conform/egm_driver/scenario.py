"""Scenario that is a driver's controller: run, stop, restart, silence, junk."""

from __future__ import annotations

from collections.abc import Iterator

from cardan.conform.controllers import COME, MAX_SENT, CyclicController
from cardan.conform.egm.scenario import JUNK
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions

FIRST, SECOND = "first", "second"
"""Ports of the suite: the controller's before and after its restart."""
SILENT_S = 1.0
STOPPED_S = 0.4
SETTLE_S = 0.1


class EgmControllerScenario(CyclicController):
    """The simulated controller, run by a script. No real arm moves."""

    def __init__(self, level: Level, seconds: float) -> None:
        super().__init__()
        self._level = level
        self._seconds = seconds
        self._core = EgmController(EgmControllerOptions(script="teleop-stream", comm_timeout_s=5.0))
        self.period_s = self._core.options.period_s
        self._channel = FIRST
        self._heard = False

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind is Kind.DATA and event.channel == self._channel:
            self._heard = True
            self._core.receive(event.data)
        return iter(())

    def script(self) -> Script:
        if self._level < Level.HOLD:
            return
        yield open_(FIRST)
        yield mark("run")
        yield from self._cycles_until(lambda: self._heard, COME * self._seconds, SETTLE_S)
        yield from self._cycles(self._seconds)
        yield mark("stopped")
        self._core.do("program-stop")
        yield from self._cycles(STOPPED_S)
        yield mark("started")
        self._core.do("program-start")
        yield from self._cycles(STOPPED_S)
        yield mark("junk")
        for data in JUNK * 3:
            yield send(data, self._channel)
            yield from self._cycles(0.03)
        yield mark("old")
        for _ in range(5):
            yield from self._cycles(0.05)
            yield send(self._sent[-MAX_SENT], self._channel)
            yield Pause(0.002)
            yield send(self._sent[-1], self._channel)
            yield Pause(0.002)
        yield mark("silence")
        yield Pause(SILENT_S)
        yield mark("restarted")
        self._core.do("controller-restart")
        self._channel = SECOND
        yield open_(SECOND)
        yield from self._cycles(2.0 + STOPPED_S)
        if self._level >= Level.BY_HAND:
            yield mark("ended")
            yield ask("end", "End the driver's program.")
            yield from self._cycles(min(10.0, self._seconds))

    def _cycle(self, now_s: float) -> tuple[bytes, ...]:
        data = self._core.cycle(now_s)
        return () if data is None else (data,)
