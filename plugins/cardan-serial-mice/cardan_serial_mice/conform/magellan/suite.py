"""The suite of a serial device that speaks Magellan's protocol."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import WireTimeline
from cardan.conform.transports import Wires
from cardan.sim_peers.base import FaultSwitch
from cardan_serial_mice.conform.magellan.decoded import MagellanMeaning, MagellanTraffic
from cardan_serial_mice.conform.magellan.requirements import requires
from cardan_serial_mice.conform.magellan.scenario import MagellanScenario
from cardan_serial_mice.conform.puck.simulated import PuckSimulation
from cardan_serial_mice.conform.wire import SerialLine
from cardan_serial_mice.peer.line import SERIAL_FAULTS
from cardan_serial_mice.protocol.magellan import BAUD


class Magellan(Suite[MagellanTraffic]):
    """A Magellan SpaceMouse, a CadMan or a Spaceball 5000 on a serial line."""

    name = "magellan"
    judges = "the device"
    speaks = "Magellan's serial packets, 9600 baud"
    target = "the serial port of the device, as /dev/ttyUSB0"
    peer = "spacemouse-serial"
    requirements = requires.all()
    transport = SuiteTransport("other")
    seconds = 1.2
    # While it is held deflected; between two commands; beyond any sensitivity's default.
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "silence": 1.5,
        "power-loss": 6.5,
        "overrange": 1.5,
    }

    def decode(self, timeline: WireTimeline) -> MagellanTraffic:
        return MagellanTraffic(timeline, MagellanMeaning())

    def scenario(self, level: Level, seconds: float) -> MagellanScenario:
        return MagellanScenario(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        PuckSimulation("magellan", exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        return SerialLine(target, BAUD, stop_bits=2)

    def switches(self) -> tuple[FaultSwitch, ...]:
        return SERIAL_FAULTS
