"""Suite of a controller that speaks Externally Guided Motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.egm.decoded import EgmTraffic
from cardan.conform.egm.requirements import requires
from cardan.conform.egm.scenario import EgmScenario
from cardan.conform.suite import Suite, SuiteTransport

PORT = 6510


class EgmSuite(Suite[EgmTraffic]):
    """An ABB controller in Externally Guided Motion."""

    name = "egm"
    judges = "the controller"
    speaks = "EGM: protobuf on UDP, 250 Hz"
    target = "[HOST]:PORT to listen at, as the controller's UdpUc device has it; 0.0.0.0:6510"
    peer = "abb-gofa"
    requirements = requires.all()
    transport = SuiteTransport("udp", {"": PORT}, frozenset(("",)))
    decode = EgmTraffic
    scenario = EgmScenario
    simulation = "cardan.conform.egm.simulated:EgmSimulation"
    seconds = 3.0
    # Times, s, in the hold.
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "pause": 0.9,
        "restart": 3.0,
        "estop": 3.0,
        "motors-off": 3.0,
    }
