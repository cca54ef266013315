"""The suite of a controller that speaks Externally Guided Motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.conduct import Conduct
from cardan.conform.egm.pilot import EgmPilot
from cardan.conform.egm.requirements import requires
from cardan.conform.egm.rig import EgmRig
from cardan.conform.egm.seen import EgmSeen
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, Transport
from cardan.conform.timeline import Timeline
from cardan.conform.wires import Listen, Wires, host_and_port

PORT = 6510


class Egm(Suite[EgmSeen]):
    """An ABB controller in Externally Guided Motion."""

    name = "egm"
    judges = "the controller"
    speaks = "EGM: protobuf on UDP, 250 Hz"
    target = "[HOST]:PORT to listen at, as the controller's UdpUc device has it; 0.0.0.0:6510"
    peer = "abb-gofa"
    requirements = requires.all()
    transport = Transport("udp", {"": PORT}, frozenset(("",)))
    seconds = 3.0
    # While it is held.
    tried_with: ClassVar[Mapping[str, float]] = {
        "pause": 0.9,
        "restart": 3.0,
        "estop": 3.0,
        "motors-off": 3.0,
    }

    def see(self, timeline: Timeline) -> EgmSeen:
        return EgmSeen(timeline, robot_sends=False)

    def pilot(self, level: Level, seconds: float) -> EgmPilot:
        return EgmPilot(level, seconds)

    def simulate(self, conduct: Conduct, faults: Mapping[str, float], seed: int) -> None:
        EgmRig(conduct, faults, seed).run()

    def wires(self, target: str) -> Wires:
        host, port = host_and_port(target, "--target", PORT)
        return Listen(host or "0.0.0.0", port)
