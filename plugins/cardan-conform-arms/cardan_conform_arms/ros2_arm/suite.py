"""The suite of an arm under ros2_control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.transports import Wires
from cardan_conform_arms.ros2_arm.decoded import RosArmTraffic
from cardan_conform_arms.ros2_arm.names import TOPICS
from cardan_conform_arms.ros2_arm.requirements import requires
from cardan_conform_arms.ros2_arm.scenario import RosArmScenario


class Ros2Arm(Suite[RosArmTraffic]):
    """An arm under ros2_control: joint_state_broadcaster and forward_command_controller."""

    name = "ros2-arm"
    judges = "the arm"
    speaks = "ROS 2 messages (CDR) on rmw_zenoh"
    target = "the Zenoh router to meet it by, as tcp/127.0.0.1:7447"
    peer = "ros2-arm"
    requirements = requires.all()
    transport = SuiteTransport("other")
    decode = RosArmTraffic
    scenario = RosArmScenario
    simulation = "cardan_conform_arms.ros2_arm.simulated:RosArmSimulation"
    seconds = 2.6
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "restart": 1.5,
        "stale": 1.5,
        "wrong-names": 1.5,
        "missing": 1.5,
        "inactive": 1.5,
    }

    def wires(self, target: str) -> Wires:
        # Zenoh is installed with the extra cardan[network].
        from cardan_conform_arms.ros2_arm.wire import RosWires

        return RosWires(target, TOPICS)
