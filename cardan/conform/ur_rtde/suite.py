"""The suite of a Universal Robots controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.conduct import Conduct
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, Transport
from cardan.conform.timeline import Event, Timeline
from cardan.conform.ur_rtde.pilot import ASKING, UrPilot
from cardan.conform.ur_rtde.programs import ALL
from cardan.conform.ur_rtde.rig import UrRig
from cardan.conform.ur_rtde.seen import RTDE, SECOND, UrSeen
from cardan.conform.wires import TcpPorts, Wires, host_and_port
from cardan.errors import ConfigurationError
from cardan.protocols.ur.dashboard import DASHBOARD_PORT, request
from cardan.protocols.ur.primary import PRIMARY_PORT
from cardan.protocols.ur.rtde import RTDE_PORT, PacketType
from cardan.sim_peers.ur_controller import UrControllerOptions

_HARMLESS = frozenset(
    (
        PacketType.PROTOCOL_VERSION,
        PacketType.CONTROLLER_VERSION,
        PacketType.OUTPUTS,
        PacketType.START,
        PacketType.PAUSE,
    )
)
"""What a client may send that only reads."""


class UrRtde(Suite[UrSeen]):
    """An e-Series or CB3 of Universal Robots."""

    name = "ur-rtde"
    judges = "the controller"
    speaks = "RTDE, programs over the primary interface, and the dashboard, on three TCP ports"
    target = (
        "HOST[:PORT] of the controller; PORT is that of RTDE, 30004, the primary interface lies 3 "
        "and the dashboard 5 below it"
    )
    peer = "ur"
    requirements = ALL
    transport = Transport(
        "tcp",
        {RTDE: RTDE_PORT, SECOND: RTDE_PORT, "primary": PRIMARY_PORT, "dashboard": DASHBOARD_PORT},
    )
    seconds = 3.0
    # While it is held; before that most would only keep the program from being begun.
    tried_with: ClassVar[Mapping[str, float]] = dict.fromkeys(
        (
            "protective-stop",
            "estop",
            "safeguard-stop",
            "power-off",
            "pause",
            "program-stop",
            "other-program",
            "local",
            "slider-zero",
            "silent",
            "cut",
            "reset",
        ),
        7.0,
    )

    def see(self, timeline: Timeline) -> UrSeen:
        return UrSeen(timeline)

    def pilot(self, level: Level, seconds: float) -> UrPilot:
        return UrPilot(level, seconds)

    def simulate(self, conduct: Conduct, faults: Mapping[str, float], seed: int) -> None:
        UrRig(conduct, UrControllerOptions(faults=faults, seed=seed)).run()

    def wires(self, target: str) -> Wires:
        host, port = host_and_port(target, "--target", RTDE_PORT)
        below = {"primary": RTDE_PORT - PRIMARY_PORT, "dashboard": RTDE_PORT - DASHBOARD_PORT}
        if port <= max(below.values()):
            raise ConfigurationError("--target", f"{target!r}: no port lies 5 below {port}")
        others = {name: port - each for name, each in below.items()}
        return TcpPorts(host, {RTDE: port, SECOND: port, **others})

    def only_asks(self, event: Event) -> bool:
        if event.channel == "dashboard":
            return event.data in map(request, ASKING)
        return event.channel.startswith(RTDE) and event.data[2] in _HARMLESS
