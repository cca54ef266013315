"""Suite of a client that moves an arm by MotoROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.motoros_driver.decoded import DriverTraffic
from cardan.conform.motoros_driver.requirements import requires
from cardan.conform.motoros_driver.scenario import MotorosControllerScenario
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, SuiteTransport
from cardan.protocols.simple_message.codes import IO_PORT, MOTION_PORT, STATE_PORT
from cardan.sim_peers.motoros_client import FAULTS


class MotorosDriverSuite(Suite[DriverTraffic]):
    """A driver of a Motoman GP8 under MotoROS: Cardan is the controller, first one with velocity
    mode, then an FS100, then a YRC1000, and nothing real moves."""

    name = "motoros-driver"
    judges = "the driver"
    speaks = "simple message on three TCP ports"
    target = "[HOST]:PORT to listen at for motion, 0.0.0.0:50240; the next two follow it"
    peer = "motoros"
    harmless = Level.HOLD
    requirements = requires.all()
    transport = SuiteTransport(
        "tcp",
        {"motion": MOTION_PORT, "state": STATE_PORT, "io": IO_PORT},
        frozenset(("motion", "state", "io")),
    )
    decode = DriverTraffic
    scenario = MotorosControllerScenario
    simulation = "cardan.conform.motoros_driver.simulated:MotorosDriverSimulation"
    own_faults = FAULTS
    seconds = 0.6
    # These faults show when the driver is ended, which only level 3 does.
    tried_on: ClassVar[Mapping[str, Level]] = {
        "leaves-moving": Level.BY_HAND,
        "leaves-mode-on": Level.BY_HAND,
        "stays": Level.BY_HAND,
    }
