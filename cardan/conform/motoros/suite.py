"""Suite of a controller that runs MotoROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.motoros.decoded import MotorosTraffic
from cardan.conform.motoros.requirements import requires
from cardan.conform.motoros.scenario import MotorosScenario
from cardan.conform.suite import Suite, SuiteTransport
from cardan.protocols.simple_message.codes import IO_PORT, MOTION_PORT, STATE_PORT


class MotorosSuite(Suite[MotorosTraffic]):
    """A Motoman controller that runs MotoROS, in trajectory mode and in velocity mode."""

    name = "motoros"
    judges = "the controller"
    speaks = "simple message on three TCP ports"
    target = "HOST[:PORT] of the controller; PORT is that of motion, 50240, the next two follow it"
    peer = "motoman-gp8"
    requirements = requires.all()
    transport = SuiteTransport("tcp", {"motion": MOTION_PORT, "state": STATE_PORT, "io": IO_PORT})
    decode = MotorosTraffic
    scenario = MotorosScenario
    simulation = "cardan.conform.motoros.simulated:MotorosSimulation"
    seconds = 3.2
    # The functional safety unit's limit must lie below the speed of a micro-motion.
    fault_test_values: ClassVar[Mapping[str, float]] = {"fsu": 0.001}
    undetectable_faults: ClassVar[Mapping[str, str]] = {
        "merge": "TCP keeps no boundaries of writes: a reader cannot tell one write of two "
        "messages from two writes that it read at once",
    }
