"""The whole chain in virtual time: simulated device, its driver, the control core, the EGM driver,
the robot.

Only sockets, threads and clocks are missing. Everything that crosses the chain crosses it as the
bytes that would be on the wire, through the same faults as in the served peers.
"""

from __future__ import annotations

import math

from cardan.drivers.abb_egm import AbbEgmOptions, EgmSession
from cardan.drivers.spacemouse import SpaceMouseOptions
from cardan.drivers.spacemouse.core import SpaceMouseCore
from cardan.gateway.arm.joint_space_arm import JointSpaceArm
from cardan.gateway.arm.status import Phase
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions
from cardan.protocols.connexion.devices import model_by_key
from cardan.sim_peers.base import parse_script
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions, FaultyLink
from cardan.sim_peers.scripted import play
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, ScriptedPuck
from cardan.spatial import norm, subtract
from cardan.types import RobotState, Vector3
from tests.controllers import controller_for_device

PC_ADDRESS = ("127.0.0.1", 40000)
SILENCE_TICK_S = 0.1

PUSH = """
0.2 axes 0.3 0 0 0 0 0
0.3 neutral
0.8 press left
1.0 axes -0.5 0 0 0 0 0 over 0.1
"""
"""Touch, release, grip, and pull back without end: 50 mm/s, away from the singularity in front."""

PUSH_AND_REGRIP = (
    PUSH
    + """
6.0 neutral
6.0 release left
6.5 press left
6.7 axes 0.5 0 0 0 0 0 over 0.1
"""
)
"""Then release everything, grip again and push forward."""


class Sample:
    """State of the robot after one control period."""

    __slots__ = ("message", "phase", "position", "sent", "speed", "time_s")

    def __init__(self, time_s: float, position: Vector3, phase: Phase, message: str) -> None:
        self.time_s = time_s
        self.position = position
        self.phase = phase
        self.message = message
        self.speed = 0.0
        self.sent = 0


class Chain:
    """Chain with faults and scripts: `run` it, then read `samples`."""

    def __init__(
        self,
        hand: str = PUSH,
        *,
        model: str = "spacenavigator",
        hand_faults: dict[str, float] | None = None,
        robot_faults: dict[str, float] | None = None,
        deadman: tuple[str, ...] = ("left",),
        limits: ReferenceLimits | None = None,
        arm: JointSpaceArm | None = None,
        egm: AbbEgmOptions | None = None,
        **controller: object,
    ) -> None:
        self.hand_faults, self.robot_faults = hand_faults or {}, robot_faults or {}
        known = model_by_key(model)
        self.puck = SimulatedSpaceMouse(known, faults=self.hand_faults, jitter_lsb=1, seed=1)
        self.script = ScriptedPuck(parse_script(hand, SCRIPT_VERBS), known)
        self.device = SpaceMouseCore(SpaceMouseOptions(), known)
        self.core = controller_for_device(
            MappingOptions(deadman=deadman),
            limits or ReferenceLimits(),
            Watchdogs(),
            arm=arm,
        )
        self.egm = EgmSession(egm or AbbEgmOptions(), 0.0)
        self.controller = EgmController(
            EgmControllerOptions(faults=self.robot_faults, **controller)  # type: ignore[arg-type]
        )
        self.to_pc = FaultyLink(self.robot_faults, 2, garbage=True)
        self.to_robot = FaultyLink(self.robot_faults, 3)
        self.now_s = 0.0
        self.cycles = 0
        self.samples: list[Sample] = []
        self.states: list[RobotState] = []
        self.session_alive = True
        """False: the process of driver and engine is dead, as after SIGKILL."""
        self._heard_s = 0.0
        self._opens_s = self.hand_faults.get("refuse", 0.0)
        self._plugged = False

    # -- one period -----------------------------------------------------------------------------

    def run(self, seconds: float) -> Chain:
        for _ in range(round(seconds / self.controller.options.period_s)):
            self._period()
        return self

    def _period(self) -> None:
        self.cycles += 1
        self.now_s = now_s = self.cycles * self.controller.options.period_s
        self._play_hand(now_s)
        data = self.controller.cycle(now_s)
        if data is not None:
            self.to_pc.push(now_s, data)
        sample = Sample(now_s, self.controller.tcp.position, Phase.NO_ROBOT, "")
        if self.session_alive:
            sample.sent = self._answer(now_s)
            status = self.core.status()
            sample.phase, sample.message = status.phase, status.message
        else:
            self.to_pc.pop(now_s)
        for answer in self.to_robot.pop(now_s):
            self.controller.receive(answer)
        if self.samples:
            moved = norm(subtract(sample.position, self.samples[-1].position))
            sample.speed = moved / self.controller.options.period_s
        self.samples.append(sample)

    def _play_hand(self, now_s: float) -> None:
        reports = play(self.puck, self.script, now_s)
        reachable = self.puck.plugged and now_s >= self._opens_s
        if reachable and not self._plugged:
            self.device.on_opened(now_s, self.puck.model)
        elif self._plugged and not reachable:
            self.device.on_lost("the device was unplugged", now_s)
        self._plugged = reachable
        if reachable:
            for report in reports:
                self.device.on_report(report, now_s)

    def _answer(self, now_s: float) -> int:
        """Act as the driver's shell: drain, process the newest, answer it once."""
        address = (PC_ADDRESS[0], PC_ADDRESS[1] + self.controller.port_changes)
        state = None
        for data in self.to_pc.pop(now_s):
            state = self.egm.receive(data, address, now_s) or state
        if state is None and now_s - self._heard_s >= SILENCE_TICK_S:
            state = self.egm.tick(now_s)
        if state is None:
            return 0
        self._heard_s = now_s
        self.states.append(state)
        command = self.core.tick(state, self.device.state(now_s), self.device.events())
        if not self.egm.reply_pending:
            return 0
        self.to_robot.push(now_s, self.egm.reply(command, now_s))
        self.egm.answered(now_s)
        return 1

    # -- results --------------------------------------------------------------------------------

    def between(self, start_s: float, end_s: float) -> list[Sample]:
        return [s for s in self.samples if start_s <= s.time_s < end_s]

    def traveled_m(self, start_s: float, end_s: float) -> float:
        """Return the distance of the TCP between two times."""
        there = self.between(start_s, end_s)
        return norm(subtract(there[-1].position, there[0].position))

    def fastest_m_s(self, start_s: float = 0.0, end_s: float = math.inf) -> float:
        return max(s.speed for s in self.between(start_s, end_s))

    def hardest_m_s2(self, start_s: float = 0.0, end_s: float = math.inf) -> float:
        """Return the largest change of the TCP's speed over 10 periods (less would be encoder
        noise)."""
        there = self.between(start_s, end_s)
        window_s = 10 * self.controller.options.period_s
        pairs = zip(there, there[10:], strict=False)
        return max((abs(b.speed - a.speed) / window_s for a, b in pairs), default=0.0)

    def rests_from(self, tolerance_m: float = 2e-4) -> float:
        """Return the time when the TCP reached its last position."""
        last = self.samples[-1].position
        for sample in reversed(self.samples):
            if norm(subtract(sample.position, last)) > tolerance_m:
                return sample.time_s
        return 0.0

    def messages(self) -> str:
        """Return all messages, each once."""
        return "\n".join(dict.fromkeys(s.message for s in self.samples if s.message))
