"""The simulated ROS 2 arm and a scenario in virtual time, with the network between them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

from cardan.conform.runner import Exchange
from cardan.conform.simulation import CyclicSimulation
from cardan.protocols.ros2.cdr import codec_of
from cardan.sim_peers.arm.plant import ArmPlant
from cardan.sim_peers.ros2_arm.controllers import JointStateMessage, RosArm
from cardan.sim_peers.ros2_arm.options import RosArmOptions
from cardan_conform_arms.ros2_arm.names import DESCRIPTION, STATES, TOPICS

WALL_S = 1.7e9
STEP_S = 0.002


class RosArmSimulation(CyclicSimulation[JointStateMessage]):
    """Cycles of the controller manager, and messages both ways."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        options = RosArmOptions(faults=faults, seed=seed)
        super().__init__(exchange, options.period_s, faults, seed)
        self._arm = RosArm(options)
        # Longer steps than the arm's own, to save computing time.
        coarse = dataclasses.replace(options.plant, step_s=STEP_S)
        self._arm.plant = ArmPlant(self._arm.arm, coarse)
        self._ended = False

    def _receive(self, data: bytes) -> None:
        self._arm.receive(data)

    def _cycle(self, due_s: float) -> Iterable[JointStateMessage]:
        found = self._arm.cycle(WALL_S)
        return () if self._ended else found

    def _tell(self, sent: JointStateMessage) -> None:
        sender, sequence, data = sent
        self._hear(STATES, data, note=f"{sender}:{sequence}")

    def _open(self, channel: str) -> None:
        super()._open(channel)
        if channel == DESCRIPTION:
            codec = codec_of(TOPICS[DESCRIPTION].type)
            self._hear(DESCRIPTION, codec.encode({"data": self._arm.arm.urdf}))

    def _by_hand(self, what: str) -> None:
        self._ended = True
