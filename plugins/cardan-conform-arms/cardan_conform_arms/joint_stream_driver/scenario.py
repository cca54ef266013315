"""Scenario that is a client's arm over the joint stream: it is stopped, restarts, falls silent, and
sends junk and old states in between."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from cardan.conform.controllers import COME, MAX_SENT, CyclicController
from cardan.conform.egm.scenario import JUNK
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.arm.faults import RESTART_SILENCE_S
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan_conform_arms.joint_stream_driver.requirements import PERIOD_S, ROBOT

STEP_S = 0.002
SESSION = 41
"""First session number: no client chooses it by itself."""
SILENT_S = 1.0
STOPPED_S = 0.4
SETTLE_S = 0.1
TIMES = 5
BETWEEN_S = 0.05


class ArmScenario(CyclicController):
    """Simulated arm, run by a script. No real arm moves."""

    period_s = PERIOD_S

    def __init__(self, level: Level, seconds: float) -> None:
        super().__init__()
        self._level = level
        self._seconds = seconds
        self._silent = False
        """The arm runs as usual, but its states are lost."""
        self._core = SimulatedArm(
            SimulatedArmOptions(
                robot=ROBOT,
                plant=PlantOptions(step_s=STEP_S, gravity_feedforward=True),
                period_s=PERIOD_S,
                acknowledge_after_s=math.inf,
            ),
            SESSION,
        )

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind is Kind.DATA:
            self._core.receive(event.data, self.now_s, event.note)
        return iter(())

    def _cycle(self, now_s: float) -> Sequence[bytes]:
        found = self._core.cycle(now_s)
        return () if self._silent else found

    def _client_comes(self) -> Script:
        """Run cycles until a client is connected, and a few more."""
        yield from self._cycles_until(
            lambda: self._core.client is not None, COME * self._seconds, SETTLE_S
        )

    def script(self) -> Script:
        if self._level < Level.HOLD:
            return
        arm = self._core
        yield open_("")
        yield mark("greet")
        yield from self._client_comes()
        if arm.client is None:
            return
        yield mark("run")
        yield from self._cycles(self._seconds)
        yield mark("estop")
        arm.emergency_stop()
        yield from self._cycles(STOPPED_S)
        yield mark("acknowledged")
        arm.acknowledge()
        yield from self._cycles(STOPPED_S)
        yield mark("junk")
        for data in JUNK * 3:
            yield send(data)
            yield from self._cycles(BETWEEN_S)
        yield from self._old("old", self._sent[-MAX_SENT])
        yield mark("silence")
        self._silent = True
        yield from self._cycles(SILENT_S)
        self._silent = False
        yield mark("again")
        yield from self._cycles(STOPPED_S)
        earlier = self._sent[-1]
        yield mark("restarted")
        arm.restart()
        yield from self._cycles(RESTART_SILENCE_S + SETTLE_S)
        yield from self._client_comes()
        yield mark("anew")
        yield from self._cycles(max(STOPPED_S, self._seconds))
        yield from self._old("earlier", earlier)
        if self._level >= Level.BY_HAND:
            yield mark("ended")
            yield ask("end", "End the driver's program while the arm moves.")
            yield from self._cycles(min(10.0, max(STOPPED_S, self._seconds)))

    def _old(self, phase: str, data: bytes) -> Script:
        """Repeat an earlier datagram of the arm, each time followed by the newest state."""
        yield mark(phase)
        for _ in range(TIMES):
            yield from self._cycles(BETWEEN_S)
            for each in (data, self._sent[-1]):
                yield send(each)
                yield Pause(0.5 * STEP_S)
