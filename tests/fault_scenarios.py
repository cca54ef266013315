"""Request sources for the benches of faults: a controller with each source of motion.

Only `make` knows all of them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.arm.status import OPERATOR
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_results import Motion
from cardan.gateway.arm.vocab import Parameter, Stream
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions
from cardan.gateway.session.arm_assembly import make_arm
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.supervisor_heartbeat import SupervisorHeartbeat
from cardan.types import CommandKind, DeviceLink, DeviceState, RobotCommand, RobotState
from tests.controllers import controller_for_device
from tests.fault_benches import Bench

SPEED_M_S = 0.1
"""Requested speed."""
LIMIT_M_S = 0.25
ACCELERATION_M_S2 = 1.0
RENEWED_S = 0.02
REPORTED_S = 0.016
WAY_M = 0.3
"""Length of a path."""

REST = (0.0,) * 6


class Scenario(ABC):
    """Control core with a source that requests motion."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.silent = False
        """True once the device or the sender of the stream is silent."""
        self.started_s = math.inf
        self.heartbeat: SupervisorHeartbeat | None = None
        """Heartbeat of a stopped supervisor; None while it runs."""

    controller: ArmController

    def stop_supervisor(self) -> None:
        """Stop the supervising process (SIGSTOP)."""
        self.heartbeat = SupervisorHeartbeat(Watchdogs().heartbeat_s, self.bench.now_s)

    def _supervise(self, now_s: float) -> None:
        if self.heartbeat is not None:
            self.controller.inhibit(self.heartbeat.fault(now_s), Inhibit.WHILE_SAID)

    @abstractmethod
    def lose_authority(self) -> None:
        """Give the authority over the arm to another source."""

    def start(self) -> None:
        """Request SPEED_M_S along the bench's direction from now on."""
        self.started_s = self.bench.now_s

    @abstractmethod
    def tick(self, state: RobotState) -> RobotCommand:
        """Return the core's answer to `state`."""


class Operator(Scenario):
    """Operator with a deflected device and its dead-man pressed."""

    def __init__(self, bench: Bench, watchdogs: Watchdogs | None = None) -> None:
        super().__init__(bench)
        arm = None
        if CommandKind.POSE not in bench.capabilities.commands:
            table = {"device": {"driver": "spacemouse"}, "robot": {"driver": "sim_arm"}}
            arm = make_arm(parse_config({**table, "arm": {"model": bench.arm}}), bench.driver)
        self.controller = controller_for_device(
            MappingOptions(deadman=("left",), linear_speed_m_s=SPEED_M_S),
            ReferenceLimits(linear_speed_m_s=LIMIT_M_S, linear_acceleration_m_s2=ACCELERATION_M_S2),
            watchdogs,
            arm=arm,
            period_s=bench.capabilities.period_s,
        )
        self._report: DeviceState | None = None

    def tick(self, state: RobotState) -> RobotCommand:
        self._supervise(state.stamp_s)
        return self.controller.tick(state, self._device(state.stamp_s))

    def lose_authority(self) -> None:
        self.controller.authority.hand_over(OPERATOR, "somebody else", self.bench.now_s)
        self.controller.stop("authority was handed over")

    def _device(self, now_s: float) -> DeviceState:
        """Return the newest report; reports continue independently of this process."""
        before = self._report
        if before is None or not self.silent:
            stamp_s = math.floor(now_s / REPORTED_S) * REPORTED_S
            held = now_s >= self.started_s + RENEWED_S
            axes = (*self.bench.direction, 0.0, 0.0, 0.0) if now_s > self.started_s else REST
            buttons = frozenset({"left"}) if held else frozenset()
            # Rest first: rest and then the button re-arm.
            axes = axes if now_s >= self.started_s + 2.0 * RENEWED_S else REST
            self._report = DeviceState(stamp_s, DeviceLink.LIVE, axes, buttons)
        assert self._report is not None
        return self._report


class _Verbs(Scenario):
    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.verbs = ArmVerbs.alone(
            bench.model, bench.capabilities, mapping=MappingOptions(deadman=("left",))
        )
        self.controller = self.verbs.controller
        self._taken_s = math.inf
        self.verbs.set_parameters(
            {
                Parameter.TRAJECTORY_SPEED: SPEED_M_S,
                Parameter.TRAJECTORY_ACCELERATION: ACCELERATION_M_S2,
            }
        )

    def tick(self, state: RobotState) -> RobotCommand:
        self._supervise(state.stamp_s)
        held = frozenset({"left"} if state.stamp_s >= self._taken_s else ())
        hand = DeviceState(state.stamp_s, DeviceLink.LIVE, REST, held)
        return self.controller.tick(state, hand)

    def lose_authority(self) -> None:
        self._taken_s = self.bench.now_s


class TwistStream(_Verbs):
    """Program that streams a twist, sent every 20 ms by its own process."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self._sent_s = -math.inf

    def start(self) -> None:
        super().start()
        self.verbs.set_parameter(Parameter.STREAM, float(Stream.TWIST))

    def tick(self, state: RobotState) -> RobotCommand:
        now_s = self.bench.now_s
        if now_s >= self.started_s and not self.silent and now_s - self._sent_s >= RENEWED_S:
            self._sent_s = math.floor(now_s / RENEWED_S) * RENEWED_S
            way = tuple(SPEED_M_S * part for part in self.bench.direction)
            self.verbs.stream("twist", (*way, 0.0, 0.0, 0.0))
        return super().tick(state)


class Path(_Verbs):
    """Program that requests movl along a line."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.motion: Motion | None = None

    def start(self) -> None:
        super().start()
        here = self.verbs.stat().pose
        way = (*(WAY_M * part for part in self.bench.direction), 0.0, 0.0, 0.0)
        self.motion = self.verbs.movl([a + b for a, b in zip(here, way, strict=True)])


Make = Callable[[str, Bench], Scenario]

SCENARIOS: dict[str, type[Scenario]] = {"operator": Operator, "twist": TwistStream, "path": Path}


def make(source: str, bench: Bench) -> Scenario:
    """Return the controller that `source` drives."""
    return SCENARIOS[source](bench)
