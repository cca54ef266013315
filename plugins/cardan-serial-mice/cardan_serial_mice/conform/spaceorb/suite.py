"""The suite of a SpaceOrb 360 on its serial line."""

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
from cardan_serial_mice.conform.spaceorb.packets import OrbTraffic, SpaceOrbMeaning
from cardan_serial_mice.conform.spaceorb.requirements import requires
from cardan_serial_mice.conform.spaceorb.scenario import SpaceOrbScenario
from cardan_serial_mice.conform.wire import SerialLine
from cardan_serial_mice.peer.line import SERIAL_FAULTS
from cardan_serial_mice.protocol.spaceorb import BAUD


class SpaceOrb(Suite[OrbTraffic]):
    """A SpaceOrb 360, or a Spaceball Avenger, which speaks the same."""

    name = "spaceorb"
    judges = "the device"
    speaks = "the SpaceOrb's serial packets, 9600 baud"
    target = "the serial port of the device, as /dev/ttyUSB0"
    peer = "spacemouse-serial"
    requirements = requires.all()
    transport = SuiteTransport("other")
    seconds = 1.2
    # After its start.
    fault_test_values: ClassVar[Mapping[str, float]] = {"power-loss": 5.5}

    def decode(self, timeline: WireTimeline) -> OrbTraffic:
        return OrbTraffic(timeline, SpaceOrbMeaning())

    def scenario(self, level: Level, seconds: float) -> SpaceOrbScenario:
        return SpaceOrbScenario(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        PuckSimulation("spaceorb", exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        return SerialLine(target, BAUD)

    def switches(self) -> tuple[FaultSwitch, ...]:
        return SERIAL_FAULTS
