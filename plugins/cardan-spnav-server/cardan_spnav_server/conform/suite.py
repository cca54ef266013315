"""The suite of a daemon that serves spacenavd's socket."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import WireTimeline
from cardan.conform.transports import Wires
from cardan.sim_peers.base import FaultSwitch
from cardan_spnav_server.conform.decoded import SpnavTraffic
from cardan_spnav_server.conform.faults import FAULTS
from cardan_spnav_server.conform.requirements import requires
from cardan_spnav_server.conform.scenario import SpnavScenario
from cardan_spnav_server.conform.simulated import SpnavSimulation
from cardan_spnav_server.conform.wire import UnixStream


class SpnavDaemon(Suite[SpnavTraffic]):
    """spacenavd, or a substitute: Cardan's own server where there is no target."""

    name = "spnav"
    judges = "the daemon"
    speaks = "spacenavd's records on a Unix socket, versions 0 and 1"
    target = "the socket of the daemon, as /run/spnav.sock"
    peer = "spnav"
    requirements = requires.all()
    transport = SuiteTransport("other")
    seconds = 1.2
    # Both need an unplugged device, which level 3 has.
    tried_on: ClassVar[Mapping[str, Level]] = {
        "unplug-unreported": Level.BY_HAND,
        "keeps-device": Level.BY_HAND,
        "replug-unreported": Level.BY_HAND,
    }

    def decode(self, timeline: WireTimeline) -> SpnavTraffic:
        return SpnavTraffic(timeline)

    def scenario(self, level: Level, seconds: float) -> SpnavScenario:
        return SpnavScenario(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        SpnavSimulation(exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        return UnixStream(target)

    def switches(self) -> tuple[FaultSwitch, ...]:
        return FAULTS
