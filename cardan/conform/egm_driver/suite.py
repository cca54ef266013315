"""Suite of a driver that guides a controller over EGM."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import ClassVar

from cardan.conform.egm.decoded import EgmTraffic
from cardan.conform.egm.suite import PORT
from cardan.conform.egm_driver.requirements import requires
from cardan.conform.egm_driver.scenario import FIRST, SECOND, EgmControllerScenario
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, SuiteTransport
from cardan.sim_peers.egm_client import FAULTS


class EgmDriverSuite(Suite[EgmTraffic]):
    """A driver that guides an ABB controller: Cardan is the controller, and nothing real moves."""

    name = "egm-driver"
    judges = "the driver"
    speaks = "EGM: protobuf on UDP, 250 Hz"
    target = "HOST[:PORT] of the PC at which the driver listens, 6510"
    peer = "abb_egm"
    harmless = Level.HOLD
    requirements = requires.all()
    transport = SuiteTransport("udp", {FIRST: PORT, SECOND: PORT})
    decode = staticmethod(partial(EgmTraffic, robot_sends=True))
    scenario = EgmControllerScenario
    simulation = "cardan.conform.egm_driver.simulated:EgmDriverSimulation"
    own_faults = FAULTS
    seconds = 0.6
    # These faults show when the driver is ended, which only level 3 does.
    tried_on: ClassVar[Mapping[str, Level]] = {"leaves-moving": Level.BY_HAND}
