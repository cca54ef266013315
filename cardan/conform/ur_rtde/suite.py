"""Suite of a Universal Robots controller."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import ClassVar

from cardan.common.sockets import address_towards
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import WireEvent
from cardan.conform.transports import TcpPorts, Wires, host_and_port
from cardan.conform.ur_rtde import (
    decoded,
    programs,  # noqa: F401 - enters its requirements
)
from cardan.conform.ur_rtde.requirements import requires
from cardan.conform.ur_rtde.scenario import ASKING, REVERSE_PORT, WORDED, UrScenario
from cardan.errors import ConfigurationError
from cardan.protocols.ur.dashboard import DASHBOARD_PORT, request
from cardan.protocols.ur.primary import PRIMARY_PORT, SECONDARY_PORT
from cardan.protocols.ur.realtime import REALTIME_PORT
from cardan.protocols.ur.rtde import RTDE_PORT, PacketType

_HARMLESS = frozenset(
    (
        PacketType.PROTOCOL_VERSION,
        PacketType.CONTROLLER_VERSION,
        PacketType.OUTPUTS,
        PacketType.START,
        PacketType.PAUSE,
    )
)
"""Packets of a client that only reads."""

_PORTS = {
    decoded.RTDE: RTDE_PORT,
    decoded.SECOND: RTDE_PORT,
    decoded.OLD: RTDE_PORT,
    decoded.PRIMARY: PRIMARY_PORT,
    decoded.SECONDARY: SECONDARY_PORT,
    decoded.REALTIME: REALTIME_PORT,
    "dashboard": DASHBOARD_PORT,
}


class UrRtdeSuite(Suite[decoded.UrTraffic]):
    """A Universal Robots controller of an e-Series or CB3."""

    name = "ur-rtde"
    judges = "the controller"
    speaks = "RTDE, client interfaces and programs, and the dashboard, on five TCP ports"
    target = (
        "HOST[:PORT] of the controller; PORT is that of RTDE, 30004, the client interfaces lie 1 "
        "to 3 and the dashboard 5 below it"
    )
    home = "127.0.0.1"
    """Our address, as the target reaches it."""
    peer = "ur"
    requirements = requires.all()
    transport = SuiteTransport(
        "tcp",
        {**_PORTS, decoded.REVERSE: REVERSE_PORT},
        frozenset((decoded.REVERSE,)),
        frozenset((decoded.SECOND, decoded.OLD)),
    )
    decode = decoded.UrTraffic
    simulation = "cardan.conform.ur_rtde.simulated:UrSimulation"
    seconds = 3.0
    # Times, s, in the hold; before it most faults would only keep the program from starting.
    fault_test_values: ClassVar[Mapping[str, float]] = dict.fromkeys(
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

    def scenario(self, level: Level, seconds: float) -> UrScenario:
        return UrScenario(level, seconds, self.home)

    def wires(self, target: str) -> Wires:
        host, port = host_and_port(target, "--target", RTDE_PORT)
        if port <= RTDE_PORT - DASHBOARD_PORT:
            raise ConfigurationError("--target", f"{target!r}: no port lies 5 below {port}")
        with contextlib.suppress(OSError):  # The first wire reports the error.
            self.home = address_towards(host, port)
        ports = {name: port + each - RTDE_PORT for name, each in _PORTS.items()}
        ours = {decoded.REVERSE: REVERSE_PORT}
        return TcpPorts(host, ports | ours, ours, self.home)

    def only_asks(self, event: WireEvent) -> bool:
        if event.channel == "dashboard":
            return event.data in map(request, (*ASKING, *WORDED))
        return event.channel.startswith(decoded.RTDE) and event.data[2] in _HARMLESS
