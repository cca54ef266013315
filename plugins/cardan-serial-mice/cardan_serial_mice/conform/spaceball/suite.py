"""The suite of a Spaceball on its serial line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import WireTimeline
from cardan.conform.transports import Wires
from cardan.sim_peers.base import FaultSwitch
from cardan_serial_mice.conform.puck.simulated import PuckSimulation
from cardan_serial_mice.conform.spaceball.packets import BallTraffic, SpaceballMeaning
from cardan_serial_mice.conform.spaceball.requirements import requires
from cardan_serial_mice.conform.spaceball.scenario import SpaceballScenario
from cardan_serial_mice.conform.wire import SerialLine
from cardan_serial_mice.peer.line import SERIAL_FAULTS
from cardan_serial_mice.protocol.spaceball import BAUD


class Spaceball(Suite[BallTraffic]):
    """A Spaceball 1003, 2003, 3003 or 4000 FLX. A Spaceball 5000 speaks as a Magellan."""

    name = "spaceball"
    judges = "the device"
    speaks = "the Spaceball's serial packets, 9600 baud"
    target = "the serial port of the device, as /dev/ttyUSB0"
    peer = "spacemouse-serial"
    requirements = requires.all()
    transport = SuiteTransport("other")
    seconds = 1.2
    # While it is held deflected; beyond the range's reserve.
    fault_test_values: ClassVar[Mapping[str, float]] = {"power-loss": 4.5, "overrange": 1.5}

    def decode(self, timeline: WireTimeline) -> BallTraffic:
        return BallTraffic(timeline, SpaceballMeaning())

    def scenario(self, level: Level, seconds: float) -> SpaceballScenario:
        return SpaceballScenario(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        PuckSimulation("spaceball-2003", exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        return SerialLine(target, BAUD)

    def switches(self) -> tuple[FaultSwitch, ...]:
        return SERIAL_FAULTS
