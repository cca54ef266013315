"""The suite of a Wii Remote."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import WireTimeline
from cardan.conform.transports import DeviceFile, Wires
from cardan_wiimote.conform.decoded import WiimoteTraffic
from cardan_wiimote.conform.requirements import requires
from cardan_wiimote.conform.scenario import WiimoteScenario
from cardan_wiimote.conform.simulated import WiimoteSimulation


class Wiimote(Suite[WiimoteTraffic]):
    """A Wii Remote with a Nunchuk, report by report."""

    name = "wiimote"
    judges = "the device"
    speaks = "HID reports over Bluetooth, about 100 a second"
    target = "/dev/hidrawN of the remote, which `cardan devices` names"
    peer = "wiimote"
    requirements = requires.all()
    transport = SuiteTransport("other")
    dissector = "wiimote"
    seconds = 1.2
    # While data come.
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "silence": 1.2,
        "out-of-range": 1.2,
        "in-range": 2.0,
        "power-off": 1.2,
        "power-on": 2.0,
        "close-control": 1.2,
        "close-interrupt": 1.2,
        "battery-low": 1.2,
        "stolen-mode": 1.2,
    }

    def decode(self, timeline: WireTimeline) -> WiimoteTraffic:
        return WiimoteTraffic(timeline)

    def scenario(self, level: Level, seconds: float) -> WiimoteScenario:
        return WiimoteScenario(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        WiimoteSimulation(exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        return DeviceFile(target)
