"""The simulated arm and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from cardan.conform.runner import Exchange
from cardan.conform.simulation import CyclicSimulation
from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions

PERIOD_S, STEP_S = 0.008, 0.002
"""Slower than the arm's own, to save computing time."""


class JointStreamSimulation(CyclicSimulation[bytes]):
    """Simulated arm, with faults of its own and of the network."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        options = SimulatedArmOptions(
            plant=PlantOptions(step_s=STEP_S, gravity_feedforward=True),
            period_s=PERIOD_S,
            faults=faults,
            seed=seed,
        )
        super().__init__(exchange, PERIOD_S, {}, seed)
        self._arm = SimulatedArm(options)

    def _receive(self, data: bytes) -> None:
        self._arm.receive(data, self._now_s)

    def _cycle(self, due_s: float) -> Iterable[bytes]:
        return self._arm.cycle(due_s)

    def _tell(self, sent: bytes) -> None:
        self._hear("", sent)

    def _by_hand(self, what: str) -> None:
        self._arm.emergency_stop()
