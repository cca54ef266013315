"""The simulated ROS 2 arm and a pilot in virtual time, with the network between them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from cardan.conform.ros2_arm.names import DESCRIPTION, STATES, TOPICS
from cardan.conform.runner import Act, Exchange
from cardan.conform.timeline import Kind
from cardan.protocols.ros2.cdr import codec_of
from cardan.sim_peers.arm.plant import ArmPlant
from cardan.sim_peers.link import FaultyLink
from cardan.sim_peers.ros2_arm.controllers import RosArm, StateMessage
from cardan.sim_peers.ros2_arm.options import RosArmOptions

LONGEST_S = 300.0
"""Of a simulated run; a script that waits for what never comes ends before."""
WALL_S = 1.7e9
STEP_S = 0.002


class RosArmRig:
    """Runs the controller manager's cycles, and carries messages both ways."""

    def __init__(self, conduct: Exchange, faults: Mapping[str, float], seed: int) -> None:
        options = RosArmOptions(faults=faults, seed=seed)
        self._conduct = conduct
        self._arm = RosArm(options)
        # Longer steps than the arm's own, for the sake of what they cost to compute.
        coarse = dataclasses.replace(options.plant, step_s=STEP_S)
        self._arm.plant = ArmPlant(self._arm.arm, coarse)
        self._period_s = options.period_s
        self._out: FaultyLink[StateMessage] = FaultyLink(faults, seed + 2)
        self._in: FaultyLink[bytes] = FaultyLink(faults, seed + 3)
        self._ended = False
        self._now_s = 0.0

    def run(self) -> None:
        """Until the pilot's script is over."""
        conduct, cycle = self._conduct, 0
        while not conduct.over and self._now_s < LONGEST_S:
            due_s = cycle * self._period_s
            times = (due_s, conduct.next_s, self._out.next_s(), self._in.next_s())
            self._now_s = max(self._now_s, min(each for each in times if each is not None))
            self._do(conduct.due(self._now_s))
            for data in self._in.pop(self._now_s):
                self._arm.receive(data)
            if self._now_s >= due_s:
                cycle += 1
                for state in self._arm.cycle(WALL_S):
                    if not self._ended:
                        self._out.push(self._now_s, state)
            for sender, sequence, data in self._out.pop(self._now_s):
                note = f"{sender}:{sequence}"
                self._do(conduct.heard(self._now_s, STATES, data, note=note))

    def _do(self, acts: list[Act]) -> None:
        for act in acts:
            if act.kind is Kind.DATA:
                self._in.push(self._now_s, act.data)
            elif act.kind is Kind.OPENED:
                self._do(self._conduct.heard(self._now_s, act.channel, kind=Kind.OPENED))
                if act.channel == DESCRIPTION:
                    codec = codec_of(TOPICS[DESCRIPTION].type)
                    text = codec.encode({"data": self._arm.arm.urdf})
                    self._do(self._conduct.heard(self._now_s, DESCRIPTION, text))
            elif act.kind is Kind.ASKED:
                self._ended = True
