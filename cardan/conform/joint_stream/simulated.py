"""The simulated arm and a pilot in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.runner import Act, Exchange
from cardan.conform.timeline import Kind
from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions

LONGEST_S = 300.0
"""Of a simulated run; a script that waits for what never comes ends before."""
PERIOD_S, STEP_S = 0.008, 0.002
"""Slower than the arm's own, for the sake of what it costs to compute."""


class JointStreamRig:
    """Runs the arm's cycles, and carries datagrams both ways at once."""

    def __init__(self, conduct: Exchange, faults: Mapping[str, float], seed: int) -> None:
        options = SimulatedArmOptions(
            plant=PlantOptions(step_s=STEP_S, gravity_feedforward=True),
            period_s=PERIOD_S,
            faults=faults,
            seed=seed,
        )
        self._conduct = conduct
        self._arm = SimulatedArm(options)
        self._now_s = 0.0

    def run(self) -> None:
        """Until the pilot's script is over."""
        conduct, cycle = self._conduct, 0
        while not conduct.over and self._now_s < LONGEST_S:
            due_s = cycle * PERIOD_S
            self._now_s = max(self._now_s, min(due_s, conduct.next_s))
            self._do(conduct.due(self._now_s))
            if self._now_s >= due_s:
                cycle += 1
                for data in self._arm.cycle(due_s):
                    self._do(conduct.heard(self._now_s, "", data))

    def _do(self, acts: list[Act]) -> None:
        for act in acts:
            if act.kind is Kind.DATA:
                self._arm.receive(act.data, self._now_s)
            elif act.kind is Kind.OPENED:
                self._do(self._conduct.heard(self._now_s, "", kind=Kind.OPENED))
            elif act.kind is Kind.ASKED:
                self._arm.emergency_stop()
