"""The suite of a Leap Motion tracking service."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import Kind, WireEvent, WireTimeline
from cardan.conform.transports import Wires, host_and_port
from cardan_leap.conform.decoded import LeapTraffic
from cardan_leap.conform.requirements import requires
from cardan_leap.conform.scenario import LeapScenario
from cardan_leap.conform.simulated import LeapSimulation
from cardan_leap.conform.wire import Service
from cardan_leap.protocol import PORT

_SERIAL = re.compile(rb'("id"\s*:\s*")([^"]*)(")')


class Leap(Suite[LeapTraffic]):
    """A tracking service of the Leap Motion Controller, in version 6 of its protocol."""

    name = "leap"
    judges = "the service"
    speaks = "JSON over WebSocket, about 110 frames a second"
    target = "HOST[:PORT] of the service, 6437"
    peer = "leap"
    requirements = requires.all()
    transport = SuiteTransport("other")
    seconds = 1.5
    # While a hand is in view; with the focus; for longer than silence may last.
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "unplug": 2.0,
        "replug": 2.5,
        "pause": 2.0,
        "stall": 3.0,
        "restart": 2.0,
        "lost-focus": 4.0,
        "count-anew": 2.0,
        "new-ids": 1.0,
    }

    def decode(self, timeline: WireTimeline) -> LeapTraffic:
        return LeapTraffic(timeline)

    def scenario(self, level: Level, seconds: float) -> LeapScenario:
        return LeapScenario(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        LeapSimulation(exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        return Service(*host_and_port(target, "--target", PORT))

    def redacted(self, event: WireEvent) -> WireEvent:
        """Return `event` without the serial number that device events have as id."""
        if event.kind is not Kind.DATA or b'"event"' not in event.data:
            return event
        hidden = _SERIAL.sub(lambda m: m[1] + b"X" * len(m[2]) + m[3], event.data)
        return event._replace(data=hidden)
