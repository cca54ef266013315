"""The suite of a client that moves an arm over the joint stream."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Scenario
from cardan.conform.suite import Suite, SuiteTransport
from cardan_conform_arms.joint_stream.decoded import JointStreamTraffic
from cardan_conform_arms.joint_stream.suite import PORT
from cardan_conform_arms.joint_stream_driver.faults import FAULTS
from cardan_conform_arms.joint_stream_driver.requirements import requires


class JointStreamDriver(Suite[JointStreamTraffic]):
    """A driver of a UR5 over the joint stream: Cardan is the arm, and nothing real moves."""

    name = "joint-stream-driver"
    judges = "the driver"
    speaks = "joint stream on UDP, 125 Hz"
    target = "[HOST]:PORT to listen at, 0.0.0.0:6520"
    peer = "sim_arm"
    harmless = Level.HOLD
    requirements = requires.all()
    transport = SuiteTransport("udp", {"": PORT}, frozenset(("",)))
    decode = staticmethod(partial(JointStreamTraffic, arm_sends=True))
    simulation = "cardan_conform_arms.joint_stream_driver.simulated:JointStreamDriverSimulation"
    own_faults = FAULTS
    seconds = 0.8
    # Traffic at the end of the driver, which only level 3 includes.
    tried_on: ClassVar[Mapping[str, Level]] = {"leaves-moving": Level.BY_HAND}

    def scenario(self, level: Level, seconds: float) -> Scenario:
        # The simulated arm needs the extra cardan[arm]; checking its traffic does not.
        from cardan_conform_arms.joint_stream_driver.scenario import ArmScenario

        return ArmScenario(level, seconds)
