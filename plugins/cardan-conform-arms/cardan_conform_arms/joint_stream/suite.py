"""The suite of an arm that speaks the joint stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.suite import Suite, SuiteTransport
from cardan_conform_arms.joint_stream.decoded import JointStreamTraffic
from cardan_conform_arms.joint_stream.requirements import requires
from cardan_conform_arms.joint_stream.scenario import JointStreamScenario

PORT = 6520


class JointStream(Suite[JointStreamTraffic]):
    """An arm that is commanded joint by joint, as Cardan's own simulated arm is."""

    name = "joint-stream"
    judges = "the controller"
    speaks = "joint stream on UDP"
    target = "HOST[:PORT] of the controller, 6520"
    peer = "arm"
    requirements = requires.all()
    transport = SuiteTransport("udp", {"": PORT})
    decode = JointStreamTraffic
    scenario = JointStreamScenario
    simulation = "cardan_conform_arms.joint_stream.simulated:JointStreamSimulation"
    seconds = 2.0
    # Beyond the cycle of the simulation; while it is held; below the speed of a micro-motion.
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "jitter": 20.0,
        "silence": 3.0,
        "restart": 2.0,
        "estop": 2.0,
        "slow": 0.0002,
    }
