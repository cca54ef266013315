"""The suite of a client that moves an arm by MotoROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.conduct import Conduct
from cardan.conform.motoros_driver.faults import FAULTS
from cardan.conform.motoros_driver.pilot import ControllerPilot
from cardan.conform.motoros_driver.requirements import requires
from cardan.conform.motoros_driver.rig import MotorosDriverRig
from cardan.conform.motoros_driver.seen import DriverSeen
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, Transport
from cardan.conform.timeline import Timeline
from cardan.conform.wires import ListenTcp, Wires, host_and_port
from cardan.protocols.simple_message import IO_PORT, MOTION_PORT, STATE_PORT
from cardan.sim_peers.base import FaultSwitch


class MotorosDriver(Suite[DriverSeen]):
    """A driver of a Motoman GP8 under MotoROS: Cardan is the controller, first one with velocity
    mode, then an FS100, then a YRC1000, and nothing real moves."""

    name = "motoros-driver"
    judges = "the driver"
    speaks = "simple message on three TCP ports"
    target = "[HOST]:PORT to listen at for motion, 0.0.0.0:50240; the next two follow it"
    peer = "motoros"
    harmless = Level.HOLD
    requirements = requires.all()
    transport = Transport(
        "tcp",
        {"motion": MOTION_PORT, "state": STATE_PORT, "io": IO_PORT},
        frozenset(("motion", "state", "io")),
    )
    seconds = 0.6
    # Seen where it is ended, which only level 3 does.
    tried_on: ClassVar[Mapping[str, Level]] = {
        "leaves-moving": Level.BY_HAND,
        "leaves-mode-on": Level.BY_HAND,
        "stays": Level.BY_HAND,
    }

    def see(self, timeline: Timeline) -> DriverSeen:
        return DriverSeen(timeline)

    def pilot(self, level: Level, seconds: float) -> ControllerPilot:
        return ControllerPilot(level, seconds)

    def simulate(self, conduct: Conduct, faults: Mapping[str, float], seed: int) -> None:
        MotorosDriverRig(conduct, faults).run()

    def wires(self, target: str) -> Wires:
        host, port = host_and_port(target, "--target", MOTION_PORT)
        ports = {"motion": port, "state": port + 1, "io": port + 2}
        return ListenTcp(host or "0.0.0.0", ports)

    def switches(self) -> tuple[FaultSwitch, ...]:
        return FAULTS
