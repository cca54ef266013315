"""The suite of an HDAPI library."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import Kind, WireEvent, WireTimeline
from cardan.conform.transports import Wires
from cardan_omni.conform.decoded import HdapiTraffic
from cardan_omni.conform.requirements import requires
from cardan_omni.conform.scenario import HdapiScenario
from cardan_omni.conform.simulated import HdapiSimulation
from cardan_omni.conform.wire import Library
from cardan_omni.protocol import Info

_SERIAL = re.compile(
    rb'("hdGetString", "arguments": \[%d\], "returns": ")([^"]*)(")' % Info.DEVICE_SERIAL_NUMBER
)


class Hdapi(Suite[HdapiTraffic]):
    """A libHD of OpenHaptics 3, and the Phantom Omni or Touch behind it."""

    name = "hdapi"
    judges = "the library"
    speaks = "calls of C functions, and 1000 callbacks a second"
    target = "the path of libHD.so"
    peer = "omni"
    requirements = requires.all()
    transport = SuiteTransport("other")
    seconds = 0.4
    # Longer than a gap may be; more than ticks may be early and late.
    fault_test_values: ClassVar[Mapping[str, float]] = {"late-tick": 20.0, "jitter": 1000.0}

    def decode(self, timeline: WireTimeline) -> HdapiTraffic:
        return HdapiTraffic(timeline)

    def scenario(self, level: Level, seconds: float) -> HdapiScenario:
        return HdapiScenario(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        HdapiSimulation(exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        return Library(target)

    def redacted(self, event: WireEvent) -> WireEvent:
        """True if one of the strings is the device's serial number."""
        if event.kind is not Kind.DATA or b"hdGetString" not in event.data:
            return event
        hidden = _SERIAL.sub(lambda m: m[1] + b"X" * len(m[2]) + m[3], event.data)
        return event._replace(data=hidden)
